"""The analysis of residuals as a group of ``result.nc``.

Variables begin with their channel's name. Dimensions: ``recording``, ``load_angle_rad`` (720),
``bin`` of the spectra and ``line`` of the significant lines, strongest first; shorter ones are
padded with NaN, missing channels filled with it. The attribute ``unexplained`` holds, as JSON, what
is significant over all recordings.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import xarray as xr

from bayesbl.diagnosis.residuals import FALSE_LINES, MAP_POINTS, ChannelResiduals, ResidualAnalysis
from bayesbl.diagnosis.summary import plain
from bayesbl.recording.types import CHANNELS
from bayesbl.results.variables import Group, Variable, dataset, labels, padded, table
from bayesbl.units import unit_of


def _of_channel(channel: str) -> tuple[Variable, ...]:
    """Named as attributes of its :class:`ChannelResiduals`; behind ``line_``, of a line."""
    unit, name = unit_of(channel), CHANNELS[channel]
    return table(f"""
        {channel}_offset (recording) | {unit} | {name}: mean of recording less simulation
        {channel}_repeating_rms (recording) | {unit} | {name}: RMS that repeats with the load angle
        {channel}_noise_sd (recording) | {unit} | {name}: standard deviation of the noise
        {channel}_drift_per_s (recording) | {unit}/s | {name}: slope over the recording
        {channel}_outliers (recording) | 1 | {name}: samples that no noise explains
        {channel}_map_error (recording) | {unit} | {name}: standard error of rotation averages
        {channel}_load_map (recording, load_angle_rad) | {unit} | {name}: residual that repeats
        {channel}_amplitude (recording, bin) | {unit} | {name}: amplitude of the residual
        {channel}_noise_amplitude (recording, bin) | {unit} | {name}: RMS amplitude of noise
        {channel}_line_frequency_hz (recording, line) | Hz | {name}: frequency of a line
        {channel}_line_load_order (recording, line) | 1 | {name}: cycles of it per turn of the load
        {channel}_line_motor_order (recording, line) | 1 | {name}: the same of the motor
        {channel}_line_amplitude (recording, line) | {unit} | {name}: its amplitude
        {channel}_line_phase_rad (recording, line) | rad | {name}: of a cosine at the first sample
        {channel}_line_dependence (recording, line) | text | {name}: what it repeats with
    """)


def _named(name: str) -> Variable | None:
    """A variable of any channel."""
    of_any = (v for channel in CHANNELS if name.startswith(channel) for v in _of_channel(channel))
    return next((variable for variable in of_any if variable.name == name), None)


def residuals_group(stage: str) -> Group:
    """Of the bench as believed (``before``), or with what was named (``after``)."""
    return Group(
        f"residuals_{stage}",
        table("load_order (recording, bin) | 1 | cycles per turn of the load"),
        (
            labels("recording", "recording"),
            *table("load_angle_rad (load_angle_rad) | rad | load angle"),
        ),
        _named,
        optional=True,
    )


def residuals_dataset(analysis: ResidualAnalysis, stage: str) -> xr.Dataset:
    """All that an analysis holds, as this module's text describes it."""
    recordings = analysis.recordings
    names = list(dict.fromkeys(c.channel for r in recordings for c in r.channels))
    orders = [r.whole.load_order for r in recordings]
    sizes = {
        "line": max(len(c.lines) for r in recordings for c in r.channels),
        "bin": max(order.size for order in orders),
        "load_angle_rad": MAP_POINTS,
    }
    values: dict[str, object] = {"load_order": padded(orders, sizes["bin"])}
    for name in names:
        seen = [next((c for c in r.channels if c.channel == name), None) for r in recordings]
        for variable in _of_channel(name):
            attribute = variable.name.removeprefix(f"{name}_")
            own: Any = [np.nan if c is None else _value(c, attribute) for c in seen]
            if len(variable.dims) == 2:
                own = [[] if c is None else x for c, x in zip(seen, own, strict=True)]
                own = padded(own, sizes[variable.dims[1]], variable.kind == "text")
            values[variable.name] = own
    angles = 2.0 * np.pi * np.arange(MAP_POINTS) / MAP_POINTS
    coordinates = {"recording": [r.name for r in recordings], "load_angle_rad": angles}
    made = dataset(residuals_group(stage), values, coordinates)
    made.attrs = {
        "channels": names,
        "false_discovery_rate": FALSE_LINES,
        "unexplained": json.dumps(plain(analysis.remaining), ensure_ascii=False),
    }
    return made


def _value(residuals: ChannelResiduals, attribute: str) -> Any:
    of_line = attribute.removeprefix("line_")
    if of_line != attribute:
        return [getattr(line, of_line) for line in residuals.lines]
    return getattr(residuals, attribute)
