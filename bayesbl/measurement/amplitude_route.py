"""The paper's route: the amplitude of the ringing, converted to the gap by a gap curve.

CMA-ES finds the RMSE optimum of the disturbance model. emcee samples the posterior around it under
the noise of the recording. The gap curve converts the draws of A to draws of δ.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesbl.bench.bench import Bench, require_flank_change
from bayesbl.config.measurement import SnapshotConfig
from bayesbl.config.sections import PUBLISHED
from bayesbl.curve.gap_curve import GapCurve, likeliest_branch, published_curve
from bayesbl.curve.sweep import SweepSettings
from bayesbl.errors import NeedsBench, RecordingError, ResultError
from bayesbl.matching.observed import reference_speed
from bayesbl.matching.signals import SMALLEST_GAP_RAD
from bayesbl.measurement import shared_groups as shared
from bayesbl.measurement.compatibility import (
    bench_of,
    bench_with,
    other_speed,
    require_one_speed_of_all,
    require_same_estimator,
    unsuited,
)
from bayesbl.measurement.curves import CURVE, SweepProblem, curves_group, read_curve
from bayesbl.measurement.gap_by_curve import CONTRADICTED, Gap, MeasuredRinging, gaps
from bayesbl.measurement.measurement import (
    Answer,
    JointCheck,
    Measurement,
    Measurer,
    Reason,
    Task,
    check_item,
    estimator_of,
    joint_check,
    outcome_of,
    sampling_reasons,
)
from bayesbl.measurement.same_joint import (
    COULD_BE,
    HARMLESS_SD,
    INTEGRAL,
    PROPORTIONAL,
    RINGING,
    beside_bench,
    change_reason,
    harmonic_name,
    same_joint,
)
from bayesbl.measurement.stored import routes_of, stored_answers
from bayesbl.probabilities import FALSE_ALARM, ends, normal_isf
from bayesbl.processes import processes
from bayesbl.progress import StageProgress, of_stage
from bayesbl.recording.checks import moves, speed_in_another_unit
from bayesbl.recording.types import LOAD_POSITION, MOTOR_SPEED, FloatArray, Recording
from bayesbl.results.store import Interval, read_tree
from bayesbl.results.variables import Group, Variable, labels, table
from bayesbl.results.work import NOTHING_KEPT, WorkStore
from bayesbl.ringing.estimator import Estimator, Fit, PointEstimate, nominal_speed_rpm
from bayesbl.ringing.objective import Objective
from bayesbl.ringing.optimum import EarlierOptimum, bounds
from bayesbl.ringing.pointwise import likelihood_draws, predicted, speed_at
from bayesbl.ringing.posterior import require_second_sampler
from bayesbl.ringing.search import refine
from bayesbl.ringing.symbols import AMPLITUDE, MEAN, ROTATION, SYMBOLS
from bayesbl.ringing.table_2 import BoxSearch, same_pulses
from bayesbl.ringing.waveform import jacobian_columns

NAME = "amplitude"

BAND_DRAWS = 100
"""Posterior draws behind the predictive band."""

BENCHES = 12
"""Benches drawn within the tolerances that a recording is compared with."""

MOVES_RINGING = {
    PROPORTIONAL,
    INTEGRAL,
    harmonic_name("current", 1),
    harmonic_name("speed", 1),
}
"""Features that show controller gains and gravity. The ringing amplitude goes with at most the
first power of these; friction hardly changes it."""


GAPS, START_ANGLES = 20, 4
"""Gaps and start angles of a curve on demand. Against 60 gaps, 16 start angles and 5 rotations the
error of δ is far less than the uncertainty by the amplitude (``experiments/curve_counts.py``)."""

MOST_ROTATIONS = 3
"""Simulated load rotations: more change the fitted amplitude by less than 0.03 % of δ."""

DRAWS_PER_TERM = 3
"""Swept benches per term of the linear model in the parameters. With 24 benches for seven
parameters the curve's band is as wide as with 150, within 3 % (same command)."""

DEGREE = 3
SEED = 20260301
"""One seed for all curves on demand, so that the store serves runs of every seed."""


def _symbol(*dims: str) -> Callable[[str], Variable | None]:
    """Return a function that declares each symbol of the disturbance model over ``dims``."""

    def declared(name: str) -> Variable | None:
        if name not in SYMBOLS:
            return None
        return Variable(name, dims, SYMBOLS[name].unit, SYMBOLS[name].long_name)

    return declared


(_BASELINE,) = table("""
    baseline_rpm (chain, draw, baseline_term) | rpm | load-angle harmonics of the speed
""")

_TERMS = labels("baseline_term", "term of the load-angle baseline")

POSTERIOR = Group(
    "posterior",
    (
        _BASELINE,
        *table("""
            curve_amplitude_rpm? (chain, draw) | rpm
                | amplitude that enters the gap curve, with its scatter over start angles
            curve_scale? (chain, draw) | 1 | factor by which a known gap scales the curve
        """),
        replace(shared.DELTA, optional=True),
    ),
    (shared.CHAIN, shared.DRAW, _TERMS),
    named=_symbol(*shared.DRAWS),
)

SAMPLE_STATS = Group(
    "sample_stats",
    (
        *table("""
            lp (chain, draw) | 1 | log likelihood less its largest, linear symbols at their best
            outside_curve? (chain, draw) | 1 | amplitude below (-1), inside (0) or above (1)
                the range of the gap curve
        """),
        shared.ACCEPTANCE,
    ),
)

OF_NOISE = shared.of_noise_alone(
    _symbol(*shared.DRAWS), (_BASELINE,), (_TERMS,), (replace(shared.DELTA, optional=True),)
)

PREDICTIVE = Group(
    "predictive",
    table("""
        model_rpm (sample) | rpm | motor speed of the RMSE optimum
        residual_rpm (sample) | rpm | recording minus optimum
        low_rpm (sample) | rpm | lower bound of the predictive band
        high_rpm (sample) | rpm | upper bound of the predictive band
    """),
)

OPTIMUM = Group(
    "optimum",
    table("""
        baseline_rpm (baseline_term) | rpm | load-angle harmonics of the speed
        rmse_rpm! | rpm | root mean square error
        relative_rmse! | 1 | RMSE over the standard deviation of the speed
        evaluations | 1 | model evaluations
        search_seconds | s | time of the search
        covariance (parameter, parameter_) | products of units | sandwich covariance of the optimum
        impact_sd_rpm! (case) | rpm | standard deviation of A from impact to impact, beyond noise
        impact_loss (case) | 1 | share of A that is lost because impacts come early or late
        rival_amplitude_rpm (rival) | rpm | amplitude at other local optima
        rival_rmse_rpm (rival) | rpm | root mean square error at other local optima
        start? | text | start of the search
    """),
    (labels("parameter", "free parameter"), labels("parameter_", "free parameter")),
    named=_symbol(),
)

SEARCH_HISTORY = Group(
    "search_history",
    table("""
        run (iteration) | 1 | start that the iteration belongs to
        evaluations (iteration) | 1 | model evaluations in the run
        rmse_rpm (iteration) | rpm | best RMSE so far in the run
    """),
)

NOISE = Group(
    "noise",
    (
        *table("""
            sd_rpm | rpm | standard deviation of the noise
            coefficients (lag) | 1 | autoregressive coefficients
            differentiated | 1 | 1 where the noise is the change from sample to sample of such
                a process
            degrees_of_freedom | 1 | of Student-t innovations, infinite for normal ones
            student_t_evidence | 1 | gain in log likelihood of Student-t over normal innovations,
                less 1/2 ln n
            hidden_sd_rpm | rpm | standard deviation of the rounding that repeats every rotation
            bic (candidate_order) | 1 | Bayesian information criterion less its smallest
        """),
        shared.NOISE_ORDER,
        shared.DIFFERENCES,
    ),
)

MISFIT = Group(
    "misfit",
    table("""
        mean_rpm (phase_rad) | rpm | residual that repeats every load rotation
        standard_error_rpm (phase_rad) | rpm | standard error of the repeating residual
        rms_rpm | rpm | RMS of the repeating residual
    """),
    table("phase_rad (phase_rad) | rad | load phase from the start of the recording"),
)


@dataclass(frozen=True, slots=True)
class _Need:
    """What determines the curve of a recording, besides bench file and estimator.

    ``known``: bench values that differed when the recording was made.
    """

    reference_speed_rpm: float
    sampling_hz: float
    rotations: int
    known: tuple[tuple[str, float], ...]

    def __str__(self) -> str:
        return f"{self.sampling_hz:g} Hz at {abs(self.reference_speed_rpm):g} rpm"


class AmplitudeMeasurer(Measurer):
    """The amplitude route, with its estimator and the source of its gap curves.

    ``named`` is the published curve, or that of a sweep: one for all recordings. Without one, the
    ``bench`` is swept for the sampling rate, speed and length of each recording, if there is one.

    Raises UserError if the named curve or the bench cannot be read.
    """

    def __init__(self, config: SnapshotConfig, bench: Bench | None = None) -> None:
        super().__init__(config)
        self.estimator = estimator_of(config)
        self.named: GapCurve | None = None
        self.bench: Bench | None = None
        if config.curve.source is not None:
            is_published = config.curve.source == PUBLISHED
            self.named = published_curve() if is_published else read_curve(config.curve.source)
            self.gap_range_rad = self.named.gap_range_rad
        elif bench is not None or config.estimator.bench is not None:
            self.bench = bench_of(config) if bench is None else bench
            self.gap_range_rad = (SMALLEST_GAP_RAD, SweepSettings().high_rad)

    def describe(self) -> Iterator[tuple[str, Callable[[], str]]]:
        """Yield estimator and curve, and the earlier optimum and second sampler if configured."""
        estimator, curve = self.estimator, self.named
        yield "estimator", lambda: f"search {estimator.search}, noise {estimator.noise_kind}"
        if curve is not None:
            yield "curve", lambda: curve.name
        elif self.bench is not None:
            yield "curve", lambda: f"swept from {self.config.estimator.bench} on demand"
        else:
            none = "none, so the ringing alone: δ needs --bench FILE, or --curve RESULT of a sweep"
            yield "curve", lambda: none
        start_from = self.config.estimator.search.start_from
        if start_from is not None:
            yield "start from", lambda: f"{', '.join(read_earlier(start_from))} in {start_from}"
        if self.config.posterior.check_sampler:
            yield "second sampler", require_second_sampler

    def require_usable(self, recording: Recording) -> None:
        """Require a constant speed and a curve that fits this recording or can be swept for it."""
        if moves(recording):
            has_load = LOAD_POSITION in recording.channels
            raise (RecordingError if has_load else NeedsBench)(
                "This joint does not turn at one speed, and no gap curve belongs to the ringing of "
                "a motion.",
                file=recording.place,
                found="a reference that varies over time",
                expected=(
                    "--route two_encoders, as the load's position is recorded"
                    if has_load
                    else "the direct route, which needs a bench (--bench FILE); `bayesbl init "
                    "--bench` begins one, and `bayesbl identify` of three such motions completes it"
                ),
            )
        if self.named is not None:
            require_same_estimator(self.named, self.estimator, recording)
        elif (bench := self.bench_of(recording)) is not None:
            speed = self._need(recording, bench).reference_speed_rpm
            require_flank_change(bench, [speed], self.config.estimator.bench)

    def doubts(self, recording: Recording) -> Iterator[Reason]:
        """Yield why δ would be withheld whatever the fit: the curve belongs to another speed."""
        if self.named is None or self.config.curve.allow_extrapolation:
            return
        if (against := other_speed(recording, self.named)) is not None:
            if (question := self.question(recording)) is not None:
                yield question
            yield against

    def question(self, recording: Recording) -> Reason | None:
        """Ask whether the speed is in another unit, if that would explain why δ is withheld."""
        speed_rpm = None if self.named is None else self.named.reference_speed_rpm
        text = speed_in_another_unit(recording, speed_rpm)
        return None if text is None else Reason.of_text("speed_unit", text)

    def require_together(self, recordings: Sequence[Recording]) -> str | None:
        """The speed they share. With a bench, each recording has a curve of its own speed."""
        if self.bench is not None or len(recordings) < 2:
            return None
        require_one_speed_of_all(recordings)
        return f"{nominal_speed_rpm(recordings[0]):.5g} rpm in all"

    def bench_of(self, recording: Recording) -> Bench | None:
        """The bench at the time of a recording; ``None`` if no curves are swept from a bench."""
        if self.bench is None:
            return None
        return bench_with(self.bench, self.config.entry_of(recording.name).bench)

    def curves(self, task: Task) -> list[GapCurve]:
        """The curve of each recording, read or swept, in order; empty without one.

        Raises BenchError if a simulation fails, and CurveError if A does not grow with δ.
        """
        if self.named is not None:
            return [self.named] * len(task.recordings)
        if self.bench is None:
            return []
        needs = [self._need(recording, self.bench) for recording in task.recordings]
        curve_of_need = {
            need: self._swept(need, task, recording)
            for need, recording in dict(zip(needs, task.recordings, strict=True)).items()
        }
        return [curve_of_need[need] for need in needs]

    def _need(self, recording: Recording, bench: Bench) -> _Need:
        entry = self.config.entry_of(recording.name)
        speed = reference_speed(recording, bench, entry.reference_speed_rpm)
        recorded_rotations = recording.duration_s / bench.rotation_period_s(speed)
        rotations = min(max(int(recorded_rotations), 2), MOST_ROTATIONS)
        # The fingerprint of an estimator distinguishes rates to three digits.
        sampling_hz = float(f"{1.0 / recording.sampling_period_s:.3g}")
        return _Need(speed, sampling_hz, rotations, tuple(sorted(entry.bench.items())))

    def _swept(self, need: _Need, task: Task, recording: Recording) -> GapCurve:
        bench = self.bench_of(recording)
        assert bench is not None
        bench = bench.with_parameters(reference_speed_rpm=need.reference_speed_rpm)
        model = self.estimator.model
        model = replace(model, ranges=model.lasting_ranges)
        settings = SweepSettings(
            low_rad=SMALLEST_GAP_RAD,
            count=GAPS,
            start_angles=START_ANGLES,
            rotations=need.rotations,
            sampling_hz=need.sampling_hz,
        )
        problem = SweepProblem(bench, model, settings, SEED, task.work)
        report = of_stage(task.progress, f"Making the curve for {need}")
        if report is not None:
            report(0, 1)
        parameters = len(bench.tolerances)
        curve, _, _ = problem.curve(
            str(self.config.estimator.bench),
            DEGREE,
            self.estimator.fingerprint(recording),
            abs(need.reference_speed_rpm),
            DRAWS_PER_TERM * (1 + parameters) if parameters else 0,
            self.config.run.workers,
            report,
        )
        if report is not None:
            report(1, 1)
        return curve

    def measure(self, task: Task) -> Measurement:
        """Fit every recording and convert its amplitude to a gap, if there is a curve."""
        curves, entries = self.curves(task), task.config.recordings
        curve_or_none: Sequence[GapCurve | None] = curves or [None] * len(entries)
        fits = run_fits(self._jobs(task, curve_or_none), task.config.run.workers, task.progress)
        for fit in fits:
            if fit.point.start:
                task.say(f"{fit.point.recording.name}: {fit.point.start}")
        gap_or_none: Sequence[Gap | None] = [None] * len(fits)
        stored = {}
        if curves:  # all snapshots go through the same draws of the curve
            level = task.config.interval.level
            gap_or_none = read_gaps = gaps(
                curves,
                [measured_ringing(fit) for fit in fits],
                task.seeds.gap,
                [entry.known_gap for entry in entries],
                allow_extrapolation=task.config.curve.allow_extrapolation,
                level=level,
            )
            rows = [gap.rows for gap in read_gaps]
            stored[CURVE.name] = curves_group(task.names, curves, rows, level, task.seeds.curve)
        check = same_joint(
            [fit.point for fit in fits],
            [entry.repaired for entry in entries],
            [tuple(sorted(entry.bench.items())) for entry in entries],
            curve_or_none,
        )
        ringing_change = None
        if len(fits) > 1 and len({id(curve) for curve in curves}) <= 1:  # of one speed and rate
            first, last = (
                fits[at].posterior.draws[AMPLITUDE].ravel()[_index(fits[at], gap_or_none[at])]
                for at in (0, -1)
            )
            ringing_change = np.asarray(last / first - 1.0)
        seeds = task.seeds.predictive.spawn(len(fits))
        parts = zip(task.recordings, fits, gap_or_none, curve_or_none, seeds, strict=True)
        return Measurement(
            NAME,
            [self._answer(*part, task) for part in parts],
            shared=stored,
            curve=curves[0].name if curves else "",
            warnings=curves[0].warnings if curves else (),
            ringing_change=ringing_change,
            same_joint=check,
            change_reason=change_reason(check) if curves else None,
        )

    def _answer(
        self,
        recording: Recording,
        fit: Fit,
        gap: Gap | None,
        curve: GapCurve | None,
        seed: np.random.SeedSequence,
        task: Task,
    ) -> Answer:
        level = task.config.interval.level
        groups, numbers = shared.stored(
            amplitude_groups(fit, gap, curve, level, seed), task.config.interval
        )
        groups["optimum"].attrs["method"] = fit.point.optimum.method
        check, unlike = self._against_bench(recording, fit, gap, curve, level)
        unsuitable = unsuited(recording, fit, curve, task.config)
        against = [*reasons_as_printed(fit, curve), *unsuitable, *unlike]
        reasons = reasons_of(fit, gap, against, self.question(recording))
        bounded = all(reason.code == "beyond_curve" for reason in reasons if reason.withholds)
        return Answer(
            recording.name,
            None if gap is None else gap.delta_rad,
            reasons,
            groups,
            {**numbers, **_numbers(fit, numbers["parameters"])},
            check,
            gap.upper_bound_rad if gap is not None and bounded else None,
        )

    def _against_bench(
        self, recording: Recording, fit: Fit, gap: Gap | None, curve: GapCurve | None, level: float
    ) -> tuple[JointCheck, list[Reason]]:
        """Compare the recording with the curve's bench, and say why δ is withheld if they differ. A
        feature that differs moves δ by at most its own relative difference. It withholds δ if that
        difference is larger than half the width of the interval of ln δ."""
        if curve is None or gap is None:
            return joint_check(), []
        check = ringing_check(curve, measured_ringing(fit), gap)
        bench = self.bench_of(recording)
        if bench is None or np.any(gap.delta_rad <= 0.0):
            return check, []
        draws = gap.delta_rad.ravel()
        delta_sample = draws[np.linspace(0, draws.size - 1, BENCHES).round().astype(int)]
        items = beside_bench(fit.point, bench, delta_sample, np.random.default_rng(BENCHES))
        low, high = np.log(ends(draws, level))
        bound = normal_isf(0.5 * FALSE_ALARM / max(len(items), 1))
        differing = [
            item
            for item in items
            if item["quantity"] in MOVES_RINGING and abs(item["z"]) > bound
            if item["expected"] > 0.0
            if abs(item["measured"] / item["expected"] - 1.0) > 0.5 * (high - low)
        ]
        causes = [cause for item in differing for cause in COULD_BE[item["quantity"]]]
        reasons = [
            Reason("other_bench", {key: value for key, value in item.items() if key != "z"})
            for item in differing
        ]
        compared = joint_check(
            check["agrees"] and not differing,
            [*check["items"], *items],
            [*check["could_be"], *causes],
        )
        return compared, reasons

    def _jobs(self, task: Task, curves: Sequence[GapCurve | None]) -> list[FitJob]:
        start_from = task.config.estimator.search.start_from
        earlier = {} if start_from is None else read_earlier(start_from)
        check = task.config.posterior.check_sampler
        if check:
            require_second_sampler()
        last = next(reversed([*earlier.values()]), None)
        jobs = []
        for recording, seed, curve in zip(
            task.recordings, task.seeds.recordings, curves, strict=True
        ):
            bench = self.bench_of(recording)
            known = None if bench is None else bench.value("gear_ratio")
            ratio = self.config.joint.gear_ratio or known
            start = earlier.get(recording.name) or last
            jobs.append(
                FitJob(self.estimator, curve, recording, seed, ratio, start, check, task.work)
            )
        return jobs


def _numbers(fit: Fit, parameters: Mapping[str, Interval]) -> dict[str, Any]:
    """Further keys of the summary, with the misfit, the start and the second sampler."""
    point, optimum, noise = fit.point, fit.point.optimum, fit.point.noise
    evidence = noise.student_t_evidence
    numbers: dict[str, Any] = {
        "amplitude_rpm": parameters[AMPLITUDE],
        "optimum": {**optimum.symbols, "rmse_rpm": optimum.rmse_rpm},
        "noise": {
            "kind": noise.kind,
            "order": noise.order,
            "sd_rpm": noise.sd_rpm,
            "coefficients": noise.coefficients.tolist(),
            "degrees_of_freedom": noise.degrees_of_freedom,
            "student_t_evidence": evidence if np.isfinite(evidence) else None,
            "differentiated": noise.differentiated,
            "repeating_rounding_sd_rpm": noise.hidden_sd_rpm,
        },
        "misfit_rms_rpm": point.misfit.rms_rpm,
    }
    if point.start:
        numbers["start"] = point.start
    if (box := optimum.box_search) is not None:
        numbers["box_search"] = {
            **box.symbols,
            "rmse_rpm": box.rmse_rpm,
            "gap_as_printed_rad": gap_as_printed_rad(box),
            "has_pulses_of_optimum": float(has_pulses_of_optimum(box, point)),
        }
    if fit.check is not None:
        check = fit.check
        numbers["sampler_check"] = {
            "agrees": not check.differing,
            "symbols": {
                name: {"difference_sd": check.difference_sd[name], "width_ratio": ratio}
                for name, ratio in check.width_ratio.items()
            },
        }
    return numbers


def reasons_of(
    fit: Fit,
    gap: Gap | None,
    unsuited: Sequence[Reason] = (),
    question: Reason | None = None,
) -> list[Reason]:
    """List the reasons and notes of one snapshot's answer, the gravest first.

    ``gap``: ``None`` without a curve: the answer is then the amplitude of the ringing.
    ``unsuited``: reasons other than those of the fit and of the gap. ``question``: what to ask the
    user before anything else if δ is withheld.
    """
    sampling = sampling_reasons(fit.posterior.diagnostics)
    notes = [Reason.of_text("mended", text) for text in fit.point.notes]
    notes += [] if gap is None else gap.notes
    against = [*unsuited, *(() if gap is None else gap.reasons)]
    if fit.check is not None and fit.check.reason:
        against.append(Reason.of_text("second_sampler", fit.check.reason))
    # If the draws fail, all that is computed from them fails too: the cause comes first.
    failed = fit.posterior.diagnostics.failures
    reasons = [*sampling, *against] if failed else [*against, *sampling]
    reasons += [*notes, *(Reason.of_text("recording", n) for n in fit.point.recording.notes)]
    if question is not None and outcome_of(reasons) == "withheld":
        reasons.insert(0, question)
    return reasons


def amplitude_groups(
    fit: Fit, gap: Gap | None, curve: GapCurve | None, level: float, seed: np.random.SeedSequence
) -> dict[Group, object]:
    """Data of all groups of one recording."""
    index, point, posterior = _index(fit, gap), fit.point, fit.posterior
    return {
        POSTERIOR: (
            {name: values.ravel()[index] for name, values in posterior.draws.items()},
            {
                "baseline_rpm": posterior.baseline_rpm.reshape(index.size, -1)[index],
                "baseline_term": _baseline_terms(fit),
            },
            gap,
        ),
        SAMPLE_STATS: (
            {
                "lp": posterior.log_likelihood.ravel()[index],
                "acceptance_rate": posterior.diagnostics.acceptance,
            },
            gap,
        ),
        **_noise_only(fit, curve, np.random.default_rng(seed)),
        **shared.common_groups(
            point.recording,
            [MOTOR_SPEED],
            posterior.diagnostics,
            {} if gap is None else gap.budget,
            point.objective.duration_s / point.optimum.symbols[ROTATION],
        ),
        PREDICTIVE: _predictive(fit, level),
        OPTIMUM: (point.optimum, _optimum(fit)),
        SEARCH_HISTORY: point.optimum.history,
        NOISE: (point.noise, {"degrees_of_freedom": point.noise.degrees_of_freedom or np.inf}),
        MISFIT: point.misfit,
    }


def _index(fit: Fit, gap: Gap | None) -> NDArray[np.int64]:
    """Index of the posterior draw that is stored at each place, shape (chain, draw)."""
    if gap is not None:
        return gap.index
    shape = fit.posterior.log_likelihood.shape
    return np.arange(fit.posterior.log_likelihood.size).reshape(shape)


def _baseline_terms(fit: Fit) -> list[str]:
    return [n for n in jacobian_columns(fit.point.optimum.model) if n not in SYMBOLS]


def _noise_only(
    fit: Fit, curve: GapCurve | None, generator: np.random.Generator
) -> dict[Group, object]:
    """Prior, posterior and predictions of the model with waveform and noise alone.

    The prior is flat in every searched symbol within its range, and in ln δ, or without a curve in
    A. That of the mean speed is flat without bounds; its prior draws cover the recorded range.
    """
    point, objective = fit.point, fit.point.objective
    chains, _, terms = fit.posterior.baseline_rpm.shape
    speed = objective.speed_rpm[objective.used]
    ranges = {MEAN: (float(speed.min()), float(speed.max()))}
    ranges |= dict(zip(objective.searched, zip(*bounds(objective), strict=True), strict=True))
    ranges = {name: ranges[name] for name in fit.posterior.draws if name != AMPLITUDE}
    prior = {name: generator.uniform(*ends, shared.PRIOR_DRAWS) for name, ends in ranges.items()}
    low, high = (0.0, 0.5 * np.ptp(speed)) if curve is None else np.log(curve.gap_range_rad)
    amplitude = generator.uniform(low, high, shared.PRIOR_DRAWS)
    of_gap = {}
    if curve is not None:
        of_gap, knots = {shared.DELTA.name: np.exp(amplitude)}, curve.knots_rpm
        amplitude = np.exp(np.interp(amplitude, np.log(curve.gap(knots)), np.log(knots)))
    prior[AMPLITUDE] = amplitude

    def log_prior_of_amplitude(rpm: FloatArray) -> FloatArray:
        slope = (rpm > 0.0) & (rpm < high) if curve is None else curve.log_slope(rpm)
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(np.maximum(slope, 0.0) / (high - low)))

    def predictions(draws: dict[str, FloatArray], baseline: FloatArray) -> dict[str, FloatArray]:
        first = {name: values[:chains] for name, values in draws.items()}
        speeds = predicted(point, first, baseline[:chains], generator)
        return shared.replicates({MOTOR_SPEED: speeds})

    groups: dict[Group, object] = {
        OF_NOISE["prior"]: {name: values[None] for name, values in (prior | of_gap).items()},
        shared.PRIOR_PREDICTIVE: predictions(prior, np.zeros((chains, terms))),
    }
    count = shared.NOISE_DRAWS // chains * chains
    found = likelihood_draws(point, log_prior_of_amplitude, count, generator)
    if found is None:
        return groups
    flat, baseline, by_rotation = found
    groups[shared.POSTERIOR_PREDICTIVE] = predictions(flat, baseline)
    draws = {name: values.reshape(chains, -1) for name, values in flat.items()}
    shape = draws[AMPLITUDE].shape
    baseline, by_rotation = baseline.reshape(*shape, -1), by_rotation.reshape(*shape, -1)
    log_prior = {n: np.full(baseline.shape[:2], -math.log(b - a)) for n, (a, b) in ranges.items()}
    log_prior[AMPLITUDE] = log_prior_of_amplitude(draws[AMPLITUDE])
    labelled = {"baseline_rpm": baseline, "baseline_term": _baseline_terms(fit)}
    return groups | {
        OF_NOISE["noise_posterior"]: {**draws, **labelled},
        shared.LOG_LIKELIHOOD: {"recording": by_rotation},
        OF_NOISE["log_prior"]: log_prior,
    }


def _predictive(fit: Fit, level: float) -> dict[str, FloatArray]:
    """The optimum, and the band in which a new recording of the same joint would lie. The misfit
    that repeats every rotation would repeat in a new recording too. The band is therefore centred
    on optimum plus misfit."""

    point = fit.point
    time_s = point.objective.time_s
    model = point.optimum.predict(time_s)
    repeating, error = point.misfit.at(time_s - time_s[0], point.optimum.symbols[ROTATION])
    expected = model + repeating
    spread = np.sqrt(_prediction_variance(fit) + error**2 + point.noise.sd_rpm**2)
    half = normal_isf(0.5 - 0.5 * level) * spread
    return {
        "model_rpm": model,
        "residual_rpm": point.residual_rpm,
        "low_rpm": expected - half,
        "high_rpm": expected + half,
    }


def _prediction_variance(fit: Fit) -> FloatArray:
    """Posterior variance of the model speed h(t), shape (n,), rpm²."""
    point = fit.point
    objective, posterior = point.objective, fit.posterior
    flat = {name: values.ravel() for name, values in posterior.draws.items()}
    chains, draws, terms = posterior.baseline_rpm.shape
    baseline = posterior.baseline_rpm.reshape(chains * draws, terms)  # no -1: it may have no terms
    draw_index = np.linspace(0, len(baseline) - 1, BAND_DRAWS).round().astype(int)
    total, square = np.zeros(objective.samples), np.zeros(objective.samples)
    centre = point.optimum.predict(objective.time_s)
    for i in draw_index:
        difference = speed_at(point, flat, baseline, int(i)) - centre
        total += difference
        square += difference**2
    return np.asarray(square / draw_index.size - (total / draw_index.size) ** 2)


def _optimum(fit: Fit) -> dict[str, object]:
    optimum, spread = fit.point.optimum, fit.point.spread
    rival_squares = np.array([rival.sum_of_squares for rival in optimum.rivals])
    return {
        **optimum.symbols,
        "search_seconds": optimum.seconds,
        "covariance": spread.sandwich,
        "impact_sd_rpm": spread.impact_sd_rpm,
        "impact_loss": spread.losses,
        "rival_amplitude_rpm": [rival.symbols[AMPLITUDE] for rival in optimum.rivals],
        "rival_rmse_rpm": np.sqrt(rival_squares / optimum.samples),
        "start": fit.point.start,
        "parameter": list(spread.names),
        "parameter_": list(spread.names),
    }


# An earlier result, to start a search from.


def read_earlier(path: str | Path) -> dict[str, EarlierOptimum]:
    """Optima of a fit or a comparison, by name of the recording, in order.

    Raises ResultError if the result cannot be read, or has no optimum of the ringing.
    """
    tree = read_tree(path)
    if NAME not in routes_of(tree):
        raise ResultError(
            "This result holds no optimum to start from.",
            file=path,
            found=f'kind = "{tree.attrs.get("kind")}", routes: {", ".join(routes_of(tree))}',
            expected="the result of bayesbl fit or bayesbl compare by the ringing's amplitude",
        )
    return {
        stored.name: EarlierOptimum(
            f'the optimum of "{stored.name}" in {path}',
            {symbol: stored.number("optimum", symbol) for symbol in SYMBOLS},
            stored.number("optimum", "rmse_rpm"),
            withheld=stored.summary["diagnostics"]["outcome"] == "withheld",
        )
        for stored in stored_answers(tree, NAME)
    }


# The fits of all recordings.

FEWEST_PER_PROCESS = 2
"""Fits per process: a process takes as long to start as one fit takes to run."""


@dataclass(frozen=True, slots=True)
class FitJob:
    """All inputs of one fit; can be sent to another process."""

    estimator: Estimator
    curve: GapCurve | None
    recording: Recording
    seed: np.random.SeedSequence
    gear_ratio: float | None
    earlier: EarlierOptimum | None = None
    check: bool = False
    work: WorkStore = field(default=NOTHING_KEPT, compare=False)

    def run(self, progress: StageProgress | None = None) -> Fit:
        """Fit the recording, or recall the fit from the store of an unfinished run."""
        curve = self.curve
        make = partial(
            self.estimator.fit,
            self.recording,
            self.seed,
            self.gear_ratio,
            of_stage(progress, f"Sampling {self.recording.name}"),
            None if curve is None else partial(likeliest_branch, curve, self.estimator),
            earlier=self.earlier,
            check=self.check,
        )
        return self.work.get("fit", self, make, Fit)


def run_fits(jobs: Sequence[FitJob], workers: int, progress: StageProgress | None) -> list[Fit]:
    """Run all fits and return them in the order of their jobs, whatever the number of workers.

    A fit takes a second or two, so a few recordings are fitted before processes would have started.
    A check by the second sampler takes longer and gets a process of its own.
    """
    per_process = 1 if any(job.check for job in jobs) else FEWEST_PER_PROCESS
    count = min(workers, len(jobs) // per_process)
    if count <= 1:
        return [job.run(progress) for job in jobs]
    fits: list[Fit] = []
    with processes(count) as pool:
        for fit in pool.map(FitJob.run, jobs):
            fits.append(fit)
            if progress is not None:
                steps = fit.posterior.diagnostics.steps
                progress(f"Sampling {fit.point.recording.name}", steps, steps)
    return fits


def measured_ringing(fit: Fit) -> MeasuredRinging:
    """Amplitude, frequency and decay of the ringing, as a fit measured them."""
    return MeasuredRinging(fit.posterior.draws[AMPLITUDE], *fit.point.ringing)


# The ringing, compared with that of the bench.


def ringing_check(curve: GapCurve, measured: MeasuredRinging, gap: Gap) -> JointCheck:
    """Compare frequency and decay with the curve's at the measured amplitude.

    A curve without ringing data compares nothing. The standard deviation is that of the logarithms
    at the measured amplitude. It covers the fit, the start angle and the bench's tolerances.
    """
    if curve.ringing is None:
        return joint_check()
    expected, scatter, bench = curve.ringing_at(measured.centre[0])
    _, covariance = measured.given_amplitude(scatter)
    sds = np.sqrt(np.diag(covariance + bench))
    items = []
    for k, (quantity, unit, size) in enumerate(RINGING):
        if measured.covariance[k + 1, k + 1] > 0.0:  # else a fixed symbol was not measured
            found, log = float(measured.centre[k + 1]), float(expected[k])
            z = (found - log) / float(sds[k])
            item = check_item(quantity, math.exp(found) / size, math.exp(log) / size, unit, z)
            items.append(item)
    agrees = all(reason.code != CONTRADICTED for reason in gap.reasons)
    causes = [] if agrees else [cause for item in items for cause in COULD_BE[item["quantity"]]]
    return joint_check(agrees, items, causes)


# The paper's own search and model.


def reasons_as_printed(fit: Fit, curve: GapCurve | None) -> Iterator[Reason]:
    """Yield why an answer by the paper's search or by the paper's model is withheld."""
    point = fit.point
    box = point.optimum.box_search
    if box is not None and not has_pulses_of_optimum(box, point):
        values = {
            "amplitude_rpm": box.symbols[AMPLITUDE],
            "rmse_rpm": box.rmse_rpm,
            "gap_as_printed_rad": gap_as_printed_rad(box),
            "optimum_amplitude_rpm": point.optimum.symbols[AMPLITUDE],
            "optimum_rmse_rpm": point.optimum.rmse_rpm,
        }
        yield Reason("box_search_missed", values)
    no_baseline = point.optimum.model.baseline_harmonics == 0
    if no_baseline and curve is not None and curve.fingerprint is None:
        without, with_one = point.optimum.symbols[AMPLITUDE], amplitude_with_baseline_rpm(point)
        if abs(with_one - without) > HARMLESS_SD * math.sqrt(fit.point.spread.sandwich[0, 0]):
            values = {"amplitude_rpm": without, "with_baseline_rpm": with_one}
            yield Reason("no_baseline", values)


def has_pulses_of_optimum(box: BoxSearch, point: PointEstimate) -> bool:
    """Whether the search within Table 2's ranges found the same pulses as the optimum."""
    return same_pulses(box.symbols, point.optimum.symbols, point.objective.duration_s)


def gap_as_printed_rad(box: BoxSearch) -> float:
    """δ by eq. 4 at |A| of the box search, extrapolated if |A| is outside the curve's range."""
    return float(published_curve(draws=1).gap(np.array(abs(box.symbols[AMPLITUDE]))))


def amplitude_with_baseline_rpm(point: PointEstimate) -> float:
    """A of the neighbouring optimum after adding one load-angle harmonic to the model.

    The ranges of the symbols hold for this refinement too.
    """
    fitted = point.objective
    objective = Objective(
        replace(fitted.model, baseline_harmonics=1),
        fitted.time_s,
        fitted.speed_rpm,
        excluded=None if fitted.used.all() else ~fitted.used,
    )
    refined = refine(objective, point.optimum.searched)
    return float(objective.solve(refined[None]).coefficients[0, -1])
