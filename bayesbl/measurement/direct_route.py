"""Straight from recordings to the gap: their bench is simulated until it matches them.

All snapshots of a joint are fitted at once. They share the bench, so what is not known of it
largely cancels in the change.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.config.measurement import SnapshotConfig
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.impacts import IMPACTS_DIFFER
from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.observed import Observed, observed
from bayesbl.matching.posterior import MATTERS, DirectPosterior, sample_direct, widened
from bayesbl.matching.predictive_check import RepeatingPower, agrees, disagreements
from bayesbl.matching.signals import (
    GAP,
    Unknown,
    drift_unknowns,
    effect_unknowns,
    gap_unknown,
    reference_delay_unknown,
    start_angle_unknown,
    tolerance_unknowns,
)
from bayesbl.matching.standstill import believed
from bayesbl.measurement.bench_of import bench_of, drifts_of
from bayesbl.measurement.direct_groups import GROUPS, direct_groups
from bayesbl.measurement.direct_summary import summarise_direct
from bayesbl.measurement.joint_check import CheckItem, JointCheck
from bayesbl.measurement.measurement import Measurement, Measurer, Route, Snapshot
from bayesbl.measurement.model_check import (
    UNEXPLAINED,
    against_the_bench,
    check_of_comparison,
    check_of_snapshot,
    feature_items,
    motor_orders_in_words,
    undecided_change,
    undecided_gap,
)
from bayesbl.measurement.motion_verdict import motion_notes, unknown_start, unseen_gap
from bayesbl.measurement.task import Task, sampler_of
from bayesbl.measurement.verdict import Verdict
from bayesbl.model_search.always_in import Beside, beside, directions, marginalised, settled
from bayesbl.naming.joint_change import FALSE_ALARM, JointFindings, changed_beside, find_changes
from bayesbl.probabilities import normal_isf
from bayesbl.progress import StageProgress, of_stage
from bayesbl.recording.checks import require_alive
from bayesbl.recording.types import MOTOR_CURRENT, FloatArray, Recording
from bayesbl.results.provenance import file_sha256
from bayesbl.sampling.chains import SamplerSettings

LARGEST_Z = 37.0
"""Beyond it a probability is zero in double precision."""

NO_DRIFT: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class DirectMatch:
    """A joint posterior with the predictive check of its optimum, and what changed in the joint."""

    posterior: DirectPosterior
    check: tuple[RepeatingPower, ...]
    joint: JointFindings

    @property
    def change_rad(self) -> FloatArray:
        """Draws of the change of δ from the first recording to the last, shape (chain, draw)."""
        names = [seen.name for seen in self.posterior.fit.model.recordings]
        first, last = (self.posterior.values(GAP, name) for name in (names[0], names[-1]))
        return last - first

    @property
    def shares_unknowns(self) -> bool:
        """Whether anything unknown belongs to all recordings."""
        return any(u.recording is None for u in self.posterior.fit.model.unknowns)

    def repeating(self, recording: str) -> list[RepeatingPower]:
        """Entries that noise does not explain and that touch the answer of one recording.

        Through shared unknowns a misfit in one recording moves the gap of all.
        """
        entries = list(self.check)
        return [
            entry
            for entry in entries
            if not agrees([entry], FALSE_ALARM / len(entries))
            and (self.shares_unknowns or entry.recording == recording)
        ]

    def model_check(self, recording: str, level: float) -> JointCheck:
        """Whether this recording may be one of the bench as believed.

        What disagrees is said by the verdict, which it withholds δ by, or by the comparison.
        """
        beyond = self.posterior.beyond_tolerance(recording, level)
        check = check_of_snapshot(self.joint, recording)
        return replace(
            check,
            agrees=check.agrees and not self.repeating(recording) and beyond is None,
            items=[
                *check.items,
                *feature_items(self.posterior.fit, recording),
                *(_item(e) for e in self.check if e.recording == recording),
            ],
        )


class DirectMeasurer(Measurer):
    """The direct route with its bench."""

    def __init__(self, config: SnapshotConfig, bench: Bench) -> None:
        self.config = config
        self.bench = bench

    @property
    def gap_range_rad(self) -> tuple[float, float]:
        """Gaps inside the prior."""
        return self.config.estimator.gap_rad

    def describe(self) -> Iterator[tuple[str, Callable[[], str]]]:
        """The bench."""
        file, form = self.config.estimator.bench, self.bench.gap_form
        yield "bench", lambda: f"{file}, gap form {form}"

    def require_usable(self, recording: Recording) -> None:
        """The bench can be compared with it."""
        observed_of(self.config, self.bench, recording)

    def measure(self, task: Task) -> Measurement:
        """Match the bench with all recordings at once."""
        problem = (
            self.bench,
            [observed_of(self.config, self.bench, recording) for recording in task.recordings],
            self.config.estimator.gap_rad,
            drifts_of(self.config, self.bench),
            sampler_of(self.config),
            task.seeds.direct,
        )
        drift = self.config.joint.drift
        found = task.work.get(
            "direct match",
            (*problem, drift),
            lambda: fit_directly(*problem, self.config.run.workers, task.progress, drift),
            DirectMatch,
        )
        level = self.config.interval.level
        snapshots = [
            self._snapshot(recording, index, found)
            for index, recording in enumerate(task.recordings)
        ]
        change_reason = undecided_change(
            found.joint,
            found.change_rad,
            level,
            with_current=all(MOTOR_CURRENT in r.channels for r in task.recordings),
        )
        withheld = change_reason is not None or any(s.verdict.reason for s in snapshots)
        return Measurement(
            "direct",
            snapshots,
            attributes={"bench": self.bench.fingerprint()},
            same_joint=check_of_comparison(
                found.joint, found.change_rad, level, is_given=not withheld
            ),
            change_reason=change_reason,
        )

    def _snapshot(self, recording: Recording, index: int, found: DirectMatch) -> Snapshot:
        posterior = found.posterior
        check = [entry for entry in found.check if entry.recording == recording.name]
        seen = posterior.fit.model.recordings[index]
        notes = (*recording.notes, *seen.notes, *self._counted_twice(recording))
        level = self.config.interval.level
        return Snapshot(
            recording.name,
            posterior.values(GAP, recording.name),
            direct_verdict(found, index, notes, level),
            direct_groups(posterior, recording, index, check),
            model_check=found.model_check(recording.name, level),
        )

    def _counted_twice(self, recording: Recording) -> Iterator[str]:
        """A note where the bench was identified from this very recording."""
        joint = self.bench.identified
        entry = self.config.entry_of(recording.name)
        if joint is not None and file_sha256(entry.file) in joint.sources:
            yield (
                f"The bench was identified from {entry.name} too, so this recording counts twice "
                "and its interval is somewhat too narrow. Measure later recordings with that bench."
            )


def observed_of(config: SnapshotConfig, bench: Bench, recording: Recording) -> Observed:
    """A recording as the simulator is compared with it, with what the config knows of it."""
    require_alive(recording, (MOTOR_CURRENT,))
    entry = config.entry_of(recording.name)
    known = {name.replace(".", "__"): value for name, value in entry.bench.items()}
    seen = observed(recording, bench, entry.reference_speed_rpm)
    return replace(seen, known={**seen.known, **known})


def direct_unknowns(
    bench: Bench,
    names: Sequence[str],
    gap_rad: tuple[float, float],
    may_drift: Mapping[str, float] = NO_DRIFT,
    moving: Sequence[str] = (),
) -> list[Unknown]:
    """A gap and a start angle for each recording, and what is not known of their bench.

    ``may_drift`` as :func:`bayesbl.matching.signals.drift_unknowns` takes it; ``moving``: names of
    those that are of motions.
    """
    return [
        *(replace(gap_unknown(*gap_rad), recording=name) for name in names),
        *(start_angle_unknown(name) for name in names),
        *(reference_delay_unknown(name) for name in moving),
        *effect_unknowns(bench, names),
        *tolerance_unknowns(bench),
        *drift_unknowns(bench, may_drift, names),
    ]


@dataclass(frozen=True, slots=True)
class JointFit:
    """All recordings fitted together.

    Attributes
    ----------
    nominal
        With the bench as believed and nothing but gaps free, beside what its file leaves open.
    fit
        With what changed, and what is far from where the bench has it, among its unknowns.
    rest
        Laws, drift and changes that stand beside it.
    joint
        Whether one joint made the recordings.
    check
        The predictive check, with ``rest`` taken into account.
    """

    nominal: SimulatedFit
    fit: SimulatedFit
    rest: Beside
    joint: JointFindings
    check: tuple[RepeatingPower, ...]

    @property
    def withheld(self) -> bool:
        """No gap can be given."""
        return self.joint.against_bench or not self.joint.explained


def fit_jointly(
    bench: Bench,
    recordings: Sequence[Observed],
    gap_rad: tuple[float, float],
    may_drift: Mapping[str, float],
    workers: int = 1,
    progress: StageProgress | None = None,
    drift: Mapping[str, float] = NO_DRIFT,
) -> JointFit:
    """The optimum of all recordings together, and whether one joint made them.

    Laws that bias the gap before they show, and what drifts between the recordings, are always
    allowed for; ``drift``: relative standard deviations in place of the defaults. What changed in
    the joint beside that is freed where it is found.
    """
    moving = [r.name for r in recordings if r.motion is not None]
    unknowns = direct_unknowns(bench, [r.name for r in recordings], gap_rad, may_drift, moving)
    name = " and ".join(r.name for r in recordings)
    aligning = of_stage(progress, f"Fitting the bench to {name}")
    nominal = believed(fit_aligned(bench, recordings, unknowns, workers, aligning), FALSE_ALARM)
    among = directions(bench, {**dict.fromkeys(may_drift, 0.0), **drift})
    fit, rest = settled(nominal, among)
    check = disagreements(rest.explained(fit))
    if agrees(check, FALSE_ALARM):
        return JointFit(nominal, fit, rest, changed_beside(fit, among), tuple(check))
    seeking = of_stage(progress, f"Seeking changes in {name}")
    fit, joint = find_changes(fit, among=among, progress=seeking)
    rest = beside(fit, among)
    check = disagreements(rest.explained(fit) if joint.explained else fit)
    return JointFit(nominal, fit, rest, joint, tuple(check))


def fit_directly(
    bench: Bench,
    recordings: Sequence[Observed],
    gap_rad: tuple[float, float],
    may_drift: Mapping[str, float],
    sampler: SamplerSettings,
    seed: np.random.SeedSequence,
    workers: int = 1,
    progress: StageProgress | None = None,
    drift: Mapping[str, float] = NO_DRIFT,
) -> DirectMatch:
    """Optimum and posterior of all recordings together, as :func:`fit_jointly` has them."""
    matched = fit_jointly(bench, recordings, gap_rad, may_drift, workers, progress, drift)
    name = " and ".join(r.name for r in recordings)
    report = of_stage(progress, f"Sampling {name}")
    simulating = of_stage(progress, f"Simulating draws of {name}")
    withheld = matched.withheld
    posterior = sample_direct(matched.fit, sampler, seed, report, simulating, withheld=withheld)
    if not withheld:
        scattering, drifting = seed.spawn(2)
        posterior = marginalised(widened(posterior, scattering), matched.rest, drifting)
    return DirectMatch(posterior, matched.check, matched.joint)


def direct_verdict(
    found: DirectMatch, index: int, notes: Sequence[str] = (), level: float = 0.9
) -> Verdict:
    """Outcome of one snapshot with its reasons; ``reason``, where δ is withheld, says why alone.

    ``index``: of its recording; ``notes``: what was done to it; ``level``: of the interval.
    """
    diagnostics = found.posterior.diagnostics
    outcome, reasons = diagnostics.outcome, list(diagnostics.reasons)
    recording = found.posterior.fit.model.recordings[index]
    gap = found.posterior.values(GAP, recording.name)
    repeating = found.repeating(recording.name)
    against = [
        found.posterior.beyond_tolerance(recording.name, level),
        _disagreement_in_words(repeating, recording.motion is not None) if repeating else None,
        None if repeating or found.joint.explained else UNEXPLAINED,
        against_the_bench(found.joint),
        undecided_gap(found.joint, index, gap, level, with_current=len(recording.signals) > 1),
    ]
    fit = found.posterior.fit
    unseen = unseen_gap(found.posterior, index) or unknown_start(fit, index)
    if found.posterior.impacts_differ(level)[index]:
        unseen = IMPACTS_DIFFER
    if any(against):
        against = list(dict.fromkeys([*against, motor_orders_in_words(found.joint)]))
    if any(against) or unseen:
        outcome = "withheld"
        # Where δ is not seen, its prior's range may decide: that needs no saying.
        reasons = [*filter(None, against), *([unseen] if unseen else reasons)]
    reason = " ".join(reasons) if outcome == "withheld" else None
    if len(recording.signals) == 1:
        reasons.append(
            "There is no motor current in the recording, so the speed alone was used: with the "
            "current δ would be several times sharper."
        )
    wider = float(found.posterior.widening[fit.model.index(GAP, recording.name)])
    if reason is None and wider > 1.0 + MATTERS:
        reasons.append(_widened_in_words(wider))
    reasons += motion_notes(fit, index)
    return Verdict(outcome, (*reasons, *notes), reason)


def _widened_in_words(times: float) -> str:
    return (
        "Noise that goes round in the speed loop, or something like it, makes the impacts differ: "
        f"the interval is {times:.2g} times as wide for it."
    )


def _disagreement_in_words(entries: Sequence[RepeatingPower], moving: bool) -> str:
    worst = max(entries, key=lambda entry: entry.ratio)
    others = sorted({f"{e.channel} of {e.recording}" for e in entries})
    which = f"up to load order {worst.highest_order}" if worst.highest_order else "in the mean"
    repeats, look = "repeats every rotation", "`bayesbl diagnose` looks for what is missing."
    if moving:
        which = which.replace("load order", "order") + " of the cycle"
        repeats = "is left"
        look = "`bayesbl identify` of some recordings, with --effects catalogue, finds which."
    return (
        "Simulation and recording disagree beyond noise, so δ cannot be trusted: in "
        f"{worst.channel} of {worst.recording}, {which}, what {repeats} has "
        f"{worst.ratio:.3g} times the power that noise would leave (disagreement in "
        f"{', '.join(others)}). The bench file lacks an effect or has wrong "
        f"values; {look}"
    )


def _item(entry: RepeatingPower) -> CheckItem:
    band = f"up to load order {entry.highest_order}" if entry.highest_order else "in the mean"
    z = normal_isf(entry.probability)
    return CheckItem(
        f"power that repeats every rotation over that of noise, {entry.channel} {band}",
        entry.ratio,
        1.0,
        "",
        min(z, LARGEST_Z),
    )


def prepare(config: SnapshotConfig) -> DirectMeasurer:
    """With its bench."""
    return DirectMeasurer(config, bench_of(config))


ROUTE = Route("direct", GROUPS, summarise_direct)
