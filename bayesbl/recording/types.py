"""A recording: named channels over one time axis, with where they came from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

TIME = "time_s"
MOTOR_SPEED = "motor_speed_rpm"
MOTOR_POSITION = "motor_position_rad"
MOTOR_CURRENT = "motor_current_a"
MOTOR_TORQUE = "motor_torque_nm"
LOAD_POSITION = "load_position_rad"
REFERENCE_SPEED = "reference_speed_rpm"

CHANNELS: Mapping[str, str] = MappingProxyType(
    {
        MOTOR_SPEED: "motor speed",
        MOTOR_POSITION: "motor position",
        MOTOR_CURRENT: "motor current",
        MOTOR_TORQUE: "motor torque",
        LOAD_POSITION: "load position",
        REFERENCE_SPEED: "reference speed",
    }
)
"""Channels the package knows by name, with their long names."""


@dataclass(frozen=True, slots=True)
class Source:
    """Where a recording came from."""

    file: str
    sha256: str
    unused_columns: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Recording:
    """Named channels over time, checked at file level only.

    Attributes
    ----------
    name
        Short name that results and figures use.
    time_s
        Shape (n,), strictly increasing, finite.
    channels
        Channel name to values, each of shape (n,), finite, in the unit its name ends in.
    source
        File and hash it was read from; ``None`` for a simulated recording.
    metadata
        What else is known, e.g. ``date`` or the parameters of the simulation that made it.
    """

    name: str
    time_s: FloatArray
    channels: Mapping[str, FloatArray]
    source: Source | None = None
    metadata: Mapping[str, Any] = field(default_factory=dict)

    @property
    def samples(self) -> int:
        """Number of samples n."""
        return int(self.time_s.size)

    @property
    def duration_s(self) -> float:
        """Length of record n · Δt in seconds: one period beyond the last sample's time stamp."""
        span = float(self.time_s[-1] - self.time_s[0])
        return span * self.samples / (self.samples - 1)

    @property
    def sampling_period_s(self) -> float:
        """Mean time between samples Δt in seconds."""
        return float(self.time_s[-1] - self.time_s[0]) / (self.samples - 1)

    @property
    def motor_speed_rpm(self) -> FloatArray:
        """Motor speed, shape (n,), rpm."""
        return self.channels[MOTOR_SPEED]
