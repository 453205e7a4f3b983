"""Text in any encoding: a table, a log of events, or an export of TwinCAT Scope."""

from __future__ import annotations

import codecs
import re
from itertools import islice
from pathlib import Path

from bayesbl.errors import RecordingError
from bayesbl.recording.array_table import ArrayTable
from bayesbl.recording.formats.scope_export import is_scope_export, read_scope_export
from bayesbl.recording.input_bytes import require_memory
from bayesbl.recording.text_table import (
    EXPECTED,
    TIMES,
    in_cells,
    in_columns,
    layout_of,
    lines_of,
    middle_of,
    table_of_text,
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
"""An accented letter of Latin-1 and the one after it may read as a kanji within a word."""

_HEAD_LINES = 400
_LONGEST_LINE = 4_000_000


def read(file: Path, data: bytes) -> ArrayTable:
    """Find the table in a text, or read an export of TwinCAT Scope or a log of events.

    Raises
    ------
    RecordingError
        If it is not text, or holds no table or no sample. Nothing of it is quoted before its lines
        have proved to be numbers.
    """
    for begin in range(0, len(data), _LONGEST_LINE):
        part = data[begin : begin + _LONGEST_LINE]
        if len(part) == _LONGEST_LINE and b"\n" not in part and b"\r" not in part:
            actual = f"a line of more than {_LONGEST_LINE // 1_000_000} MB"
            raise RecordingError(
                "This is not a CSV file.", file=file, found=actual, expected=EXPECTED
            )
    text, control = _in_utf8(file, data)
    head = list(islice(lines_of(text), _HEAD_LINES))
    if is_scope_export("\n".join(head)):
        require_memory(file, TIMES * len(data), "cells of text")
        return read_scope_export(file, list(lines_of(text)))
    if (table := in_cells(file, text, head)) is None:
        layout = layout_of(file, head, middle_of(text), text.count(b"\n"), is_binary=control > 0)
        table = table_of_text(file, text, layout, control)
    return in_columns(table)


def _in_utf8(file: Path, data: bytes) -> tuple[bytes, int]:
    """A text in UTF-8, its lines ended alike, and how many control characters it is now without."""
    encoding = _encoding(data)
    copies = 3.0 if encoding != "utf-8" else 2.0 if b"\r" in data else 1.0
    require_memory(file, copies * len(data), "a text and its copy in UTF-8")
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
