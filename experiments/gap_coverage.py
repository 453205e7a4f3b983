"""Does the interval of δ hold what it promises on recordings of the virtual bench?

Recordings are simulated with a random start angle, fitted as any recording is, and put through a
swept curve. A row holds the gap fixed or draws it from the default prior, log-uniform; it simulates
single recordings or pairs, on the bench that the curve was swept on or on one drawn within the
tolerances that the curve knows of. It may also spoil the recordings as real ones are.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import xarray as xr
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PositiveInt

from bayesbl.config.bench import load_bench
from bayesbl.config.fields import as_tuple
from bayesbl.gap.branch import likeliest_branch
from bayesbl.gap.change import Gap, MeasuredRinging, gaps
from bayesbl.gap.curve import GapCurve
from bayesbl.inference.diagnostics import WEAKEST_SIGNAL_TO_NOISE
from bayesbl.inference.estimator import Estimator
from bayesbl.inference.posterior import SamplerSettings
from bayesbl.physics.bench import Bench, Measurement, SpeedSource
from bayesbl.physics.noise import NoiseModel
from bayesbl.recording.types import MOTOR_SPEED, Recording
from bayesbl.results.curve_file import read_curve
from bayesbl.signal.parameters import AMPLITUDE

LEVELS = (0.5, 0.8, 0.9, 0.95)


class Row(BaseModel):
    """A row: what is simulated, and the curve that it is read with.

    ``gap_rad`` is one gap, or [low, high] of a log-uniform draw. ``bench_off`` draws the true bench
    within the tolerances of the bench file. ``posterior`` is sampled by ``emcee`` as shipped, or
    taken ``normal`` around the optimum with the same covariance, at a third of the time.

    What real recordings suffer from: ``degrees_of_freedom`` of Student-t noise; ``missing_share``
    of the samples lost, each on its own; ``speed_source`` ``encoder``, the speed differentiated
    from ``encoder_counts``, with no other noise; ``drift_share``, the relative change of the speed
    from begin to end.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    bench: Path
    curve: Path
    cases: PositiveInt
    gap_rad: Annotated[float | tuple[float, float], BeforeValidator(as_tuple)]
    speed_noise_sd_rpm: float = Field(gt=0.0)
    coefficients: Annotated[tuple[float, ...], BeforeValidator(as_tuple)] = (0.6,)
    pairs: bool = False
    bench_off: bool = False
    posterior: Literal["emcee", "normal"] = "emcee"
    rotations: float = 5.0
    sampling_hz: float = 1000.0
    degrees_of_freedom: float | None = None
    missing_share: float = Field(default=0.0, ge=0.0, lt=0.5)
    encoder_counts: PositiveInt | None = None
    speed_source: SpeedSource = "sensor"
    drift_share: float = 0.0


COLUMNS = {
    "delta_rad": ("rad", "gap simulated"),
    "median_rad": ("rad", "posterior median of the gap"),
    "log_error": ("1", "ln of the median over the gap simulated"),
    "log_sd": ("1", "posterior standard deviation of ln δ"),
    "rank": ("1", "share of posterior draws below the truth"),
    "change_rad": ("rad", "change simulated"),
    "change_error_rad": ("rad", "posterior median of the change less the change simulated"),
    "change_sd_rad": ("rad", "posterior standard deviation of the change"),
    "change_rank": ("1", "share of posterior draws of the change below the truth"),
    "change_width_rad": ("rad", "width of the 90 % interval of the change"),
    "independent_width_rad": ("rad", "the same if each snapshot had a curve draw of its own"),
    "withheld": ("1", "1 where the answer would be withheld"),
}


def count(row: Row) -> int:
    """Number of recordings, or of pairs."""
    return row.cases


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One recording, or one pair of recordings, from truth to posterior."""
    truth_seed, fit_seed, gap_seed = seed.spawn(3)
    generator = np.random.default_rng(truth_seed)
    bench, curve = _bench(row), _curve(row.curve)
    if row.bench_off:
        bench = bench.draw(generator)
    truths = [_gap(row, generator) for _ in range(2 if row.pairs else 1)]
    ringing = [
        _fit(row, bench, truth, generator, s)
        for truth, s in zip(truths, fit_seed.spawn(len(truths)), strict=True)
    ]
    found = gaps(curve, ringing, gap_seed)
    result = _of_gap(truths[-1], found[-1], ringing[-1])
    if row.pairs:
        result |= _of_change(truths, found, np.random.default_rng(gap_seed.spawn(1)[0]))
    return result


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """Coverage at each level, bias, and claimed over actual width."""
    error, sd = cases["log_error"].values, cases["log_sd"].values
    spread = float(np.sqrt(np.mean((error - error.mean()) ** 2)))
    line: dict[str, float | str] = {"n": float(error.size)}
    line |= {f"cover_{p:.0%}": _covered(cases["rank"].values, p) for p in LEVELS}
    line |= {
        "bias_%": 100.0 * float(error.mean()),
        "bias_se_%": 100.0 * spread / math.sqrt(error.size),
        "claimed/actual": float(np.sqrt(np.mean(sd**2))) / spread,
        "median_error_%": 100.0 * float(np.median(np.abs(error))),
        "withheld": float(cases["withheld"].values.mean()),
    }
    if row.pairs:
        line |= {f"change_{p:.0%}": _covered(cases["change_rank"].values, p) for p in LEVELS}
        width, alone = cases["change_width_rad"].values, cases["independent_width_rad"].values
        line |= {
            "change_width_mrad": 1e3 * float(np.median(width)),
            "if_independent_mrad": 1e3 * float(np.median(alone)),
        }
    return line


def _covered(rank: np.ndarray, level: float) -> float:
    return float(np.mean(np.abs(rank - 0.5) <= 0.5 * level))


def _gap(row: Row, generator: np.random.Generator) -> float:
    if isinstance(row.gap_rad, tuple):
        low, high = np.log(row.gap_rad)
        return float(np.exp(generator.uniform(low, high)))
    return row.gap_rad


def _fit(
    row: Row, bench: Bench, gap_rad: float, generator: np.random.Generator, seed: Any
) -> MeasuredRinging:
    recording = _spoiled(row, _recorded(row, bench, gap_rad, generator), generator)
    choose = partial(likeliest_branch, _curve(row.curve), Estimator())
    if row.posterior == "normal":
        point = choose(Estimator().estimate(recording, seed))
        centre, covariance = point.ringing
        draws = generator.normal(centre[0], math.sqrt(covariance[0, 0]), (2, 1000))
        return MeasuredRinging(draws, centre, covariance)
    # Two ensembles of 500 steps: enough draws for a rank, at a third of the default's time.
    settings = SamplerSettings(ensembles=2, max_steps=500)
    fit = Estimator(sampler=settings).fit(recording, seed, choose=choose)
    return MeasuredRinging(fit.posterior.draws[AMPLITUDE], *fit.point.ringing)


def _recorded(row: Row, bench: Bench, gap_rad: float, generator: np.random.Generator) -> Recording:
    """A recording at constant speed, or of a speed that drifts, slowly against the ringing."""
    start_angle_rad = generator.uniform(0.0, 2.0 * math.pi)
    if not row.drift_share:
        return bench.simulate(
            gap_rad,
            rotations=row.rotations,
            sampling_hz=row.sampling_hz,
            start_angle_rad=start_angle_rad,
            seed=generator,
        )
    steady = bench.simulate(
        gap_rad,
        rotations=row.rotations + 0.1,
        sampling_hz=10.0 * row.sampling_hz,
        start_angle_rad=start_angle_rad,
    )
    samples = bench.samples(row.rotations, row.sampling_hz)
    time_s = np.arange(samples) / row.sampling_hz
    drift = row.drift_share * (time_s / time_s[-1] - 0.5)
    # What the load angle decides comes when the angle is reached: the integral of the speed.
    reached_s = time_s + np.concatenate(([0.0], np.cumsum(drift[1:] + drift[:-1]))) * (
        0.5 / row.sampling_hz
    )
    speed = np.interp(reached_s - reached_s.min(), steady.time_s, steady.motor_speed_rpm)
    speed = speed + drift * bench.value("reference_speed_rpm")
    speed = speed + bench.measurement.speed_noise.draw(samples, generator)
    return Recording("drifting", time_s, {MOTOR_SPEED: speed})


def _spoiled(row: Row, recording: Recording, generator: np.random.Generator) -> Recording:
    """The recording as it is read in after some of its samples were lost."""
    if not row.missing_share:
        return recording
    kept = generator.uniform(size=recording.samples) >= row.missing_share
    kept[[0, -1]] = True
    speed = np.interp(recording.time_s, recording.time_s[kept], recording.motor_speed_rpm[kept])
    return replace(recording, channels={MOTOR_SPEED: speed})


def _of_gap(truth_rad: float, gap: Gap, ringing: MeasuredRinging) -> dict[str, float]:
    draws = gap.delta_rad
    median = float(np.median(draws))
    signal_to_noise = ringing.centre[0] / math.sqrt(ringing.covariance[0, 0])
    weak = signal_to_noise < WEAKEST_SIGNAL_TO_NOISE
    return {
        "delta_rad": truth_rad,
        "median_rad": median,
        "log_error": math.log(median / truth_rad),
        "log_sd": float(np.std(np.log(draws[draws > 0.0]))),
        "rank": float(np.mean(draws < truth_rad)),
        "withheld": float(weak or gap.reason is not None),
    }


def _of_change(
    truths: list[float], found: list[Gap], generator: np.random.Generator
) -> dict[str, float]:
    first, last = (gap.delta_rad.ravel() for gap in found)
    truth, draws = truths[1] - truths[0], last - first
    low, high = np.quantile(draws, [0.05, 0.95])
    alone = np.quantile(last - generator.permutation(first), [0.05, 0.95])
    return {
        "change_rad": truth,
        "change_error_rad": float(np.median(draws)) - truth,
        "change_sd_rad": float(draws.std()),
        "change_rank": float(np.mean(draws < truth)),
        "change_width_rad": float(high - low),
        "independent_width_rad": float(alone[1] - alone[0]),
    }


@cache
def _curve(path: Path) -> GapCurve:
    return read_curve(path)


@cache
def _bench(row: Row) -> Bench:
    bench = load_bench(row.bench)
    noise = NoiseModel(row.speed_noise_sd_rpm, row.coefficients, row.degrees_of_freedom)
    seen: Measurement = bench.measurement
    return bench.with_measurement(
        Measurement(
            encoder_counts=row.encoder_counts or seen.encoder_counts,
            speed_source=row.speed_source,
            speed_noise=noise,
            current_noise=seen.current_noise,
        )
    )
