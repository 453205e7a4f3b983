"""Recordings of motions beside their simulation: noise, start angles, changes of flank."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayesbl.bench.kernel import CURRENT, SPEED, TWIST, Slot
from bayesbl.bench.simulation import simulate_motions
from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.observed import FAST_S, Observed, begin_of
from bayesbl.matching.signals import GAP, START_ANGLE, SimulatedSignals
from bayesbl.noise.channel_noise import ChannelNoise, estimate_channel_noise, estimate_fast_noise
from bayesbl.recording.types import BoolArray, FloatArray

LOADED_SHARE = 0.05
"""Of gravity's largest torque, that presses the teeth together at a start without doubt: a bearing
that a bench calls free of friction may still hold some per cent."""

ANGLES_SCANNED = 36
GAPS_SCANNED = 16
GAPS_SCANNED_ALONE = 96
"""Without gravity, where there is no angle to be scanned."""
VALLEYS_REFINED = 6
VALLEYS_FITTED = 3
"""A motion has more valleys of χ² than a rotation: one for each sequence of impacts."""
REFINEMENTS = 4
AT_ONCE = 64
"""Simulated motions held in memory together."""
SCANNED_S = 4.0
"""Of a motion, behind what is left out, or one cycle if that is longer: enough to start from."""


def noise_of(seen: Observed, residual: FloatArray) -> ChannelNoise:
    """Noise from what is left of a recording, shape (c, n), where it repeats or where it does not.

    Raises
    ------
    RecordingError
        If there is too little of it.
    """
    if seen.motion is None:
        return estimate_channel_noise(residual, seen.lag)
    kept = None if seen.excluded is None else ~seen.excluded
    if seen.cycle is None:
        return estimate_fast_noise(residual, round(FAST_S * seen.sampling_hz), kept)
    return estimate_channel_noise(residual, seen.cycle, kept)


def undecided_starts(fit: SimulatedFit) -> list[int]:
    """Recordings whose first flank the bench does not decide: gravity hardly presses there."""
    found = []
    for i, seen in enumerate(fit.model.recordings):
        if seen.motion is None or begin_of(seen) > 0:
            continue
        settings = fit.model.settings_of(fit.point[None], seen)
        row = fit.model.bench.vector(**settings)[0]
        angle = row[Slot.start_angle_rad] + row[Slot.gravity_angle_rad]
        torque = abs(row[Slot.gravity_torque_nm] * math.sin(angle))
        if torque <= LOADED_SHARE * row[Slot.gravity_torque_nm]:
            found.append(i)
    return found


def start_angles(
    model: SimulatedSignals, points: FloatArray, recording: int
) -> tuple[FloatArray, FloatArray]:
    """Best start angle of a motion at each point, (m, d) to (m,), and χ² left there, (m,).

    The angle is sought once, at the middle point: the gap moves the load by a thousandth of a
    radian, gravity tells its angle no better than that before the fit.
    """
    place = _angle_place(model, recording)
    if place is None:
        return np.zeros(len(points)), _rough_chi_square(model, points, recording)
    width = 2.0 * math.pi / ANGLES_SCANNED
    tried = np.repeat(points[len(points) // 2][None], ANGLES_SCANNED, axis=0)
    tried[:, place] = width * np.arange(ANGLES_SCANNED)
    best = _refined(model, recording, tried, {place: width})
    tried = points.copy()
    tried[:, place] = best[place]
    return tried[:, place], _rough_chi_square(model, tried, recording)


def motion_starts(model: SimulatedSignals, start: FloatArray, recording: int) -> list[FloatArray]:
    """Points to fit a motion alone from, best first: its gap and its start angle by scan.

    Parameters
    ----------
    start
        Shape (d,): where everything else stands.
    """
    name = model.recordings[recording].name
    gap = next(k for k, u in enumerate(model.unknowns) if (u.name, u.recording) == (GAP, name))
    place = _angle_place(model, recording)
    angles = 1 if place is None else ANGLES_SCANNED
    gaps = GAPS_SCANNED if place is not None else GAPS_SCANNED_ALONE
    grid = np.linspace(model.low[gap], model.high[gap], gaps)
    widths = {gap: float(grid[1] - grid[0])}
    tried = np.repeat(start[None], gaps * angles, axis=0)
    tried[:, gap] = np.repeat(grid, angles)
    if place is not None:
        widths[place] = 2.0 * math.pi / angles
        tried[:, place] = np.tile(widths[place] * np.arange(angles), gaps)
    cost = _rough_chi_square(model, tried, recording).reshape(gaps, angles)
    around = [
        np.roll(np.pad(cost, ((1, 1), (0, 0)), constant_values=np.inf), (down, right), (0, 1))[1:-1]
        for down in (-1, 0, 1)
        for right in (-1, 0, 1)
        if (down, right) != (0, 0) and (angles > 1 or right == 0)
    ]
    valleys = np.flatnonzero((cost <= np.min(around, axis=0)).ravel())
    deepest = valleys[np.argsort(cost.ravel()[valleys])][:VALLEYS_REFINED]
    refined = [_refined(model, recording, tried[k : k + 1], widths) for k in deepest]
    order = np.argsort(_rough_chi_square(model, np.array(refined), recording))
    return [refined[k] for k in order[:VALLEYS_FITTED]]


def _angle_place(model: SimulatedSignals, recording: int) -> int | None:
    """Place of a recording's start angle; ``None`` where it is known or nothing depends on it."""
    key = (START_ANGLE, model.recordings[recording].name)
    names = [(u.name, u.recording) for u in model.unknowns]
    return names.index(key) if key in names and model.bench.value("gravity_torque_nm") else None


def _refined(
    model: SimulatedSignals, recording: int, points: FloatArray, widths: Mapping[int, float]
) -> FloatArray:
    """The best of some points, (m, d) to (d,), refined on ever finer grids along some coordinates.

    ``widths``: place to the step of the grid that the points are from.
    """
    cost = _rough_chi_square(model, points, recording)
    best: FloatArray = points[int(np.argmin(cost))]
    for round_ in range(1, REFINEMENTS + 1):
        meshes = np.meshgrid(
            *(best[k] + step / 3.0**round_ * np.arange(-2.0, 3.0) for k, step in widths.items())
        )
        tried = np.repeat(best[None], meshes[0].size, axis=0)
        for k, mesh in zip(widths, meshes, strict=True):
            tried[:, k] = mesh.ravel()
        best = tried[int(np.argmin(_rough_chi_square(model, tried, recording)))]
    return best


def _rough_chi_square(model: SimulatedSignals, points: FloatArray, recording: int) -> FloatArray:
    """χ² of one motion as if its noise were white, from its first seconds, (m, d) to (m,)."""
    seen = model.recordings[recording]
    assert seen.motion is not None
    scanned = begin_of(seen) + max(seen.cycle or 0, round(SCANNED_S * seen.sampling_hz))
    compared = np.ones(seen.samples) if seen.excluded is None else 1.0 - seen.excluded
    compared, signals = compared[:scanned], seen.signals[:, :scanned]
    matrix = model.bench.vector(**model.settings_of(points, seen))
    if len(matrix) < len(points):
        matrix = np.repeat(matrix, len(points), axis=0)
    cost = np.empty(len(points))
    for begin in range(0, len(points), AT_ONCE):
        rows = slice(begin, begin + AT_ONCE)
        simulated = simulate_motions(
            matrix[rows],
            seen.motion,
            compared.size,
            seen.sampling_hz,
            workers=model.workers,
            failures="nan",
        )[:, [SPEED, CURRENT][: len(seen.signals)]]
        left = (signals - simulated) ** 2
        cost[rows] = np.einsum("c,mcn,n->m", model.noise[recording].sd ** -2.0, left, compared)
    cost *= seen.samples / compared.size
    return np.where(np.isfinite(cost), cost, np.inf)


@dataclass(frozen=True, slots=True)
class FlankChange:
    """The load passes from one flank to the other.

    Attributes
    ----------
    left_s, met_s
        When the teeth part, and when they meet on the other side, from the first sample.
    side
        Of the flank met: 1 where the motor pushes the load forward, −1 backward.
    """

    left_s: float
    met_s: float
    side: int


def flank_changes(fit: SimulatedFit, recording: int) -> list[FlankChange]:
    """Every change of flank in the part of a motion that is compared, at the fit's optimum."""
    model, seen = fit.model, fit.model.recordings[recording]
    assert seen.motion is not None
    row = model.bench.vector(**model.settings_of(fit.point[None], seen))
    twist = simulate_motions(row, seen.motion, seen.samples, seen.sampling_hz, states=True)[
        0, TWIST
    ]
    gap = float(row[0, Slot.gap_rad] + row[0, Slot.backlash__gap_rad])
    return changes_of(twist, gap, 1.0 / seen.sampling_hz, seen.excluded)


def changes_of(
    twist: FloatArray, gap_rad: float, period_s: float, excluded: BoolArray | None = None
) -> list[FlankChange]:
    """Changes of flank in a twist, shape (n,), rad, but for those that end in excluded samples."""
    side = np.where(twist > gap_rad, 1, np.where(twist < -gap_rad, -1, 0))
    touching = np.flatnonzero(side)
    before, after = touching[:-1], touching[1:]
    return [
        FlankChange(period_s * float(i), period_s * float(j), int(side[j]))
        for i, j in zip(before, after, strict=True)
        if side[i] != side[j] and (excluded is None or not excluded[j])
    ]
