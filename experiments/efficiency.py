"""How much of what a recording holds about δ does each route use?

The same recordings of the virtual bench, each with a start angle of its own, are answered by the
amplitude of the ringing through the swept curve and by direct simulation, from speed and current
and from the speed alone. The posterior standard deviation of ln δ is compared with the Cramér-Rao
bounds (bench known, start angle free) of speed and current, and of the speed alone, which is all
that the amplitude route uses. The direct posterior is the surrogate's, that of A normal around
the optimum with the covariance that emcee samples.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import xarray as xr
from pydantic import Field
from study_tools import FAST, TurningRow, bench_of, curve_of, normal_ringing, turned

from bayesbl.bench.bench import Bench
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.observed import observed
from bayesbl.matching.posterior import sample_direct
from bayesbl.matching.signals import GAP, gap_unknown, start_angle_unknown
from bayesbl.measurement.gap_by_curve import gaps
from bayesbl.recording.types import MOTOR_SPEED, FloatArray, Recording

RANGE_RAD = (5e-5, 1e-2)
"""Of the direct route's prior, log-uniform: wider than any answer."""

WAYS = ("direct", "direct_speed", "amplitude")


class Row(TurningRow):
    """A row: one gap on one bench that is known exactly, and the curve swept on it."""

    bench: Path
    curve: Path
    gap_rad: float = Field(gt=0.0)


COLUMNS = {
    "bound": ("1", "Cramér-Rao bound on the sd of ln δ, speed and current"),
    "bound_speed": ("1", "the same of the speed alone"),
    "direct_sd": ("1", "posterior sd of ln δ, direct route, speed and current"),
    "direct_error": ("1", "its median of ln δ less the truth"),
    "direct_speed_sd": ("1", "posterior sd of ln δ, direct route, speed alone"),
    "direct_speed_error": ("1", "its median of ln δ less the truth"),
    "amplitude_sd": ("1", "posterior sd of ln δ, amplitude route"),
    "amplitude_error": ("1", "its median of ln δ less the truth"),
}


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One recording through all routes."""
    truth_seed, both_seed, speed_seed, fit_seed, gap_seed = seed.spawn(5)
    generator = np.random.default_rng(truth_seed)
    bench = bench_of(row.bench)
    recording = turned(bench, row.gap_rad, row, generator)
    speed_only = replace(recording, channels={MOTOR_SPEED: recording.motor_speed_rpm})
    bound, both = _direct(bench, recording, both_seed)
    bound_speed, alone = _direct(bench, speed_only, speed_seed)
    curve = curve_of(row.curve)
    ringing = normal_ringing(curve, speed_only, fit_seed, generator)
    (gap,) = gaps([curve], [ringing], gap_seed)
    amplitude = np.log(gap.delta_rad)
    result = {"bound": bound, "bound_speed": bound_speed}
    for way, log_gap in zip(WAYS, (both, alone, amplitude), strict=True):
        result[f"{way}_sd"] = float(log_gap.std())
        result[f"{way}_error"] = float(np.median(log_gap)) - math.log(row.gap_rad)
    return result


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """Bounds, posterior and actual scatter of each way in percent of δ, medians over the cases."""
    line: dict[str, float | str] = {"gap_mrad": 1e3 * row.gap_rad}
    for name in ("bound", "bound_speed"):
        line[f"{name}_%"] = 100.0 * float(np.median(cases[name].values))
    for way in WAYS:
        line[f"{way}_sd_%"] = 100.0 * float(np.median(cases[f"{way}_sd"].values))
        error = cases[f"{way}_error"].values
        line[f"{way}_scatter_%"] = 100.0 * float(np.sqrt(np.mean(error**2)))
    for way, bound in zip(WAYS, ("bound", "bound_speed", "bound_speed"), strict=True):
        ratio = cases[f"{way}_sd"].values / cases[bound].values
        line[f"{way}_sd/bound"] = float(np.median(ratio))
    return line


def _direct(
    bench: Bench, recording: Recording, seed: np.random.SeedSequence
) -> tuple[float, FloatArray]:
    """Bound on the sd of ln δ, and draws of ln δ."""
    unknowns = [gap_unknown(*RANGE_RAD), start_angle_unknown(recording.name)]
    fit = fit_aligned(bench, [observed(recording, bench)], unknowns)
    draws = sample_direct(fit, FAST, seed)
    return float(fit.bound[fit.model.index(GAP)]), np.log(draws.values(GAP)).ravel()
