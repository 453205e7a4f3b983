"""The analysis of residuals as a group of ``result.nc``.

Variables begin with their channel's name. Dimensions: ``recording``, ``load_angle_rad`` (720),
``bin`` of the spectra and ``line`` of the significant lines, strongest first; shorter ones are
padded with NaN, missing channels filled with it. The attributes ``unexplained`` and ``offsets``
hold, as JSON, what is significant over all recordings and how offsets depend on direction and
speed.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayesbl.diagnosis.residuals.analysis import ChannelResiduals, ResidualAnalysis
from bayesbl.diagnosis.residuals.decomposition import MAP_POINTS
from bayesbl.diagnosis.residuals.unexplained import describe_unexplained
from bayesbl.diagnosis.summary import plain
from bayesbl.recording.types import CHANNELS
from bayesbl.results.variables import Group, Variable, dataset, labels
from bayesbl.units import unit_of

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_ANGLE = "load_angle_rad"


@dataclass(frozen=True, slots=True)
class _OfChannel:
    """A variable of every channel.

    ``dims`` after the recording; ``{unit}`` in ``unit`` is the channel's; ``of`` gives a number,
    or an array over the other dimension.
    """

    name: str
    dims: tuple[str, ...]
    unit: str
    meaning: str
    of: Callable[[ChannelResiduals], object]
    kind: Literal["number", "text"] = "number"

    def declared(self, channel: str) -> Variable:
        """The variable of one channel."""
        return Variable(
            f"{channel}_{self.name}",
            ("recording", *self.dims),
            self.unit.format(unit=unit_of(channel)),
            f"{CHANNELS.get(channel, channel)}: {self.meaning}",
            self.kind,
        )


def _of_lines(
    name: str, unit: str, meaning: str, kind: Literal["number", "text"] = "number"
) -> _OfChannel:
    """What every significant line has under this name."""
    return _OfChannel(
        f"line_{name}",
        ("line",),
        unit,
        f"{meaning} of a significant line",
        lambda c: [getattr(line, name) for line in c.lines],
        kind,
    )


_VARIABLES = (
    _OfChannel("offset", (), "{unit}", "mean of recording less simulation", lambda c: c.offset),
    _OfChannel(
        "offset_error", (), "{unit}", "standard error of that mean", lambda c: c.offset_error
    ),
    _OfChannel(
        "offset_significant",
        (),
        "1",
        "1 where noise does not explain that mean",
        lambda c: c.offset_significant,
    ),
    _OfChannel(
        "repeating_rms",
        (),
        "{unit}",
        "RMS of what repeats with the load angle",
        lambda c: c.repeating_rms,
    ),
    _OfChannel(
        "repeating_probability",
        (),
        "1",
        "probability that noise alone repeats as much",
        lambda c: c.repeating_probability,
    ),
    _OfChannel("noise_sd", (), "{unit}", "standard deviation of the noise", lambda c: c.noise_sd),
    _OfChannel("drift", (), "{unit}/s", "slope over the recording", lambda c: c.drift_per_s),
    _OfChannel(
        "drift_error", (), "{unit}/s", "standard error of that slope", lambda c: c.drift_error_per_s
    ),
    _OfChannel(
        "lag_s", (), "s", "time by which the recording lags the simulation", lambda c: c.skew.lag_s
    ),
    _OfChannel(
        "lag_error_s", (), "s", "standard error of that time", lambda c: c.skew.standard_error_s
    ),
    _OfChannel(
        "lag_explains",
        (),
        "1",
        "share of the residual beyond noise that the lag explains",
        lambda c: c.skew.explained,
    ),
    _OfChannel("outliers", (), "1", "samples that no noise explains", lambda c: c.outliers),
    _OfChannel(
        "map_error",
        (),
        "{unit}",
        "standard error of averages over rotations",
        lambda c: c.load_map_error,
    ),
    _OfChannel(
        "power_offset", (), "({unit})²", "mean square of the offset", lambda c: c.split.offset
    ),
    _OfChannel(
        "power_load_angle",
        (),
        "({unit})²",
        "mean square of what repeats with the load angle",
        lambda c: c.split.load_angle,
    ),
    _OfChannel(
        "power_other", (), "({unit})²", "mean square of lines and drift", lambda c: c.split.other
    ),
    _OfChannel("power_noise", (), "({unit})²", "mean square of the noise", lambda c: c.split.noise),
    _OfChannel(
        "recorded", (_ANGLE,), "{unit}", "recording, mean over rotations", lambda c: c.recorded
    ),
    _OfChannel(
        "simulated", (_ANGLE,), "{unit}", "simulation, mean over rotations", lambda c: c.simulated
    ),
    _OfChannel(
        "load_map",
        (_ANGLE,),
        "{unit}",
        "residual that repeats with the load angle",
        lambda c: c.load_map,
    ),
    _OfChannel(
        "amplitude", ("bin",), "{unit}", "amplitude of the residual", lambda c: c.spectrum.amplitude
    ),
    _OfChannel(
        "noise_amplitude",
        ("bin",),
        "{unit}",
        "root mean square amplitude of noise alone",
        lambda c: c.spectrum.noise_amplitude,
    ),
    _of_lines("frequency_hz", "Hz", "frequency"),
    _of_lines("load_order", "1", "cycles per turn of the load"),
    _of_lines("motor_order", "1", "cycles per turn of the motor"),
    _of_lines("amplitude", "{unit}", "amplitude"),
    _of_lines("phase_rad", "rad", "phase of a cosine at the first sample"),
    _of_lines("probability", "1", "probability, from noise alone,"),
    _of_lines("dependence", "", "what the angle or time is", "text"),
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
        (
            Variable("reference_speed_rpm", ("recording",), "rpm", "reference speed of the motor"),
            Variable("rotations", ("recording",), "1", "load rotations looked at"),
            Variable("gear_ratio", ("recording",), "1", "motor turns in a turn of the load"),
            Variable("frequency_hz", ("recording", "bin"), "Hz", "frequency"),
            Variable("load_order", ("recording", "bin"), "1", "cycles per turn of the load"),
        ),
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
        "frequency_hz": _table([w.frequency_hz for w in whole], sizes["bin"]),
        "load_order": _table([w.frequency_hz / w.rotation_hz for w in whole], sizes["bin"]),
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
        "false_discovery_rate": analysis.false_discovery_rate,
        "unexplained": _json(describe_unexplained(analysis)),
        "offsets": _json(analysis.offsets),
    }
    return made


def _of_recordings(
    row: _OfChannel, seen: Sequence[ChannelResiduals | None], sizes: dict[str, int]
) -> object:
    if not row.dims:
        return np.array([np.nan if c is None else row.of(c) for c in seen], dtype=float)
    rows = [[] if c is None else row.of(c) for c in seen]
    return _table(rows, sizes[row.dims[0]], row.kind == "text")


def _table(rows: Sequence[object], width: int, text: bool = False) -> NDArray[np.generic]:
    """Rows of different lengths, padded with NaN or empty text, shape (recordings, width)."""
    out = np.full((len(rows), width), "" if text else np.nan, dtype="U16" if text else float)
    for place, row in zip(out, map(np.asarray, rows), strict=True):
        place[: row.size] = row
    return out


def _json(entries: Sequence[DataclassInstance]) -> str:
    return json.dumps([plain(entry) for entry in entries], ensure_ascii=False)
