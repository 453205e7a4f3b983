"""Expected uncertainty of the gap, from bench and noise of recordings, before any fit.

The posterior is linearised at the true value. Its width follows from the derivatives of the
simulation and from the noise, which is estimated from the differences between rotations, or
between cycles of a motion. Laws that
the bench may lack and drift are included, as in an answer. The error of a wrong bench is not.
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
"""Draws of the marginalised directions: they give a standard deviation to 2 %."""


def expected_sds(
    bench: Bench,
    recordings: Sequence[Observed],
    unknowns: Sequence[Unknown],
    among: Sequence[Direction],
    gaps_rad: Sequence[float],
) -> list[ExpectedSd]:
    """Expected posterior standard deviations at each of these gaps.

    Parameters
    ----------
    recordings
        At constant speed, or motions that repeat. Only noise, length and motion matter.
    unknowns, among
        Unknowns of a fit, with a gap for each recording, and the directions marginalised with them.

    Raises
    ------
    RecordingError
        If a recording is too short to estimate its noise.
    SimulationError
        If the bench cannot be simulated at one of the gaps.
    """
    noise = [noise_of(observations, observations.signals) for observations in recordings]
    observations = [marginalising_motor_lines(recording, bench) for recording in recordings]
    model = SimulatedSignals(bench, observations, unknowns, noise, 1)
    return [_at(model, gap_rad, among) for gap_rad in gaps_rad]


def _at(model: SimulatedSignals, gap_rad: float, among: Sequence[Direction]) -> ExpectedSd:
    gaps = [k for k, unknown in enumerate(model.unknowns) if unknown.name == GAP]
    point = np.array([_expected_value(unknown) for unknown in model.unknowns])
    point[gaps] = [float(model.unknowns[k].coordinate(np.array(gap_rad))) for k in gaps]
    model.require(point)
    # Use the simulation itself as data, so that the residuals are zero.
    simulated = [
        replace(observation, signals=model.signals(point, place)[0])
        for place, observation in enumerate(model.recordings)
    ]
    fit = fit_at(replace(model, recordings=simulated), point)
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
    """Mean of the prior for a one-sided unknown, else its middle. At its bound, derivatives toward
    the other side would be missed."""
    if unknown.low == unknown.centre and math.isfinite(unknown.sd):
        return unknown.centre + unknown.sd * math.sqrt(2.0 / math.pi)
    return unknown.middle
