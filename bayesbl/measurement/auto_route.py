"""Several routes beside one another, each whole; one answers for all snapshots.

So the change between snapshots lies within one route. With a bench the direct route answers where
its checks pass, the amplitude beside it. Where the direct route could not be sampled, or a
recording cannot be compared with the simulation, the amplitude answers. Where a recording
contradicts the bench, neither does: the curve is of that bench too.

Where all recordings have the load's position too, both encoders are a witness beside these. They
need no bench, so what the bench has wrong shows as a disagreement.
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
from bayesbl.measurement.two_encoder_route import CHANNELS, NAME, TwoEncoderMeasurer
from bayesbl.probabilities import normal_isf
from bayesbl.recording.checks import moves, require_alive
from bayesbl.recording.types import MOTOR_POSITION, FloatArray, Recording
from bayesbl.units import RPM_PER_RAD_PER_S

FALSE_ALARM = 0.01
"""Of the routes' disagreement, over all snapshots of a run."""


class AutoMeasurer(Measurer):
    """Both routes of one bench."""

    def __init__(self, config: SnapshotConfig) -> None:
        super().__init__(config)
        bench = bench_of(config)
        self.direct = DirectMeasurer(config, bench)
        self.amplitude = AmplitudeMeasurer(config, bench)
        self.gap_range_rad = self.direct.gap_range_rad

    def describe(self) -> Iterator[tuple[str, Callable[[], str]]]:
        """The bench and the curve."""
        yield from self.direct.describe()
        yield from self.amplitude.describe()

    def require_usable(self, recording: Recording) -> None:
        """The amplitude can be measured; where only the direct route cannot, it is left out."""
        self._of([recording]).require_usable(recording)

    def require_together(self, recordings: Sequence[Recording]) -> str | None:
        """What holds for the amplitude; the direct route takes any."""
        return self._of(recordings).require_together(recordings)

    def _of(self, recordings: Sequence[Recording]) -> Measurer:
        """The route that decides what can be measured: motions are the direct one's alone."""
        return self.direct if any(map(moves, recordings)) else self.amplitude

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
        """Direct, unless it failed by itself while the amplitude has an answer."""
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
        against = direct.change_reason
        if against is None and self.amplitude.bench is not None:
            against = disagreement(direct, amplitude)
        return replace(direct, why=Reason(why), beside=(amplitude,), change_reason=against)


def _instead(amplitude: Measurement, because: Sequence[Reason]) -> Measurement:
    """The amplitude's answer, which says why it is not the direct one."""
    note = Reason("by_amplitude_instead", {"because": [reason.stored for reason in because]})
    answers = [replace(answer, reasons=(*answer.reasons, note)) for answer in amplitude.answers]
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
        if direct_answer.model_check["agrees"]
        else replace(
            answer, reasons=(against, *answer.reasons), model_check=direct_answer.model_check
        )
        for direct_answer, answer in zip(direct.answers, amplitude.answers, strict=True)
    ]
    return replace(amplitude, answers=answers)


def disagreement(first: Measurement, second: Measurement, **values: object) -> Reason | None:
    """Why the change is withheld: both routes answer, and not alike; ``values``: the sentence's."""
    pairs = [
        (one.name, one.delta_rad, answer.delta_rad)
        for one, answer in zip(first.answers, second.answers, strict=True)
        if not (one.is_withheld or answer.is_withheld)
        if one.delta_rad is not None and answer.delta_rad is not None
    ]
    if not pairs:
        return None
    bound = normal_isf(0.5 * FALSE_ALARM / len(pairs))
    apart = [name for name, *gaps in pairs if abs(_standard_difference(*gaps)) > bound]
    return Reason("routes_disagree", {"names": apart, **values}) if apart else None


def _standard_difference(first: FloatArray, second: FloatArray) -> float:
    """Difference of means of ln δ over its standard deviation, as if both gaps, in rad, were
    independent; of gaps too small to be called so, of δ itself.

    What both draw from the tolerances of the bench is common to them, so the true standard
    deviation is smaller and the alarm rarer than its level.
    """
    first, second = (np.log(SMALLEST_GAP_RAD + gap_rad) for gap_rad in (first, second))
    sd = float(np.hypot(first.std(), second.std()))
    return float(first.mean() - second.mean()) / sd


def with_witness(measured: Measurement, task: Task) -> Measurement:
    """The measurement with what two encoders say beside it, or why they say nothing.

    The answer stays; a disagreement withholds the change, as one between other routes does.
    """
    measurer = TwoEncoderMeasurer(_with_gear_ratio(task.config))
    recordings = tuple(map(_of_both_encoders, task.recordings))
    try:
        for recording in recordings:
            require_alive(recording, CHANNELS)
            measurer.require_usable(recording)
    except RecordingError as refusal:
        refused = {**measured.refused, NAME: Reason.of_text(refusal.code, str(refusal))}
        return replace(measured, refused=refused)
    witness = measurer.measure(replace(task, recordings=recordings))
    bounded = replace(witness, answers=[within_bound(answer) for answer in witness.answers])
    return replace(
        measured,
        beside=(*measured.beside, witness),
        change_reason=disagreement(measured, bounded, witness=True) or measured.change_reason,
        why=Reason("witnessed") if measured.why.code == "only_route" else measured.why,
    )


def _with_gear_ratio(config: SnapshotConfig) -> SnapshotConfig:
    """With the ratio of the bench, where the joint's is not stated."""
    if config.joint.gear_ratio is not None or config.estimator.bench is None:
        return config
    known = {"gear_ratio": bench_of(config).value("gear_ratio")}
    return config.model_copy(update={"joint": config.joint.model_copy(update=known)})


def _of_both_encoders(recording: Recording) -> Recording:
    """Samples that are no repairs; a motor's position that is missing is its speed, integrated."""
    channels, notes = dict(recording.channels), recording.notes
    if MOTOR_POSITION not in channels:
        from scipy.integrate import cumulative_trapezoid

        speed = recording.motor_speed_rpm / RPM_PER_RAD_PER_S
        channels[MOTOR_POSITION] = cumulative_trapezoid(speed, recording.time_s, initial=0.0)
        notes = (*notes, "The motor's position is its speed, integrated.")
    if (lost := recording.excluded) is None:
        return replace(recording, channels=channels, notes=notes)
    kept = {name: values[~lost] for name, values in channels.items()}
    time_s = recording.time_s[~lost]
    return replace(recording, time_s=time_s, channels=kept, notes=notes, excluded=None)


def within_bound(answer: Answer) -> Answer:
    """An answer whose gap may be none has all gaps below its bound alike, rad."""
    bound = answer.upper_bound_rad
    return answer if bound is None else replace(answer, delta_rad=np.linspace(0.0, bound, 1000))


prepare = AutoMeasurer
