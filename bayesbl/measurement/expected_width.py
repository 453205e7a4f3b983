"""How precisely recordings would give the gap, by their bench and their noise, before any fit.

Near the truth everything is linear, so the width of a posterior is known from the derivatives of
the simulation and the noise, which rotations of a recording show by how they differ. Laws that the
bench may lack and drift are in it, as they are in an answer; a bench that is wrong is not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.matching.least_squares import fit_at
from bayesbl.matching.motions import noise_of
from bayesbl.matching.observed import Observed, marginalising_motor_lines
from bayesbl.matching.signals import GAP, SimulatedSignals, Unknown
from bayesbl.measurement.measurement import ExpectedSd
from bayesbl.model_search.always_in import Direction, linearised_fit

DRAWS = 1000
"""Of what is marginalised: they tell a standard deviation to 2 %."""


def expected_sds(
    bench: Bench,
    recordings: Sequence[Observed],
    unknowns: Sequence[Unknown],
    among: Sequence[Direction],
    gaps_rad: Sequence[float],
) -> list[ExpectedSd]:
    """What an answer would be known to, at each of these gaps.

    Parameters
    ----------
    recordings
        At constant speed; only their noise, length and speed count.
    unknowns, among
        Of a fit, with a gap for each recording, and what is marginalised beside it.

    Raises
    ------
    RecordingError
        If a recording is too short to tell its noise.
    SimulationError
        If the bench cannot be simulated at one of the gaps.
    """
    noise = [noise_of(observations, observations.signals) for observations in recordings]
    observations = [marginalising_motor_lines(one, bench) for one in recordings]
    model = SimulatedSignals(bench, observations, unknowns, noise, 1)
    return [_at(model, gap_rad, among) for gap_rad in gaps_rad]


def _at(model: SimulatedSignals, gap_rad: float, among: Sequence[Direction]) -> ExpectedSd:
    gaps = [k for k, unknown in enumerate(model.unknowns) if unknown.name == GAP]
    point = np.array([_expected_value(unknown) for unknown in model.unknowns])
    point[gaps] = [float(model.unknowns[k].coordinate(np.array(gap_rad))) for k in gaps]
    model.require(point)
    # As if the recordings were the simulation's own, so that nothing is left but noise.
    own = [
        replace(observation, signals=model.signals(point, place)[0])
        for place, observation in enumerate(model.recordings)
    ]
    fit = fit_at(replace(model, recordings=own), point)
    drawn = linearised_fit(fit, among).posterior.draw(np.random.default_rng(0), DRAWS).shift
    covariance = fit.covariance + np.cov(drawn.T)
    slope_rad = float(model.unknowns[gaps[0]].slope(np.array(gap_rad)))

    def sd_rad(toward: Mapping[int, float]) -> float:
        weights = np.zeros(point.size)
        weights[list(toward)] = list(toward.values())
        return slope_rad * math.sqrt(float(weights @ covariance @ weights))

    first, last = gaps[0], gaps[-1]
    change = sd_rad({first: -1.0, last: 1.0}) if last != first else None
    return ExpectedSd(gap_rad, max(sd_rad({k: 1.0}) for k in gaps), change)


def _expected_value(unknown: Unknown) -> float:
    """Of what is at least none, its prior's mean: at none its other side would be missed."""
    if unknown.low == unknown.centre and math.isfinite(unknown.sd):
        return unknown.centre + unknown.sd * math.sqrt(2.0 / math.pi)
    return unknown.middle
