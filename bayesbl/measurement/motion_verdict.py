"""What a motion shows of its gap."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bayesbl.bench.kernel import Slot
from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.motions import flank_changes, remembered_start
from bayesbl.matching.observed import standstills
from bayesbl.matching.posterior import DirectPosterior
from bayesbl.matching.signals import GAP, REFERENCE_DELAY
from bayesbl.measurement.measurement import UPPER_BOUND_LEVEL, Reason
from bayesbl.probabilities import TOO_FEW
from bayesbl.units import RPM_PER_RAD_PER_S

EXCLUDED_END = 0.1
"""A recording excludes an end of the range of ln δ if the outer ``EXCLUDED_END`` of it holds less
than ``TOO_FEW`` of the posterior (a flat posterior: 0.1). Then δ has a bound."""

REMEMBERED = 1.0
"""Largest χ² that an unknown start may leave: it moves δ by at most one standard deviation."""


def unseen_gap(posterior: DirectPosterior, index: int) -> Reason | None:
    """Why a motion does not determine δ of a recording, with the bound it leaves; ``None`` if it
    does or turns at constant speed."""
    fit = posterior.fit
    observation = fit.model.recordings[index]
    if observation.motion is None or flank_changes(fit, index):
        return None
    values: dict[str, float | bool] = {"pull_rpm_per_s": largest_pull(fit, index)}
    is_larger, is_smaller = excluded_ends(posterior, observation.name)
    if is_larger != is_smaller:
        share = 1.0 - UPPER_BOUND_LEVEL if is_larger else UPPER_BOUND_LEVEL
        bound_rad = float(np.quantile(posterior.values(GAP, observation.name), share))
        values |= {"is_larger": is_larger, "level": UPPER_BOUND_LEVEL, "bound_rad": bound_rad}
    return Reason("gap_unseen", values)


def unknown_start(fit: SimulatedFit, index: int) -> Reason | None:
    """Why the unknown start of a motion leaves δ unknown; ``None`` if it does not."""
    observation = fit.model.recordings[index]
    if (
        observation.motion is None
        or remembered_start(fit, index)[observation.first_compared] <= REMEMBERED
    ):
        return None
    return Reason("start_unknown")


def largest_pull(fit: SimulatedFit, index: int) -> float:
    """Smallest motor acceleration, rpm/s, that would lift the load off its flank anywhere in this
    motion: the minimum of N |m g l sin(θ + φ_g)| / J_l."""
    model, observation = fit.model, fit.model.recordings[index]
    assert observation.motion is not None
    row = model.vectors(fit.point[None], observation)[0]
    time = np.arange(observation.samples) / observation.sampling_hz
    angle = row[Slot.start_angle_rad] + observation.motion.position_rad(time) / row[Slot.gear_ratio]
    pull = np.abs(row[Slot.gravity_torque_nm] * np.sin(angle + row[Slot.gravity_angle_rad]))
    smallest = row[Slot.gear_ratio] * pull.min() / row[Slot.load_inertia_kg_m2]
    return float(smallest * RPM_PER_RAD_PER_S)


def excluded_ends(posterior: DirectPosterior, recording: str) -> tuple[bool, bool]:
    """Whether a recording excludes the lower and the upper end of the range of its δ."""
    model = posterior.fit.model
    place = model.index(GAP, recording)
    unknown, draws = model.unknowns[place], posterior.draws[..., place]
    end = EXCLUDED_END * (unknown.high - unknown.low)
    at_low = float(np.mean(draws < unknown.low + end))
    at_high = float(np.mean(draws > unknown.high - end))
    return at_low < TOO_FEW, at_high < TOO_FEW


def motion_notes(fit: SimulatedFit, index: int) -> Iterator[Reason]:
    """Yield notes on how a motion was compared."""
    observation = fit.model.recordings[index]
    if observation.motion is None:
        return
    if observation.cycle is None:
        yield Reason("motion_once")
    if all(u.name != REFERENCE_DELAY for u in fit.model.unknowns):
        yield Reason("reference_held")
    first_compared = observation.first_compared
    at_rest = standstills(observation, fit.model.bench)[first_compared:]
    if (
        observation.excluded is not None
        and at_rest.any()
        and observation.excluded[first_compared:][at_rest].all()
    ):
        yield Reason("standstills_left_out")
    if first_compared > 0:
        yield Reason("start_left_out", {"begin_s": first_compared / observation.sampling_hz})
