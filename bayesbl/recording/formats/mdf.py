"""MDF files (version 3 and 4) as a table; each group of channels has its own master, the time."""

from __future__ import annotations

import gc
import io
import re
from pathlib import Path
from traceback import clear_frames
from typing import TYPE_CHECKING, Any

from bayesbl.recording.formats import Format

if TYPE_CHECKING:
    from bayesbl.recording.array_table import ArrayTable
    from bayesbl.recording.clocked_columns import Group

_PLAIN_4 = (0, 1, 2, 4, 5, 6)
"""Conversions of MDF 4: none, linear, rational, and tables from number to number."""

_PLAIN_3 = (65535, 0, 1, 2, 6, 7, 8, 9)
"""Conversions of MDF 3: none, linear, tables, polynomial, exponential, logarithm, rational."""

_IN_MEMORY = re.compile("[\"']?<_io.BytesIO[^>]*>[\"']?")
"""What asammdf calls a file by that it was given in memory."""


def read_mdf(file: Path, data: bytes) -> ArrayTable:
    """Every channel of one dimension, in the units after its conversion; none with a formula.

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


def _is_plain(conversion: Any) -> bool:
    """Whether a conversion is arithmetic or a table of numbers.

    A formula is text that would be run, and any other gives text.
    """
    if conversion is None:
        return True
    plain = _PLAIN_4 if conversion.id == b"##CC" else _PLAIN_3
    return conversion.conversion_type in plain


def _opened(mdf: Any, data: bytes) -> Any:
    try:
        return mdf(io.BytesIO(data))
    except Exception as error:
        # What is left half made complains when it ends: here, where nobody hears it.
        clear_frames(error.__traceback__)
        gc.collect()
        raise ValueError(_IN_MEMORY.sub("it", str(error))) from None


def _group(stored: Any, number: int) -> Group:
    from bayesbl.recording.clocked_columns import Group

    master = stored.masters_db.get(number)
    signals = [
        stored.get(group=number, index=index)
        for index, channel in enumerate(stored.groups[number].channels)
        if index != master and _is_plain(channel.conversion)
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
