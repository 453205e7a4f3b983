"""Several routes for the same recordings; one of them answers for all snapshots.

The change between snapshots thus lies within one route. With a bench the direct route answers if
its checks pass, with the amplitude beside it. The amplitude answers if the direct route could not
be sampled or a recording cannot be compared with the simulation. If a recording contradicts the
bench, neither answers, because the curve belongs to that bench too.

Where the load's position is recorded, the two-encoder route is a witness beside the others. It
needs no bench, so an error of the bench shows as a disagreement.
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
from bayesbl.measurement.measurement import Answer, ExpectedSd, Measurement, Measurer, Reason, Task
from bayesbl.measurement.two_encoder_route import CHANNELS, TwoEncoderMeasurer
from bayesbl.measurement.two_encoder_route import NAME as WITNESS
from bayesbl.probabilities import FALSE_ALARM, normal_isf
from bayesbl.progress import StageProgress
from bayesbl.recording.checks import moves, require_alive
from bayesbl.recording.types import MOTOR_POSITION, Recording
from bayesbl.units import RPM_PER_RAD_PER_S


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
        """Require that the deciding route can measure."""
        self._of([recording]).require_usable(recording)

    def require_together(self, recordings: Sequence[Recording]) -> str | None:
        """As the deciding route."""
        return self._of(recordings).require_together(recordings)

    def _of(self, recordings: Sequence[Recording]) -> Measurer:
        """The route that decides what can be measured: only the direct route measures motions. It
        compares any recordings, and may fail where the amplitude does not."""
        return self.direct if any(map(moves, recordings)) else self.amplitude

    def expected(
        self, recordings: Sequence[Recording], progress: StageProgress | None = None
    ) -> Sequence[ExpectedSd]:
        """Expected standard deviations of the direct route."""
        return self.direct.expected(recordings, progress)

    def measure(self, task: Task) -> Measurement:
        """Measure by both routes and choose the one that answers.

        Raises UserError if neither can measure these recordings.
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
        if self.amplitude.bench is not None:  # what contradicts the bench contradicts its curve
            against = Reason("recording_contradicts_bench")
            answers = [
                own
                if other.model_check["agrees"]
                else replace(own, reasons=(against, *own.reasons), model_check=other.model_check)
                for own, other in zip(amplitude.answers, direct.answers, strict=True)
            ]
            amplitude = replace(amplitude, answers=answers)
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


def disagreement(first: Measurement, second: Measurement, **values: object) -> Reason | None:
    """Why the change is withheld: both routes answer and differ; ``values`` go to the sentence."""
    pairs = [
        (first_answer.name, first_answer.delta_rad, second_answer.delta_rad)
        for first_answer, second_answer in zip(first.answers, second.answers, strict=True)
        if not (first_answer.is_withheld or second_answer.is_withheld)
        if first_answer.delta_rad is not None and second_answer.delta_rad is not None
    ]
    if not pairs:
        return None
    bound = normal_isf(0.5 * FALSE_ALARM / len(pairs))
    differing = []
    for name, *gaps_rad in pairs:
        # As if they were independent. Both share the tolerances of the bench, so the true standard
        # deviation is smaller, and the alarm rarer than its level. For gaps far below
        # SMALLEST_GAP_RAD, it is the difference of δ itself.
        logs = [np.log(SMALLEST_GAP_RAD + gap_rad) for gap_rad in gaps_rad]
        sd = float(np.hypot(logs[0].std(), logs[1].std()))
        if abs(float(logs[0].mean() - logs[1].mean()) / sd) > bound:
            differing.append(name)
    return Reason("routes_disagree", {"names": differing, **values}) if differing else None


def with_witness(measured: Measurement, task: Task) -> Measurement:
    """Add the two-encoder measurement as a witness, or the reason why it cannot be run.

    The answer stays. A disagreement withholds the change, as between other routes.
    """
    config = task.config
    if config.joint.gear_ratio is None and config.estimator.bench is not None:
        known = {"gear_ratio": bench_of(config).value("gear_ratio")}
        config = config.model_copy(update={"joint": config.joint.model_copy(update=known)})
    measurer = TwoEncoderMeasurer(config)
    recordings = tuple(map(_of_both_encoders, task.recordings))
    try:
        for recording in recordings:
            require_alive(recording, CHANNELS)
            measurer.require_usable(recording)
    except RecordingError as refusal:
        refused = {**measured.refused, WITNESS: Reason.of_text(refusal.code, str(refusal))}
        return replace(measured, refused=refused)
    witness = measurer.measure(replace(task, recordings=recordings))
    bounded = replace(witness, answers=[within_bound(answer) for answer in witness.answers])
    return replace(
        measured,
        beside=(*measured.beside, witness),
        change_reason=disagreement(measured, bounded, witness=True) or measured.change_reason,
        why=Reason("witnessed") if measured.why.code == "only_route" else measured.why,
    )


def _of_both_encoders(recording: Recording) -> Recording:
    """Drop repaired samples; integrate the speed if the motor's position is missing."""
    channels, notes = dict(recording.channels), recording.notes
    if MOTOR_POSITION not in channels:
        from scipy.integrate import cumulative_trapezoid

        speed = recording.motor_speed_rpm / RPM_PER_RAD_PER_S
        channels[MOTOR_POSITION] = cumulative_trapezoid(speed, recording.time_s, initial=0.0)
        notes = (*notes, "The motor's position is its speed, integrated.")
    if (repaired := recording.excluded) is None:
        return replace(recording, channels=channels, notes=notes)
    kept = {name: values[~repaired] for name, values in channels.items()}
    time_s = recording.time_s[~repaired]
    return replace(recording, time_s=time_s, channels=kept, notes=notes, excluded=None)


def within_bound(answer: Answer) -> Answer:
    """Replace δ by equally spaced gaps from 0 to its bound, rad, if the gap may be zero."""
    bound = answer.upper_bound_rad
    return answer if bound is None else replace(answer, delta_rad=np.linspace(0.0, bound, 1000))
