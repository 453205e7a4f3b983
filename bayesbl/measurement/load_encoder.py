"""The load's encoder as a witness beside a route that goes by the motor alone.

Where all recordings have the load's position too, :mod:`bayesbl.measurement.two_encoder_route`
measures them as well. It needs no bench, so what the bench has wrong shows as a disagreement.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.integrate import cumulative_trapezoid

from bayesbl.config.measurement import SnapshotConfig
from bayesbl.errors import RecordingError
from bayesbl.measurement.auto_route import disagreement
from bayesbl.measurement.compatibility import bench_of
from bayesbl.measurement.measurement import Answer, Measurement, Reason, Task
from bayesbl.measurement.two_encoder_route import CHANNELS, NAME, TwoEncoderMeasurer
from bayesbl.recording.checks import require_alive
from bayesbl.recording.types import MOTOR_POSITION, Recording
from bayesbl.units import RPM_PER_RAD_PER_S


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
