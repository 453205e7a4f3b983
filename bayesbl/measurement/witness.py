"""Whether two routes agree, and the two-encoder route as a witness beside another route.

The witness needs no bench, so an error of the bench shows as a disagreement.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayesbl.config.measurement import SnapshotConfig
from bayesbl.errors import RecordingError
from bayesbl.matching.signals import SMALLEST_GAP_RAD
from bayesbl.measurement.compatibility import bench_of
from bayesbl.measurement.measurement import Answer, Measurement, Reason, Task
from bayesbl.measurement.two_encoder_route import CHANNELS, NAME, TwoEncoderMeasurer
from bayesbl.probabilities import FALSE_ALARM, normal_isf
from bayesbl.recording.checks import require_alive
from bayesbl.recording.types import MOTOR_POSITION, FloatArray, Recording
from bayesbl.units import RPM_PER_RAD_PER_S


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
    differing = [name for name, *gaps in pairs if abs(_standard_difference(*gaps)) > bound]
    return Reason("routes_disagree", {"names": differing, **values}) if differing else None


def _standard_difference(first: FloatArray, second: FloatArray) -> float:
    """Standardised difference of ln δ between two routes, as if their gaps (rad) were independent.

    For gaps far below ``SMALLEST_GAP_RAD`` it is the difference of δ itself. Both routes share the
    tolerances of the bench. The true standard deviation is therefore smaller, and the alarm rarer
    than its level.
    """
    first, second = (np.log(SMALLEST_GAP_RAD + gap_rad) for gap_rad in (first, second))
    sd = float(np.hypot(first.std(), second.std()))
    return float(first.mean() - second.mean()) / sd


def with_witness(measured: Measurement, task: Task) -> Measurement:
    """Add the two-encoder measurement as a witness, or the reason why it cannot be run.

    The answer stays. A disagreement withholds the change, as between other routes.
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
    """Use the gear ratio of the bench if the joint states none."""
    if config.joint.gear_ratio is not None or config.estimator.bench is None:
        return config
    known = {"gear_ratio": bench_of(config).value("gear_ratio")}
    return config.model_copy(update={"joint": config.joint.model_copy(update=known)})


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
