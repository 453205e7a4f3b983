"""Measure one joint: each recording by itself, then its wear from paired gaps.

A recording is measured as by ``bayesbl fit``. By the amplitude, the change is that of
``bayesbl compare``, which reuses the stored fits. By the direct route, gaps are paired through the
bench that they share (:mod:`bayesbl.fleet.shared_bench`), so that only a new recording has to be
fitted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date as Date
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pydantic import ValidationError

from bayesbl.bench.bench import Bench
from bayesbl.config.kinds import KINDS, FleetConfig
from bayesbl.config.loading import problems_of
from bayesbl.config.measurement import CompareConfig, SnapshotConfig
from bayesbl.config.sections import BASE_DIRECTORY, PUBLISHED
from bayesbl.errors import UnavailableError, UserError
from bayesbl.fleet.inventory import FileState, Found, Joint, digest_of_file, file_state
from bayesbl.fleet.shared_bench import MatchedAlone, as_normal, other_benches, paired_gaps
from bayesbl.matching.signals import Unknown, effect_unknowns, tolerance_unknowns
from bayesbl.measurement.measurement import NO_CURVE, Answer, Reason, Seeds
from bayesbl.measurement.routes import measure
from bayesbl.measurement.stored import stored_answers
from bayesbl.measurement.wear import WearDraws, wear_of
from bayesbl.recording.types import FloatArray
from bayesbl.results.identified import bench_from
from bayesbl.results.provenance import file_sha256
from bayesbl.results.store import summary_of
from bayesbl.results.work import STORE, WorkStore
from bayesbl.sentences import sentence, with_sentences

REFUSED, FAILED = "refused", "failed"  # further outcomes: an unusable recording, and a bug


@dataclass(frozen=True, slots=True)
class RecordingAnswer:
    """The answer for one recording by itself.

    ``reason``: why δ is withheld or the recording refused. ``agrees``: whether it may belong to its
    bench. ``gap_rad``: draws of δ, shape (draw,), even if withheld; ``None`` without a curve.
    ``bench``: unknowns of the bench in coordinates with a standard normal prior, shape (unknown,
    draw), paired with ``gap_rad``; ``None`` by the amplitude. ``amplitude_rpm``: median, low and
    high. ``lasting``: content and code alone determine it, so that it is always the same.
    """

    outcome: str
    reason: str | None
    notes: tuple[str, ...] = ()
    route: str = ""
    agrees: bool = True
    gap_rad: FloatArray | None = None
    bench: FloatArray | None = None
    amplitude_rpm: tuple[float, float, float] | None = None
    lasting: bool = True

    @property
    def answers(self) -> bool:
        """Whether it gives δ."""
        return self.gap_rad is not None and self.reason is None


@dataclass(frozen=True, slots=True)
class JointAnswer:
    """The wear of a joint since its last repair.

    ``reason``: why there is no rate. ``used``: numbers of the recordings behind the rate.
    ``gap_rad``: their gaps, paired by draw, shape (used, draw). ``wear``: draws of the rate and
    related quantities. ``lasting``: as for a recording.
    """

    reason: str | None
    route: str = ""
    used: tuple[int, ...] = ()
    gap_rad: FloatArray | None = None
    wear: WearDraws | None = None
    lasting: bool = True


@dataclass(frozen=True, slots=True)
class JointJob:
    """A joint with its recordings in order of time; it can be sent to another process.

    ``named``: SHA-256 of the files that the joint names, its bench or its curve. ``known``: answers
    of an earlier run, by number of the recording.
    """

    fleet: FleetConfig
    joint: Joint
    recordings: tuple[Found, ...]
    named: Mapping[str, str]
    known: Mapping[int, RecordingAnswer] = field(default_factory=dict)

    @classmethod
    def of(cls, fleet: FleetConfig, joint: Joint, recordings: Sequence[Found]) -> JointJob:
        """The job of a joint from its recordings with their digests."""
        files = [str(file) for file in (joint.bench, joint.curve) if file not in (None, PUBLISHED)]
        return cls(fleet, joint, tuple(recordings), {file: file_sha256(file) for file in files})

    @property
    def settings(self) -> dict[str, Any]:
        """Sections of the configuration that all joints share."""
        shared = {"columns", "estimator", "posterior", "interval", "curve", "wear"}
        return self.fleet.model_dump(by_alias=True, exclude_none=True, include=shared)

    @property
    def in_words(self) -> str:
        """Name of the joint."""
        return f"joint {self.joint.name}"

    @property
    def names(self) -> list[str]:
        """Names of the recordings: their dates, numbered if several share a day."""
        dates = [one.date for one in self.recordings]
        return [
            day if dates.count(day) == 1 else f"{day}-{dates[: n + 1].count(day)}"
            for n, day in enumerate(dates)
        ]

    def problem(self) -> dict[str, Any]:
        """All that determines the answer, files by their content."""
        return {**self._of_all(), "limit_rad": self.joint.limit_rad} | {
            "in_service_since": self.joint.in_service_since,
            "repaired": self.joint.repaired,
            "recordings": [
                (one.date, one.sha256, one.reference_speed_rpm) for one in self.recordings
            ],
            "wear": self.settings["wear"],
        }

    def problem_of(self, number: int) -> dict[str, Any]:
        """All that determines the answer for one recording."""
        return {
            **self._of_all(),
            "recording": (self.names[number], self.recordings[number].sha256),
            "reference_speed_rpm": self.recordings[number].reference_speed_rpm,
        }

    def config(self, kind: str, numbers: Sequence[int], route: str | None = None) -> SnapshotConfig:
        """The configuration of a run over some of the recordings. Raises ConfigError."""
        joint, model, settings = self.joint, KINDS[kind], self.settings
        estimator = settings["estimator"]
        if joint.bench is None:
            estimator |= {"route": "amplitude"}
        else:
            estimator |= {"bench": joint.bench, "route": route or estimator["route"]}
        curve = settings["curve"] | ({"source": joint.curve} if joint.curve else {})
        repaired = [
            n for n in numbers if joint.repaired and self.recordings[n].date >= joint.repaired
        ]
        tables: dict[str, Any] = {
            "schema": 1,
            "kind": kind,
            "run": {"seed": self.fleet.run.seed, "workers": 1, "output": self.fleet.run.output},
            "joint": {"gear_ratio": joint.gear_ratio, "limit_rad": joint.limit_rad},
            "recordings": [self._entry(n, repaired=n in repaired[:1]) for n in numbers],
            "estimator": estimator,
            "curve": curve,
            **{key: settings[key] for key in ("columns", "posterior", "interval")},
        }
        if kind == "compare":
            tables["wear"] = settings["wear"]
            if joint.in_service_since is not None:
                tables["wear"]["in_service_since"] = Date.fromisoformat(joint.in_service_since)
        try:
            snapshot_config = model.model_validate(tables, context={BASE_DIRECTORY: Path.cwd()})
        except ValidationError as error:
            raise problems_of(error, model)[0] from None
        assert isinstance(snapshot_config, SnapshotConfig)
        return snapshot_config

    def seeds(self, numbers: Sequence[int]) -> Seeds:
        """A seed for each recording by its content, so that no recording affects another."""
        seed, digests = self.fleet.run.seed, [str(self.recordings[n].sha256) for n in numbers]
        contents = [int(digest[:16], 16) for digest in digests]
        own = tuple(np.random.SeedSequence([seed, content]) for content in contents)
        return replace(Seeds.spawn(seed, 0), recordings=own)

    def _of_all(self) -> dict[str, Any]:
        settings = {key: value for key, value in self.settings.items() if key != "wear"}
        joint = self.joint
        return {
            "joint": joint.name,
            "gear_ratio": joint.gear_ratio,
            "bench": self.named.get(str(joint.bench)),
            "curve": self.named.get(str(joint.curve), joint.curve),
            "settings": settings,
            "seed": self.fleet.run.seed,
        }

    def _entry(self, number: int, repaired: bool) -> dict[str, Any]:
        one = self.recordings[number]
        return {
            "name": self.names[number],
            "file": one.file,
            "date": Date.fromisoformat(one.date),
            "repaired": repaired,
            "reference_speed_rpm": one.reference_speed_rpm,
        }


DRAWS = 2000  # of gaps and rate: a 90 % interval has 90 ± 0.7 % (√(p (1 − p)/n))

CHANGED = RecordingAnswer(
    REFUSED, "A file changed while it was measured. Measure it again.", lasting=False
)

OTHER_JOINT = "By the curve of the paper's test bench neither rate nor date is given."

MeasuredJoint = tuple[tuple[RecordingAnswer, ...], JointAnswer]
"""Answers for each recording, and for the joint."""


def measure_joint(job: JointJob) -> MeasuredJoint:
    """Measure the recordings of a joint that are not known, and its wear.

    A refused recording raises nothing. Raises OSError if fits cannot be stored.
    """
    numbers = range(len(job.recordings))
    answers = [job.known.get(number) or measure_recording(job, number) for number in numbers]
    wear = _wear(job, answers)
    lasting = wear.lasting and all(answer.lasting for answer in answers)
    return tuple(answers), replace(wear, lasting=lasting)


def measure_recording(job: JointJob, number: int) -> RecordingAnswer:
    """Measure one recording by itself. Raises OSError if its fit cannot be stored."""
    before_it = _states(job, [number])
    try:
        answer = _answer(job, _measured(job, job.config("fit", [number]), [number]))
    except UserError as error:
        lasting = not isinstance(error, UnavailableError)
        answer = RecordingAnswer(REFUSED, str(error), lasting=lasting)
    except (OSError, MemoryError):
        raise
    except Exception as error:
        # One recording that meets a bug must not hide the answers of a plant.
        answer = RecordingAnswer(
            FAILED, f"This is a bug in bayesbl: {type(error).__name__}: {error}"
        )
    return answer if before_it and before_it == _states(job, [number]) else CHANGED


def _states(job: JointJob, numbers: Sequence[int]) -> list[FileState]:
    """States of the files of recordings, bench and curve; empty if any has another content."""
    files = [(job.recordings[number].file, job.recordings[number].sha256) for number in numbers]
    states = []
    for file, sha256 in (*files, *job.named.items()):
        state = file_state(file)
        if state is None or digest_of_file(file)[0] != sha256:
            return []
        states.append(state)
    return states


def _answer(job: JointJob, tree: xr.DataTree) -> RecordingAnswer:
    route, whole = tree.attrs["route"], with_sentences(summary_of(tree))
    (stored,) = stored_answers(tree)
    gap = bench = None
    if "gap" in tree.children:
        gap = _flat(tree["gap"].to_dataset()["delta_rad"].values)
    if gap is not None and route == "direct":
        own = _bench(job)
        unknowns = _unknowns(own, stored.name)
        draws = [_flat(stored.group("posterior")[u.name].values) for u in unknowns]
        bench = as_normal(unknowns, draws, own.identified).reshape(len(unknowns), gap.size)
    amplitude = None
    if route == "amplitude":
        ringing = whole["amplitude_rpm"]
        amplitude = ringing["median"], ringing["low"], ringing["high"]
    outcome, reason = whole["diagnostics"]["outcome"], whole["routes"][route]["reason"]
    if gap is None:
        outcome = outcome if outcome == "withheld" else "no_curve"
        reason = reason or whole["reason"]
    return RecordingAnswer(
        outcome,
        None if reason is None else reason["text"],
        tuple(reason["text"] for reason in whole["diagnostics"]["reasons"]),
        route,
        bool(whole["model_check"]["agrees"]),
        gap,
        bench,
        amplitude,
    )


def _wear(job: JointJob, answers: Sequence[RecordingAnswer]) -> JointAnswer:
    """Wear from the recordings since the last repair that give δ by the same route."""
    since = [
        number
        for number, one in enumerate(job.recordings)
        if job.joint.repaired is None or one.date >= job.joint.repaired
    ]
    against = [job.names[number] for number in since if not answers[number].agrees]
    giving = [number for number in since if answers[number].answers]
    if against:
        return JointAnswer(
            f"{', '.join(against)}: the recording contradicts the bench, so something other than "
            "the gap may have changed. `bayesbl diagnose` looks for what the bench lacks."
        )
    if job.joint.curve == PUBLISHED:
        return JointAnswer(OTHER_JOINT)
    if since and not giving and any(answers[n].outcome == "no_curve" for n in since):
        return JointAnswer(_text(NO_CURVE))
    routes = Counter(answers[number].route for number in giving).most_common(1)
    route = routes[0][0] if routes else ""
    used = [number for number in giving if answers[number].route == route]
    if len({job.recordings[number].date for number in used}) < 2:
        last = answers[used[-1]].gap_rad if used else None
        values = {"count": len(used), "repaired": job.joint.repaired is not None}
        return JointAnswer(
            _text(Reason("one_date", values)),
            route,
            tuple(used[-1:]),
            None if last is None else _thin(last)[None],
        )
    asked = used if route == "amplitude" else []
    before_it = _states(job, asked)
    try:
        answer = _by_bench(job, used, answers) if route == "direct" else _by_curve(job, used)
    except UserError as error:
        lasting = not isinstance(error, UnavailableError)
        answer = JointAnswer(str(error), route, tuple(used), lasting=lasting)
    if before_it != _states(job, asked):
        return JointAnswer(CHANGED.reason, route, tuple(used), lasting=False)
    return answer


def _by_bench(
    job: JointJob, used: Sequence[int], answers: Sequence[RecordingAnswer]
) -> JointAnswer:
    config = job.config("compare", used)
    assert isinstance(config, CompareConfig)
    pairs = [(answers[number].gap_rad, answers[number].bench) for number in used]
    matched = [MatchedAlone(g, b) for g, b in pairs if g is not None and b is not None]
    names = [job.names[number] for number in used]
    seeds = job.seeds(used)
    gaps = paired_gaps(matched, DRAWS, np.random.default_rng(seeds.gap))
    differing = other_benches(matched, [u.name for u in _unknowns(_bench(job), names[0])])
    reason = None
    if differing:
        needed = [f"{names[number]} ({' or '.join(what)})" for number, what in differing.items()]
        reason = Reason("other_benches", {"needed": needed})
    alone = [Answer(name, draws[None]) for name, draws in zip(names, gaps, strict=True)]
    wear, against = wear_of(config, alone, seeds.wear, reason)
    return _of_group(wear, None if against is None else _text(against), "direct", used, gaps)


def _by_curve(job: JointJob, used: Sequence[int]) -> JointAnswer:
    tree = _measured(job, job.config("compare", used, "amplitude"), used)
    gaps = np.asarray(tree["gap"].to_dataset()["delta_rad"].values)
    wear = tree["wear"].to_dataset() if "wear" in tree.children else None
    told = with_sentences(summary_of(tree))["wear"] or {"reason": None}
    reason = told["reason"] and told["reason"]["text"]
    return _of_group(wear, reason, "amplitude", used, gaps.reshape(len(used), -1))


def _of_group(
    group: xr.Dataset | None, against: str | None, route: str, used: Sequence[int], gaps: FloatArray
) -> JointAnswer:
    reason = OTHER_JOINT if group is None else against
    wear = None if group is None or reason is not None else WearDraws.of(group)
    if wear is not None:
        wear = wear.at(_thin(np.arange(wear.kind.size)))
    return JointAnswer(reason, route, tuple(used), _thin(gaps), wear)


def _text(reason: Reason) -> str:
    return sentence(reason.stored)


def _bench(job: JointJob) -> Bench:
    assert job.joint.bench is not None
    return bench_from(job.joint.bench)


def _unknowns(bench: Bench, name: str) -> list[Unknown]:
    """Unknowns of a joint's bench that all its recordings share."""
    own = [u for u in effect_unknowns(bench, [name]) if u.recording is None]
    return [*own, *tolerance_unknowns(bench)]


def _measured(job: JointJob, config: SnapshotConfig, numbers: Sequence[int]) -> xr.DataTree:
    """Measure recordings; fits are stored for ``compare`` to reuse."""
    work = WorkStore.shared(job.fleet.run.output.parent / STORE)
    return measure(config, work=work, seeds=job.seeds(numbers))


def _thin(draws: NDArray[Any]) -> NDArray[Any]:
    """At most :data:`DRAWS` draws, evenly spaced, shape (…, draw)."""
    count = draws.shape[-1]
    if count <= DRAWS:
        return draws
    return np.asarray(draws[..., np.linspace(0, count - 1, DRAWS).astype(int)])


def _flat(draws: FloatArray) -> FloatArray:
    return _thin(np.asarray(draws, dtype=float).ravel())
