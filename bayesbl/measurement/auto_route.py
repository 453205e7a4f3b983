"""Both routes, each whole: the direct one answers where its checks pass, beside the amplitude.

One route answers for all snapshots, so that the change between them lies within one. Where the
direct route could not be sampled, or a recording cannot be compared with the simulation, the
amplitude answers. Where a recording contradicts the bench, neither does: the curve is of that
bench too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from bayesbl.config.measurement import SnapshotConfig
from bayesbl.errors import BenchError, CurveError, RecordingError, UserError
from bayesbl.matching.signals import SMALLEST_GAP_RAD
from bayesbl.measurement.amplitude_route import AmplitudeMeasurer
from bayesbl.measurement.compatibility import bench_of
from bayesbl.measurement.direct_route import DirectMeasurer
from bayesbl.measurement.measurement import ExpectedSd, Measurement, Measurer, Reason, Task
from bayesbl.probabilities import normal_isf
from bayesbl.recording.checks import moves
from bayesbl.recording.types import FloatArray, Recording

FALSE_ALARM = 0.01
"""Of the routes' disagreement, over all snapshots of a run."""


class AutoMeasurer(Measurer):
    """Both routes of one bench."""

    def __init__(self, config: SnapshotConfig) -> None:
        super().__init__(config)
        bench = bench_of(config)
        self.direct = DirectMeasurer(config, bench)
        self.amplitude = AmplitudeMeasurer(config, bench)

    @property
    def gap_range_rad(self) -> tuple[float, float]:
        """Gaps inside the direct route's prior."""
        return self.direct.gap_range_rad

    def describe(self) -> Iterator[tuple[str, Callable[[], str]]]:
        """The bench and the curve."""
        yield from self.direct.describe()
        yield from self.amplitude.describe()

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

    def expected(self, recordings: Sequence[Recording]) -> Sequence[ExpectedSd]:
        """Of the direct route."""
        return self.direct.expected(recordings)

    def measure(self, task: Task) -> Measurement:
        """By both routes, each whole.

        Raises
        ------
        UserError
            If neither can measure these recordings.
        """
        if any(map(moves, task.recordings)):
            return replace(self.direct.measure(task), why=Reason("motion"))
        direct, amplitude = _tried(self.direct.measure, task), _tried(self.amplitude.measure, task)
        match direct, amplitude:
            case UserError(), UserError():
                raise direct
            case Measurement(), UserError():
                refused = {"amplitude": Reason.of_text(amplitude.code, str(amplitude))}
                return replace(direct, why=Reason("amplitude_has_no_answer"), refused=refused)
            case UserError(), Measurement():
                refusal = Reason.of_text(direct.code, str(direct))
                found = self._by_amplitude(amplitude, [refusal])
                return replace(found, refused={"direct": refusal})
            case Measurement(), Measurement():
                return self._of_both(direct, amplitude)
        raise AssertionError("all cases are above")

    def _of_both(self, direct: Measurement, amplitude: Measurement) -> Measurement:
        """Direct, unless it failed by itself while the amplitude has an answer."""
        if self.amplitude.source.bench is not None:
            amplitude = _without_contradicted(direct, amplitude)
        failed = [
            reason
            for answer in direct.answers
            if answer.model_check["agrees"]
            for reason in answer.withholding
        ]
        if failed and not all(answer.is_withheld for answer in amplitude.answers):
            return replace(self._by_amplitude(amplitude, failed), beside=(direct,))
        checked = all(answer.model_check["agrees"] for answer in direct.answers)
        why = "sharper_and_checked" if checked else "sharper"
        if any(answer.is_withheld for answer in direct.answers):
            why = "direct_withheld"
        found = replace(
            direct,
            why=Reason(why),
            beside=(amplitude,),
        )
        if self.amplitude.source.bench is not None and found.change_reason is None:
            found = replace(found, change_reason=disagreement(direct, amplitude))
        return found

    def _by_amplitude(self, amplitude: Measurement, because: Sequence[Reason]) -> Measurement:
        """The amplitude's answer, which says why it is not the direct one."""
        told = [reason.stored for reason in because]
        note = Reason("by_amplitude_instead", {"because": told})
        answers = [replace(a, reasons=(*a.reasons, note)) for a in amplitude.answers]
        return replace(amplitude, answers=answers, why=Reason("direct_has_no_answer"))


def _tried(measure: Callable[[Task], Measurement], task: Task) -> Measurement | UserError:
    try:
        return measure(task)
    except (RecordingError, CurveError, BenchError) as refusal:
        return refusal  # what cannot be written or read is no matter of the route


def _without_contradicted(direct: Measurement, amplitude: Measurement) -> Measurement:
    """The amplitude's answer, withheld where the direct route's check contradicts the bench."""
    against = Reason("recording_contradicts_bench")
    answers = [
        answer
        if seen.model_check["agrees"]
        else replace(answer, reasons=(against, *answer.reasons), model_check=seen.model_check)
        for seen, answer in zip(direct.answers, amplitude.answers, strict=True)
    ]
    return replace(amplitude, answers=answers)


def disagreement(first: Measurement, second: Measurement, **told: object) -> Reason | None:
    """Why the change is withheld: both routes answer, and not alike; ``told`` to its sentence."""
    pairs = [
        (seen.name, seen.delta_rad, answer.delta_rad)
        for seen, answer in zip(first.answers, second.answers, strict=True)
        if not (seen.is_withheld or answer.is_withheld)
        if seen.delta_rad is not None and answer.delta_rad is not None
    ]
    if not pairs:
        return None
    bound = normal_isf(0.5 * FALSE_ALARM / len(pairs))
    apart = [name for name, *gaps in pairs if abs(_standard_difference(*gaps)) > bound]
    return Reason("routes_disagree", {"names": apart, **told}) if apart else None


def _standard_difference(first: FloatArray, second: FloatArray) -> float:
    """Difference of means of ln δ over its standard deviation, as if both gaps, in rad, were
    independent; of gaps too small to be called so, of δ itself.

    What both draw from the tolerances of the bench is common to them, so the true standard
    deviation is smaller and the alarm rarer than its level.
    """
    first, second = (np.log(SMALLEST_GAP_RAD + gap_rad) for gap_rad in (first, second))
    sd = float(np.hypot(first.std(), second.std()))
    return float(first.mean() - second.mean()) / sd


prepare = AutoMeasurer
