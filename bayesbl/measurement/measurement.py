"""What every route of measurement returns: its answer for each recording of one joint.

An answer holds numbers, and reasons as codes with numbers; sentences are made elsewhere. Several
routes may measure the same recordings. One of them is *the* answer, and the others are stored
beside it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
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
    """One seed sequence per stage, all spawned from the seed of the run."""

    curve: np.random.SeedSequence
    gap: np.random.SeedSequence
    recordings: tuple[np.random.SeedSequence, ...]
    direct: np.random.SeedSequence
    wear: np.random.SeedSequence
    predictive: np.random.SeedSequence

    @classmethod
    def spawn(cls, seed: int, recordings: int) -> Seeds:
        """Spawn the seeds; they do not depend on the number of workers."""
        curve, gap, fits, direct, wear, predictive = np.random.SeedSequence(seed).spawn(6)
        return cls(curve, gap, tuple(fits.spawn(recordings)), direct, wear, predictive)


@dataclass(frozen=True, slots=True)
class Task:
    """Recordings to be measured, with seeds, progress callbacks and a store.

    ``work``: stores finished steps, and returns those that an earlier run finished. ``say``: called
    with a sentence on what each search started from, if it started from an earlier optimum.
    """

    config: SnapshotConfig
    recordings: tuple[Recording, ...]
    seeds: Seeds
    progress: StageProgress | None = None
    work: WorkStore = NOTHING_KEPT
    say: Callable[[str], None] = lambda sentence: None

    @property
    def names(self) -> list[str]:
        """Names of the recordings, in order."""
        return [recording.name for recording in self.recordings]


def recording_of(entry: SnapshotRecording, config: SnapshotConfig) -> Recording:
    """Read the recording of an entry and prepare it for a fit.

    Raises RecordingError if it cannot be read, or lacks what a fit needs.
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
    """The sampler settings of a configuration."""
    sampling = config.posterior
    return SamplerSettings(sampling.ensembles, sampling.max_steps, config.interval.level)


MeasurementOutcome = Outcome | Literal["no_curve"]

UPPER_BOUND_LEVEL = 0.95
"""Probability of the one-sided bound that is reported if the gap may be zero."""


LIMITING, WITHHOLDING = (
    frozenset(codes.split())
    for codes in (
        """
        sampling_doubt mended few_curve_draws by_amplitude_instead gap_not_told bench_lacks
        allows_for_misfit negative_law play_not_told load_coasts
        """,
        """
        sampling no_flank_change second_sampler ringing_contradicts_bench beyond_curve speed_unit
        box_search_missed no_baseline other_speed other_rotation other_bench
        recording_contradicts_bench repeats_beyond_noise unexplained sheet_contradicted
        tolerance_decides gap_unseen start_unknown ramps_held nothing_told held_by_weight
        weight_unknown skew_or_play positions_exchanged known_gaps_disagree
        """,
    )
)
"""Codes that limit or withhold an answer on any route. All other codes are notes."""


@dataclass(frozen=True, slots=True)
class Reason(Flaw):
    """Why an answer is withheld or limited."""

    @classmethod
    def of_text(cls, code: str, text: str) -> Reason:
        """Make a reason from a sentence that a lower layer has already written."""
        return cls(code, {"text": text})

    @property
    def withholds(self) -> bool:
        """Whether this reason withholds the answer."""
        return self.code in WITHHOLDING

    @property
    def stored(self) -> dict[str, Any]:
        """The reason as ``summary.json`` stores it, without its sentence."""
        return {"code": self.code, **self.values}


def sampling_reasons(diagnostics: Diagnostics) -> list[Reason]:
    """Reasons from the sampler: failures withhold the answer, doubts limit it."""
    flaws = [("sampling" if k else diagnostics.code, f) for k, f in enumerate(diagnostics.failures)]
    flaws += [("sampling_doubt", flaw) for flaw in diagnostics.doubts]
    return [Reason(code, {"flaw": flaw.code, **flaw.values}) for code, flaw in flaws]


def outcome_of(reasons: Iterable[Reason]) -> Outcome:
    """The worst outcome that these reasons cause."""
    codes = {reason.code for reason in reasons}
    if codes & WITHHOLDING:
        return "withheld"
    return "usable" if codes & LIMITING else "converged"


class CheckItem(TypedDict):
    """A measured and an expected value; ``z`` is their difference in standard deviations."""

    quantity: str
    measured: float
    expected: float
    unit: str
    z: float


class JointCheck(TypedDict):
    """Comparison of a snapshot with its bench, or of snapshots with one another.

    ``could_be`` names effects or bench parameters that would explain the differences.
    ``blind_spots`` are changes of the joint that the check cannot detect, with how far each would
    move δ, if known (``delta_error_rad``). If nothing was compared, ``items`` is empty and
    ``agrees`` true.
    """

    agrees: bool
    items: list[CheckItem]
    could_be: list[str]
    findings: list[dict[str, Any]]
    blind_spots: list[dict[str, Any]]


def check_item(quantity: str, measured: float, expected: float, unit: str, z: float) -> CheckItem:
    """Make an item; ``unit`` is that of both values, empty for a pure number."""
    return CheckItem(quantity=quantity, measured=measured, expected=expected, unit=unit, z=z)


def joint_check(
    agrees: bool = True,
    items: Iterable[CheckItem] = (),
    could_be: Iterable[str] = (),
    findings: Iterable[Mapping[str, Any]] = (),
    blind_spots: Iterable[Mapping[str, Any]] = (),
) -> JointCheck:
    """Make a check, by default one that compared nothing; ``could_be`` names each cause once."""
    return {
        "agrees": agrees,
        "items": list(items),
        "could_be": list(dict.fromkeys(could_be)),
        "findings": [dict(finding) for finding in findings],
        "blind_spots": [dict(spot) for spot in blind_spots],
    }


def blind_spot(code: str, delta_error_rad: float | None = None, **values: object) -> dict[str, Any]:
    """A change of the joint that a check cannot detect, and the error of δ it causes, if known."""
    return {"code": code, **values, "delta_error_rad": delta_error_rad}


NO_CURVE = Reason("no_curve")
"""There is no δ because there is no curve; the ringing alone is an answer."""


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer of one route for one recording.

    Attributes
    ----------
    delta_rad
        Draws of δ, shape (chain, draw), paired by draw between the answers of a measurement;
        ``None`` without a curve.
    reasons
        All reasons and notes of the answer, the gravest first.
    groups
        The datasets to store, by name of the group.
    numbers
        The keys of ``summary.json`` that not every answer has.
    model_check
        Comparison of the recording with the bench's prediction at the measured gap.
    upper_bound_rad
        Upper bound of δ at 95 % probability, if the gap may be zero.
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
        """Whether the answer is converged, usable or withheld."""
        return outcome_of(self.reasons)

    @property
    def withholding(self) -> list[Reason]:
        """The reasons that withhold the answer; empty if none does."""
        return [reason for reason in self.reasons if reason.withholds]

    @property
    def is_withheld(self) -> bool:
        """Whether δ must not be read."""
        return self.outcome == "withheld"


@dataclass(frozen=True, slots=True)
class Measurement:
    """The answers of one route for the recordings of one joint, with other routes' beside them.

    Attributes
    ----------
    route
        Name of the route that measured.
    answers
        One per recording, in order of time.
    shared
        The datasets of the route that belong to no single answer, by name of the group.
    curve
        Name of the gap curve; empty without one.
    warnings
        Warnings other than those of the recordings.
    attributes
        Attributes stored at the root of the result.
    ringing_change
        Draws of the change of the ringing's amplitude from first to last, as a share of the first.
    same_joint
        Comparison of the recordings with one another.
    change_reason
        Why the change between the recordings is withheld although the gaps are not.
    why
        Why this route is the one that answers.
    beside
        Measurements by other routes.
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
        """The worst outcome of the answers; withheld if only the change is withheld.

        ``no_curve`` if the only thing missing is δ, because there is no curve.
        """
        if self.change_reason is not None:
            return "withheld"
        worst = outcome_of(reason for answer in self.answers for reason in answer.reasons)
        return "no_curve" if self.without_gap and worst != "withheld" else worst

    @property
    def without_gap(self) -> bool:
        """Whether δ is missing because there is no curve."""
        return any(answer.delta_rad is None for answer in self.answers)

    @property
    def by_other_joint(self) -> bool:
        """Whether the gaps are read from the curve of the paper's test bench."""
        return self.curve == PUBLISHED


@dataclass(frozen=True, slots=True)
class ExpectedSd:
    """Expected posterior standard deviations, rad, if all recordings have the gap ``gap_rad``.

    ``change_rad`` is that of the change from the first recording to the last; ``None`` for a single
    recording.
    """

    gap_rad: float
    delta_rad: float
    change_rad: float | None


def upper_bound(delta_rad: FloatArray) -> float:
    """The gap below which δ lies with a probability of :data:`UPPER_BOUND_LEVEL`, rad."""
    return float(np.quantile(delta_rad, UPPER_BOUND_LEVEL))


class Measurer(ABC):
    """A route, prepared from a configuration; raises if it cannot use what is configured."""

    gap_range_rad: tuple[float, float] | None = None
    """Range of gaps that can be measured; ``None`` if none can."""

    def __init__(self, config: SnapshotConfig) -> None:
        self.config = config

    @abstractmethod
    def describe(self) -> Iterator[tuple[str, Callable[[], str]]]:
        """Yield what the route uses besides recordings, as label and text function; may raise."""

    def read(self, entry: SnapshotRecording) -> Recording:
        """Read the recording of a snapshot as this route needs it; raises if it cannot."""
        return recording_of(entry, self.config)

    @abstractmethod
    def require_usable(self, recording: Recording) -> None:
        """Raise if this recording cannot be measured."""

    def doubts(self, recording: Recording) -> Iterable[Reason]:
        """Reasons, known before the measurement, why δ of this recording would be withheld."""
        return ()

    def require_together(self, recordings: Sequence[Recording]) -> str | None:
        """Raise if the recordings cannot be compared; return what they share, if worth saying."""
        return None

    def expected(
        self, recordings: Sequence[Recording], progress: StageProgress | None = None
    ) -> Sequence[ExpectedSd]:
        """Expected standard deviations at a few gaps, if they can be predicted before a fit."""
        return ()

    @abstractmethod
    def measure(self, task: Task) -> Measurement:
        """Measure all recordings of one joint."""
