"""MDF files (version 3 and 4) as a table; each group of channels has its own master, the time."""

from __future__ import annotations

import gc
import io
from pathlib import Path
from traceback import clear_frames
from typing import TYPE_CHECKING, Any

from bayesbl.recording.formats import Format

if TYPE_CHECKING:
    from bayesbl.recording.array_table import ArrayTable
    from bayesbl.recording.clocked_columns import Group


def read_mdf(file: Path, data: bytes) -> ArrayTable:
    """Every channel of one dimension, in the units after its conversion.

    Raises
    ------
    RecordingError
        If it is no MDF file, or asammdf is not installed.
    """
    from bayesbl.recording.array_table import missing_library, readable
    from bayesbl.recording.clocked_columns import table_of_groups

    try:
        import asammdf
    except ImportError:
        raise missing_library(file, "MDF", "asammdf") from None
    with readable(file, "MDF"), _opened(asammdf.MDF, data) as stored:
        groups = [_group(stored, number) for number in range(len(stored.groups))]
        return table_of_groups(file, groups)


def _opened(mdf: Any, data: bytes) -> Any:
    try:
        return mdf(io.BytesIO(data))
    except Exception as error:
        # What is left half made complains when it ends: here, where nobody hears it.
        clear_frames(error.__traceback__)
        gc.collect()
        raise


def _group(stored: Any, number: int) -> Group:
    from bayesbl.recording.clocked_columns import Group

    master = stored.masters_db.get(number)
    signals = [
        stored.get(group=number, index=index)
        for index in range(len(stored.groups[number].channels))
        if index != master
    ]
    flat = [signal for signal in signals if signal.samples.ndim == 1]
    name = getattr(stored.groups[number].channel_group, "acq_name", "") or f"group {number + 1}"
    return Group(
        name,
        {signal.name: signal.samples for signal in flat},
        flat[0].timestamps if flat and master is not None else None,
        {signal.name: signal.unit for signal in flat if signal.unit},
    )


FORMAT = Format("MDF", (".mf4", ".mdf"), read_mdf)
