"""The direct route: fit the simulated bench to the recordings, with the gap as an unknown.

All snapshots of a joint are fitted at once. They share the bench, so its unknown parameters largely
cancel in the change.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from bayesbl.bench.bench import Bench, require_flank_change
from bayesbl.bench.effects import effect_named
from bayesbl.bench.kernel import Slot
from bayesbl.bench.learned import ENCODER_ERROR, LEARNED_TORQUE
from bayesbl.bench.parameters import declaration_of
from bayesbl.config.measurement import SnapshotConfig
from bayesbl.errors import RecordingError
from bayesbl.matching.least_squares import SimulatedFit, fit_at
from bayesbl.matching.motions import flank_changes, noise_of, remembered_start
from bayesbl.matching.observed import Observed, marginalising_motor_lines, observed
from bayesbl.matching.posterior import MATTERS, DirectPosterior
from bayesbl.matching.predictive_check import RepeatingPower, standing_out
from bayesbl.matching.signals import (
    GAP,
    REFERENCE_DELAY,
    SMALLEST_GAP_RAD,
    START_ANGLE,
    SimulatedSignals,
    Unknown,
)
from bayesbl.measurement import shared_groups as shared
from bayesbl.measurement.compatibility import bench_of, bench_with
from bayesbl.measurement.measurement import (
    UPPER_BOUND_LEVEL,
    Answer,
    CheckItem,
    ExpectedSd,
    JointCheck,
    Measurement,
    Measurer,
    Reason,
    Task,
    blind_spot,
    check_item,
    joint_check,
    outcome_of,
    sampler_of,
    sampling_reasons,
    upper_bound,
)
from bayesbl.measurement.summary_types import PredictiveCheckEntry
from bayesbl.model_search.always_in import (
    CHANGED_TOGETHER,
    Direction,
    directions,
    edge_variances,
    linearised_fit,
    with_friction,
)
from bayesbl.model_search.joint_change import ChangedParameter, JointFindings
from bayesbl.model_search.pipeline import direct_unknowns, fit_jointly
from bayesbl.noise.outside_lines import without_outside_lines
from bayesbl.probabilities import TOO_FEW, ends
from bayesbl.progress import Progress, StageProgress, joined, of_stage, silent
from bayesbl.recording.checks import moves, require_alive
from bayesbl.recording.types import MOTOR_CURRENT, MOTOR_SPEED, FloatArray, Recording
from bayesbl.results.provenance import file_sha256
from bayesbl.results.variables import Group, Variable, labels, table
from bayesbl.ringing.cleaning import without_motor_lines
from bayesbl.sampling.chains import SamplerSettings
from bayesbl.units import RPM_PER_RAD_PER_S, unit_of

WHOLE_ORDER = 0.03
"""Distance from a whole number above which a line's order is not whole: several times the
resolution by five rotations."""

WORST = ("channel", "recording", "highest_order", "ratio")
"""What is told of the largest power that repeats."""

BOUNDED = ("gap_unseen",)
"""Codes of reasons that withhold δ but leave an upper bound."""

EXPECTED_AT_RAD = (1e-4, 3e-4, 1e-3)
"""Gaps of a new, a used and a worn reducer."""

EXPECTED_DRAWS = 1000
"""Draws of the marginalised directions: they give a standard deviation to 2 %."""

EXCLUDED_END = 0.1
"""A recording excludes an end of the range of ln δ if the outer ``EXCLUDED_END`` of it holds less
than ``TOO_FEW`` of the posterior (a flat posterior: 0.1). Then δ has a bound."""

REMEMBERED = 1.0
"""Largest χ² that an unknown start may leave: it moves δ by at most one standard deviation."""


@dataclass(frozen=True, slots=True)
class DirectMatch:
    """A joint posterior, the predictive check of its optimum, and the changes of the joint."""

    posterior: DirectPosterior
    check: tuple[RepeatingPower, ...]
    joint: JointFindings
    allows_for_misfit: bool = False
    """Whether δ includes the possible effect of a law that no candidate explains."""

    @property
    def change_rad(self) -> FloatArray:
        """Draws of the change of δ from the first recording to the last, shape (chain, draw)."""
        names = [observation.name for observation in self.posterior.fit.model.recordings]
        first, last = (self.posterior.values(GAP, name) for name in (names[0], names[-1]))
        return last - first

    def repeating(self, recording: str) -> list[RepeatingPower]:
        """Entries that noise does not explain and that affect the answer of one recording.

        Through shared unknowns, a misfit in one recording moves the gaps of all.
        """
        shared_by_all = any(u.recording is None for u in self.posterior.fit.model.unknowns)
        repeating = standing_out(self.check)
        return [entry for entry in repeating if shared_by_all or entry.recording == recording]

    def model_check(self, recording: str, level: float) -> JointCheck:
        """Whether this recording is consistent with the bench as stated.

        A disagreement shows in a reason that withholds δ, or in the comparison.
        """
        changed, allowed = (
            [c for c in found if c.recording in (None, recording)]
            for found in (self.joint.changed, self.joint.allowed)
        )
        contradicted = changed or self.repeating(recording)
        beyond = self.posterior.beyond_tolerance(recording, level)
        return joint_check(
            self.joint.explained and not contradicted and beyond is None,
            [_check_item(c) for c in (*changed, *allowed)],
            self.joint.could_be if changed else (),
        )


class DirectMeasurer(Measurer):
    """The direct route with its bench."""

    def __init__(self, config: SnapshotConfig, bench: Bench | None = None) -> None:
        super().__init__(config)
        self.bench = bench_of(config) if bench is None else bench
        self.gap_range_rad = config.estimator.gap_rad

    def describe(self) -> Iterator[tuple[str, Callable[[], str]]]:
        """Yield the bench."""
        file, form = self.config.estimator.bench, self.bench.gap_form
        yield "bench", lambda: f"{file}, gap form {form}"

    def require_usable(self, recording: Recording) -> None:
        """Require that the bench can be compared with the recording, and that its gap shows."""
        observation = observed_of(self.config, self.bench, recording)
        if observation.motion is None:
            bench = bench_with(self.bench, self.config.entry_of(recording.name).bench)
            require_flank_change(
                bench, [observation.reference_speed_rpm], self.config.estimator.bench
            )

    def expected(
        self, recordings: Sequence[Recording], progress: StageProgress | None = None
    ) -> Sequence[ExpectedSd]:
        """Expected at gaps within the prior, from bench and noise.

        A motion must repeat: otherwise its noise is unknown before a fit.
        """
        observations = [observed_of(self.config, self.bench, recording) for recording in recordings]
        moving = [o.name for o in observations if o.motion is not None]
        if not observations or any(o.name in moving and o.cycle is None for o in observations):
            return ()
        bench = with_friction(self.bench, observations)
        low, high = self.config.estimator.gap_rad
        names = [observation.name for observation in observations]
        return expected_sds(
            bench,
            observations,
            direct_unknowns(bench, names, (low, high), moving),
            directions(bench, self.config.joint.drift),
            [gap_rad for gap_rad in EXPECTED_AT_RAD if low < gap_rad < high],
            of_stage(progress, "Estimating the precision at some gaps"),
        )

    def measure(self, task: Task) -> Measurement:
        """Fit the bench to all recordings at once."""
        problem = (
            self.bench,
            [observed_of(self.config, self.bench, recording) for recording in task.recordings],
            self.config.estimator.gap_rad,
            self.config.joint.drift,
            sampler_of(self.config),
            task.seeds.direct,
        )
        match = task.work.get(
            "direct match",
            problem,
            lambda: fit_directly(*problem, self.config.run.workers, task.progress),
            DirectMatch,
        )
        level = self.config.interval.level
        seeds = task.seeds.predictive.spawn(len(task.recordings))
        answers = [
            self._answer(recording, index, match, child)
            for index, (recording, child) in enumerate(zip(task.recordings, seeds, strict=True))
        ]
        withheld = any(a.is_withheld for a in answers)
        return Measurement(
            "direct",
            answers,
            attributes={"bench": self.bench.fingerprint()},
            same_joint=check_of_comparison(
                match.joint, match.change_rad, level, is_given=not withheld
            ),
        )

    def _answer(
        self, recording: Recording, index: int, match: DirectMatch, seed: np.random.SeedSequence
    ) -> Answer:
        posterior = match.posterior
        check = [entry for entry in match.check if entry.recording == recording.name]
        observation = posterior.fit.model.recordings[index]
        texts = (
            Reason.of_text("recording", text) for text in (*recording.notes, *observation.notes)
        )
        notes = [*texts, *self._beyond_the_bench(match)]
        entry, identified = self.config.entry_of(recording.name), self.bench.identified
        if identified is not None and file_sha256(entry.file) in identified.sources:
            notes.append(Reason("counted_twice", {"name": entry.name}))
        level = self.config.interval.level
        generator = np.random.default_rng(seed)
        groups, numbers = shared.stored(
            direct_groups(posterior, recording, index, generator), self.config.interval
        )
        gap = posterior.values(GAP, recording.name)
        reasons = direct_reasons(match, index, notes, level)
        contradicted = any(r.code not in BOUNDED for r in reasons if r.withholds)
        return Answer(
            recording.name,
            gap,
            reasons,
            groups,
            {**numbers, **_numbers(posterior, recording, index, check, groups)},
            match.model_check(recording.name, level),
            None
            if contradicted or excluded_ends(posterior, recording.name) != (False, True)
            else upper_bound(gap),
        )

    def _beyond_the_bench(self, match: DirectMatch) -> Iterator[Reason]:
        """Yield notes of what was added to the bench and is allowed for in δ."""
        if (part := match.joint.part) is not None:
            values = {
                "name": part.name,
                "frequency_hz": part.frequency_hz,
                "probability": part.probability,
            }
            yield Reason("elastic_part", values)
        stated = {effect.name for effect in self.bench.effects}
        for effect in match.posterior.fit.model.bench.effects:
            if effect.name == "sampled_control" and effect.name not in stated:
                period_s = effect.complete()["period_s"]
                yield Reason("controller_period", {"period_s": period_s})


def observed_of(config: SnapshotConfig, bench: Bench, recording: Recording) -> Observed:
    """A recording prepared for the simulator, with the parameter values that its config states."""
    require_alive(recording, (MOTOR_CURRENT,))
    require_unshaken(recording, bench)
    entry = config.entry_of(recording.name)
    known = {name.replace(".", "__"): value for name, value in entry.bench.items()}
    observation = observed(recording, bench, entry.reference_speed_rpm)
    return replace(observation, known={**observation.known, **known})


def require_unshaken(recording: Recording, bench: Bench) -> None:
    """Require that no outside vibration shakes a joint at constant speed.

    Lines at whole orders of the load or the motor are part of the simulation, as are all lines if
    the bench has periodic effects.

    Raises RecordingError if there are other lines, with their frequencies.
    """
    if moves(recording) or any(effect_named(e.name).is_periodic for e in bench.effects):
        return
    without_motor, _ = without_motor_lines(recording)
    channels = {MOTOR_SPEED: without_motor.motor_speed_rpm}
    turn_s = bench.rotation_period_s(float(recording.motor_speed_rpm.mean()))
    _, lines = without_outside_lines(channels, recording.sampling_period_s, turn_s)
    orders = [line.frequency_hz * turn_s for line in lines]
    outside = [
        line
        for line, order in zip(lines, orders, strict=True)
        if abs(order - round(order)) > WHOLE_ORDER
    ]
    if outside:
        raise RecordingError(
            "Something shakes the joint from outside, and the simulation lacks it.",
            file=recording.place,
            where=MOTOR_SPEED,
            found=" and ".join(
                f"{line.size_rpm:.2g} rpm at {line.frequency_hz:.4g} Hz, all the time"
                for line in outside
            ),
            expected="a recording while other machines and axes stand still; the amplitude's "
            "route allows for the shaking (--route amplitude)",
        )


def fit_directly(
    bench: Bench,
    recordings: Sequence[Observed],
    gap_rad: tuple[float, float],
    drift: Mapping[str, float],
    sampler: SamplerSettings,
    seed: np.random.SeedSequence,
    workers: int = 1,
    progress: StageProgress | None = None,
) -> DirectMatch:
    """Optimum and posterior of all recordings; ``drift`` as of :func:`fit_jointly`."""
    joint_fit = fit_jointly(bench, recordings, gap_rad, drift, workers, progress)
    name = joined([r.name for r in recordings])
    report = of_stage(progress, f"Sampling {name}")
    simulating = of_stage(progress, f"Simulating draws of {name}")
    allows_for_misfit = joint_fit.allows_for_misfit
    withheld = not (joint_fit.joint.explained or allows_for_misfit)
    posterior = joint_fit.sampled(sampler, seed, report, simulating, withheld=withheld)
    return DirectMatch(posterior, joint_fit.linear_fit.check, joint_fit.joint, allows_for_misfit)


def direct_reasons(
    match: DirectMatch, index: int, notes: Sequence[Reason] = (), level: float = 0.9
) -> list[Reason]:
    """List the reasons and notes of one snapshot's answer, the gravest first.

    ``index``: place of its recording in the model; ``notes``: what was done to it; ``level``: of
    the interval.
    """
    fit = match.posterior.fit
    recording = fit.model.recordings[index]
    gap = match.posterior.values(GAP, recording.name)
    repeating = match.repeating(recording.name)
    with_current = len(recording.signals) > 1
    tolerance = match.posterior.beyond_tolerance(recording.name, level)
    problems = [] if tolerance is None else [Reason("tolerance_decides", tolerance)]
    if contradicted := match.posterior.contradicted_together():
        problems.append(Reason("sheet_contradicted", {"names": contradicted[:4]}))
    if not (repeating or match.joint.explained or match.allows_for_misfit):
        problems.append(Reason("unexplained"))
    misfit: dict[str, Any] = {}
    if repeating:
        worst = max(repeating, key=lambda entry: entry.ratio)
        misfit = {
            **{key: getattr(worst, key) for key in WORST},
            "channels": sorted({f"{e.channel} of {e.recording}" for e in repeating}),
            "is_motion": recording.motion is not None,
        }
        if match.joint.could_be:
            misfit["could_be"] = list(match.joint.could_be)
    if misfit and not match.allows_for_misfit:
        # A misfit that nothing explains also biases bench parameters: they are not its cause.
        problems.insert(0, Reason("repeats_beyond_noise", misfit))
    # If δ is not seen, the range of its prior may decide; that needs no extra reason.
    unseen = unseen_gap(match.posterior, index) or unknown_start(fit, index)
    reasons = [*problems, *([unseen] if unseen else sampling_reasons(match.posterior.diagnostics))]
    answered = outcome_of(reasons) != "withheld"
    unknown = fit.model.unknowns[fit.model.index(GAP, recording.name)]
    ends = excluded_ends(match.posterior, recording.name)
    if answered and unknown.offset and ends == (False, True):
        values = {"upper_rad": upper_bound(gap), "smallest_rad": SMALLEST_GAP_RAD}
        reasons.append(Reason("gap_not_told", values))
    if answered and match.joint.beyond_bench:
        reasons.append(Reason("bench_lacks", bench_lacks(match.joint)))
    if answered and match.allows_for_misfit:
        # The bench has one misfit: it is reported once, with the largest widening.
        places = [place for place, u in enumerate(fit.model.unknowns) if u.name == GAP]
        wider = float(match.posterior.model_widening[places].max())
        code = "allows_for_misfit" if misfit else "negative_law"
        reasons.append(Reason(code, {**misfit, "times": wider}))
    if not with_current:
        reasons.append(Reason("no_current"))
    wider = float(match.posterior.widening[fit.model.index(GAP, recording.name)])
    if answered and wider > 1.0 + MATTERS:
        reasons.append(Reason("widened", {"times": wider}))
    variance = float(edge_variances(match.posterior).mean())
    if answered and variance > 0.0:
        reasons.append(Reason("soft_edges", {"sd_rad": math.sqrt(variance)}))
    return [*reasons, *motion_notes(fit, index), *notes]


def _numbers(
    posterior: DirectPosterior,
    recording: Recording,
    index: int,
    check: Sequence[RepeatingPower],
    groups: Mapping[str, xr.Dataset],
) -> dict[str, Any]:
    """Further keys of the summary, with the bound and the predictive check."""
    optimum, drawn = groups["optimum"], groups["posterior"]
    names = list(own_unknowns(posterior, recording.name))
    noise = posterior.fit.model.noise[index]
    sd = groups["noise"]["sd"].values.tolist()
    numbers: dict[str, Any] = {
        "optimum": {n: float(optimum[n]) for n in names},
        "cramer_rao_sd": {n: float(optimum["cramer_rao_sd"].sel(parameter=n)) for n in names},
        "posterior_sd": {n: float(drawn[n].std()) for n in names},
        "noise": {
            "kind": "ar" if noise.order else "white",
            "order": noise.order,
            "sd_rpm": sd[0],
            "sd_a": sd[1] if len(sd) > 1 else None,
            "coefficients": groups["noise"]["coefficients"].values.tolist(),
            "degrees_of_freedom": None,
        },
        "predictive_check": [
            {key: getattr(entry, key) for key in PredictiveCheckEntry.__annotations__}
            for entry in check
        ],
    }
    if "flank_changes" in groups["predictive"]:
        motion = groups["predictive"]
        repeats = bool(motion["repeats"])
        numbers["motion"] = {
            "cycle_s": float(motion["rotation_period_s"]) if repeats else None,
            "cycles": float(groups["diagnostics"]["rotations"]) if repeats else None,
            "flank_changes": round(float(motion["flank_changes"])),
            "compared_from_s": float(motion["compared_from_s"]),
        }
    return numbers


# What is expected before a fit.


def expected_sds(
    bench: Bench,
    recordings: Sequence[Observed],
    unknowns: Sequence[Unknown],
    among: Sequence[Direction],
    gaps_rad: Sequence[float],
    progress: Progress = silent,
) -> list[ExpectedSd]:
    """Expected posterior standard deviations at each of these gaps, before any fit.

    The posterior is linearised at the true value: its width follows from the derivatives of the
    simulation and from the noise between rotations, or cycles of a motion. The laws ``among`` which
    the bench may lack, and drift, are included as in an answer; the error of a wrong bench is not.
    Of the recordings, only noise, length and motion matter. Raises RecordingError if one is too
    short to estimate its noise, and SimulationError if the bench cannot be simulated at a gap.
    """
    noise = [noise_of(observations, observations.signals) for observations in recordings]
    observations = [marginalising_motor_lines(recording, bench) for recording in recordings]
    model = SimulatedSignals(bench, observations, unknowns, noise, 1)
    expected: list[ExpectedSd] = []
    for gap_rad in gaps_rad:
        progress(len(expected), len(gaps_rad))
        expected.append(_at(model, gap_rad, among))
    return expected


def _at(model: SimulatedSignals, gap_rad: float, among: Sequence[Direction]) -> ExpectedSd:
    gaps = [k for k, unknown in enumerate(model.unknowns) if unknown.name == GAP]
    # One-sided unknowns at the mean of their prior: at the bound, derivatives toward the other side
    # would be missed.
    one_sided = np.array([u.low == u.centre and math.isfinite(u.sd) for u in model.unknowns])
    means = [u.centre + u.sd * math.sqrt(2.0 / math.pi) for u in model.unknowns]
    point = np.where(one_sided, means, [u.middle for u in model.unknowns])
    point[gaps] = [float(model.unknowns[k].coordinate(np.array(gap_rad))) for k in gaps]
    model.require(point)
    # Use the simulation itself as data, so that the residuals are zero.
    simulated = [
        replace(observation, signals=model.signals(point, place)[0])
        for place, observation in enumerate(model.recordings)
    ]
    fit = fit_at(replace(model, recordings=simulated), point)
    drawn = (
        linearised_fit(fit, among).posterior.draw(np.random.default_rng(0), EXPECTED_DRAWS).shift
    )
    covariance = fit.covariance + np.cov(drawn.T)
    slope_rad = float(model.unknowns[gaps[0]].slope(np.array(gap_rad)))

    def sd_rad(toward: Mapping[int, float]) -> float:
        weights = np.zeros(point.size)
        weights[list(toward)] = list(toward.values())
        return slope_rad * math.sqrt(float(weights @ covariance @ weights))

    first, last = gaps[0], gaps[-1]
    change = sd_rad({first: -1.0, last: 1.0}) if last != first else None
    return ExpectedSd(gap_rad, max(sd_rad({k: 1.0}) for k in gaps), change)


# What a motion shows of its gap.


def unseen_gap(posterior: DirectPosterior, index: int) -> Reason | None:
    """Why a motion does not determine δ of a recording, with the bound it leaves; ``None`` if it
    does or turns at constant speed."""
    fit = posterior.fit
    observation = fit.model.recordings[index]
    if observation.motion is None or flank_changes(fit, index):
        return None
    values: dict[str, float | bool] = {"pull_rpm_per_s": largest_pull(fit, index)}
    is_larger, is_smaller = excluded_ends(posterior, observation.name)
    if is_larger != is_smaller:
        share = 1.0 - UPPER_BOUND_LEVEL if is_larger else UPPER_BOUND_LEVEL
        bound_rad = float(np.quantile(posterior.values(GAP, observation.name), share))
        values |= {"is_larger": is_larger, "level": UPPER_BOUND_LEVEL, "bound_rad": bound_rad}
    return Reason("gap_unseen", values)


def unknown_start(fit: SimulatedFit, index: int) -> Reason | None:
    """Why the unknown start of a motion leaves δ unknown; ``None`` if it does not."""
    observation = fit.model.recordings[index]
    if (
        observation.motion is None
        or remembered_start(fit, index)[observation.first_compared] <= REMEMBERED
    ):
        return None
    return Reason("start_unknown")


def largest_pull(fit: SimulatedFit, index: int) -> float:
    """Smallest motor acceleration, rpm/s, that would lift the load off its flank anywhere in this
    motion: the minimum of N |m g l sin(θ + φ_g)| / J_l."""
    model, observation = fit.model, fit.model.recordings[index]
    assert observation.motion is not None
    row = model.vectors(fit.point[None], observation)[0]
    time = np.arange(observation.samples) / observation.sampling_hz
    angle = row[Slot.start_angle_rad] + observation.motion.position_rad(time) / row[Slot.gear_ratio]
    pull = np.abs(row[Slot.gravity_torque_nm] * np.sin(angle + row[Slot.gravity_angle_rad]))
    smallest = row[Slot.gear_ratio] * pull.min() / row[Slot.load_inertia_kg_m2]
    return float(smallest * RPM_PER_RAD_PER_S)


def excluded_ends(posterior: DirectPosterior, recording: str) -> tuple[bool, bool]:
    """Whether a recording excludes the lower and the upper end of the range of its δ."""
    model = posterior.fit.model
    place = model.index(GAP, recording)
    unknown, draws = model.unknowns[place], posterior.draws[..., place]
    end = EXCLUDED_END * (unknown.high - unknown.low)
    at_low = float(np.mean(draws < unknown.low + end))
    at_high = float(np.mean(draws > unknown.high - end))
    return at_low < TOO_FEW, at_high < TOO_FEW


def motion_notes(fit: SimulatedFit, index: int) -> Iterator[Reason]:
    """Yield notes on how a motion was compared."""
    observation = fit.model.recordings[index]
    if observation.motion is None:
        return
    if observation.cycle is None:
        yield Reason("motion_once")
    if all(u.name != REFERENCE_DELAY for u in fit.model.unknowns):
        yield Reason("reference_held")
    if observation.first_compared > 0:
        begin_s = observation.first_compared / observation.sampling_hz
        yield Reason("start_left_out", {"begin_s": begin_s})


# What is reported of the joint: items, findings, blind spots.


def check_of_comparison(
    joint: JointFindings, change_rad: FloatArray, level: float, *, is_given: bool
) -> JointCheck:
    """Compare the recordings with one another, and list changes that none of them would show.

    ``change_rad``: draws of the change of δ from the first to the last; ``is_given``: whether the
    change is reported.
    """
    between = joint.between
    findings = [{"code": "parameter_changed", **_change_values(c)} for c in between]
    if between:
        lookalike = {"code": "would_look_the_same", "names": _alike(joint, between)}
        allowed = {"code": "change_allows_for_it"}
        findings[-1]["also"] = [lookalike] * bool(lookalike["names"]) + [allowed] * is_given
    return joint_check(
        joint.explained and not between,
        [_check_item(c) for c in between],
        joint.could_be if between else (),
        findings,
        [
            blind_spot(
                "parameter_unseen",
                spot.error_rad,
                name=spot.name,
                size=spot.size,
                expected=spot.expected,
                unit=spot.unit,
            )
            for spot in joint.blind_spots
            if spot.error_rad > MATTERS * float(np.ptp(ends(change_rad, level)))
        ],
    )


def bench_lacks(findings: JointFindings) -> dict[str, Any]:
    """Parameters that differ from the bench in every recording, for the sentence."""
    changed = findings.beyond_bench
    return {"parameters": [_change_values(c) for c in changed], "alike": _alike(findings, changed)}


def _alike(findings: JointFindings, changed: Sequence[ChangedParameter]) -> list[str]:
    """Names that the recordings cannot distinguish from the changed parameters."""
    freed = {part for c in changed for part in (c.name, c.name.partition(".")[0])}
    freed |= {name for name, parts in CHANGED_TOGETHER.items() if freed >= set(parts)}
    return [name for name in findings.could_be if name not in freed]


def _check_item(changed: ChangedParameter) -> CheckItem:
    z = (changed.estimate - changed.expected) / changed.sd if changed.sd > 0.0 else 0.0
    return check_item(changed.name, changed.estimate, changed.expected, changed.unit, z)


def _change_values(changed: ChangedParameter) -> dict[str, Any]:
    return {
        "name": changed.name,
        "measured": changed.estimate,
        "expected": changed.expected,
        "unit": changed.unit,
        "recording": changed.recording,
    }


# What is stored.

DELTA = shared.DELTA.name


DRIFT = "drift__"
"""Prefix of parameters that may have drifted since the first snapshot."""


def result_name(unknown: Unknown) -> str:
    """Name of an unknown in results, ``delta_rad`` for the gap."""
    if unknown.added:
        return DRIFT + unknown.name
    return DELTA if unknown.name == GAP else unknown.name


OF_NO_BENCH = {
    DELTA: shared.DELTA.meaning,
    START_ANGLE: "load angle at the first sample, 0 hangs straight down",
    REFERENCE_DELAY: "how much later the controller was given its reference than is recorded",
}
"""Unknowns that are neither in a bench file nor learned, by their names in results."""


def unit_and_meaning(name: str) -> tuple[str, str]:
    """Unit and long name of an unknown, by its name in results."""
    if name.startswith(DRIFT):
        unit, meaning = unit_and_meaning(name.removeprefix(DRIFT))
        return unit, f"change since the first snapshot of: {meaning}"
    block, _, slot = name.partition("__")
    if block in (LEARNED_TORQUE, ENCODER_ERROR):
        kind = block.replace("_", " ")
        if slot.startswith("shift"):
            return "1", f"where the variable of the {kind} is at the first sample, rad or s"
        return "rad" if block == ENCODER_ERROR else "N m", f"coefficient of the {kind}: {slot}"
    meaning = OF_NO_BENCH.get(name) or declaration_of(name).meaning
    return unit_of(name) or "1", f"{meaning} of {block}" if slot else meaning


def _unknown(*dims: str) -> Callable[[str], Variable]:
    """Return a function that declares an unknown, given its name in results."""
    return lambda name: Variable(name, dims, *unit_and_meaning(name))


def _predicted(name: str) -> Variable | None:
    kind, _, channel = name.partition("_")
    meanings = {"simulated": "simulation at the optimum", "residual": "recording minus simulation"}
    if kind not in meanings:
        return None
    return Variable(name, ("sample",), unit_of(channel), meanings[kind])


POSTERIOR = Group(
    "posterior", (shared.DELTA,), (shared.CHAIN, shared.DRAW), named=_unknown(*shared.DRAWS)
)

OF_NOISE = shared.of_noise_alone(_unknown(*shared.DRAWS))

SAMPLE_STATS = Group(
    "sample_stats",
    (
        *table("""
            lp (chain, draw) | 1 | log likelihood less its largest, by full simulation,
                all recordings together
        """),
        shared.ACCEPTANCE,
    ),
)

PREDICTIVE = Group(
    "predictive",
    table("""
        rotation_period_s | s | one load rotation, or one cycle of a motion
        reference_speed_rpm? (sample) | rpm | reference speed of the motor in a motion
        compared_from_s? | s | start of the compared part of a motion, from the first sample
        repeats? | 1 | 1 where a motion repeats, 0 where it does not
        flank_changes? | 1 | how often the load passed from one flank to the other
        flank_left_s? (flank) | s | when the teeth parted, from the first sample
        flank_met_s? (flank) | s | when the teeth met on the other side
        flank_side? (flank) | 1 | flank met: 1 where the motor pushes forward, −1 backward
    """),
    named=_predicted,
)

OPTIMUM = Group(
    "optimum",
    table("""
        cramer_rao_sd (parameter) | each parameter's own
            | Cramér-Rao bound on the standard deviation, priors left out
        covariance (parameter, parameter_) | products of units
            | covariance of the normal approximation, priors included
    """),
    (labels("parameter", "unknown"), labels("parameter_", "unknown")),
    named=_unknown(),
)

NOISE = Group(
    "noise",
    (
        *table("""
            sd (channel) | each channel's own | standard deviation of the noise
            coefficients (lag, channel, channel_) | ratios of units
                | vector autoregressive coefficients
            innovation_root (channel, channel_) | each channel's own
                | lower triangular root of the innovations' covariance
        """),
        shared.NOISE_ORDER,
        shared.DIFFERENCES,
    ),
    (labels("channel", "channel"), labels("channel_", "channel")),
)


def direct_groups(
    posterior: DirectPosterior,
    recording: Recording,
    index: int,
    generator: np.random.Generator,
) -> dict[Group, object]:
    """Data of all groups of one snapshot.

    ``index``: place of the recording in the posterior's model; ``generator``: for the predictions
    of prior and posterior.
    """
    model = posterior.fit.model
    observation, noise = model.recordings[index], model.noise[index]
    channels = list(observation.channels)
    return {
        POSTERIOR: _draws(posterior, recording.name, posterior.draws),
        SAMPLE_STATS: {
            "lp": -0.5 * (posterior.chi_square - np.nanmin(posterior.chi_square)),
            "acceptance_rate": posterior.diagnostics.acceptance,
        },
        **_noise_only(posterior, index, generator),
        **shared.common_groups(
            recording,
            channels,
            posterior.diagnostics,
            _budget(posterior, recording.name),
            observation.samples / observation.sampling_hz / observation.rotation_period_s,
            effective=posterior.effective,
            simulated=posterior.simulated,
            refits=posterior.refits,
        ),
        PREDICTIVE: (_predictive(posterior, index), _motion(posterior.fit, index)),
        OPTIMUM: _optimum(posterior, recording.name),
        NOISE: (
            noise,
            {"innovation_root": noise.root, "channel": channels, "channel_": channels},
        ),
    }


def own_unknowns(posterior: DirectPosterior, recording: str) -> dict[str, int]:
    """Name in results → index in a point, of all unknowns that a recording depends on."""
    return {
        result_name(u): i
        for i, u in enumerate(posterior.fit.model.unknowns)
        if u.recording in (None, recording)
    }


def _draws(posterior: DirectPosterior, recording: str, points: FloatArray) -> dict[str, FloatArray]:
    """Values of a recording's unknowns at points of shape (chain, draw, d)."""
    unknowns = posterior.fit.model.unknowns
    places = own_unknowns(posterior, recording)
    return {name: unknowns[i].value(points[..., i]) for name, i in places.items()}


def _noise_only(
    posterior: DirectPosterior, index: int, generator: np.random.Generator
) -> dict[Group, object]:
    """Prior, posterior and predictions of the model with bench and noise alone."""
    model = posterior.fit.model
    observation, noise = model.recordings[index], model.noise[index]
    chains, _, d = posterior.draws.shape

    def predictions(points: FloatArray) -> dict[str, FloatArray]:
        signals = model.signals(points, index)
        signals = signals + noise.draw(observation.samples, chains, generator)
        channels = zip(observation.channels, signals.swapaxes(0, 1), strict=True)
        return shared.replicates(dict(channels))

    prior = model.prior_draws(shared.PRIOR_DRAWS, generator)
    groups: dict[Group, object] = {
        OF_NOISE["prior"]: _draws(posterior, observation.name, prior[None]),
        shared.PRIOR_PREDICTIVE: predictions(prior[:chains]),
    }
    if posterior.noise_only is None:
        return groups
    draws = posterior.noise_only.draws
    densities = model.log_priors(draws.reshape(-1, d)).reshape(draws.shape)
    places = own_unknowns(posterior, observation.name)
    return groups | {
        OF_NOISE["noise_posterior"]: _draws(posterior, observation.name, draws),
        shared.LOG_LIKELIHOOD: {"recording": posterior.noise_only.log_likelihood[index]},
        OF_NOISE["log_prior"]: {name: densities[..., i] for name, i in places.items()},
        shared.POSTERIOR_PREDICTIVE: predictions(draws[:, 0]),
    }


def _predictive(posterior: DirectPosterior, index: int) -> dict[str, object]:
    fit = posterior.fit
    observation = fit.model.recordings[index]
    simulated = fit.simulated(index)
    residuals = observation.signals - simulated
    return {
        "rotation_period_s": observation.rotation_period_s,
        **{f"simulated_{c}": row for c, row in zip(observation.channels, simulated, strict=True)},
        **{f"residual_{c}": row for c, row in zip(observation.channels, residuals, strict=True)},
    }


def _motion(fit: SimulatedFit, index: int) -> dict[str, object]:
    """Variables of a motion only: its reference, the compared part, its changes of flank."""
    observation = fit.model.recordings[index]
    if observation.motion is None:
        return {}
    changes = flank_changes(fit, index)
    variables: dict[str, object] = {
        "reference_speed_rpm": observation.motion.speed_rpm(
            np.arange(observation.samples) / observation.sampling_hz
        ),
        "compared_from_s": observation.first_compared / observation.sampling_hz,
        "repeats": float(observation.cycle is not None),
        "flank_changes": float(len(changes)),
    }
    if changes:
        variables["flank_left_s"] = np.array([change.left_s for change in changes])
        variables["flank_met_s"] = np.array([change.met_s for change in changes])
        variables["flank_side"] = np.array([float(change.side) for change in changes])
    return variables


def _optimum(posterior: DirectPosterior, recording: str) -> dict[str, object]:
    """Values at the optimum; bounds in the unit of each parameter, rad for δ."""
    fit = posterior.fit
    places = own_unknowns(posterior, recording)
    values = {name: float(fit.model.unknowns[i].value(fit.point[i])) for name, i in places.items()}
    slopes = np.array(
        [float(fit.model.unknowns[i].slope(np.array(values[n]))) for n, i in places.items()]
    )
    index = np.array(list(places.values()))
    return {
        **values,
        "cramer_rao_sd": slopes * fit.bound[index],
        "covariance": np.outer(slopes, slopes) * fit.covariance[np.ix_(index, index)],
        "parameter": list(places),
        "parameter_": list(places),
    }


def _budget(posterior: DirectPosterior, recording: str) -> dict[str, float]:
    """Shares of the variance of ln δ by source: noise (at a known bench), laws that the bench may
    lack together with drift, and the tolerances of the bench."""
    fit = posterior.fit
    gap_index = own_unknowns(posterior, recording)[DELTA]
    model_share = 1.0 - min(1.0, float(posterior.model_widening[gap_index]) ** -2.0)
    free = np.array([i for i, u in enumerate(fit.model.unknowns) if u.recording is not None])
    if free.size == len(fit.model.unknowns):
        return {"noise": 1.0 - model_share, "laws_and_drift": model_share}
    precision = fit.curvature + fit.model.prior_precision()
    known_bench_covariance = np.linalg.inv(precision[np.ix_(free, free)])
    noise = float(known_bench_covariance[list(free).index(gap_index), list(free).index(gap_index)])
    # If one draw carries all the weight, the variance is 0.
    share = min(1.0 - model_share, noise / max(float(posterior.draws[..., gap_index].var()), noise))
    return {"noise": share, "laws_and_drift": model_share, "bench": 1.0 - model_share - share}
