"""Both routes: the direct one answers where its checks pass, the amplitude stands beside it.

One route answers for all snapshots, so that the change between them lies within one. Where the
direct route could not be sampled, or a recording cannot be compared with the simulation, the
amplitude answers. Where a recording contradicts the bench, neither does: the curve is of that
bench too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesbl.config.measurement import SnapshotConfig
from bayesbl.errors import BenchError, CurveError, RecordingError, UserError
from bayesbl.measurement.amplitude_route import AmplitudeMeasurer
from bayesbl.measurement.bench_of import bench_of
from bayesbl.measurement.direct_route import DirectMeasurer
from bayesbl.measurement.joint_check import JointCheck
from bayesbl.measurement.measurement import Measurement, Measurer, Snapshot
from bayesbl.measurement.other_route import OTHER, other_route
from bayesbl.measurement.task import Task
from bayesbl.measurement.verdict import Verdict
from bayesbl.probabilities import normal_isf
from bayesbl.recording.moving import moves
from bayesbl.recording.types import FloatArray, Recording

FALSE_ALARM = 0.01
"""Of the routes' disagreement, over all snapshots of a run."""

CONTRADICTED = (
    "The recording contradicts the bench, and the amplitude is read from a curve of that bench."
)

WITHOUT_DRIFT = (
    "The change by the amplitude does not include what [joint] may_drift allows, so it is withheld."
)


@dataclass(frozen=True, slots=True)
class AutoMeasurer(Measurer):
    """Both routes of one bench."""

    config: SnapshotConfig
    direct: DirectMeasurer
    amplitude: AmplitudeMeasurer

    @property
    def gap_range_rad(self) -> tuple[float, float]:
        """Gaps inside the direct route's prior."""
        return self.direct.gap_range_rad

    def describe(self) -> Iterator[tuple[str, Callable[[], str]]]:
        """The bench and the curve."""
        yield from self.direct.describe()
        yield from self.amplitude.describe()

    def notes(self) -> Iterable[str]:
        """Those of the amplitude."""
        return self.amplitude.notes()

    def require_usable(self, recording: Recording) -> None:
        """The amplitude can be measured; where only the direct route cannot, it is left out.

        Motions are the direct route's alone.
        """
        (self.direct if moves(recording) else self.amplitude).require_usable(recording)

    def require_together(self, recordings: Sequence[Recording]) -> str | None:
        """What holds for the amplitude; the direct route takes any."""
        if any(map(moves, recordings)):
            return self.direct.require_together(recordings)
        return self.amplitude.require_together(recordings)

    def measure(self, task: Task) -> Measurement:
        """By both routes.

        Raises
        ------
        UserError
            If neither can measure these recordings.
        """
        if any(map(moves, task.recordings)):
            return _with_attributes(self.direct.measure(task))
        direct, amplitude = _tried(self.direct.measure, task), _tried(self.amplitude.measure, task)
        match direct, amplitude:
            case UserError(), UserError():
                raise direct
            case Measurement(), UserError():
                return _with_attributes(_beside(direct, [str(amplitude)] * len(task.recordings)))
            case UserError(), Measurement():
                return self._by_amplitude(amplitude, None, str(direct))
            case Measurement(), Measurement():
                return self._of_both(direct, amplitude)
        raise AssertionError("all cases are above")

    def _of_both(self, direct: Measurement, amplitude: Measurement) -> Measurement:
        """Direct, unless it failed by itself while the amplitude has an answer."""
        if self.amplitude.source.is_of_bench:
            amplitude = _without_contradicted(direct, amplitude)
        failed = [
            s.verdict.reason
            for s in direct.snapshots
            if s.verdict.reason is not None and s.model_check.agrees
        ]
        if failed and any(s.verdict.reason is None for s in amplitude.snapshots):
            why = " ".join(dict.fromkeys(filter(None, failed)))
            return self._by_amplitude(amplitude, direct, why)
        reasons = [s.verdict.reason for s in amplitude.snapshots]
        found = _beside(direct, reasons, amplitude)
        # A drift moves the amplitude's gaps, and its curve does not know of it.
        comparable = self.amplitude.source.is_of_bench and not self.config.joint.may_drift
        if comparable and found.change_reason is None:
            found = replace(found, change_reason=_disagreement(direct, amplitude))
        return _with_attributes(found)

    def _by_amplitude(
        self, amplitude: Measurement, direct: Measurement | None, why: str
    ) -> Measurement:
        found = _instead(amplitude, direct, why)
        if self.config.joint.may_drift and found.change_reason is None:
            return replace(found, change_reason=WITHOUT_DRIFT)
        return found


def _tried(measure: Callable[[Task], Measurement], task: Task) -> Measurement | UserError:
    try:
        return measure(task)
    except (RecordingError, CurveError, BenchError) as refusal:
        return refusal  # what cannot be written or read is no matter of the route


def _with_attributes(found: Measurement) -> Measurement:
    return replace(found, attributes={**found.attributes, "route_asked": "auto"})


def _beside(
    answer: Measurement, reasons: Sequence[str | None], other: Measurement | None = None
) -> Measurement:
    """The answer with another route's stored beside; ``reasons``: why that one has none."""
    group = OTHER[answer.route].name
    others: Sequence[Snapshot | None] = other.snapshots if other else [None] * len(reasons)
    snapshots = [
        replace(
            snapshot,
            groups={**snapshot.groups, group: other_route(answer.route, beside)},
            group_reasons={**snapshot.group_reasons, group: reason},
            model_check=_of_both_routes(snapshot, beside),
        )
        for snapshot, beside, reason in zip(answer.snapshots, others, reasons, strict=True)
    ]
    curves = answer.curves or (other.curves if other else ())
    return replace(answer, snapshots=snapshots, curves=curves)


def _of_both_routes(snapshot: Snapshot, beside: Snapshot | None) -> JointCheck:
    """The answer's own judgement, with what the other route compared listed too."""
    own = snapshot.model_check
    told = {item.quantity for item in own.items}
    others = () if beside is None else beside.model_check.items
    return replace(own, items=[*own.items, *(i for i in others if i.quantity not in told)])


def _instead(amplitude: Measurement, direct: Measurement | None, why: str) -> Measurement:
    """The amplitude's answer, which says why it is not the direct one."""
    note = f"By the amplitude of the ringing, as the direct route has no answer: {why}"
    reasons = [why] * len(amplitude.snapshots)
    if direct is not None:
        reasons = [s.verdict.reason or why for s in direct.snapshots]
    found = _beside(amplitude, reasons, direct)
    snapshots = [replace(s, verdict=_noted(s.verdict, note)) for s in found.snapshots]
    return _with_attributes(replace(found, snapshots=snapshots))


def _noted(verdict: Verdict, note: str) -> Verdict:
    outcome = "usable" if verdict.outcome == "converged" else verdict.outcome
    return replace(verdict, outcome=outcome, reasons=(*verdict.reasons, note))


def _without_contradicted(direct: Measurement, amplitude: Measurement) -> Measurement:
    """The amplitude's answer, withheld where the direct route's check contradicts the bench."""
    snapshots = [
        found
        if seen.model_check.agrees
        else replace(
            found,
            verdict=Verdict(
                "withheld",
                (CONTRADICTED, *found.verdict.reasons),
                " ".join(filter(None, [CONTRADICTED, found.verdict.reason])),
            ),
            model_check=seen.model_check,
        )
        for seen, found in zip(direct.snapshots, amplitude.snapshots, strict=True)
    ]
    return replace(amplitude, snapshots=snapshots)


def _disagreement(direct: Measurement, amplitude: Measurement) -> str | None:
    """Why the change is withheld: both routes answer, and not alike."""
    pairs = [
        (seen.name, np.log(seen.delta_rad), np.log(found.delta_rad))
        for seen, found in zip(direct.snapshots, amplitude.snapshots, strict=True)
        if seen.verdict.reason is None and found.verdict.reason is None
        if seen.delta_rad is not None and found.delta_rad is not None
    ]
    if not pairs:
        return None
    bound = normal_isf(0.5 * FALSE_ALARM / len(pairs))
    apart = [name for name, *logs in pairs if abs(_standard_difference(*logs)) > bound]
    if not apart:
        return None
    return (
        f"The direct route and the amplitude disagree beyond their intervals in {', '.join(apart)}"
        ", though they rest on one bench, so the change is withheld: the bench lacks an effect or "
        "has wrong values (`bayesbl diagnose` looks for what is missing)."
    )


def _standard_difference(first: FloatArray, second: FloatArray) -> float:
    """Difference of means of ln δ over its standard deviation, as if both were independent.

    What both draw from the tolerances of the bench is common to them, so the true standard
    deviation is smaller and the alarm rarer than its level.
    """
    sd = float(np.hypot(first.std(), second.std()))
    return float(first.mean() - second.mean()) / sd


def prepare(config: SnapshotConfig) -> AutoMeasurer:
    """Both routes with one bench."""
    bench = bench_of(config)
    return AutoMeasurer(config, DirectMeasurer(config, bench), AmplitudeMeasurer(config, bench))
