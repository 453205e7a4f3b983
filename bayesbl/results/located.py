"""What a simulation leaves, as a dataset: what figures and later readers need of it."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayesbl.diagnosis.residuals.attribution import Line
from bayesbl.diagnosis.residuals.decomposition import MAP_POINTS
from bayesbl.diagnosis.residuals.locate import ChannelLeft, Located
from bayesbl.diagnosis.residuals.unexplained import describe_unexplained
from bayesbl.recording.types import CHANNELS, FloatArray
from bayesbl.results.tree import dataset
from bayesbl.units import unit_of

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_NUMBERS: tuple[tuple[str, str, str, Callable[[ChannelLeft], float]], ...] = (
    ("offset", "{unit}", "mean of recording less simulation", lambda c: c.offset),
    ("offset_error", "{unit}", "standard error of that mean", lambda c: c.offset_error),
    (
        "offset_significant",
        "1",
        "1 where noise does not explain that mean",
        lambda c: float(c.offset_significant),
    ),
    (
        "repeating_rms",
        "{unit}",
        "RMS of what repeats with the load angle",
        lambda c: c.repeating_rms,
    ),
    (
        "repeating_probability",
        "1",
        "probability that noise alone repeats as much",
        lambda c: c.repeating_probability,
    ),
    ("noise_sd", "{unit}", "standard deviation of the noise", lambda c: c.noise_sd),
    ("drift", "{unit}/s", "slope over the recording", lambda c: c.drift_per_s),
    ("drift_error", "{unit}/s", "standard error of that slope", lambda c: c.drift_error_per_s),
    ("lag_s", "s", "time by which the recording lags the simulation", lambda c: c.skew.lag_s),
    ("lag_error_s", "s", "standard error of that time", lambda c: c.skew.standard_error_s),
    (
        "lag_explains",
        "1",
        "share of what is left beyond noise that the lag explains",
        lambda c: c.skew.explained,
    ),
    ("outliers", "1", "samples that no noise explains", lambda c: float(c.outliers)),
    (
        "map_error",
        "{unit}",
        "standard error of averages over rotations",
        lambda c: c.load_map_error,
    ),
    ("power_offset", "({unit})²", "mean square of the offset", lambda c: c.split.offset),
    (
        "power_load_angle",
        "({unit})²",
        "mean square of what repeats with the load angle",
        lambda c: c.split.load_angle,
    ),
    ("power_other", "({unit})²", "mean square of lines and drift", lambda c: c.split.other),
    ("power_noise", "({unit})²", "mean square of the noise", lambda c: c.split.noise),
)

_MAPS: tuple[tuple[str, str, Callable[[ChannelLeft], FloatArray]], ...] = (
    ("recorded", "recording, mean over rotations", lambda c: c.recorded),
    ("simulated", "simulation, mean over rotations", lambda c: c.simulated),
    ("load_map", "what is left and repeats with the load angle", lambda c: c.load_map),
)

_SPECTRA: tuple[tuple[str, str, Callable[[ChannelLeft], FloatArray]], ...] = (
    ("amplitude", "amplitude of what is left", lambda c: c.spectrum.amplitude),
    (
        "noise_amplitude",
        "root mean square amplitude of noise alone",
        lambda c: c.spectrum.noise_amplitude,
    ),
)

_LINES: tuple[tuple[str, str, str, Callable[[Line], float]], ...] = (
    ("frequency_hz", "Hz", "frequency", lambda x: x.frequency_hz),
    ("load_order", "1", "cycles per turn of the load", lambda x: x.load_order),
    ("motor_order", "1", "cycles per turn of the motor", lambda x: x.motor_order),
    ("amplitude", "{unit}", "amplitude", lambda x: x.amplitude),
    ("phase_rad", "rad", "phase of a cosine at the first sample", lambda x: x.phase_rad),
    ("probability", "1", "probability of as much from noise alone", lambda x: x.probability),
)


def located_dataset(located: Located) -> xr.Dataset:
    """All that is left.

    Variables begin with their channel's name. Dimensions: ``recording``, ``load_angle_rad`` (720),
    ``bin`` of the spectra and ``line`` of the significant lines, strongest first; shorter ones are
    padded with NaN, missing channels filled with it. Attributes
    ``unexplained`` and ``offsets`` hold, as JSON, what is significant over all recordings and how
    offsets depend on direction and speed.
    """
    recordings = located.recordings
    names = list(dict.fromkeys(c.channel for r in recordings for c in r.channels))
    variables: dict[str, tuple[tuple[str, ...], FloatArray, str, str]] = {
        "reference_speed_rpm": (
            ("recording",),
            np.array([r.whole.reference_speed_rpm for r in recordings]),
            "rpm",
            "reference speed of the motor",
        ),
        "rotations": (
            ("recording",),
            np.array([float(r.whole.rotations) for r in recordings]),
            "1",
            "load rotations looked at",
        ),
        "gear_ratio": (
            ("recording",),
            np.array([r.whole.gear_ratio for r in recordings]),
            "1",
            "motor turns in a turn of the load",
        ),
        "frequency_hz": (
            ("recording", "bin"),
            _padded([r.whole.frequency_hz for r in recordings]),
            "Hz",
            "frequency",
        ),
        "load_order": (
            ("recording", "bin"),
            _padded([r.whole.frequency_hz / r.whole.rotation_hz for r in recordings]),
            "1",
            "cycles per turn of the load",
        ),
    }
    dependences = {}
    most = max(len(c.lines) for r in recordings for c in r.channels)
    for name in names:
        seen = [next((c for c in r.channels if c.channel == name), None) for r in recordings]
        variables |= _of_channel(name, seen)
        dependences[f"{name}_line_dependence"] = (
            ("recording", "line"),
            _words(seen, most),
            {"long_name": f"{CHANNELS.get(name, name)}: what each line repeats with"},
        )
    coordinates = {
        "recording": [r.name for r in recordings],
        "load_angle_rad": (
            "load_angle_rad",
            2.0 * np.pi * np.arange(MAP_POINTS) / MAP_POINTS,
            {"units": "rad", "long_name": "load angle"},
        ),
    }
    made = dataset(
        {k: (d, _widened(d, v, most), u, n) for k, (d, v, u, n) in variables.items()}, coordinates
    )
    made = made.assign(dependences)
    made.attrs = {
        "channels": names,
        "false_discovery_rate": located.false_discovery_rate,
        "unexplained": _json(describe_unexplained(located)),
        "offsets": _json(located.offsets),
    }
    return made


def plain(entry: DataclassInstance) -> dict[str, Any]:
    """An entry as JSON can hold it, which knows no NaN."""
    return {
        key: None if isinstance(value, float) and math.isnan(value) else value
        for key, value in asdict(entry).items()
    }


def _json(entries: Sequence[DataclassInstance]) -> str:
    return json.dumps([plain(entry) for entry in entries], ensure_ascii=False)


def _of_channel(
    name: str, seen: Sequence[ChannelLeft | None]
) -> dict[str, tuple[tuple[str, ...], FloatArray, str, str]]:
    unit, said = unit_of(name), CHANNELS.get(name, name)
    nothing = np.full(1, np.nan)
    variables: dict[str, tuple[tuple[str, ...], FloatArray, str, str]] = {}
    for key, units, text, number in _NUMBERS:
        values = np.array([np.nan if c is None else number(c) for c in seen])
        variables[f"{name}_{key}"] = (
            ("recording",),
            values,
            units.format(unit=unit),
            f"{said}: {text}",
        )
    for dimension, table in (("load_angle_rad", _MAPS), ("bin", _SPECTRA)):
        for key, text, curve in table:
            rows = [np.full(MAP_POINTS, np.nan) if c is None else curve(c) for c in seen]
            variables[f"{name}_{key}"] = (
                ("recording", dimension),
                _padded(rows),
                unit,
                f"{said}: {text}",
            )
    for key, units, text, of_line in _LINES:
        rows = [nothing if c is None else np.array([of_line(x) for x in c.lines]) for c in seen]
        variables[f"{name}_line_{key}"] = (
            ("recording", "line"),
            _padded(rows),
            units.format(unit=unit),
            f"{said}: {text} of a significant line",
        )
    return variables


def _padded(rows: Sequence[FloatArray]) -> FloatArray:
    out = np.full((len(rows), max(row.size for row in rows)), np.nan)
    for i, row in enumerate(rows):
        out[i, : row.size] = row
    return out


def _widened(dimensions: tuple[str, ...], values: FloatArray, lines: int) -> FloatArray:
    """Lines of every channel padded to the same number."""
    if "line" not in dimensions:
        return values
    kept = values[:, :lines]
    return np.pad(kept, ((0, 0), (0, lines - kept.shape[1])), constant_values=np.nan)


def _words(seen: Sequence[ChannelLeft | None], lines: int) -> NDArray[np.str_]:
    out = np.full((len(seen), lines), "", dtype="U16")
    for i, channel in enumerate(seen):
        for j, line in enumerate(channel.lines if channel else ()):
            out[i, j] = line.dependence
    return out
