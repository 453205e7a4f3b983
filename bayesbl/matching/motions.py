"""Recordings of motions beside their simulation: noise, start angles, changes of flank."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bayesbl.bench.kernel import CURRENT, SPEED, TWIST, Slot
from bayesbl.bench.simulation import simulate_motions
from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.observed import FAST_S, Observed, begin_of
from bayesbl.matching.signals import START_ANGLE, SimulatedSignals
from bayesbl.noise.channel_noise import ChannelNoise, estimate_channel_noise, estimate_fast_noise
from bayesbl.recording.types import BoolArray, FloatArray

LOADED_SHARE = 0.05
"""Of gravity's largest torque, that presses the teeth together at a start without doubt: a bearing
that a bench calls free of friction may still hold some per cent."""

ANGLES_SCANNED = 36
REFINEMENTS = 3
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

    The angle is sought once: the gap moves the load by a thousandth of a radian, gravity tells its
    angle no better than that before the fit.
    """
    seen, noise = model.recordings[recording], model.noise[recording]
    weight = 1.0 / noise.sd**2
    scanned = begin_of(seen) + max(seen.cycle or 0, round(SCANNED_S * seen.sampling_hz))
    compared = np.ones(seen.samples) if seen.excluded is None else 1.0 - seen.excluded
    compared, signals = compared[:scanned], seen.signals[:, :scanned]
    motion = seen.motion
    assert motion is not None

    def left(settings_of: FloatArray, angles: FloatArray | None) -> FloatArray:
        settings = model.settings_of(settings_of, seen)
        if angles is not None:
            settings = settings | {START_ANGLE: angles}
        matrix = model.bench.vector(**settings)
        rows = max(len(settings_of), 1 if angles is None else angles.size)
        if len(matrix) < rows:
            matrix = np.repeat(matrix, rows, axis=0)
        simulated = simulate_motions(
            matrix,
            motion,
            compared.size,
            seen.sampling_hz,
            workers=model.workers,
            failures="nan",
        )[:, [SPEED, CURRENT][: len(seen.signals)]]
        cost = np.einsum("c,mcn,n->m", weight, (signals - simulated) ** 2, compared)
        cost *= seen.samples / compared.size
        return np.where(np.isfinite(cost), cost, np.inf)

    middle = points[len(points) // 2 : len(points) // 2 + 1]
    names = [(u.name, u.recording) for u in model.unknowns]
    if (START_ANGLE, seen.name) not in names or model.bench.value("gravity_torque_nm") == 0.0:
        return np.zeros(len(points)), left(points, np.zeros(len(points)))
    width = 2.0 * math.pi / ANGLES_SCANNED
    grid: FloatArray = np.arange(float(ANGLES_SCANNED)) * width
    cost = left(middle, grid)
    valleys = np.flatnonzero((cost <= np.roll(cost, 1)) & (cost <= np.roll(cost, -1)))
    best = grid[valleys[np.argsort(cost[valleys])][:2]]
    for _ in range(REFINEMENTS):
        width /= 4.0
        tried = (best[:, None] + width * np.arange(-3.0, 4.0)).ravel()
        costs = left(middle, tried).reshape(best.size, -1)
        best = tried.reshape(best.size, -1)[np.arange(best.size), np.argmin(costs, axis=1)]
    costs = np.stack([left(points, np.full(len(points), angle)) for angle in best])
    chosen = np.argmin(costs, axis=0)
    return best[chosen], costs[chosen, np.arange(len(points))]


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
