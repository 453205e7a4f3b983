"""Text that TwinCAT Scope exports: lines of what each channel is, then times and values in turn.

Channels stand side by side in groups, each with a column of its own time in ms in front. A slower
group ends before the others, or repeats its samples to fill the lines.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from bayesbl.errors import RecordingError, shortened
from bayesbl.recording.formats.event_log import plain_number

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from bayesbl.recording.array_table import ArrayTable, Group
    from bayesbl.recording.types import FloatArray

_SEPARATORS = "\t;,"
_KEYS = (
    "Name", "SymbolComment", "Data-Type", "SampleTime[ms]", "SampleTime", "VariableSize",
    "SymbolBased", "IndexGroup", "IndexOffset", "SymbolName", "NetID", "NetId", "Port", "Offset",
    "ScaleFactor", "BitMask", "Unit", "Unit ScaleFactor", "Unit Offset",
)  # fmt: skip
_SCALES = {"Offset": 0.0, "ScaleFactor": 1.0, "Unit Offset": 0.0, "Unit ScaleFactor": 1.0}
"""What leaves a value as it is. Whether the export scaled it is not in the file."""

_BEGIN = re.compile(rf"Name[{_SEPARATORS}]")
_KNOWN_LINE = re.compile(
    rf"^(?:Starttime of export|Data-Type|SampleTime(?:\[ms\])?|SymbolName)[{_SEPARATORS}]", re.M
)
_LONGEST_HEADER = 500
"""Lines in which the last line about channels is looked for; comments may go over several."""

_FILETIME = 1e15
"""A time from here on is a Windows date in units of 100 ns, not a count of ms."""


def is_scope_export(text: str) -> bool:
    """Whether a text begins as TwinCAT Scope's exports do, with lines on its channels."""
    return bool(_BEGIN.match(text)) and bool(_KNOWN_LINE.search(text[:100_000]))


def read_scope_export(file: Path, text: str) -> ArrayTable:
    """Every channel with its clock; a unit only where no scale leaves open what it belongs to.

    Raises
    ------
    RecordingError
        If its channels have no times, or a line holds anything but numbers.
    """
    from bayesbl.recording.array_table import table_of_groups

    lines = text.split("\n")
    separator = text[4]
    head = [[cell.strip() for cell in line.split(separator)] for line in lines[:_LONGEST_HEADER]]
    about = [i for i, cells in enumerate(head) if cells[0] in _KEYS]
    known = {head[i][0]: head[i] for i in about}  # the later "Name" is the channels'
    starts = [i for i, cell in enumerate(known["Name"]) if cell == "Name"]
    width = len(known["Name"])
    if width < 2 or not any(b - a > 1 for a, b in zip(starts, [*starts[1:], width], strict=True)):
        raise RecordingError(
            "This export of TwinCAT Scope has no channels.",
            file=file,
            where=f"line {about[-1] + 1}",
            found=shortened(", ".join(known["Name"])),
            expected="a line of channels' names with a column of times before each group",
        )
    numbers = _numbers(file, lines, about[-1] + 1, separator, width)
    groups = list(_groups(known, starts, numbers))
    return table_of_groups(file, groups)


def _numbers(
    file: Path, lines: Sequence[str], begin: int, separator: str, width: int
) -> FloatArray:
    """The samples, shape (lines, width); NaN where a slower group has none, and in a text channel.

    Raises
    ------
    RecordingError
        At the first text in a column that holds numbers too.
    """
    import numpy as np

    places: list[int] = []
    rows: list[list[str]] = []
    for index in range(begin, len(lines)):
        line = lines[index].strip("\r\n ")
        if line == "EOF":
            break
        if line.strip(separator):
            cells = (line if separator == "," else line.replace(",", ".")).split(separator)
            rows.append([*cells[:width], *[""] * (width - len(cells))])
            places.append(index + 1)
    values = np.full((len(rows), width), np.nan)
    for column in range(width):
        texts = [row[column].strip() for row in rows]
        held = [(row, plain_number(text)) for row, text in enumerate(texts) if text]
        bad = next((row for row, number in held if number is None), None)
        if bad is None:
            for row, number in held:
                values[row, column] = number
        elif any(number is not None for _, number in held):
            raise RecordingError(
                "There is text among the samples of this export of TwinCAT Scope.",
                file=file,
                where=f"line {places[bad]}",
                found=repr(shortened(texts[bad])),
                expected="a number",
            )
    return values


def _groups(
    known: Mapping[str, Sequence[str]], starts: Sequence[int], numbers: FloatArray
) -> Iterator[Group]:
    """Channels that have the same times; a line that only repeats a time is left out."""
    import numpy as np

    from bayesbl.recording.array_table import Group, numbered

    starting = set(starts)
    channels = [column for column in range(numbers.shape[1]) if column not in starting]
    names = dict(
        zip(channels, numbered([known["Name"][column] for column in channels]), strict=True)
    )
    times: list[FloatArray] = []
    columns: list[dict[str, FloatArray]] = []
    units: dict[str, str] = {}
    for start, end in zip(starts, [*starts[1:], numbers.shape[1]], strict=True):
        stamps = numbers[:, start]
        kept = np.isfinite(stamps) & (stamps != np.concatenate([[np.nan], stamps[:-1]]))
        time = stamps[kept]
        if time.size and time[0] >= _FILETIME:
            time = (time - time[0]) / 1e4
        same = next((i for i, other in enumerate(times) if np.array_equal(other, time)), len(times))
        if same == len(times):
            times.append(time)
            columns.append({})
        for column in range(start + 1, end):
            name = names[column]
            columns[same][name] = numbers[kept, column]
            units[name] = _unit(known, column)
    for number, (time, held) in enumerate(zip(times, columns, strict=True), 1):
        yield Group(f"clock {number}", held, time / 1e3, {n: units[n] for n in held})


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
