"""The amplitude that a measured recording would show, at every gap of a virtual bench.

Each simulated recording goes through the estimator used for measured ones (model, window, baseline,
sampling), so that curve and measurement mean the same A. The search is warm-started along the gap;
it finds the same least-squares optimum.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Literal

import numpy as np

from bayesbl.bench.bench import Bench, require_flank_change
from bayesbl.errors import CurveError
from bayesbl.recording.types import FloatArray
from bayesbl.ringing.objective import Objective
from bayesbl.ringing.optimum import exchanged, find_optimum
from bayesbl.ringing.search import refine
from bayesbl.ringing.symbols import FREQUENCY, START, DisturbanceModel

LEAST_LEAP = 0.2
"""Of ln ω: neighbours scatter by some per cent with the start angle, and leaps are to another mode
of the joint, 40 % away on the benches that had one."""

FEWEST_GAPS = 8
"""What a polynomial of the highest degree takes."""


@dataclass(frozen=True, slots=True)
class SweepSettings:
    """Over which gaps and start angles a bench is simulated, and how it is sampled.

    Attributes
    ----------
    low_rad, high_rad, count, spacing
        The gaps, ``log`` or ``linear``.
    start_angles
        Number of load angles at the first sample.
    rotations, sampling_hz
        Length in load rotations and rate of each simulated recording.
    """

    low_rad: float = 1e-4
    high_rad: float = 4e-3
    count: int = 40
    spacing: Literal["log", "linear"] = "log"
    start_angles: int = 4
    rotations: float = 5.0
    sampling_hz: float = 1000.0

    @property
    def gap_rad(self) -> FloatArray:
        """The gaps, increasing, shape (g,), rad."""
        spread = np.geomspace if self.spacing == "log" else np.linspace
        return np.asarray(spread(self.low_rad, self.high_rad, self.count))

    @property
    def start_angle_rad(self) -> FloatArray:
        """The start angles at each gap, shape (g, s), rad.

        All different, spread by the golden ratio: equal parts of a rotation are often whole numbers
        of samples, and then every recording would meet the window's end at the same point between
        samples.
        """
        number = np.arange(self.count * self.start_angles)
        turns = (0.05 + number * (math.sqrt(5.0) - 1.0) / 2.0) % 1.0
        return np.asarray(2.0 * math.pi * turns).reshape(self.count, self.start_angles)


@dataclass(frozen=True, slots=True)
class SweepRow:
    """One bench over all gaps and some start angles.

    Attributes
    ----------
    gap_rad, start_angle_rad
        Shapes (g,) and (g, s), rad.
    searched
        Optimum of the searched symbols, shape (g, s, d), in the order of ``model.searched``.
    amplitude_rpm, rmse_rpm
        Shape (g, s), rpm.
    names
        The searched symbols.
    """

    gap_rad: FloatArray
    start_angle_rad: FloatArray
    searched: FloatArray
    amplitude_rpm: FloatArray
    rmse_rpm: FloatArray
    names: tuple[str, ...]

    def on_one_branch(self, fixed: Mapping[str, float]) -> SweepRow:
        """From the gap on above which the optimum is one and the same ringing.

        Below it another oscillation fits better, and A means another thing. Where it changes over,
        ω leaps; along one branch it follows the gap far less than proportionally.

        Raises
        ------
        CurveError
            If fewer than :data:`FEWEST_GAPS` are left.
        """
        steps = np.abs(np.diff(np.log(self.symbol(FREQUENCY, fixed)[:, 0])))
        leaps = np.flatnonzero(steps > np.maximum(np.diff(np.log(self.gap_rad)), LEAST_LEAP))
        kept = slice(int(leaps[-1]) + 1 if leaps.size else 0, None)
        if leaps.size and self.gap_rad[kept].size < FEWEST_GAPS:
            raise CurveError(
                "The best fit jumps from one ringing to another, and too few gaps lie beyond.",
                where=f"δ = {self.gap_rad[leaps[-1]]:.3g} to {self.gap_rad[leaps[-1] + 1]:.3g} rad",
                found=f"{self.gap_rad[kept].size} gaps",
                expected=f"at least {FEWEST_GAPS}; larger gaps, or another bench",
            )
        rows = {f.name: getattr(self, f.name)[kept] for f in fields(self) if f.name != "names"}
        return replace(self, **rows)

    def symbol(self, name: str, fixed: Mapping[str, float]) -> FloatArray:
        """A searched or fixed symbol, shape (g, s)."""
        if name in fixed:
            return np.full_like(self.amplitude_rpm, fixed[name])
        return np.asarray(self.searched[:, :, self.names.index(name)])


def sweep_nominal(
    bench: Bench,
    model: DisturbanceModel,
    settings: SweepSettings,
    generator: np.random.Generator,
    workers: int = 1,
) -> SweepRow:
    """The nominal bench: a full search at the largest gap, then down the gaps of one branch.

    At every gap the optimum is also sought where both pulses start half a ringing off and change
    places, the other candidate for the least sum of squares.

    Raises
    ------
    BenchError
        If the load stays on one tooth flank, or a simulation fails.
    """
    require_flank_change(bench)
    angles = settings.start_angle_rad
    objectives = _objectives(bench, model, settings, settings.gap_rad, angles, workers)
    point = find_optimum(objectives[-1][0], "guess", generator).searched
    searched = np.empty((*angles.shape, point.size))
    trend = np.zeros_like(point)
    for g in reversed(range(settings.count)):
        first, last = objectives[g][0], point
        if g < settings.count - 1:
            point = _turned(model, point, angles[g, 0] - angles[g + 1, 0], bench)
            last = point
        # The trend alone could lead on and on to where there is no ringing.
        starts = [point + trend, point, *exchanged(model, point + trend)]
        ends = np.array([refine(first, start) for start in starts])
        best = int(np.argmin(first.sum_of_squares(ends)))
        point = ends[best]
        is_same = best < 2 and g < settings.count - 1
        trend = point - last if is_same else np.zeros_like(point)
        for s, angle in enumerate(angles[g]):
            start = _turned(model, point, angle - angles[g, 0], bench)
            searched[g, s] = point if s == 0 else refine(objectives[g][s], start)
    row = _row(model, settings.gap_rad, angles, objectives, searched)
    return row.on_one_branch(model.fixed)


def sweep_like(
    bench: Bench,
    nominal: SweepRow,
    model: DisturbanceModel,
    settings: SweepSettings,
) -> SweepRow:
    """A bench near the nominal one, first start angles only, warm-started from the nominal sweep.

    Uses the nominal sweep's start angles, so that their scatter cancels in the difference.
    """
    angles = nominal.start_angle_rad[:, :1]
    objectives = _objectives(bench, model, settings, nominal.gap_rad, angles, 1)
    searched = np.empty_like(nominal.searched[:, :1])
    shift = np.zeros(nominal.searched.shape[2])
    for g in reversed(range(nominal.gap_rad.size)):
        there = nominal.searched[g, 0]
        point = refine(objectives[g][0], there + shift)
        shift = point - there
        searched[g, 0] = point
    return _row(model, nominal.gap_rad, angles, objectives, searched)


def _row(
    model: DisturbanceModel,
    gap_rad: FloatArray,
    start_angle_rad: FloatArray,
    objectives: Sequence[Sequence[Objective]],
    searched: FloatArray,
) -> SweepRow:
    """The row of optima (g, s, d)."""
    found = [
        objective.solve(point[None])
        for of_gap, points in zip(objectives, searched, strict=True)
        for objective, point in zip(of_gap, points, strict=True)
    ]
    shape = start_angle_rad.shape
    amplitude = np.abs([solution.coefficients[0, -1] for solution in found])
    squares = np.array([solution.sum_of_squares[0] for solution in found])
    rmse = np.sqrt(squares / objectives[0][0].samples_used)
    return SweepRow(
        gap_rad,
        start_angle_rad,
        searched,
        amplitude.reshape(shape),
        rmse.reshape(shape),
        model.searched,
    )


def _objectives(
    bench: Bench,
    model: DisturbanceModel,
    settings: SweepSettings,
    gap_rad: FloatArray,
    start_angle_rad: FloatArray,
    workers: int,
) -> list[list[Objective]]:
    width = start_angle_rad.shape[1]
    speeds = bench.simulate_many(
        np.repeat(gap_rad, width),
        rotations=settings.rotations,
        sampling_hz=settings.sampling_hz,
        start_angle_rad=start_angle_rad.ravel(),
        workers=workers,
    )
    time_s = np.arange(speeds.shape[1]) / settings.sampling_hz
    flat = [Objective(model, time_s, speed) for speed in speeds]
    return [flat[i : i + width] for i in range(0, len(flat), width)]


def _turned(
    model: DisturbanceModel, point: FloatArray, angle_rad: float, bench: Bench
) -> FloatArray:
    """The point as it looks when the recording starts ``angle_rad`` further on."""
    if START not in model.searched:
        return point
    turned = point.copy()
    direction = math.copysign(1.0, bench.value("reference_speed_rpm"))
    period = bench.rotation_period_s()
    turned[model.searched.index(START)] -= direction * angle_rad / (2.0 * math.pi) * period
    return turned
