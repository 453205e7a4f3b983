"""Text that TwinCAT Scope exports: lines of what each channel is, then times and values in turn.

Channels stand side by side in groups, each with a column of its own time in ms in front. A slower
group ends before the others, or repeats its samples to fill the lines.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from bayesbl.errors import RecordingError, shortened
from bayesbl.recording.array_table import ArrayTable, is_number, number_in, numbered
from bayesbl.recording.channels import TIME
from bayesbl.recording.text_table import Layout, table_of_text

_SEPARATORS = "\t;,"
_SCALES = {"Offset": 0.0, "ScaleFactor": 1.0, "Unit Offset": 0.0, "Unit ScaleFactor": 1.0}
"""What leaves a value as it is. Whether the export scaled it is not in the file."""

_BEGIN = re.compile(rf"Name[{_SEPARATORS}]")
_KNOWN_LINE = re.compile(
    rf"^(?:Starttime of export|Data-Type|SampleTime(?:\[ms\])?|SymbolName)[{_SEPARATORS}]", re.M
)
_LONGEST_HEADER = 500
"""Lines in which the first sample is looked for; comments may go over several."""

_FILETIME = 1e15
"""A time from here on is a Windows date in units of 100 ns, not a count of ms."""


def is_scope_export(text: str) -> bool:
    """Whether a text begins as TwinCAT Scope's exports do, with lines on its channels."""
    return bool(_BEGIN.match(text)) and bool(_KNOWN_LINE.search(text[:100_000]))


def read_scope_export(file: Path, lines: Sequence[str]) -> ArrayTable:
    """All channels; a unit only where no scale leaves open what it belongs to.

    Raises
    ------
    RecordingError
        If its channels have no times, or there is text among these.
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
            file=file,
            where=f"line {above}",
            found=shortened(", ".join(known["Name"])),
            expected="a line of channels' names with a column of times before each group",
        )
    body = [*[""] * above, *_padded(lines[above:], separator, width)]
    first = number_in(body[above].partition(separator)[0], ".") if len(body) > above else None
    time = "100 ns" if first is not None and first >= _FILETIME else "ms"
    names = numbered([TIME if i in starts else name for i, name in enumerate(known["Name"])])
    units = [time if i in starts else _unit(known, i) for i in range(width)]
    layout = Layout(separator, tuple(names), units=tuple(units))
    return table_of_text(file, "\n".join(body).encode(), layout)


def _padded(lines: Sequence[str], separator: str, width: int) -> Iterator[str]:
    """Lines of samples with a decimal point and a cell for every column."""
    for line in lines:
        if line.strip("\r\n ") == "EOF":
            break
        cells = (line if separator == "," else line.replace(",", ".")).split(separator)
        yield separator.join([*cells[:width], *[""] * (width - len(cells))])


def _unit(known: Mapping[str, Sequence[str]], column: int) -> str:
    """``rad/s`` of ``rad/s (Velocity)``; empty where there is none, or where a scale is set."""
    for key, neutral in _SCALES.items():
        cells = known.get(key, ())
        text = cells[column].replace(",", ".") if column < len(cells) else ""
        if text and text != f"{neutral:g}":
            return ""
    cells = known.get("Unit", ())
    unit = cells[column] if column < len(cells) else ""
    return "" if unit.startswith("(") else unit.partition(" (")[0]
