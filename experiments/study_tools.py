"""What many studies share: rows, benches and curves, recordings, answers and their scores."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, PositiveInt

from bayesbl.bench.bench import Bench
from bayesbl.config.bench import load_bench
from bayesbl.curve.gap_curve import GapCurve, likeliest_branch
from bayesbl.matching.observed import observed
from bayesbl.measurement.curves import read_curve
from bayesbl.measurement.direct_route import DirectMatch, direct_reasons, fit_directly
from bayesbl.measurement.gap_by_curve import MeasuredRinging
from bayesbl.measurement.measurement import outcome_of
from bayesbl.noise.process import NoiseModel
from bayesbl.recording.types import MOTOR_CURRENT, FloatArray, Recording
from bayesbl.ringing.estimator import Estimator
from bayesbl.sampling.chains import SamplerSettings

LEVEL = 0.9
FAST = SamplerSettings(ensembles=2, max_steps=1000)
SNAPSHOTS = ("before", "after")


class StudyRow(BaseModel):
    """What every row says: its name, and how many independent cases it has."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str = ""
    cases: PositiveInt


class TurningRow(StudyRow):
    """A row whose recordings are of steady rotation."""

    rotations: float = 5.0
    sampling_hz: float = 1000.0


@cache
def bench_of(path: Path, noise_sd_rpm: float | None = None, *coefficients: float) -> Bench:
    """The bench of a file, perhaps with another noise of its speed."""
    bench = load_bench(path)
    if noise_sd_rpm is None:
        return bench
    noise = NoiseModel(noise_sd_rpm, coefficients)
    return replace(bench, measurement=replace(bench.measurement, speed_noise=noise))


@cache
def curve_of(path: Path) -> GapCurve:
    """The curve of a sweep's result."""
    return read_curve(path)


def turned(bench: Bench, gap_rad: float, row: TurningRow, rng: np.random.Generator) -> Recording:
    """A recording of a bench from a random start angle."""
    return bench.simulate(
        gap_rad,
        rotations=row.rotations,
        sampling_hz=row.sampling_hz,
        start_angle_rad=rng.uniform(0.0, 2.0 * math.pi),
        seed=rng,
    )


def random_start(rng: np.random.Generator) -> dict[str, float]:
    """Start angles of load and motor, as a plant of the independent simulator takes them."""
    start, motor = rng.uniform(-math.pi, math.pi, 2)
    return {"start_angle_rad": start, "motor_start_angle_rad": motor}


def without_current(recording: Recording) -> Recording:
    """The recording without the motor's current."""
    kept = {name: own for name, own in recording.channels.items() if name != MOTOR_CURRENT}
    return replace(recording, channels=kept)


def write_csv(columns: Mapping[str, FloatArray], path: Path, digits: str = "%.9g") -> Path:
    """Columns as CSV with a header; the file."""
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, digits, ",", header=",".join(columns), comments="")
    return path


def written(recording: Recording, path: Path, digits: str = "%.9g") -> Path:
    """A recording as CSV; the file."""
    return write_csv({"time_s": recording.time_s, **recording.channels}, path, digits)


def normal_ringing(
    curve: GapCurve,
    recording: Recording,
    seed: np.random.SeedSequence,
    rng: np.random.Generator,
) -> MeasuredRinging:
    """The ringing's amplitude, normal around the optimum with the covariance that emcee samples."""
    estimator = Estimator()
    point = likeliest_branch(curve, estimator, estimator.estimate(recording, seed))
    centre, covariance = point.ringing
    draws = rng.normal(centre[0], math.sqrt(covariance[0, 0]), (2, 2000))
    return MeasuredRinging(draws, centre, covariance)


def fit_pair(
    bench: Bench,
    recordings: Sequence[Recording],
    prior_rad: tuple[float, float],
    seed: np.random.SeedSequence,
) -> DirectMatch:
    """Two recordings, named as :data:`SNAPSHOTS`, fitted together by the direct route."""
    seen = [
        observed(replace(recording, name=name), bench)
        for recording, name in zip(recordings, SNAPSHOTS, strict=True)
    ]
    return fit_directly(bench, seen, prior_rad, {}, FAST, seed)


def is_withheld(match: DirectMatch, places: Sequence[int] = (0, 1)) -> bool:
    """Whether the direct route withholds the gap of any of these recordings."""
    each = (direct_reasons(match, place, level=LEVEL) for place in places)
    return any(outcome_of(reasons) == "withheld" for reasons in each)


def interval_of(draws: FloatArray, level: float = LEVEL) -> tuple[float, float]:
    """Ends of the equal-tailed interval of draws; those that are not a number are left out."""
    low, high = np.nanquantile(draws, [0.5 - 0.5 * level, 0.5 + 0.5 * level])
    return float(low), float(high)


def held(draws: FloatArray, truth: float, level: float = LEVEL) -> float:
    """1 where the interval of draws holds the truth."""
    low, high = interval_of(draws, level)
    return float(low <= truth <= high)


def inside(below: FloatArray, level: float = LEVEL) -> np.ndarray:
    """Whether the interval holds the truth, from the share of the draws below the truth."""
    return np.asarray(np.abs(below - 0.5) < 0.5 * level)


def mean(values: ArrayLike) -> float:
    """Mean of what is a number; NaN without any."""
    known = np.asarray(values, dtype=float)
    known = known[np.isfinite(known)]
    return float(known.mean()) if known.size else math.nan


def listed(numbers: Iterable[float], digits: int = 5) -> str:
    """Numbers in one cell of a table."""
    return " ".join(f"{number:.{digits}g}" for number in numbers)
