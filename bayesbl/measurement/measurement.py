"""What every route of measurement returns: its answer for each recording of one joint.

An answer holds numbers, and reasons as codes with numbers; nothing here makes a sentence of its
own. Several routes may answer the same recordings: one is *the* answer, the others stand beside it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, repeat
from typing import Any, Literal, TypedDict

import numpy as np
import xarray as xr

from bayesbl.config.measurement import SnapshotConfig
from bayesbl.config.sections import PUBLISHED, SnapshotRecording
from bayesbl.progress import StageProgress
from bayesbl.recording.checks import ready_for_fit, require_reference_speed, with_speed
from bayesbl.recording.readers import read_recording
from bayesbl.recording.types import FloatArray, Recording
from bayesbl.results.work import NOTHING_KEPT, WorkStore
from bayesbl.ringing.estimator import Estimator
from bayesbl.ringing.symbols import DisturbanceModel
from bayesbl.sampling.chains import SamplerSettings
from bayesbl.sampling.convergence import Diagnostics, Flaw, Outcome


@dataclass(frozen=True, slots=True)
class Seeds:
    """One seed sequence per stage, all spawned from the run's."""

    curve: np.random.SeedSequence
    gap: np.random.SeedSequence
    recordings: tuple[np.random.SeedSequence, ...]
    direct: np.random.SeedSequence
    wear: np.random.SeedSequence
    predictive: np.random.SeedSequence

    @classmethod
    def spawn(cls, seed: int, recordings: int) -> Seeds:
        """The same seeds whatever the number of workers."""
        curve, gap, fits, direct, wear, predictive = np.random.SeedSequence(seed).spawn(6)
        return cls(curve, gap, tuple(fits.spawn(recordings)), direct, wear, predictive)


@dataclass(frozen=True, slots=True)
class Task:
    """Recordings to be measured, and who is to hear of it.

    Attributes
    ----------
    work
        Keeps what is finished, and gives back what an earlier run had finished.
    say
        Called with a sentence on what each search started from, if from an earlier optimum.
    swept
        Keeps swept benches for this run and others.
    """

    config: SnapshotConfig
    recordings: tuple[Recording, ...]
    seeds: Seeds
    progress: StageProgress | None = None
    work: WorkStore = NOTHING_KEPT
    say: Callable[[str], None] = lambda sentence: None
    swept: WorkStore = NOTHING_KEPT

    @property
    def names(self) -> list[str]:
        """Of the recordings, in their order."""
        return [recording.name for recording in self.recordings]


def recording_of(entry: SnapshotRecording, config: SnapshotConfig) -> Recording:
    """The recording of an entry, ready for a fit.

    Raises
    ------
    RecordingError
        If it cannot be read, or lacks what a fit needs.
    """
    columns = config.column_specs
    recording = with_speed(read_recording(entry.file, name=entry.name, columns=columns))
    if entry.reference_speed_rpm is not None:
        require_reference_speed(recording, entry.reference_speed_rpm)
    return ready_for_fit(recording, config.joint.gear_ratio)


def estimator_of(config: SnapshotConfig) -> Estimator:
    """The estimator that a configuration describes."""
    section = config.estimator
    return Estimator(
        model=DisturbanceModel(
            section.model.baseline_harmonics, section.model.fixed, section.model.ranges
        ),
        search=section.search.method,
        noise_kind=section.noise.kind,
        noise_order=section.noise.order,
        sampler=sampler_of(config),
    )


def sampler_of(config: SnapshotConfig) -> SamplerSettings:
    """How a configuration has posteriors sampled."""
    sampling = config.posterior
    return SamplerSettings(sampling.ensembles, sampling.max_steps, config.interval.level)


MeasurementOutcome = Outcome | Literal["no_curve"]

UPPER_BOUND_LEVEL = 0.95
"""Of the one-sided bound that is given where a gap is not told from none."""


OUTCOMES: Mapping[Outcome, str] = {
    "converged": "",
    "usable": """
        sampling_doubt mended few_curve_draws by_amplitude_instead gap_not_told bench_lacks
        allows_for_misfit negative_law play_not_told load_coasts""",
    "withheld": """
        sampling no_flank_change second_sampler ringing_contradicts_bench beyond_curve speed_unit
        box_search_missed no_baseline other_speed other_rotation other_bench
        recording_contradicts_bench repeats_beyond_noise unexplained sheet_contradicted
        tolerance_decides gap_unseen start_unknown ramps_held nothing_told held_by_weight
        weight_unknown skew_or_play positions_exchanged known_gaps_disagree""",
}
"""Outcomes of an answer, the worst last, with the codes that bring it there, by whatever route.

All other codes are of notes.
"""


@dataclass(frozen=True, slots=True)
class Reason(Flaw):
    """Why an answer is withheld or limited."""

    @classmethod
    def of_text(cls, code: str, text: str) -> Reason:
        """One that a room below has already put into a sentence."""
        return cls(code, {"text": text})

    @property
    def withholds(self) -> bool:
        """Whether it withholds the answer."""
        return outcome_of([self]) == "withheld"

    @property
    def stored(self) -> dict[str, Any]:
        """As the summary holds it, without its sentence."""
        return {"code": self.code, **self.values}


def sampling_reasons(diagnostics: Diagnostics) -> list[Reason]:
    """Why draws are not simply converged: failures withhold the answer, doubts limit it."""
    codes = chain([diagnostics.code], repeat("sampling"))
    failed = zip(codes, diagnostics.failures, strict=False)
    flaws = chain(failed, zip(repeat("sampling_doubt"), diagnostics.doubts, strict=False))
    return [Reason(code, {"flaw": flaw.code, **flaw.values}) for code, flaw in flaws]


def outcome_of(reasons: Iterable[Reason]) -> Outcome:
    """Of an answer that has these."""
    codes = {reason.code for reason in reasons}
    return [o for o, bring in OUTCOMES.items() if o == "converged" or codes & {*bring.split()}][-1]


class CheckItem(TypedDict):
    """A quantity as measured and as expected; ``z`` is their difference in standard deviations."""

    quantity: str
    measured: float
    expected: float
    unit: str
    z: float


class JointCheck(TypedDict):
    """A snapshot against its bench, or snapshots against one another.

    ``could_be`` names effects or parameters of the bench that would explain what was found.
    ``blind_spots`` are changes of the joint that the check cannot detect. Each has
    ``delta_error_rad``, by how much it would move δ, if that is known. If nothing was compared,
    ``items`` is empty and ``agrees`` true.
    """

    agrees: bool
    items: list[CheckItem]
    could_be: list[str]
    findings: list[dict[str, Any]]
    blind_spots: list[dict[str, Any]]


def check_item(quantity: str, measured: float, expected: float, unit: str, z: float) -> CheckItem:
    """One quantity; ``unit`` of both values, empty for a pure number."""
    return {
        "quantity": quantity,
        "measured": measured,
        "expected": expected,
        "unit": unit,
        "z": z,
    }


def joint_check(
    agrees: bool = True,
    items: Iterable[CheckItem] = (),
    could_be: Iterable[str] = (),
    findings: Iterable[Mapping[str, Any]] = (),
    blind_spots: Iterable[Mapping[str, Any]] = (),
) -> JointCheck:
    """What was compared, nothing by default; ``could_be`` names each cause once."""
    return {
        "agrees": agrees,
        "items": list(items),
        "could_be": list(dict.fromkeys(could_be)),
        "findings": [dict(finding) for finding in findings],
        "blind_spots": [dict(spot) for spot in blind_spots],
    }


def blind_spot(code: str, delta_error_rad: float | None = None, **values: object) -> dict[str, Any]:
    """A change of the joint that a check cannot see, and what it would do to δ, where known."""
    return {"code": code, **values, "delta_error_rad": delta_error_rad}


NO_CURVE = Reason("no_curve")
"""There is no δ for want of a curve; the ringing alone is an answer."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What one route says of one recording.

    Attributes
    ----------
    delta_rad
        Draws of δ, shape (chain, draw), paired by draw between the answers of a measurement;
        ``None`` without a curve.
    reasons
        All that is to be known of the answer, the gravest first.
    groups
        What is stored of it, by name of the group.
    numbers
        Its part of ``summary.json``, beside what every answer has.
    model_check
        The recording against what the bench predicts at its gap.
    upper_bound_rad
        δ is below it with a probability of 95 %, where it is not told from none.
    """

    name: str
    delta_rad: FloatArray | None
    reasons: Sequence[Reason] = ()
    groups: Mapping[str, xr.Dataset] = field(default_factory=dict)
    numbers: Mapping[str, Any] = field(default_factory=dict)
    model_check: JointCheck = field(default_factory=joint_check)
    upper_bound_rad: float | None = None

    @property
    def outcome(self) -> Outcome:
        """Whether it can be trusted."""
        return outcome_of(self.reasons)

    @property
    def withholding(self) -> list[Reason]:
        """Why it is withheld; empty where it is not."""
        return [reason for reason in self.reasons if reason.withholds]

    @property
    def is_withheld(self) -> bool:
        """Whether δ must not be read."""
        return self.outcome == "withheld"


@dataclass(frozen=True, slots=True)
class Measurement:
    """Answers of one route for recordings of one joint, with those of others beside them.

    Attributes
    ----------
    route
        Name of the route that made it.
    answers
        In order of time.
    shared
        What is stored of the route beside its answers, by name of the group.
    curve
        Name of the gap curve; empty without one.
    warnings
        Beside those of the recordings.
    attributes
        Stored at the root of the result.
    ringing_change
        Draws of the change of the ringing from first to last, as a share of the first.
    same_joint
        The recordings against one another.
    change_reason
        Why the change between them is withheld, where its gaps are not.
    why
        Why this route is the one that answers.
    beside
        What other routes answer.
    refused
        Why another route could not be run, by its name.
    """

    route: str
    answers: Sequence[Answer]
    shared: Mapping[str, xr.Dataset] = field(default_factory=dict)
    curve: str = ""
    warnings: Sequence[str] = ()
    attributes: Mapping[str, str] = field(default_factory=dict)
    ringing_change: FloatArray | None = None
    same_joint: JointCheck = field(default_factory=joint_check)
    change_reason: Reason | None = None
    why: Reason = Reason("only_route")
    beside: Sequence[Measurement] = ()
    refused: Mapping[str, Reason] = field(default_factory=dict)

    @property
    def outcome(self) -> MeasurementOutcome:
        """The worst of its answers' outcomes; withheld where the change alone is.

        ``no_curve`` where all is well but δ, for want of a curve.
        """
        if self.change_reason is not None:
            return "withheld"
        worst = outcome_of(reason for answer in self.answers for reason in answer.reasons)
        return "no_curve" if self.without_gap and worst != "withheld" else worst

    @property
    def without_gap(self) -> bool:
        """Whether there is no δ, for want of a curve."""
        return any(answer.delta_rad is None for answer in self.answers)

    @property
    def by_other_joint(self) -> bool:
        """Whether the gaps are read from the curve of the paper's test bench."""
        return self.curve == PUBLISHED


@dataclass(frozen=True, slots=True)
class ExpectedSd:
    """Posterior standard deviations at a gap that all recordings have, rad.

    ``change_rad``: of the change from the first recording to the last; ``None`` of one recording.
    """

    gap_rad: float
    delta_rad: float
    change_rad: float | None


def upper_bound(delta_rad: FloatArray) -> float:
    """The gap below which δ lies with a probability of :data:`UPPER_BOUND_LEVEL`, rad."""
    return float(np.quantile(delta_rad, UPPER_BOUND_LEVEL))


class Measurer(ABC):
    """A route with what a configuration gives it; raises where it cannot use that."""

    gap_range_rad: tuple[float, float] | None = None
    """Gaps that can be measured; ``None`` where none can."""

    def __init__(self, config: SnapshotConfig) -> None:
        self.config = config

    @abstractmethod
    def describe(self) -> Iterator[tuple[str, Callable[[], str]]]:
        """What it needs beside recordings and curve, as label and text, which may raise."""

    def read(self, entry: SnapshotRecording) -> Recording:
        """The recording of a snapshot as this route takes it; raises where it cannot."""
        return recording_of(entry, self.config)

    @abstractmethod
    def require_usable(self, recording: Recording) -> None:
        """Raises where this recording cannot be measured."""

    def doubts(self, recording: Recording) -> Iterable[Reason]:
        """Why δ of this recording would be withheld, where that is known before it is measured."""
        return ()

    def require_together(self, recordings: Sequence[Recording]) -> str | None:
        """Raises where these cannot be compared; what they share, where that is worth saying."""
        return None

    def expected(self, recordings: Sequence[Recording]) -> Sequence[ExpectedSd]:
        """How precisely these would give δ, at a few gaps, where that is known before a fit."""
        return ()

    @abstractmethod
    def measure(self, task: Task) -> Measurement:
        """Measure all recordings of one joint."""
