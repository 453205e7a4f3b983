"""What every route of measurement returns: the snapshots of one joint, each with its gap."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import xarray as xr

from bayesbl.config.fields import PUBLISHED
from bayesbl.config.measurement import SnapshotConfig
from bayesbl.config.sections import SnapshotRecording
from bayesbl.curve.gap_curve import GapCurve
from bayesbl.measurement.joint_check import NOTHING_COMPARED, JointCheck
from bayesbl.measurement.stored_snapshot import StoredSnapshot
from bayesbl.measurement.summary_types import SnapshotSummary
from bayesbl.measurement.task import Task, recording_of
from bayesbl.measurement.verdict import Verdict
from bayesbl.recording.types import FloatArray, Recording
from bayesbl.results.variables import Group
from bayesbl.sampling.convergence import Outcome

MeasurementOutcome = Outcome | Literal["no_curve"]

NO_CURVE = (
    "The same ringing belongs to other gaps on other joints, so there is no δ without a bench of "
    "this joint (--bench FILE) or the curve of a sweep (--curve RESULT)."
)


@dataclass(frozen=True, slots=True)
class Snapshot:
    """One recording of the joint.

    Attributes
    ----------
    delta_rad
        Draws of δ, shape (chain, draw), paired by draw between the snapshots of a measurement;
        ``None`` without a curve.
    groups
        What is stored of it, by name of the group.
    group_reasons
        Group to why what it holds is no answer, or ``None``; stored as its attribute ``reasons``.
    model_check
        The recording against what the bench predicts at its gap.
    """

    name: str
    delta_rad: FloatArray | None
    verdict: Verdict
    groups: Mapping[str, xr.Dataset]
    group_reasons: Mapping[str, str | None] = field(default_factory=dict)
    model_check: JointCheck = NOTHING_COMPARED


@dataclass(frozen=True, slots=True)
class Measurement:
    """Snapshots of one joint, measured together.

    Attributes
    ----------
    route
        Name of the route that made it.
    snapshots
        In order of time.
    curves
        From amplitude to gap, one for each snapshot; none where the amplitude was not used.
    warnings
        Beside those of the recordings.
    attributes
        Of the route, stored at the root of the result.
    same_joint
        The snapshots against one another.
    change_reason
        Why the change between them is withheld, where its gaps are not; ``None`` where it is not.
    """

    route: str
    snapshots: Sequence[Snapshot]
    curves: Sequence[GapCurve] = ()
    warnings: Sequence[str] = ()
    attributes: Mapping[str, str] = field(default_factory=dict)
    same_joint: JointCheck = NOTHING_COMPARED
    change_reason: str | None = None

    @property
    def outcome(self) -> MeasurementOutcome:
        """The worst of its snapshots' outcomes; withheld where the change alone is.

        ``no_curve`` where all is well but δ, for want of a curve.
        """
        if self.change_reason is not None:
            return "withheld"
        ordered: list[Outcome] = ["converged", "usable", "withheld"]
        worst = max((s.verdict.outcome for s in self.snapshots), key=ordered.index)
        return "no_curve" if self.without_gap and worst != "withheld" else worst

    @property
    def without_gap(self) -> bool:
        """Whether there is no δ, for want of a curve."""
        return any(snapshot.delta_rad is None for snapshot in self.snapshots)

    @property
    def by_other_joint(self) -> bool:
        """Whether the gaps are read from the curve of the paper's test bench."""
        return self.route == "amplitude" and any(c.name == PUBLISHED for c in self.curves)

    @property
    def reason(self) -> str:
        """Why answers are withheld: each reason once, behind the names that it holds for."""
        names: dict[str, list[str]] = {}
        for snapshot in self.snapshots:
            if snapshot.verdict.reason:
                names.setdefault(snapshot.verdict.reason, []).append(snapshot.name)
        sentences = [
            reason if len(who) == len(self.snapshots) else f"{', '.join(who)}: {reason}"
            for reason, who in names.items()
        ]
        if self.without_gap:
            sentences.append(NO_CURVE)
        return " ".join([*sentences, *filter(None, [self.change_reason])])


class Measurer(ABC):
    """A route with what a configuration gives it; raises where it cannot use that."""

    config: SnapshotConfig

    @property
    @abstractmethod
    def gap_range_rad(self) -> tuple[float, float] | None:
        """Gaps that can be measured; ``None`` where none can."""

    @abstractmethod
    def describe(self) -> Iterator[tuple[str, Callable[[], str]]]:
        """What it needs beside recordings and curve, as label and text, which may raise."""

    def notes(self) -> Iterable[str]:
        """Sentences for a user who asks what a run would do."""
        return ()

    def read(self, entry: SnapshotRecording) -> Recording:
        """The recording of a snapshot as this route takes it; raises where it cannot."""
        return recording_of(entry, self.config)

    @abstractmethod
    def require_usable(self, recording: Recording) -> None:
        """Raises where this recording cannot be measured."""

    def doubts(self, recording: Recording) -> Iterable[str]:
        """Why δ of this recording would be withheld, where that is known before it is measured."""
        return ()

    def require_together(self, recordings: Sequence[Recording]) -> str | None:
        """Raises where these cannot be compared; what they share, where that is worth saying."""
        return None

    @abstractmethod
    def measure(self, task: Task) -> Measurement:
        """Measure all recordings of one joint."""


@dataclass(frozen=True, slots=True)
class Route:
    """A way from recordings to gaps; its module has a ``prepare`` that gives its :class:`Measurer`.

    Attributes
    ----------
    groups
        What it stores of a snapshot.
    summarise
        ``summary.json`` of a stored snapshot.
    """

    name: str
    groups: tuple[Group, ...]
    summarise: Callable[[StoredSnapshot], SnapshotSummary]
