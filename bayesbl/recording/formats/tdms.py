"""TDMS files of LabVIEW as a table; a waveform's own increment is its clock."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesbl.recording.formats import Format

if TYPE_CHECKING:
    from bayesbl.recording.array_table import ArrayTable
    from bayesbl.recording.clocked_columns import Group

_UNITS = ("unit_string", "NI_UnitDescription")


def read_tdms(file: Path, data: bytes) -> ArrayTable:
    """Every channel; ``GROUP/NAME`` where two groups have one of the same name.

    Raises
    ------
    RecordingError
        If it is no TDMS file, or npTDMS is not installed.
    """
    from bayesbl.recording.array_table import missing_library, readable
    from bayesbl.recording.clocked_columns import table_of_groups

    try:
        import nptdms
    except ImportError:
        raise missing_library(file, "TDMS", "npTDMS") from None
    with readable(file, "TDMS"):
        stored = nptdms.TdmsFile.read(io.BytesIO(data))
        return table_of_groups(file, [_group(group) for group in stored.groups()])


def _group(group: Any) -> Group:
    """Channels of a group; with a clock if all that state an increment state the same."""
    import numpy as np

    from bayesbl.recording.clocked_columns import Group

    channels = {str(channel.name): channel for channel in group.channels()}
    columns = {name: np.asarray(channel[:]) for name, channel in channels.items()}
    clocks = {
        (
            float(channel.properties.get("wf_start_offset", 0.0)),
            float(channel.properties["wf_increment"]),
            columns[name].size,
        )
        for name, channel in channels.items()
        if "wf_increment" in channel.properties
    }
    time = None
    if len(clocks) == 1:
        ((offset_s, increment_s, count),) = clocks
        time = offset_s + increment_s * np.arange(count)
    units = {
        name: str(channel.properties[key])
        for name, channel in channels.items()
        for key in _UNITS
        if key in channel.properties
    }
    return Group(str(group.name), columns, time, units)


FORMAT = Format("TDMS", (".tdms",), read_tdms)
