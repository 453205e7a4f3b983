"""Text in any encoding: a table, a log of events, or an export of TwinCAT Scope or DIAdem.

TwinCAT Scope writes lines that describe the channels, then times and values in turn. Channels stand
side by side in groups, each behind a column of its own times in ms. A slower group ends before the
others, or repeats its samples to fill the lines.

DIAdem's ``.dat`` (also KUKA's trace) is a header; its samples are 64-bit floats in a file beside
it. After ``#BEGINCHANNELHEADER`` come lines of code and value: 200 name, 202 unit, 210 ``IMPLICIT``
(a line over the number of the sample) or ``EXPLICIT``, 213 ``BLOCK`` (samples of all channels in
turn) or ``CHANNEL``, 220 samples, 221 where the channel begins, from 1, 240 offset, 241 factor.
KUKA writes German words. Any other ``.dat`` is a table.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from bayesbl.errors import RecordingError, shortened
from bayesbl.recording.array_table import (
    SCALES,
    AnyArray,
    ArrayTable,
    is_number,
    number_in,
    numbered,
)
from bayesbl.recording.channels import TIME
from bayesbl.recording.input_bytes import require_memory, two_of
from bayesbl.recording.text_table import (
    EXPECTED,
    TIMES,
    Layout,
    in_cells,
    in_lines,
    layout_of,
    lines_of,
    middle_of,
    table_of_text,
    with_scales,
)

_BYTE_ORDER_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f]|\xc2[\x80-\x9f]|\xef\xbb\xbf")
_BEGINS_OF_CONTROL = bytes([*range(9), *range(0x0E, 0x20), 0x7F, 0xC2, 0xEF])
_KANA = re.compile("[\u3041-\u30fa]|[\uff66-\uff9d]{2}")
_KANJI = re.compile("(?<![A-Za-z])[\u4e00-\u9fff]+(?![A-Za-z])")
_KANJI_IN_A_WORD = re.compile("[A-Za-z][\u4e00-\u9fff]|[\u4e00-\u9fff][A-Za-z]")
"""Two accented Latin-1 letters in a word may read as a kanji."""

_HEAD_LINES = 400
_LONGEST_LINE = 4_000_000


def read(data: bytes) -> ArrayTable:
    """Read a table, a log of events, or an export of TwinCAT Scope.

    Raises RecordingError if the bytes are not text, or hold no table or no sample. Nothing is
    quoted before lines have proved to be numbers.
    """
    for begin in range(0, len(data), _LONGEST_LINE):
        part = data[begin : begin + _LONGEST_LINE]
        if len(part) == _LONGEST_LINE and b"\n" not in part and b"\r" not in part:
            actual = f"a line of more than {_LONGEST_LINE // 1_000_000} MB"
            raise RecordingError("This is not a CSV file.", found=actual, expected=EXPECTED)
    text, control = _in_utf8(data)
    head = list(islice(lines_of(text), _HEAD_LINES))
    if _is_scope_export("\n".join(head)):
        require_memory(TIMES * len(data), "cells of text")
        return _read_scope_export(list(lines_of(text)))
    channels = in_lines(head) if len(head) < _HEAD_LINES else None
    if channels:
        text, head = "\n".join(channels).encode(), channels[:_HEAD_LINES]
    if (table := in_cells(text, head)) is None:
        layout = layout_of(head, middle_of(text), text.count(b"\n"), is_binary=control > 0)
        table = table_of_text(text, layout, control)
    return replace(table, lines=None) if channels else table


def _in_utf8(data: bytes) -> tuple[bytes, int]:
    """The text in UTF-8 with uniform line ends, and the number of control characters removed."""
    encoding = _encoding(data)
    copies = 3.0 if encoding != "utf-8" else 2.0 if b"\r" in data else 1.0
    require_memory(copies * len(data), "a text and its copy in UTF-8")
    if encoding != "utf-8":
        data = data.decode(encoding, "replace").encode()
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if len(data.translate(None, _BEGINS_OF_CONTROL)) == len(data):
        return data, 0
    return _CONTROL.subn(b"", data)


def _encoding(data: bytes) -> str:
    for mark, name in _BYTE_ORDER_MARKS:
        if data.startswith(mark):
            return name
    start = data[:1000]
    for first, name in ((1, "utf-16-le"), (0, "utf-16-be")):  # ASCII in two bytes, without a mark
        if len(start) > 30 and start[first::2].count(0) > 0.9 * len(start[first::2]):
            return name
    for name in ("utf-8", "cp932"):
        try:
            decoder = codecs.getincrementaldecoder(name)()
            for begin in range(0, len(data), 1 << 20):
                decoder.decode(data[begin : begin + (1 << 20)])
            decoder.decode(b"", True)
        except UnicodeDecodeError:
            continue
        if name == "utf-8":
            return name
        text = data[:100_000].decode(name, "replace")
        japanese = _KANA.search(text) or (_KANJI.search(text) and not _KANJI_IN_A_WORD.search(text))
        if japanese:
            return name
    return "latin-1"  # of which any byte is a character


_SEPARATORS = "\t;,"
_SCOPE_BEGIN = re.compile(rf"Name[{_SEPARATORS}]")
_SCOPE_LINE = re.compile(
    rf"^(?:Starttime of export|Data-Type|SampleTime(?:\[ms\])?|SymbolName)[{_SEPARATORS}]", re.M
)
_LONGEST_HEADER = 500  # lines in which the first sample is sought; comments may take several
_FILETIME = 1e15  # A larger time is a Windows date in units of 100 ns, not a count of ms


def _is_scope_export(text: str) -> bool:
    """Whether a text begins like an export of TwinCAT Scope."""
    return bool(_SCOPE_BEGIN.match(text)) and bool(_SCOPE_LINE.search(text[:100_000]))


def _read_scope_export(lines: Sequence[str]) -> ArrayTable:
    """All channels; units only where no scale makes them ambiguous.

    Raises RecordingError if there are no channels with times, or text among the times.
    """

    separator = lines[0][4]
    head = [[cell.strip() for cell in line.split(separator)] for line in lines[:_LONGEST_HEADER]]
    above = next((i for i, cells in enumerate(head) if is_number(cells[0])), len(head))
    known = {cells[0]: cells for cells in head[:above]}  # the later "Name" is the channels'
    starts = [i for i, cell in enumerate(known["Name"]) if cell == "Name"]
    width = len(known["Name"])
    if width < 2 or not any(b - a > 1 for a, b in zip(starts, [*starts[1:], width], strict=True)):
        raise RecordingError(
            "This export of TwinCAT Scope has no channels.",
            where=f"line {above}",
            found=shortened(", ".join(known["Name"])),
            expected="a line of channels' names with a column of times before each group",
        )
    body = [*[""] * above, *_padded_lines(lines[above:], separator, width)]
    first = number_in(body[above].partition(separator)[0], ".") if len(body) > above else None
    time = "100 ns" if first is not None and first >= _FILETIME else "ms"
    names = numbered([TIME if i in starts else name for i, name in enumerate(known["Name"])])
    units = [time if i in starts else _scope_unit(known, i) for i in range(width)]
    layout = Layout(separator, tuple(names), units=tuple(units))
    return table_of_text("\n".join(body).encode(), layout)


def _padded_lines(lines: Sequence[str], separator: str, width: int) -> Iterator[str]:
    """Lines of samples with a decimal point and one cell for each column."""
    for line in lines:
        if line.strip("\r\n ") == "EOF":
            break
        cells = (line if separator == "," else line.replace(",", ".")).split(separator)
        yield separator.join([*cells[:width], *[""] * (width - len(cells))])


def _scope_unit(known: Mapping[str, Sequence[str]], column: int) -> str:
    """``rad/s`` from ``rad/s (Velocity)``, with the scales that may have been applied or not."""
    cells = {key: row[column] for key, row in known.items() if column < len(row)}
    unit = cells.get("Unit", "").partition("(")[0].strip()
    return with_scales(
        unit, [text for key, text in cells.items() if re.search(SCALES, key.lower())]
    )


_DIADEM_CHANNEL = b"#BEGINCHANNELHEADER"


def read_diadem(data: bytes) -> ArrayTable:
    """Channels of a header and of the samples beside it. RecordingError if some are missing."""
    header, samples = two_of(data)
    if _DIADEM_CHANNEL not in header:
        return read(header)
    channels = [_diadem_values(part) for part in header.split(_DIADEM_CHANNEL)[1:]]
    are_stored = [not c.get(210, "").upper().startswith("IMPL") for c in channels]
    stored = sum(are_stored)
    count = max((int(float(c.get(220, 0))) for c in channels), default=0)
    values = np.frombuffer(samples, "<f8", count=len(samples) // 8)
    if count < 1 or not stored or values.size < count * stored:
        raise RecordingError(
            "The file has fewer samples than its header states.",
            found=f"{values.size} numbers in the .r64 file beside it",
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
    return ArrayTable(arrays, units)


def _diadem_values(part: bytes) -> dict[int, str]:
    """Code to value of a channel's lines."""
    lines = (line.partition(",") for line in part.decode("cp1252", "replace").splitlines())
    return {int(code): value.strip() for code, _, value in lines if code.strip().isdigit()}
