"""A recording reduced to its mean rotation and the noise about it, as a device sends it on request.

Some 20 kB for a channel in place of a file of half a megabyte: made on
the device that measured it, sent as a message, and a file where it is collected.
"""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BeforeValidator, Field, PlainSerializer, model_validator

from bayesbl.errors import UserError
from bayesbl.fleet.measured_joint import JointJob, RecordingAnswer
from bayesbl.fleet.message import (
    LARGEST_MESSAGE_BYTES,
    Day,
    Digest,
    JointName,
    Part,
    encoded,
    valid,
)
from bayesbl.measurement.joint_features import folded_signal
from bayesbl.measurement.routes import measurer_of
from bayesbl.noise.rotation_noise import estimate_noise
from bayesbl.recording.channels import MOTOR_CURRENT, MOTOR_SPEED, MOTOR_TORQUE, TIME
from bayesbl.recording.checks import is_constant, rotations_of
from bayesbl.recording.types import FloatArray, Recording
from bayesbl.results.atomic import replacing
from bayesbl.results.identified import bench_from
from bayesbl.ringing.symbols import ROTATION

ROTATION_MESSAGE = "mean_rotation"
"""Kind of a message that holds a mean rotation."""

FOLDER = "rotations"
REPEATING = (MOTOR_SPEED, MOTOR_CURRENT, MOTOR_TORQUE)
"""Channels that are the same in every rotation."""

MOST_ROTATIONS, MOST_COEFFICIENTS = 1_000_000, 100
"""Far more than ``watch`` sends."""

_LARGEST = 1e30
_LITTLE_ENDIAN = np.dtype("<f4")


def _numbers(given: object) -> FloatArray:
    """A row of them, as a message has it."""
    if isinstance(given, np.ndarray):
        return given
    if not isinstance(given, str):
        raise ValueError("it is no text")
    values = np.frombuffer(base64.b64decode(given, validate=True), _LITTLE_ENDIAN)
    if values.size < 2 or not np.all(np.isfinite(values)):
        raise ValueError("it is no row of numbers")
    return values.astype(float)


def _text(values: FloatArray) -> str:
    return base64.b64encode(values.astype(_LITTLE_ENDIAN).tobytes()).decode()


_Name = Annotated[str, Field(pattern=f"^({'|'.join(REPEATING)})$")]
_Number = Annotated[float, Field(gt=-_LARGEST, lt=_LARGEST)]


class MeanChannel(Part):
    """A channel over one rotation, in its own unit; single precision in a message.

    Attributes
    ----------
    mean
        Mean over the rotations, shape (n,), evenly over the rotation from the recording's start.
    noise_sd
        Of a single sample; that of ``mean`` is 1/√rotations of it.
    noise_coefficients
        φ of the autoregressive noise x_t = Σ φ_k x_{t−k} + ε_t at the recording's sampling, (p,).
    """

    mean: Annotated[Any, BeforeValidator(_numbers), PlainSerializer(_text)]
    noise_sd: Annotated[_Number, Field(ge=0.0)]
    noise_coefficients: Annotated[list[_Number], Field(max_length=MOST_COEFFICIENTS)]


class MeanRotation(Part):
    """What repeats of a recording, by channel, and whose it is."""

    joint: JointName
    date: Day
    sha256: Digest
    rotation_s: Annotated[_Number, Field(gt=0.0)]
    rotations: Annotated[int, Field(ge=2, le=MOST_ROTATIONS)]
    channels: Annotated[dict[_Name, MeanChannel], Field(min_length=1)]
    device: str = Field(default="", exclude=True)

    @property
    def file(self) -> str:
        """Where it is stored, below the table of recordings."""
        return f"{FOLDER}/{self.device}/{self.joint}/{self.date}_{self.sha256[:12]}.parquet"

    @property
    def samples(self) -> int:
        """Of the rotation."""
        return int(next(iter(self.channels.values())).mean.size)

    @model_validator(mode="after")
    def _equally_long(self) -> Self:
        if any(own.mean.size != self.samples for own in self.channels.values()):
            raise ValueError("its channels are not equally long")
        return self


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
        speed = recording.motor_speed_rpm
        return MeanRotation(
            joint=job.joint.name,
            date=job.recordings[number].date,
            sha256=job.sha256[number],
            rotation_s=rotation_s,
            rotations=len(folded_signal(speed, rotation_s / recording.sampling_period_s)),
            channels={
                name: _reduced(values, recording, rotation_s)
                for name, values in recording.channels.items()
                if name in REPEATING and np.all(np.isfinite(values)) and not is_constant(values)
            },
        )
    except (UserError, ValueError):  # too short, or nothing in it that could be sent
        return None


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
    return MeanChannel(
        mean=folded.mean(axis=0),
        noise_sd=noise.sd_rpm,
        noise_coefficients=noise.coefficients.tolist(),
    )


def encoded_rotation(rotation: MeanRotation, device: str) -> bytes | None:
    """As a message; ``None`` if it is too large to be sent."""
    message = encoded(ROTATION_MESSAGE, rotation.model_dump(), device)
    return message if len(message) <= LARGEST_MESSAGE_BYTES else None


def decoded_rotation(given: Any, device: str) -> MeanRotation:
    """The mean rotation that a message of this kind holds.

    Raises
    ------
    ValueError
        If something in it cannot be, with a reason that may be printed.
    """
    return valid(MeanRotation, given).model_copy(update={"device": device})


def store_rotation(rotation: MeanRotation, output: Path) -> None:
    """One Parquet file, durable: ``time_s`` and the channels, the noise in the file's metadata.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    import pyarrow
    import pyarrow.parquet

    columns = {TIME: rotation.rotation_s / rotation.samples * np.arange(rotation.samples)}
    columns |= {name: own.mean for name, own in rotation.channels.items()}
    noise = {
        name: {"sd": own.noise_sd, "coefficients": own.noise_coefficients}
        for name, own in rotation.channels.items()
    }
    told = {
        "device": rotation.device,
        "joint": rotation.joint,
        "date": rotation.date,
        "sha256": rotation.sha256,
        "rotations": str(rotation.rotations),
        "noise": json.dumps(noise),
    }
    path = output / rotation.file
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path, durable=True) as temporary:
        pyarrow.parquet.write_table(pyarrow.table(columns).replace_schema_metadata(told), temporary)
