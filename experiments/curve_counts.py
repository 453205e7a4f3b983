"""How many gaps, start angles, rotations and benches a curve on demand needs.

    python experiments/curve_counts.py               # two minutes

Against a sweep of 60 gaps, 16 start angles and 5 rotations: the largest error of δ from 0.06 mrad
on and below, and the time.
Against 150 benches within the tolerances: the width of the band of the curve.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.config.bench import load_bench
from bayesbl.curve.gap_curve import GapCurve
from bayesbl.curve.sweep import SweepSettings
from bayesbl.matching.signals import SMALLEST_GAP_RAD
from bayesbl.measurement.curves import SweepProblem
from bayesbl.recording.types import FloatArray
from bayesbl.results.work import NOTHING_KEPT
from bayesbl.ringing.estimator import Estimator

CONFIGS = Path(__file__).resolve().parents[1] / "configs"
COUNTS = ((40, 4, 5), (40, 4, 3), (28, 4, 3), (20, 4, 3), (20, 4, 2), (12, 4, 2))
BENCHES = (150, 24, 16)
SMALL_RAD = 6e-5


def curve(
    bench: Bench, gaps: int, start_angles: int, rotations: int, benches: int = 0
) -> tuple[GapCurve, float]:
    """A curve, and the seconds that it took on one core."""
    settings = SweepSettings(
        low_rad=SMALLEST_GAP_RAD,
        count=gaps,
        start_angles=start_angles,
        rotations=float(rotations),
    )
    model = Estimator().model
    problem = SweepProblem(bench, model, settings, 1, NOTHING_KEPT)
    begin = time.perf_counter()
    made, _, _ = problem.curve("counts", 3, "{}", bench.value("reference_speed_rpm"), benches, 1)
    return made, time.perf_counter() - begin


def width(found: GapCurve, amplitude_rpm: FloatArray) -> FloatArray:
    """Standard deviation of ln δ over the draws of a curve."""
    draws = found.draw(20_000, np.random.default_rng(1))
    return np.array([np.log(draws.gap(np.full(20_000, a))).std() for a in amplitude_rpm])


def main() -> None:
    """Print both tables."""
    bench = load_bench(CONFIGS / "bench.toml")
    curve(bench, 6, 2, 2)  # compiles
    reference, _ = curve(bench, 60, 16, 5)
    low, high = reference.amplitude_range_rpm
    amplitude = np.geomspace(1.02 * low, 0.98 * high, 200)
    for counts in COUNTS:
        found, seconds = curve(bench, *counts)
        error = np.abs(found.gap(amplitude) / reference.gap(amplitude) - 1.0)
        small = reference.gap(amplitude) < SMALL_RAD
        print(
            f"gaps, start angles, rotations {counts}: {error[~small].max():.3%} of δ, "
            f"{error[small].max():.3%} below {1e3 * SMALL_RAD:g} mrad, {seconds:.1f} s"
        )
    bench = load_bench(CONFIGS / "bench_tolerances.toml")
    few = np.array([20.0, 30.0, 40.0, 80.0])
    of_many = None
    for benches in BENCHES:
        found, seconds = curve(bench, 20, 4, 3, benches)
        widths = width(found, few)
        of_many = widths if of_many is None else of_many
        apart = np.abs(widths / of_many - 1.0).max()
        print(f"{benches} benches: width within {apart:.1%} of {BENCHES[0]}, {seconds:.1f} s")


if __name__ == "__main__":
    main()
