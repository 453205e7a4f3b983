"""What every route of measurement returns: the snapshots of one joint, each with its gap."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import xarray as xr

from bayesbl.config.measurement import SnapshotConfig
from bayesbl.curve.gap_curve import GapCurve
from bayesbl.measurement.joint_check import NOTHING_COMPARED, JointCheck
from bayesbl.measurement.stored_snapshot import StoredSnapshot
from bayesbl.measurement.summary_types import SnapshotSummary
from bayesbl.measurement.task import Task
from bayesbl.measurement.verdict import Verdict
from bayesbl.recording.types import FloatArray, Recording
from bayesbl.results.variables import Group
from bayesbl.sampling.convergence import Outcome


@dataclass(frozen=True, slots=True)
class Snapshot:
    """One recording of the joint.

    Attributes
    ----------
    delta_rad
        Draws of δ, shape (chain, draw), paired by draw between the snapshots of a measurement.
    groups
        What is stored of it, by name of the group.
    group_reasons
        Group to why what it holds is no answer, or ``None``; stored as its attribute ``reasons``.
    model_check
        The recording against what the bench predicts at its gap.
    """

    name: str
    delta_rad: FloatArray
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
    curve
        From amplitude to gap.
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
    curve: GapCurve
    warnings: Sequence[str] = ()
    attributes: Mapping[str, str] = field(default_factory=dict)
    same_joint: JointCheck = NOTHING_COMPARED
    change_reason: str | None = None

    @property
    def outcome(self) -> Outcome:
        """The worst of its snapshots' outcomes; withheld where the change alone is."""
        if self.change_reason is not None:
            return "withheld"
        ordered: list[Outcome] = ["converged", "usable", "withheld"]
        return max((s.verdict.outcome for s in self.snapshots), key=ordered.index)

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
        return " ".join([*sentences, *filter(None, [self.change_reason])])


class Measurer(Protocol):
    """A route with what a configuration gives it; raises where it cannot use that."""

    @property
    def gap_range_rad(self) -> tuple[float, float]:
        """Gaps that can be measured."""

    def describe(self) -> Iterator[tuple[str, Callable[[], str]]]:
        """What it needs beside recordings and curve, as label and text, which may raise."""

    def notes(self) -> Iterator[str]:
        """Sentences for a user who asks what a run would do."""

    def require_usable(self, recording: Recording) -> None:
        """Raises where this recording cannot be measured."""

    def doubts(self, recording: Recording) -> Iterable[str]:
        """Why δ of this recording would be withheld, where that is known before it is measured."""

    def require_together(self, recordings: Sequence[Recording]) -> str | None:
        """Raises where these cannot be compared; what they share, where that is worth saying."""

    def measure(self, task: Task) -> Measurement:
        """Measure all recordings of one joint."""


@dataclass(frozen=True, slots=True)
class Route:
    """A way from recordings to gaps.

    Attributes
    ----------
    groups
        What it stores of a snapshot.
    prepare
        Reads what a configuration names beside the recordings.
    summarise
        ``summary.json`` of a stored snapshot.
    """

    name: str
    groups: tuple[Group, ...]
    prepare: Callable[[SnapshotConfig], Measurer]
    summarise: Callable[[StoredSnapshot], SnapshotSummary]
