"""A recording: named channels over one time axis, with their origin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesbl.recording.channels import CHANNELS as CHANNELS
from bayesbl.recording.channels import LOAD_POSITION as LOAD_POSITION
from bayesbl.recording.channels import MOTOR_CURRENT as MOTOR_CURRENT
from bayesbl.recording.channels import MOTOR_POSITION as MOTOR_POSITION
from bayesbl.recording.channels import MOTOR_SPEED as MOTOR_SPEED
from bayesbl.recording.channels import MOTOR_TORQUE as MOTOR_TORQUE
from bayesbl.recording.channels import REFERENCE_POSITION as REFERENCE_POSITION
from bayesbl.recording.channels import REFERENCE_SPEED as REFERENCE_SPEED
from bayesbl.recording.channels import TIME as TIME

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class Source:
    """File and hash from which a recording was read."""

    file: str
    sha256: str
    unused_columns: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, repr=False)
class Recording:
    """Named channels over time, checked at file level only; n samples."""

    name: str  # short, for results and figures
    time_s: FloatArray  # shape (n,), strictly increasing, finite
    # Each channel's values, shape (n,), finite, in the unit that its name ends in.
    channels: Mapping[str, FloatArray]
    source: Source | None = None  # None for a simulated recording
    metadata: Mapping[str, Any] = field(default_factory=dict)  # what else is known, e.g. its date
    # Samples that stand in for lost ones or cannot be trusted (clipped), shape (n,); fits leave
    # them out. None without any.
    excluded: BoolArray | None = None
    notes: tuple[str, ...] = ()  # sentences on what was done to it, for the result

    def __repr__(self) -> str:
        rate = 1.0 / self.sampling_period_s
        channels = ", ".join(self.channels)
        return f"<Recording {self.name}: {self.duration_s:.4g} s at {rate:.4g} Hz, {channels}>"

    @property
    def place(self) -> str:
        """The file it was read from, or its name; for messages."""
        return self.source.file if self.source else self.name

    @property
    def samples(self) -> int:
        """Number of samples n."""
        return int(self.time_s.size)

    @property
    def duration_s(self) -> float:
        """Length n · Δt in s: one period beyond the last stamp."""
        span = float(self.time_s[-1] - self.time_s[0])
        return span * self.samples / (self.samples - 1)

    @property
    def sampling_period_s(self) -> float:
        """Mean time between samples Δt in s."""
        return float(self.time_s[-1] - self.time_s[0]) / (self.samples - 1)

    @property
    def motor_speed_rpm(self) -> FloatArray:
        """Motor speed, shape (n,), rpm."""
        return self.channels[MOTOR_SPEED]
