"""Excel workbooks as a table: names and units are looked for above the samples, as in text."""

from __future__ import annotations

import io
import zipfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesbl.errors import RecordingError
from bayesbl.recording.formats import Format
from bayesbl.recording.formats.csv import (
    MOST_ABOVE,
    decimal_mark,
    first_sample,
    header_of,
    number_in,
    unnamed,
    value_columns,
)
from bayesbl.recording.input_bytes import require_memory

if TYPE_CHECKING:
    from bayesbl.recording.array_table import AnyArray, ArrayTable, Group

_MOST_COLUMNS = 1000
_MOST_LINES = 2**20
"""Excel's own. A damaged file may number a line as it likes, and those before it would be made."""

_MIDDLE = 200

_CELL_BYTES = 64.0
"""A number as Python holds it, with its place in a list."""


def read_excel(file: Path, data: bytes) -> ArrayTable:
    """Columns of all sheets, ``SHEET/NAME`` where two sheets have one of the same name.

    Raises
    ------
    RecordingError
        If it is no workbook, or unpacks to more than the limit of memory allows.
    """
    import openpyxl

    from bayesbl.recording.array_table import table_of_groups

    _check_size(file, data)
    book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)
    repairs: Counter[str] = Counter()
    groups = [_group(file, sheet, repairs) for sheet in book.worksheets]
    return replace(table_of_groups(file, groups), repairs=repairs)


def _check_size(file: Path, data: bytes) -> None:
    with zipfile.ZipFile(io.BytesIO(data)) as parts:
        size = sum(part.file_size for part in parts.infolist())
        # A text that many cells share is a few letters in the file and an object in memory.
        shared = sum(p.file_size for p in parts.infolist() if p.filename.endswith("Strings.xml"))
    require_memory(file, 2.0 * size + 4.0 * shared, "its sheets, unpacked")


def _group(file: Path, sheet: Any, repairs: Counter[str]) -> Group:
    from bayesbl.recording.array_table import Group

    rows = list(_rows(file, sheet))
    width = max(map(len, rows), default=0)
    middle = [_texts(row, width) for row in rows[len(rows) // 2 :][:_MIDDLE]]
    values, _ = value_columns(middle) if middle else ([], 0.0)
    above = [_texts(row, width) for row in rows[: MOST_ABOVE + 1]]
    first = first_sample(above, values) if values else None
    if first is None:  # a sheet of remarks
        return Group(sheet.title, {})
    found = header_of(above[:first], {width})
    begin, names, units = found or (first - 1, unnamed(width), ())
    mark = decimal_mark(file, middle, values)
    columns = {
        name: _array([row[i] if i < len(row) else None for row in rows[begin + 1 :]], mark, repairs)
        for i, name in enumerate(names)
        if name
    }
    stated = dict(zip(names, units, strict=False))
    return Group(sheet.title, columns, units={n: u for n, u in stated.items() if n and u})


def _texts(row: Sequence[object], width: int) -> list[str]:
    cells = ["" if cell is None else str(cell).strip() for cell in row]
    return cells + [""] * (width - len(cells))


def _rows(file: Path, sheet: Any) -> Iterator[Sequence[object]]:
    """Rows that are not blank. What the sheet says of its own size is not believed."""
    sheet.reset_dimensions()
    cells = 0
    for number, row in enumerate(sheet.iter_rows(values_only=True), 1):
        if len(row) > _MOST_COLUMNS or number > _MOST_LINES:
            raise RecordingError(
                "The sheet is too large.",
                file=file,
                where=f'sheet "{sheet.title}"',
                found=f"{len(row)} columns in line {number}",
                expected=f"at most {_MOST_COLUMNS} columns and {_MOST_LINES} lines",
            )
        cells += len(row)
        require_memory(file, _CELL_BYTES * cells, f"{cells} cells, or more")
        if any(cell is not None for cell in row):
            yield row


def _array(cells: Sequence[Any], mark: str, repairs: Counter[str]) -> AnyArray:
    """Numbers with empty cells as NaN, dates as dates; anything else as it is."""
    from datetime import datetime

    import numpy as np

    if all(cell is None or isinstance(cell, datetime) for cell in cells):
        return np.array(cells, dtype="datetime64[us]")
    numbers = [_number(cell, mark) for cell in cells]
    if any(number is None for number in numbers):
        return np.array(cells, dtype=object)
    written = sum(isinstance(cell, str) and n == n for cell, n in zip(cells, numbers, strict=True))
    repairs["number written as text"] += written
    return np.array(numbers, dtype=np.float64)


def _number(cell: Any, mark: str) -> float | None:
    if cell is None:
        return float("nan")
    if isinstance(cell, str):
        return number_in(cell.strip(), mark)
    return float(cell) if type(cell) in (int, float) else None


FORMAT = Format(
    "Excel",
    (".xlsx", ".xlsm"),
    read_excel,
    "openpyxl",
    ((0, b"PK\x03\x04"),),
    "save the sheet as CSV",
)
