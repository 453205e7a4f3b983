"""DIAdem's ``.dat`` with its samples in a file of 64-bit floats beside it: KUKA's trace.

The header is text: ``#BEGINCHANNELHEADER`` and then lines of code and value: 200 name, 202 unit,
210 ``IMPLICIT`` (a line over the number of the sample) or ``EXPLICIT``, 213 ``BLOCK`` (samples of
all channels in turn) or ``CHANNEL``, 220 samples, 221 where the channel begins, from 1, 240 offset,
241 factor. KUKA writes German words. Any other text is a table.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayesbl.errors import RecordingError
from bayesbl.recording.array_table import AnyArray, ArrayTable, numbered
from bayesbl.recording.formats import csv
from bayesbl.recording.input_bytes import two_of

_BEGIN = b"#BEGINCHANNELHEADER"


def read(file: Path, data: bytes) -> ArrayTable:
    """Channels of a header and the samples of the file beside it.

    Raises
    ------
    RecordingError
        If the samples are missing, or fewer than the header says.
    """
    header, samples = two_of(data)
    if _BEGIN not in header:
        return csv.read(file, header)
    channels = [_values(part) for part in header.split(_BEGIN)[1:]]
    are_stored = [not c.get(210, "").upper().startswith("IMPL") for c in channels]
    stored = sum(are_stored)
    count = max((int(float(c.get(220, 0))) for c in channels), default=0)
    values = np.frombuffer(samples, "<f8", count=len(samples) // 8)
    if count < 1 or not stored or values.size < count * stored:
        raise RecordingError(
            "The samples of this header are not all there.",
            file=file,
            found=f"{values.size} numbers in {file.stem}.r64 beside it",
            expected=f"{stored} channels of {count} samples, 64-bit floats",
        )
    interleaved = values[: count * stored].reshape(count, stored)
    arrays: dict[str, AnyArray] = {}
    units: dict[str, str] = {}
    names = numbered([c.get(200, "") for c in channels])
    place = 0
    for name, channel, is_stored in zip(names, channels, are_stored, strict=True):
        offset, factor = float(channel.get(240) or 0.0), float(channel.get(241) or 1.0)
        if not is_stored:
            raw = np.arange(count, dtype=float)
        elif channel.get(213, "").upper().startswith(("CHANNEL", "KANAL")):
            begin = int(float(channel.get(221) or 1)) - 1
            raw = values[begin : begin + count]
        else:
            raw = interleaved[:, place]
        place += is_stored
        arrays[name] = offset + factor * raw
        if channel.get(202, "").strip("[] "):
            units[name] = channel[202].strip("[] ")
    return ArrayTable(str(file), arrays, units)


def _values(part: bytes) -> dict[int, str]:
    """Code to value of a channel's lines."""
    lines = (line.partition(",") for line in part.decode("cp1252", "replace").splitlines())
    return {int(code): value.strip() for code, _, value in lines if code.strip().isdigit()}
