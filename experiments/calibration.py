"""Do the posteriors hold what they promise? Coverage, and simulation-based calibration.

    bayesbl run configs/calibration_main.toml
    bayesbl run configs/calibration.toml
    bayesbl run configs/calibration_model.toml

Truths are drawn from the prior, recordings simulated, and each goes through the whole fit. On
recordings of the virtual bench the gap δ and its change between two recordings are studied, on
recordings of the disturbance model its A, τ and ω: a bench has no true A.

The prior of δ is log-uniform on the swept range. The product's own goes on beyond that range, where
it then withholds the answer. So ranks are of that posterior cut off at the range, beside those of
the posterior as shipped. With the gap fixed, truths come from no prior: the posterior is as
shipped, coverage is reported and ranks are not tested.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import xarray as xr
from calibration_statistics import rank
from calibration_table import calibration_line
from independent_bench import plant, simulate, values_of
from made_recordings import draw_symbols, drifting, synthetic_recording, with_samples_lost
from outside_noise import (
    around_impacts,
    encoder_harmonics,
    one_over_f,
    unlike_impacts,
    varied_speed,
)
from pydantic import Field, NonNegativeInt, PositiveInt, Strict, model_validator
from study_tools import SNAPSHOTS, StudyRow, curve_of, fit_pair, is_withheld

from bayesbl.bench.bench import Bench
from bayesbl.bench.simulation import SpeedSource
from bayesbl.config.bench import load_bench
from bayesbl.config.sections import Items, refuse
from bayesbl.curve.gap_curve import GapCurve, likeliest_branch
from bayesbl.matching.signals import GAP
from bayesbl.measurement.gap_by_curve import MeasuredRinging, gaps
from bayesbl.noise.process import NoiseModel
from bayesbl.recording.types import MOTOR_CURRENT, MOTOR_SPEED, FloatArray, Recording
from bayesbl.ringing.estimator import Estimator, PointEstimate
from bayesbl.ringing.posterior import sample_posterior
from bayesbl.ringing.symbols import AMPLITUDE, DECAY, FREQUENCY
from bayesbl.sampling.chains import SamplerSettings
from bayesbl.sampling.convergence import WEAKEST_SIGNAL_TO_NOISE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SAMPLERS = {
    "emcee": SamplerSettings(),
    # Enough draws for a rank, at a third of the time; it stops before its bounds are stable.
    "short": SamplerSettings(ensembles=2, max_steps=500),
}

SYMBOLS = {"amplitude": AMPLITUDE, "decay_rate": DECAY, "frequency": FREQUENCY}
"""What is studied on recordings of the disturbance model: name in the table to symbol."""

AMPLITUDES_RPM = (10.0, 40.0)
FREQUENCIES_RAD_PER_S = (10.0 * math.pi, 50.0 * math.pi)
LARGEST_BASELINE_RPM = 10.0

SPEED_VARIATION = 5e-4
"""Sd of the speed's slow variation, of the speed: 1 rpm of 2000."""

LOUDER = 5.0
"""Noise around impacts over that between them."""

UNLIKE = 0.15
"""Sd of an impact's ringing over its mean."""

ENCODER_SD_RPM = 0.5
CURRENT_NOISE_SD_A = 0.05


class Row(StudyRow):
    """A row: what is simulated, and how it is fitted.

    Without ``bench``, recordings are the disturbance model's own. ``gap_rad`` is one gap, or
    [low, high] of a log-uniform draw. ``bench_off`` draws the true bench within the tolerances of
    the bench file. ``route`` ``amplitude`` needs a ``curve``.

    ``posterior`` of the amplitude route: ``emcee`` as shipped; ``short``, the same stopped early;
    ``normal`` around the optimum with the covariance that emcee samples. In the first
    ``emcee_cases`` of a row emcee as shipped is run too. The direct route has its fast posterior.

    ``made_by`` ``independent_bench``: recordings of the simulator that shares only the equations.
    ``outside_noise``, of no fitted family, is added to the row's noise, or is the noise if 1/f.

    What real recordings suffer from: ``degrees_of_freedom`` of Student-t noise; ``missing_share``
    of the samples lost; ``speed_source`` ``encoder``, the speed differentiated from
    ``encoder_counts``, with no other noise; ``drift_share``, growth of the speed from start to end.
    """

    bench: Path | None = None
    curve: Path | None = None
    route: Literal["amplitude", "direct"] = "amplitude"
    gap_rad: float | Annotated[tuple[float, float], Strict(False)] = (1e-4, 4e-3)
    bench_off: bool = False
    posterior: Literal["emcee", "short", "normal"] = "emcee"
    emcee_cases: NonNegativeInt = 0
    speed_noise_sd_rpm: float = Field(default=1.5, gt=0.0)
    coefficients: Items[float] = (0.6,)
    degrees_of_freedom: float | None = None
    rotations: float = 5.0
    sampling_hz: float = 1000.0
    missing_share: float = Field(default=0.0, ge=0.0, lt=0.05)
    encoder_counts: PositiveInt | None = None
    speed_source: SpeedSource = "sensor"
    drift_share: float = 0.0
    made_by: Literal["package", "independent_bench"] = "package"
    outside_noise: (
        Literal[
            "one_over_f",
            "encoder_harmonics",
            "speed_variation",
            "louder_around_impacts",
            "unlike_impacts",
        ]
        | None
    ) = None

    @model_validator(mode="after")
    def _fits_together(self) -> Row:
        if self.bench is None:
            if self.route == "direct" or self.posterior == "normal" or self.emcee_cases:
                refuse(
                    "Without a bench there is the posterior of the disturbance model alone.",
                    expected='route = "amplitude" and posterior = "emcee" or "short", or a bench',
                )
        elif self.route == "direct" and not isinstance(self.gap_rad, tuple):
            refuse(
                "The direct route's prior is on the range that gaps are drawn from.",
                found=self.gap_rad,
                expected="gap_rad = [low, high]",
            )
        elif self.outside_noise and self.made_by == "package":
            refuse(
                "Noise of no fitted family is of the independent bench only.",
                found=self.outside_noise,
                expected='made_by = "independent_bench"',
            )
        elif self.route == "amplitude" and self.curve is None:
            refuse("The amplitude route needs a curve.", found="none", expected="a sweep's file")
        return self


QUANTITIES = {
    "delta": "ln of the gap of the last recording",
    "change": "change of the gap, rad",
    "amplitude": "A, rpm",
    "decay_rate": "τ, 1/s",
    "frequency": "ω, rad/s",
}
COLUMNS = {
    "delta_rad": ("rad", "gap simulated"),
    "change_rad": ("rad", "change simulated"),
    "outside": ("1", "share of the draws beyond the range that the gap was drawn from"),
    "withheld": ("1", "1 where an answer would be withheld"),
    **{
        f"{name}_{what}": ("1", f"{text}: {of}")
        for name, of in QUANTITIES.items()
        for what, text in (
            ("rank", "share of the posterior below the truth"),
            ("shipped_rank", "share of the posterior below the truth, its prior as shipped"),
            ("emcee_rank", "share of emcee's posterior below the truth"),
            ("error", "posterior median less the truth"),
            ("sd", "posterior standard deviation"),
        )
    },
}


@dataclass(frozen=True)
class Answer:
    """Draws of both gaps, each of shape (draws,), and whether the product would withhold them."""

    gaps_rad: tuple[FloatArray, FloatArray]
    withheld: bool


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """From truth to ranks."""
    truth_seed, fit_seed, rank_seed = seed.spawn(3)
    generator = np.random.default_rng(truth_seed)
    if row.bench is None:
        return _of_symbols(row, generator, fit_seed, np.random.default_rng(rank_seed))
    bench = _bench(row)
    true = bench.draw(generator) if row.bench_off else bench
    truths = _gap(row, generator), _gap(row, generator)
    recordings = [_recorded(row, true, gap, generator) for gap in truths]
    if row.route == "direct":
        answers = [_directly(row, bench, recordings, fit_seed)]
    else:
        wanted = [row.posterior, *(["emcee"] if index < row.emcee_cases else [])]
        answers = _by_amplitude(curve_of(row.curve), recordings, fit_seed, wanted)
    return _of_gaps(row, truths, answers, np.random.default_rng(rank_seed))


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """Coverage at each level, whether it is in its band, uniformity of the ranks, and widths."""
    from_prior = row.bench is None or isinstance(row.gap_rad, tuple)
    line: dict[str, float | str] = {}
    for name in QUANTITIES:
        if f"{name}_rank" in cases:
            line |= calibration_line(name, cases, from_prior=from_prior)
    return line | {"withheld": float(cases["withheld"].mean())}


def figure(table: Sequence[Mapping[str, Any]], cases: Mapping[str, xr.Dataset]) -> Figure:
    """Coverage less what was promised, row by row, and the ranks' distribution less uniform."""
    from calibration_figure import draw_calibration  # matplotlib is behind it, no case needs it

    return draw_calibration(table, cases, list(QUANTITIES))


def _of_symbols(
    row: Row,
    generator: np.random.Generator,
    seed: np.random.SeedSequence,
    ranker: np.random.Generator,
) -> dict[str, float]:
    """Ranks of A, τ and ω, truths drawn from the posterior's flat priors."""
    truth = draw_symbols(generator, generator.uniform(*AMPLITUDES_RPM))
    truth[FREQUENCY] = generator.uniform(*FREQUENCIES_RAD_PER_S)
    size, phase = generator.uniform(0.0, LARGEST_BASELINE_RPM), generator.uniform(0.0, 2 * math.pi)
    recording = synthetic_recording(
        truth,
        _noise(row),
        generator,
        rotations=row.rotations,
        baseline_rpm=(size * math.cos(phase), size * math.sin(phase)),
        sampling_hz=row.sampling_hz,
    )
    fit = Estimator(sampler=SAMPLERS[row.posterior]).fit(recording, seed)
    values = {"withheld": float(fit.posterior.diagnostics.outcome == "withheld")}
    for name, symbol in SYMBOLS.items():
        draws = fit.posterior.draws[symbol].ravel()
        values[f"{name}_rank"] = rank(truth[symbol], draws, ranker)
        values[f"{name}_error"] = float(np.median(draws)) - truth[symbol]
        values[f"{name}_sd"] = float(draws.std())
    return values


def _by_amplitude(
    curve: GapCurve,
    recordings: Sequence[Recording],
    seed: np.random.SeedSequence,
    wanted: Sequence[str],
) -> list[Answer]:
    """The amplitude route's answer by each posterior asked for, from the same optima."""
    search_seed, sample_seed, gap_seed = seed.spawn(3)
    estimator = Estimator()
    points = [
        likeliest_branch(curve, estimator, estimator.estimate(recording, own))
        for recording, own in zip(recordings, search_seed.spawn(len(recordings)), strict=True)
    ]
    answers = []
    for kind in wanted:
        seeds = sample_seed.spawn(len(points))
        ringing = [_ringing(p, kind, own) for p, own in zip(points, seeds, strict=True)]
        found = gaps([curve] * len(ringing), [r for r, _ in ringing], gap_seed)
        withheld = any(w for _, w in ringing) or any(gap.reasons for gap in found)
        before, after = (gap.delta_rad.ravel() for gap in found)
        answers.append(Answer((before, after), withheld))
    return answers


def _ringing(
    point: PointEstimate, kind: str, seed: np.random.SeedSequence
) -> tuple[MeasuredRinging, bool]:
    """Draws of A, and whether the fit would withhold its answer."""
    centre, covariance = point.ringing
    if kind == "normal":
        sd = math.sqrt(covariance[0, 0])
        draws = np.random.default_rng(seed).normal(centre[0], sd, (4, 1000))
        return MeasuredRinging(draws, centre, covariance), centre[0] < WEAKEST_SIGNAL_TO_NOISE * sd
    posterior = sample_posterior(point, SAMPLERS[kind], seed)
    withheld = posterior.diagnostics.outcome == "withheld"
    return MeasuredRinging(posterior.draws[AMPLITUDE], centre, covariance), withheld


def _directly(
    row: Row, bench: Bench, recordings: Sequence[Recording], seed: np.random.SeedSequence
) -> Answer:
    """The direct route's answer for both recordings together."""
    assert isinstance(row.gap_rad, tuple)
    found = fit_pair(bench, recordings, row.gap_rad, seed)
    before, after = (found.posterior.values(GAP, name).ravel() for name in SNAPSHOTS)
    return Answer((before, after), is_withheld(found))


def _of_gaps(
    row: Row,
    truths: tuple[float, float],
    answers: Sequence[Answer],
    generator: np.random.Generator,
) -> dict[str, float]:
    """Ranks of δ and its change in the first answer; of another one, the ranks alone."""
    low, high = row.gap_rad if isinstance(row.gap_rad, tuple) else (0.0, math.inf)
    truth = {"delta": math.log(truths[1]), "change": truths[1] - truths[0]}
    values = {"delta_rad": truths[1], "change_rad": truth["change"]}
    for answer, kind in zip(answers, ("", "emcee_"), strict=False):
        before, after = answer.gaps_rad
        within = np.all([(low <= gap) & (gap <= high) for gap in answer.gaps_rad], axis=0)
        for name, draws in (("delta", np.log(after)), ("change", after - before)):
            values[f"{name}_{kind}rank"] = rank(truth[name], draws[within], generator)
            if answer is answers[0]:
                values[f"{name}_shipped_rank"] = rank(truth[name], draws, generator)
                values[f"{name}_error"] = float(np.median(draws)) - truth[name]
                values[f"{name}_sd"] = float(draws.std())
                values["outside"] = float(1.0 - within.mean())
                values["withheld"] = float(answer.withheld)
    return values


def _gap(row: Row, generator: np.random.Generator) -> float:
    if isinstance(row.gap_rad, tuple):
        return math.exp(generator.uniform(*np.log(row.gap_rad)))
    return row.gap_rad


def _recorded(row: Row, bench: Bench, gap_rad: float, generator: np.random.Generator) -> Recording:
    """A recording of a random start angle, as it would be read in."""
    start_angle_rad = generator.uniform(0.0, 2.0 * math.pi)
    how: dict[str, Any] = {
        "rotations": row.rotations,
        "sampling_hz": row.sampling_hz,
        "start_angle_rad": start_angle_rad,
    }
    if row.made_by == "independent_bench":
        return _recorded_outside(row, bench, gap_rad, start_angle_rad, generator)
    if row.drift_share:
        return drifting(bench, gap_rad, row.drift_share, generator, **how)
    recording = bench.simulate(gap_rad, **how, seed=generator)
    if row.missing_share:
        return with_samples_lost(recording, row.missing_share, generator)
    return recording


def _recorded_outside(
    row: Row, bench: Bench, gap_rad: float, start_angle_rad: float, generator: np.random.Generator
) -> Recording:
    """Of the independent bench, noise added here."""
    values = values_of(bench)
    motor = generator.uniform(0.0, 2.0 * math.pi)
    angles = {"start_angle_rad": start_angle_rad, "motor_start_angle_rad": motor}
    made = simulate(
        plant(values, gap_rad=gap_rad, **angles),
        rotations=row.rotations,
        sampling_hz=row.sampling_hz,
    )
    speed, current = made.clean[1].copy(), made.clean[2].copy()
    turning = row.sampling_hz, bench.rotation_period_s(values["reference_speed_rpm"])
    if row.outside_noise == "speed_variation":
        speed, current = varied_speed(made.clean[1:], *turning, SPEED_VARIATION, generator)
    if row.outside_noise == "unlike_impacts":
        speed, current = unlike_impacts(made.clean[1:], *turning, UNLIKE, generator)
    if row.outside_noise == "encoder_harmonics":
        speed += encoder_harmonics(made.clean[0], ENCODER_SD_RPM, generator)
    if row.outside_noise == "one_over_f":
        speed += one_over_f(speed.size, row.speed_noise_sd_rpm, generator)
    else:
        noise = _noise(row).draw(speed.size, generator)
        if row.outside_noise == "louder_around_impacts":
            noise *= 1.0 + (LOUDER - 1.0) * around_impacts(made.clean[1], *turning)
        speed += noise
    current += CURRENT_NOISE_SD_A * generator.standard_normal(current.size)
    return replace(made.recording, channels={MOTOR_SPEED: speed, MOTOR_CURRENT: current})


def _noise(row: Row) -> NoiseModel:
    return NoiseModel(row.speed_noise_sd_rpm, row.coefficients, row.degrees_of_freedom)


@cache
def _bench(row: Row) -> Bench:
    assert row.bench is not None
    bench = load_bench(row.bench)
    seen = bench.measurement
    return replace(
        bench,
        measurement=replace(
            seen,
            encoder_counts=row.encoder_counts or seen.encoder_counts,
            speed_source=row.speed_source,
            speed_noise=_noise(row),
        ),
    )
