"""Comparing motions with their simulation: noise, start angles, flank changes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from bayesbl.bench.kernel import TWIST, Slot
from bayesbl.bench.simulation import simulate_motions
from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.observed import FAST_S, Observed
from bayesbl.matching.signals import AT_ONCE, GAP, START_ANGLE, SimulatedSignals
from bayesbl.noise.channel_noise import (
    HIGHEST_ORDER,
    ChannelNoise,
    estimate_channel_noise,
    estimate_fast_noise,
)
from bayesbl.recording.types import BoolArray, FloatArray

LOADED_SHARE = 0.05
"""Share of the largest torque in a motion that surely presses the teeth together at its start: a
bearing that a bench calls frictionless may hold some per cent."""

ANGLES_SCANNED = 36
ANGLES_REFINED = 4
REFINEMENTS = 2
FINE_ANGLE = 2.0 * math.pi / ANGLES_SCANNED / 4.0 ** (REFINEMENTS + 1)
ANGLES_KEPT = 2
"""Angles of a motion by its speed alone: gravity distinguishes them by the current."""
PAIR_REFINEMENTS = 2
ABOUT = np.arange(-3.0, 4.0)
"""Neighbours of the best point of a coarser grid, in steps of a finer one, a quarter as long."""
BESIDE = np.arange(-2.0, 3.0)
"""The same in steps of the coarser grid, and of one half as long."""
GAPS_SCANNED = 12
GAPS_SCANNED_FINELY = 96
"""Steps of 5 %: χ² of a motion has a local minimum for each sequence of impacts."""
VALLEYS_FITTED = 4
ANGLE_STEP_RAD = 1e-3
"""Smaller than the load's move on a changed flank, larger than shows the simulator's error."""
SHIFTS = 2
"""Newton steps to the start angle that makes the other flank's motion most alike."""
SCANNED_S = 4.0
"""Length of a motion used for scans, or one cycle if that is longer, after the excluded start."""

_Scan = Callable[[int, FloatArray], tuple[FloatArray, FloatArray]]
"""From a number of gaps and start angles (k,) to points (k, m, d) and their χ² (k, m)."""


def noise_of(observation: Observed, residual: FloatArray) -> ChannelNoise:
    """Noise model of a recording from its residual, shape (c, n), whether it repeats or not.

    Raises
    ------
    RecordingError
        If the residual is too short.
    """
    rounding = None
    if observation.rounding:
        simulated = observation.signals - residual
        rows = zip(observation.rounding[: len(residual)], simulated, residual, strict=True)
        rounding = np.stack([r.autocovariance(a, b, HIGHEST_ORDER + 1) for r, a, b in rows])
    if observation.motion is None:
        return estimate_channel_noise(residual, observation.lag, rounding=rounding)
    mask = None if observation.excluded is None else ~observation.excluded
    if observation.cycle is None:
        samples = round(FAST_S * observation.sampling_hz)
        return estimate_fast_noise(residual, samples, mask, rounding)
    return estimate_channel_noise(residual, observation.cycle, mask, rounding)


def remembered_start(fit: SimulatedFit, index: int) -> FloatArray:
    """Remaining effect, from each sample on, of the flank that a motion began on, shape (n,).

    χ² between the simulations from either flank. A fit that begins on the wrong flank is off by at
    most its root, in standard deviations of any quantity, if the noise is white. The part that an
    unknown start angle absorbs is subtracted, and excluded samples do not count. Zero if the torque
    at the start decides the flank.
    """
    model, observation = fit.model, fit.model.recordings[index]
    assert observation.motion is not None
    row = model.vectors(fit.point[None], observation)
    size = observation.samples, observation.sampling_hz
    twist = np.abs(simulate_motions(row, observation.motion, *size, states=True)[0, TWIST])
    pressed = twist - row[0, Slot.gap_rad] - row[0, Slot.backlash__gap_rad]
    if pressed[0] > LOADED_SHARE * pressed.max():
        return np.zeros(observation.samples)
    motion = observation.motion

    def signals(shift_rad: float, flank: float) -> FloatArray:
        moved = row.copy()
        moved[0, Slot.start_angle_rad] += shift_rad
        return simulate_motions(moved, motion, *size, start_flank=flank)[0, observation.rows]

    weight = observation.compared / model.noise[index].sd[:, None] ** 2
    forward = signals(0.0, 1.0)
    if _angle_place(model, index) is None:
        return _from_each_sample_on(weight * (forward - signals(0.0, -1.0)) ** 2)
    column = (signals(ANGLE_STEP_RAD, 1.0) - forward) / ANGLE_STEP_RAD
    shift = 0.0
    for _ in range(SHIFTS):
        difference = forward - signals(shift, -1.0)
        shift += float(np.sum(weight * difference * column) / np.sum(weight * column**2))
    difference = forward - signals(shift, -1.0)
    taken = _from_each_sample_on(weight * difference * column) ** 2
    of_column = _from_each_sample_on(weight * column**2)
    remembered = _from_each_sample_on(weight * difference**2)
    remembered -= np.divide(taken, of_column, out=np.zeros(remembered.size), where=of_column > 0.0)
    return remembered


def _from_each_sample_on(values: FloatArray) -> FloatArray:
    """Sum over all channels from each sample to the end, (c, n) to (n,)."""
    total: FloatArray = np.cumsum(values.sum(axis=0)[::-1])[::-1]
    return total


def start_angles(
    model: SimulatedSignals, points: FloatArray, recording: int
) -> tuple[FloatArray, FloatArray]:
    """Best start angle of a motion and χ² at each point, (m, d) to (m,) each.

    The angle is sought once, at the middle point: the gap moves the load by a thousandth of a
    radian, and before the fit gravity shows the angle no better.
    """
    index = _angle_place(model, recording)
    if index is None:
        return np.zeros(len(points)), _rough_chi_square(model, points, recording)
    width, best, reach = 2.0 * math.pi / ANGLES_SCANNED, 0.0, np.arange(float(ANGLES_SCANNED))
    for _ in range(REFINEMENTS + 2):
        trials = np.repeat(points[len(points) // 2][None], reach.size, axis=0)
        trials[:, index] = best + width * reach
        best = float(trials[int(np.argmin(_rough_chi_square(model, trials, recording))), index])
        width, reach = width / 4.0, ABOUT
    trials = points.copy()
    trials[:, index] = best
    return trials[:, index], _rough_chi_square(model, trials, recording)


def motion_starts(model: SimulatedSignals, start: FloatArray) -> list[FloatArray]:
    """Starting points for the fit of a single motion, best first, by scans of gap and start angle.

    The angle is refined over the whole range of the gap, because gravity moves the current by more
    than any gap. Then both are scanned finely around the best angles: a milliradian moves the
    impacts to another local minimum of the gap.

    Parameters
    ----------
    model
        Model of this one recording.
    start
        Shape (d,): values of everything else.
    """
    name = model.recordings[0].name
    gap_index = model.index(GAP, name)
    angle_index = _angle_place(model, 0)

    def scanned(gaps: int, angles: FloatArray) -> tuple[FloatArray, FloatArray]:
        grid = np.linspace(model.low[gap_index], model.high[gap_index], gaps)
        trials = np.repeat(start[None], gaps * angles.size, axis=0)
        trials[:, gap_index] = np.tile(grid, angles.size)
        if angle_index is not None:
            trials[:, angle_index] = np.repeat(angles, gaps)
        cost = _rough_chi_square(model, trials, 0)
        return trials.reshape(angles.size, gaps, -1), cost.reshape(angles.size, gaps)

    kept = 1 if len(model.recordings[0].signals) > 1 else ANGLES_KEPT
    likely = [np.zeros(1)] if angle_index is None else _likely_angles(scanned)[:kept]
    valleys: list[tuple[float, FloatArray]] = []
    for angles in likely:
        points, costs = scanned(GAPS_SCANNED_FINELY, angles)
        valleys += [(float(costs[k]), points[k]) for k in _valleys(costs)]
    step = np.zeros(start.size)
    step[gap_index] = (model.high[gap_index] - model.low[gap_index]) / (GAPS_SCANNED_FINELY - 1)
    if angle_index is None:
        return _best(valleys, step)
    step[angle_index] = FINE_ANGLE
    for _ in range(PAIR_REFINEMENTS):
        step[angle_index] /= 4.0
        starts, valleys = _best(valleys, step), []
        about = np.zeros((BESIDE.size, ABOUT.size, start.size))
        about[..., gap_index] = step[gap_index] * BESIDE[:, None]
        about[..., angle_index] = step[angle_index] * ABOUT
        for centre in starts:
            points = np.clip(centre + about, model.low, model.high)
            cost = _rough_chi_square(model, points.reshape(-1, start.size), 0)
            costs = cost.reshape(about.shape[:2])
            valleys += [(float(costs[k]), points[k]) for k in _valleys(costs)]
        step[gap_index] /= 2.0
    return _best(valleys, step)


def _best(valleys: list[tuple[float, FloatArray]], step: FloatArray) -> list[FloatArray]:
    """Points of the lowest χ², best first, no two within a step of each other."""
    kept: list[FloatArray] = []
    for _, point in sorted(valleys, key=lambda valley: valley[0]):
        if all(np.any(np.abs(point - other) > 1.5 * step) for other in kept):
            kept.append(point)
    return kept[:VALLEYS_FITTED]


def _likely_angles(scanned: _Scan) -> list[FloatArray]:
    """Fine grids around the start angles that fit best with any gap, best first."""
    width = 2.0 * math.pi / ANGLES_SCANNED
    angles = width * np.arange(float(ANGLES_SCANNED))
    cost = scanned(GAPS_SCANNED, angles)[1].min(axis=1)
    valleys = np.flatnonzero((cost <= np.roll(cost, 1)) & (cost <= np.roll(cost, -1)))
    best = angles[valleys[np.argsort(cost[valleys])][:ANGLES_REFINED]]
    for _ in range(REFINEMENTS):
        width /= 4.0
        trials = best[:, None] + width * ABOUT
        cost = scanned(GAPS_SCANNED, trials.ravel())[1].min(axis=1).reshape(trials.shape)
        order = np.argsort(cost.min(axis=1))
        best = trials[np.arange(best.size), np.argmin(cost, axis=1)][order]
    return list(best[:ANGLES_KEPT, None] + FINE_ANGLE * ABOUT)


def _valleys(cost: FloatArray) -> list[tuple[int, int]]:
    """Local minima of a grid (k, m) among their eight neighbours."""
    neighbours = sliding_window_view(np.pad(cost, 1, constant_values=np.inf), (3, 3))
    return list(zip(*np.nonzero(cost <= neighbours.min(axis=(2, 3))), strict=True))


def _angle_place(model: SimulatedSignals, recording: int) -> int | None:
    """Index of a recording's start angle; ``None`` if it is known or without effect."""
    if not model.bench.value("gravity_torque_nm"):
        return None
    return model.place_of(START_ANGLE, model.recordings[recording].name)


def _rough_chi_square(model: SimulatedSignals, points: FloatArray, recording: int) -> FloatArray:
    """χ² of one motion with white noise, from its first seconds, (m, d) to (m,)."""
    observation = model.recordings[recording]
    assert observation.motion is not None
    scanned = observation.first_compared + max(
        observation.cycle or 0, round(SCANNED_S * observation.sampling_hz)
    )
    compared = observation.compared[:scanned].astype(np.float64)
    signals = observation.signals[:, :scanned]
    matrix = model.bench.measurement.seen_by(
        model.vectors(points, observation), observation.sampling_hz
    )
    cost = np.empty(len(points))
    for begin in range(0, len(points), AT_ONCE):
        rows = slice(begin, begin + AT_ONCE)
        simulated = simulate_motions(
            matrix[rows],
            observation.motion,
            compared.size,
            observation.sampling_hz,
            workers=model.workers,
            failures="nan",
        )[:, observation.rows]
        squares = (signals - simulated) ** 2
        cost[rows] = np.einsum("c,mcn,n->m", model.noise[recording].sd ** -2.0, squares, compared)
    cost *= observation.samples / compared.size
    return np.where(np.isfinite(cost), cost, np.inf)


@dataclass(frozen=True, slots=True)
class FlankChange:
    """Change of the load from one flank to the other.

    Attributes
    ----------
    left_s, met_s
        When the teeth separate, and when they meet on the other side, from the first sample.
    side
        Flank that is met: 1 where the motor pushes the load forward, −1 backward.
    """

    left_s: float
    met_s: float
    side: int


def flank_changes(fit: SimulatedFit, recording: int) -> list[FlankChange]:
    """All flank changes in the compared part of a motion, at the fit's optimum."""
    model, observation = fit.model, fit.model.recordings[recording]
    assert observation.motion is not None
    row = model.vectors(fit.point[None], observation)
    twist = simulate_motions(
        row, observation.motion, observation.samples, observation.sampling_hz, states=True
    )[0, TWIST]
    gap = float(row[0, Slot.gap_rad] + row[0, Slot.backlash__gap_rad])
    return changes_of(twist, gap, 1.0 / observation.sampling_hz, observation.excluded)


def changes_of(
    twist: FloatArray, gap_rad: float, period_s: float, excluded: BoolArray | None = None
) -> list[FlankChange]:
    """Flank changes in a twist, shape (n,), rad, except those that end in excluded samples."""
    side = np.where(twist > gap_rad, 1, np.where(twist < -gap_rad, -1, 0))
    touching = np.flatnonzero(side)
    before, after = touching[:-1], touching[1:]
    return [
        FlankChange(period_s * float(i), period_s * float(j), int(side[j]))
        for i, j in zip(before, after, strict=True)
        if side[i] != side[j] and (excluded is None or not excluded[j])
    ]
