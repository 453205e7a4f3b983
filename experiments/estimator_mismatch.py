"""What becomes of δ if a recording is not fitted by the estimator that the curve was swept with?

The ringing is not exactly a damped sinusoid, so each way of fitting it has an amplitude of its own.
Recordings of the virtual bench are fitted by the estimator of the sweep and by others that look as
good: a shorter window, a longer one, no baseline, and generalised least squares, which whitens the
noise. All of them are read through the same curve.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import xarray as xr
from pydantic import Field
from scipy.optimize import least_squares
from study_tools import TurningRow, bench_of, curve_of, listed, turned

from bayesbl.config.sections import Items
from bayesbl.curve.gap_curve import GapCurve, likeliest_branch
from bayesbl.recording.types import FloatArray
from bayesbl.ringing.estimator import Estimator, PointEstimate
from bayesbl.ringing.symbols import (
    AMPLITUDE,
    DECAY,
    FREQUENCY,
    ROTATION,
    SEPARATION,
    START,
    WINDOW_END,
    WINDOW_START,
    DisturbanceModel,
)
from bayesbl.ringing.waveform import baseline_columns, pulse_train

MODELS = {
    "same": DisturbanceModel(),
    "short_window": DisturbanceModel(fixed={WINDOW_START: 0.0, WINDOW_END: 0.102}),
    "long_window": DisturbanceModel(fixed={WINDOW_START: 0.0, WINDOW_END: 0.306}),
    "no_baseline": DisturbanceModel(baseline_harmonics=0),
}
"""Estimators by least squares; ``same`` is that of the sweep."""

GENERALISED = "generalised"
ESTIMATORS = (*MODELS, GENERALISED)

_SEARCHED = (START, DECAY, FREQUENCY, SEPARATION, ROTATION)


class Row(TurningRow):
    """A row: recordings at several gaps in turn, and the curve that all are read through."""

    bench: Path
    curve: Path
    gaps_rad: Items[float] = Field(min_length=1)
    speed_noise_sd_rpm: float = Field(default=1.5, gt=0.0)
    coefficients: Items[float] = (0.6,)


COLUMNS = {
    "gap_rad": ("rad", "gap simulated"),
    "log_sd": ("1", "standard deviation of ln δ that the sweep's estimator claims"),
    **{f"{name}_error": ("1", f"ln of δ over the gap simulated, {name}") for name in ESTIMATORS},
}


def count(row: Row) -> int:
    """Number of recordings, over all gaps."""
    return row.cases * len(row.gaps_rad)


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One recording, fitted by every estimator."""
    truth_seed, *fit_seeds = seed.spawn(1 + len(MODELS))
    generator = np.random.default_rng(truth_seed)
    gap, curve = row.gaps_rad[index % len(row.gaps_rad)], curve_of(row.curve)
    bench = bench_of(row.bench, row.speed_noise_sd_rpm, *row.coefficients)
    recording = turned(bench, gap, row, generator)
    amplitude: dict[str, float] = {}
    result = {"gap_rad": gap}
    for (name, model), own in zip(MODELS.items(), fit_seeds, strict=True):
        estimator = Estimator(model=model)
        point = likeliest_branch(curve, estimator, estimator.estimate(recording, own))
        amplitude[name] = point.optimum.symbols[AMPLITUDE]
        if name == "same":
            amplitude[GENERALISED] = generalised_amplitude(point)
            result["log_sd"] = _log_sd(curve, point)
    for name in ESTIMATORS:
        found = float(curve.gap(np.array([amplitude[name]]))[0])
        result[f"{name}_error"] = math.log(found / gap) if found > 0.0 else math.nan
    return result


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """Mean error of each estimator at each gap in percent of δ, with its standard error."""
    gap = cases["gap_rad"].values
    line: dict[str, float | str] = {
        "gaps_mrad": listed(1e3 * g for g in row.gaps_rad),
        "claimed_sd_%": listed(
            100.0 * float(np.mean(cases["log_sd"].values[gap == g])) for g in row.gaps_rad
        ),
    }
    for name in ESTIMATORS:
        error = 100.0 * cases[f"{name}_error"].values
        line[f"{name}_%"] = listed(float(np.mean(error[gap == g])) for g in row.gaps_rad)
        line[f"{name}_se_%"] = listed(
            float(np.std(error[gap == g])) / math.sqrt(row.cases) for g in row.gaps_rad
        )
    return line


def generalised_amplitude(point: PointEstimate) -> float:
    """A by least squares of residuals whitened with the noise that was found, rpm."""
    coefficients = np.concatenate([[1.0], -np.asarray(point.noise.coefficients)])
    objective, start = point.objective, point.optimum.symbols
    time, dt = objective.time_s, objective.period_s

    def white(columns: FloatArray) -> FloatArray:
        return np.apply_along_axis(np.convolve, 0, columns, coefficients, "valid")

    speed = white(objective.speed_rpm[:, None] - objective.offset_rpm)[:, 0]
    scale = np.array([start[name] for name in _SEARCHED])

    def solved(factor: FloatArray) -> tuple[FloatArray, FloatArray]:
        symbols = start | dict(zip(_SEARCHED, factor * scale, strict=True))
        train = pulse_train(time, symbols, dt)
        baseline = baseline_columns(time, symbols[ROTATION], objective.model.baseline_harmonics)
        columns = white(np.column_stack([train, baseline]))
        linear = np.asarray(np.linalg.lstsq(columns, speed, rcond=None)[0], dtype=np.float64)
        return speed - columns @ linear, linear

    found = least_squares(lambda f: solved(f)[0], np.ones(len(_SEARCHED)), x_scale=1e-3)
    return float(solved(found.x)[1][0])


def _log_sd(curve: GapCurve, point: PointEstimate) -> float:
    """Of ln δ by noise and start angle; the curve's own part is far smaller on a known bench."""
    centre, covariance = point.ringing
    amplitude = np.array([centre[0]])
    scatter = float(curve.start_angle_sd(amplitude)[0])
    return float(curve.log_slope(amplitude)[0]) * math.hypot(math.sqrt(covariance[0, 0]), scatter)
