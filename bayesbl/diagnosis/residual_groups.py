"""The analysis of residuals as a group of ``result.nc``.

Variables begin with their channel's name. Dimensions: ``recording``, ``load_angle_rad`` (720),
``bin`` of the spectra and ``line`` of the significant lines, strongest first; shorter ones are
padded with NaN, missing channels filled with it. The attribute ``unexplained`` holds, as JSON, what
is significant over all recordings.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
import xarray as xr

from bayesbl.diagnosis.residuals import FALSE_LINES, MAP_POINTS, ChannelResiduals, ResidualAnalysis
from bayesbl.diagnosis.summary import plain
from bayesbl.recording.types import CHANNELS
from bayesbl.results.variables import Group, Variable, dataset, labels, padded, table
from bayesbl.units import unit_of

_ANGLE = "load_angle_rad"


@dataclass(frozen=True, slots=True)
class _OfChannel:
    """A variable of every channel.

    ``{unit}`` in ``unit`` is the channel's. ``attribute`` of a :class:`ChannelResiduals`, by
    default the name, is a number, or an array over ``along``.
    """

    name: str
    unit: str
    meaning: str
    attribute: str = ""
    along: str = ""

    @property
    def is_text(self) -> bool:
        """Whether it holds words."""
        return not self.unit

    def declared(self, channel: str) -> Variable:
        """The variable of one channel."""
        return Variable(
            f"{channel}_{self.name}",
            ("recording", self.along) if self.along else ("recording",),
            self.unit.format(unit=unit_of(channel)),
            f"{CHANNELS.get(channel, channel)}: {self.meaning}",
            "text" if self.is_text else "number",
        )

    def of(self, residuals: ChannelResiduals) -> object:
        """Its value."""
        if self.along == "line":
            return [getattr(line, self.attribute) for line in residuals.lines]
        return attrgetter(self.attribute or self.name)(residuals)


def _of_lines(name: str, unit: str, meaning: str) -> _OfChannel:
    """What every significant line has."""
    return _OfChannel(f"line_{name}", unit, f"{meaning} of a significant line", name, "line")


_VARIABLES = (
    _OfChannel("offset", "{unit}", "mean of recording less simulation"),
    _OfChannel("repeating_rms", "{unit}", "RMS of what repeats with the load angle"),
    _OfChannel("noise_sd", "{unit}", "standard deviation of the noise"),
    _OfChannel("drift", "{unit}/s", "slope over the recording", "drift_per_s"),
    _OfChannel("drift_error", "{unit}/s", "standard error of that slope", "drift_error_per_s"),
    _OfChannel("outliers", "1", "samples that no noise explains"),
    _OfChannel("map_error", "{unit}", "standard error of rotation averages", "load_map_error"),
    _OfChannel("load_map", "{unit}", "residual that repeats with the load angle", along=_ANGLE),
    _OfChannel("amplitude", "{unit}", "amplitude of the residual", along="bin"),
    _OfChannel("noise_amplitude", "{unit}", "RMS amplitude of noise", along="bin"),
    _of_lines("frequency_hz", "Hz", "frequency"),
    _of_lines("load_order", "1", "cycles per turn of the load"),
    _of_lines("motor_order", "1", "cycles per turn of the motor"),
    _of_lines("amplitude", "{unit}", "amplitude"),
    _of_lines("phase_rad", "rad", "phase of a cosine at the first sample"),
    _of_lines("dependence", "", "angle or time"),
)


def _named(name: str) -> Variable | None:
    """A variable of any channel; of two endings that fit, the longer is meant."""
    for row in sorted(_VARIABLES, key=lambda row: -len(row.name)):
        channel = name.removesuffix(f"_{row.name}")
        if channel != name:
            return row.declared(channel)
    return None


def residuals_group(stage: str) -> Group:
    """Of the bench as believed (``before``), or with what was named (``after``)."""
    return Group(
        f"residuals_{stage}",
        table("""
            reference_speed_rpm (recording) | rpm | reference speed of the motor
            rotations (recording) | 1 | load rotations looked at
            gear_ratio (recording) | 1 | motor turns in a turn of the load
            frequency_hz (recording, bin) | Hz | frequency
            load_order (recording, bin) | 1 | cycles per turn of the load
        """),
        (
            labels("recording", "recording"),
            Variable(_ANGLE, (_ANGLE,), "rad", "load angle"),
        ),
        _named,
        optional=True,
    )


def residuals_dataset(analysis: ResidualAnalysis, stage: str) -> xr.Dataset:
    """All that an analysis holds, as this module's text describes it."""
    recordings = analysis.recordings
    names = list(dict.fromkeys(c.channel for r in recordings for c in r.channels))
    sizes = {
        "line": max(len(c.lines) for r in recordings for c in r.channels),
        "bin": max(r.whole.frequency_hz.size for r in recordings),
        _ANGLE: MAP_POINTS,
    }
    whole = [r.whole for r in recordings]
    values: dict[str, object] = {
        "reference_speed_rpm": [w.reference_speed_rpm for w in whole],
        "rotations": [float(w.rotations) for w in whole],
        "gear_ratio": [w.gear_ratio for w in whole],
        "frequency_hz": padded([w.frequency_hz for w in whole], sizes["bin"]),
        "load_order": padded(
            [w.frequency_hz * w.seconds / w.rotations for w in whole], sizes["bin"]
        ),
    }
    for name in names:
        seen = [next((c for c in r.channels if c.channel == name), None) for r in recordings]
        for row in _VARIABLES:
            values[f"{name}_{row.name}"] = _of_recordings(row, seen, sizes)
    made = dataset(
        residuals_group(stage),
        values,
        {
            "recording": [r.name for r in recordings],
            _ANGLE: 2.0 * np.pi * np.arange(MAP_POINTS) / MAP_POINTS,
        },
    )
    made.attrs = {
        "channels": names,
        "false_discovery_rate": FALSE_LINES,
        "unexplained": json.dumps(plain(analysis.remaining), ensure_ascii=False),
    }
    return made


def _of_recordings(
    row: _OfChannel, seen: Sequence[ChannelResiduals | None], sizes: dict[str, int]
) -> object:
    if not row.along:
        return np.array([np.nan if c is None else row.of(c) for c in seen], dtype=float)
    return padded([[] if c is None else row.of(c) for c in seen], sizes[row.along], row.is_text)
