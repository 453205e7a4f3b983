"""Run the direct and the amplitude route in full; one of them answers for all snapshots.

The change between snapshots thus lies within one route. With a bench the direct route answers if
its checks pass, with the amplitude beside it. The amplitude answers if the direct route could not
be sampled or a recording cannot be compared with the simulation. If a recording contradicts the
bench, neither answers, because the curve belongs to that bench too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from bayesbl.config.measurement import SnapshotConfig
from bayesbl.errors import BenchError, CurveError, RecordingError, UserError
from bayesbl.measurement.amplitude_route import AmplitudeMeasurer
from bayesbl.measurement.compatibility import bench_of
from bayesbl.measurement.direct_route import DirectMeasurer
from bayesbl.measurement.measurement import ExpectedSd, Measurement, Measurer, Reason, Task
from bayesbl.measurement.witness import disagreement
from bayesbl.recording.checks import moves
from bayesbl.recording.types import Recording


class AutoMeasurer(Measurer):
    """The direct and the amplitude route of one bench."""

    def __init__(self, config: SnapshotConfig) -> None:
        super().__init__(config)
        bench = bench_of(config)
        self.direct = DirectMeasurer(config, bench)
        self.amplitude = AmplitudeMeasurer(config, bench)
        self.gap_range_rad = self.direct.gap_range_rad

    def describe(self) -> Iterator[tuple[str, Callable[[], str]]]:
        """Yield the bench and the curve."""
        yield from self.direct.describe()
        yield from self.amplitude.describe()

    def require_usable(self, recording: Recording) -> None:
        """Require that the deciding route can measure; the direct route alone may fail."""
        self._of([recording]).require_usable(recording)

    def require_together(self, recordings: Sequence[Recording]) -> str | None:
        """Check comparability for the amplitude route; the direct route compares any recordings."""
        return self._of(recordings).require_together(recordings)

    def _of(self, recordings: Sequence[Recording]) -> Measurer:
        """The route that decides what can be measured: only the direct route measures motions."""
        return self.direct if any(map(moves, recordings)) else self.amplitude

    def expected(self, recordings: Sequence[Recording]) -> Sequence[ExpectedSd]:
        """Expected standard deviations of the direct route."""
        return self.direct.expected(recordings)

    def measure(self, task: Task) -> Measurement:
        """Measure by both routes and choose the one that answers.

        Raises
        ------
        UserError
            If neither can measure these recordings.
        """
        if any(map(moves, task.recordings)):
            return replace(self.direct.measure(task), why=Reason("motion"))
        direct, amplitude = _tried(self.direct.measure, task), _tried(self.amplitude.measure, task)
        if isinstance(amplitude, UserError):
            if isinstance(direct, UserError):
                raise direct
            refused = {"amplitude": Reason.of_text(amplitude.code, str(amplitude))}
            return replace(direct, why=Reason("amplitude_has_no_answer"), refused=refused)
        if isinstance(direct, UserError):
            refusal = Reason.of_text(direct.code, str(direct))
            return replace(_instead(amplitude, [refusal]), refused={"direct": refusal})
        return self._of_both(direct, amplitude)

    def _of_both(self, direct: Measurement, amplitude: Measurement) -> Measurement:
        """The direct answer, unless that route itself failed and the amplitude has an answer."""
        if self.amplitude.bench is not None:
            amplitude = _without_contradicted(direct, amplitude)
        failed = [
            reason
            for answer in direct.answers
            if answer.model_check["agrees"]
            for reason in answer.withholding
        ]
        if failed and not all(answer.is_withheld for answer in amplitude.answers):
            return replace(_instead(amplitude, failed), beside=(direct,))
        checked = all(answer.model_check["agrees"] for answer in direct.answers)
        why = "sharper_and_checked" if checked else "sharper"
        if any(answer.is_withheld for answer in direct.answers):
            why = "direct_withheld"
        change_reason = direct.change_reason
        if change_reason is None and self.amplitude.bench is not None:
            change_reason = disagreement(direct, amplitude)
        return replace(direct, why=Reason(why), beside=(amplitude,), change_reason=change_reason)


def _instead(amplitude: Measurement, because: Sequence[Reason]) -> Measurement:
    """The amplitude's answer, with a note why the direct route does not answer."""
    note = Reason("by_amplitude_instead", {"because": [reason.stored for reason in because]})
    answers = [replace(answer, reasons=(*answer.reasons, note)) for answer in amplitude.answers]
    return replace(amplitude, answers=answers, why=Reason("direct_has_no_answer"))


def _tried(measure: Callable[[Task], Measurement], task: Task) -> Measurement | UserError:
    try:
        return measure(task)
    except (RecordingError, CurveError, BenchError) as refusal:
        return refusal  # other errors (files that cannot be read or written) are not the route's


def _without_contradicted(direct: Measurement, amplitude: Measurement) -> Measurement:
    """Withhold the amplitude's answer where the direct route's check contradicts the bench."""
    against = Reason("recording_contradicts_bench")
    answers = [
        answer
        if direct_answer.model_check["agrees"]
        else replace(
            answer, reasons=(against, *answer.reasons), model_check=direct_answer.model_check
        )
        for direct_answer, answer in zip(direct.answers, amplitude.answers, strict=True)
    ]
    return replace(amplitude, answers=answers)
