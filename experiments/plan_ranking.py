"""Is the motion that ``plan`` ranks first the one that tells the gap best?

Some of the motions that ``plan`` ranks within limits, evenly over the ranking, are simulated again
and again, at the gaps that it looks at and with a start angle that the fit is not told; each
recording is matched by itself. A motion's scatter is the root mean square error of ln δ.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np
import xarray as xr
from pydantic import PositiveInt
from scipy.stats import spearmanr
from study_tools import StudyRow

from bayesbl.bench.bench import Bench
from bayesbl.bench.motion import cycle
from bayesbl.config.bench import load_bench
from bayesbl.config.kinds import Limits
from bayesbl.errors import BenchError
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.observed import observed
from bayesbl.matching.planning import GAPS_TRIED, PlannedMotion, Strokes, ranked_motions
from bayesbl.matching.signals import GAP
from bayesbl.model_search.pipeline import direct_unknowns

RANGE_RAD = (1e-4, 1e-2)
SAMPLING_HZ = 1000.0
NAME = "r"


class Row(StudyRow):
    """``cases`` motions within each of ``limits``, recorded ``repeats`` times at each gap."""

    bench: Path
    repeats: PositiveInt
    gap_rad: float = 8e-4
    limits: tuple[Limits, ...] = (Limits(),)


COLUMNS = {
    "expected": ("1", "standard deviation of ln δ that plan expects"),
    "scatter": ("1", "root mean square error of ln δ"),
    "median": ("1", "median absolute error of ln δ over 0.6745: what no lost fit moves"),
}


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One motion."""
    rng = np.random.default_rng(seed)
    bench, ranked = _ranked(row)
    planned = ranked[round(index * (len(ranked) - 1) / max(row.cases - 1, 1))]
    assert planned.expected_relative_sd is not None
    motion = cycle(
        bench.value("gear_ratio"),
        planned.range_rad,
        planned.speed_rpm,
        planned.acceleration_rpm_per_s,
        planned.dwell_s,
        planned.duration_s,
    )
    errors = []
    for gap in row.gap_rad * np.repeat(GAPS_TRIED, row.repeats):
        recording = bench.draw(rng).simulate(
            gap, motion, sampling_hz=SAMPLING_HZ, seed=rng, name=NAME
        )
        unknowns = direct_unknowns(bench, [NAME], RANGE_RAD, moving=[NAME])
        fit = fit_aligned(bench, [observed(recording, bench)], unknowns)
        errors.append(math.log(fit.value(GAP, NAME) / gap))
    return {
        "expected": planned.expected_relative_sd,
        "scatter": float(np.sqrt(np.mean(np.square(errors)))),
        "median": float(np.median(np.abs(errors))) / 0.6745,
    }


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """Spearman's rank correlation of what was expected with what came."""
    expected, scatter, median = (cases[name].values for name in COLUMNS)
    return {
        "motions": float(expected.size),
        "spearman": float(spearmanr(expected, scatter).statistic),
        "spearman_of_median": float(spearmanr(expected, median).statistic),
        "best_%": 100.0 * float(expected.min()),
        "worst_%": 100.0 * float(expected.max()),
        "scatter_over_expected": float(np.median(scatter / expected)),
        "largest_scatter_over_expected": float(np.max(scatter / expected)),
    }


@cache
def _ranked(row: Row) -> tuple[Bench, list[PlannedMotion]]:
    """The bench, and the motions for which ``plan`` expects an answer, best first."""
    bench = load_bench(row.bench)
    found = [
        motion
        for limits in row.limits
        for motion in ranked_motions(
            bench, Strokes(**limits.model_dump()), row.gap_rad, SAMPLING_HZ
        )
        if motion.expected_relative_sd is not None
    ]
    if len(found) < row.cases:
        raise BenchError("There are fewer motions than asked for.", found=f"{len(found)}")
    return bench, sorted(found, key=lambda motion: motion.expected_relative_sd or math.inf)
