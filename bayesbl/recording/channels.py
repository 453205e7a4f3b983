"""Names of channels, and the mapping of a file's columns to them.

Configurations use this module before any number is read, so it imports nothing heavy.
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
"""Known channels with their long names."""


@dataclass(frozen=True, slots=True)
class ColumnSpec:
    """The column of a file that holds a channel."""

    name: str
    unit: str | None = None  # None for the unit that the channel's name ends in
    reversed: bool = False  # whether forward motion is negative


def is_mappable(channel: str) -> bool:
    """Whether a column may be mapped to this name: time, a known channel or a known torque."""
    return channel == TIME or channel in CHANNELS or channel.endswith("_nm")


def or_another_name(file: str) -> str:
    """Hint for messages: map another column name, and the command that guesses the columns."""
    command = f"bayesbl init {shlex.quote(Path(file).name)}"
    return (
        f"or another name for it under [columns] (`{command}` writes them; --config takes a file "
        "that has them)"
    )


def nearest(name: str, known: Iterable[str]) -> str | None:
    """The known name most similar to ``name``, ignoring case; ``None`` if none is similar."""
    by_lower = {candidate.lower(): candidate for candidate in known}
    matches = get_close_matches(name.lower(), by_lower, n=1, cutoff=0.6)
    return by_lower[matches[0]] if matches else None


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """``' Did you mean "…"?'`` with the most similar known name, or an empty text."""
    match = nearest(name, known)
    return "" if match is None else f' Did you mean "{match}"?'


def did_you_mean_file(path: Path) -> str:
    """``' Did you mean "…"?'`` with the most similar file name in the folder of a missing file."""
    try:
        return did_you_mean(path.name, sorted(os.listdir(path.parent)))
    except (OSError, ValueError):
        return ""
