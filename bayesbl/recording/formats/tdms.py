"""TDMS files of LabVIEW; the increment of a waveform is its clock."""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import Any

import nptdms
import numpy as np

from bayesbl.recording.array_table import ArrayTable, Group, table_of_groups
from bayesbl.recording.channels import TIME
from bayesbl.units import conversion_factor, is_accepted, spelled

_CLOCK = ("wf_start_time", "wf_start_offset", "wf_increment", "wf_xunit_string")


def read(data: bytes) -> ArrayTable:
    """Every channel; ``GROUP/NAME`` if two groups have the same name."""
    stored = nptdms.TdmsFile.read(io.BytesIO(data))
    channels = [channel for group in stored.groups() for channel in group.channels()]
    starts = [c.properties.get("wf_start_time") for c in channels if "wf_increment" in c.properties]
    dated = all(isinstance(start, np.datetime64) for start in starts)
    first = min(starts) if dated and starts else None
    groups = [part for group in stored.groups() for part in _groups(group, first)]
    return table_of_groups(groups, one_origin=first is not None)


def _groups(group: Any, first: np.datetime64 | None) -> Iterator[Group]:
    """Channels of a group that share a clock: waveforms with the same start, rate and unit of time.

    Channels without an increment use the only clock, if there is just one. ``first``: the earliest
    start of all waveforms, if all are dated.
    """
    channels = {str(channel.name): channel for channel in group.channels()}
    columns = {name: np.asarray(channel[:]) for name, channel in channels.items()}
    clocks = {
        name: (*(channel.properties.get(key) for key in _CLOCK), columns[name].size)
        for name, channel in channels.items()
        if "wf_increment" in channel.properties
    }
    kinds: list[Any] = list(dict.fromkeys(clocks.values()))
    if len(kinds) == 1:
        clocks = dict.fromkeys(columns, kinds[0])
    for clock in [*kinds, None]:
        held = {name: columns[name] for name in columns if clocks.get(name) == clock}
        if not held:
            continue
        time, about = None, {name: channels[name].properties for name in held}
        stated = {
            n: str(a.get("NI_UnitDescription", a.get("unit_string", ""))) for n, a in about.items()
        }
        if clock is not None:
            start, offset, step, of_steps, size = clock
            unit = spelled(str(of_steps or "s"))
            is_time = is_accepted(TIME, unit)
            stated[TIME] = "s" if is_time else unit
            unit_s = conversion_factor(TIME, unit) if is_time else 1.0
            late_s = 0.0 if first is None else (start - first) / np.timedelta64(1, "s")
            time = late_s + unit_s * (float(offset or 0.0) + float(step) * np.arange(size))
        yield Group(str(group.name), held, time, stated)
