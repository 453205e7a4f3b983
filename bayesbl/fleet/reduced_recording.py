"""A recording reduced to its mean rotation, on the device that measured it."""

from __future__ import annotations

import numpy as np

from bayesbl.errors import UserError
from bayesbl.fleet.joint_job import JointJob, RecordingAnswer
from bayesbl.fleet.mean_rotation import REPEATING, MeanChannel, MeanRotation
from bayesbl.measurement.joint_features import folded_signal
from bayesbl.measurement.routes import measurer_of
from bayesbl.noise.rotation_noise import estimate_noise
from bayesbl.recording.checks import is_constant, rotations_of
from bayesbl.recording.types import FloatArray, Recording
from bayesbl.results.identified import bench_from
from bayesbl.ringing.symbols import ROTATION


def mean_rotation(job: JointJob, number: int, answer: RecordingAnswer) -> MeanRotation | None:
    """One recording of a joint, reduced to the channels that vary and repeat.

    ``None`` where it is too short to tell noise from what repeats, and where nothing tells how long
    a rotation takes: neither a fit of the ringing nor a gear ratio.
    """
    config = job.config("fit", [number])
    try:
        recording = measurer_of(config).read(config.recordings[0])
        rotation_s = _rotation_s(job, recording, answer)
        if rotation_s is None or recording.duration_s < 2.0 * rotation_s:
            return None
        found = {
            name: _reduced(values, recording, rotation_s)
            for name, values in recording.channels.items()
            if name in REPEATING and np.all(np.isfinite(values)) and not is_constant(values)
        }
    except UserError:
        return None
    if not found:
        return None
    turns = len(folded_signal(recording.motor_speed_rpm, rotation_s / recording.sampling_period_s))
    one = job.recordings[number]
    return MeanRotation(job.joint.name, str(one.date), job.sha256[number], rotation_s, turns, found)


def _rotation_s(job: JointJob, recording: Recording, answer: RecordingAnswer) -> float | None:
    if answer.optimum is not None:
        return float(answer.optimum[ROTATION])
    ratio = job.joint.gear_ratio
    if job.joint.bench is not None:
        ratio = bench_from(job.joint.bench).value("gear_ratio")
    turns = 0.0 if ratio is None else rotations_of(recording, ratio)
    return recording.duration_s / turns if turns else None


def _reduced(values: FloatArray, recording: Recording, rotation_s: float) -> MeanChannel:
    period_s = recording.sampling_period_s
    folded = folded_signal(values, rotation_s / period_s)
    # What repeats cancels, so the recording may stand for its residual; in the channel's unit.
    noise = estimate_noise(values, rotation_s, period_s)
    return MeanChannel(folded.mean(axis=0), noise.sd_rpm, noise.coefficients)
