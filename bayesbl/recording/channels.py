"""The names of channels, and how a file's columns are mapped to them.

Free of heavy imports: configurations use it before any number is read.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType

TIME = "time_s"
MOTOR_SPEED = "motor_speed_rpm"
MOTOR_POSITION = "motor_position_rad"
MOTOR_CURRENT = "motor_current_a"
MOTOR_TORQUE = "motor_torque_nm"
LOAD_POSITION = "load_position_rad"
REFERENCE_SPEED = "reference_speed_rpm"
REFERENCE_POSITION = "reference_position_rad"

CHANNELS: Mapping[str, str] = MappingProxyType(
    {
        MOTOR_SPEED: "motor speed",
        MOTOR_POSITION: "motor position",
        MOTOR_CURRENT: "motor current",
        MOTOR_TORQUE: "motor torque",
        LOAD_POSITION: "load position",
        REFERENCE_SPEED: "reference speed",
        REFERENCE_POSITION: "reference position",
    }
)
"""Channels the package knows by name, with their long names."""


@dataclass(frozen=True, slots=True)
class ColumnSpec:
    """The column of a file that holds a channel.

    ``name``: the column's name in the file. ``unit``: the unit it comes in; ``None`` for the unit
    that the channel's name ends in. ``reversed``: whether its sign is the other one: forwards is
    negative there.
    """

    name: str
    unit: str | None = None
    reversed: bool = False


def is_mappable(channel: str) -> bool:
    """Whether a column may be mapped to this name: time, a known channel, or a known torque."""
    return channel == TIME or channel in CHANNELS or channel.endswith("_nm")


def or_another_name(file: str) -> str:
    """What else a file's column may be called, and the command that guesses the columns."""
    command = f"bayesbl init {shlex.quote(Path(file).name)}"
    return (
        f"or another name for it under [columns] (`{command}` writes them; --config takes a file "
        "that has them)"
    )


def nearest(name: str, known: Iterable[str]) -> str | None:
    """The known name most like ``name``, whatever its case; ``None`` if none is near."""
    by_lower = {candidate.lower(): candidate for candidate in known}
    matches = get_close_matches(name.lower(), by_lower, n=1, cutoff=0.6)
    return by_lower[matches[0]] if matches else None


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """``' Did you mean "…"?'`` with the nearest known name, or nothing."""
    match = nearest(name, known)
    return "" if match is None else f' Did you mean "{match}"?'


def did_you_mean_file(path: Path) -> str:
    """``' Did you mean "…"?'`` with the name in its folder most like a missing file's."""
    try:
        return did_you_mean(path.name, sorted(os.listdir(path.parent)))
    except (OSError, ValueError):
        return ""
