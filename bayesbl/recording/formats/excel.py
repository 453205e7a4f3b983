"""Excel workbooks as a table: each sheet's first line that is not blank names its columns."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesbl.errors import RecordingError, shortened
from bayesbl.recording.formats import Format
from bayesbl.recording.input_bytes import require_memory

if TYPE_CHECKING:
    from bayesbl.recording.array_table import AnyArray, ArrayTable

_MOST_COLUMNS = 1000
_MOST_LINES = 2**20
"""Excel's own. A damaged file may number a line as it likes, and those before it would be made."""

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

    from bayesbl.recording.array_table import readable
    from bayesbl.recording.clocked_columns import Group, table_of_groups

    with readable(file, "Excel", "or save the sheet as CSV"):
        _check_size(file, data)
        book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)
        sheets = [(sheet.title, _columns(file, sheet)) for sheet in book.worksheets]
    return table_of_groups(file, [Group(title, columns) for title, columns in sheets])


def _check_size(file: Path, data: bytes) -> None:
    with zipfile.ZipFile(io.BytesIO(data)) as parts:
        size = sum(part.file_size for part in parts.infolist())
        # A text that many cells share is a few letters in the file and an object in memory.
        shared = sum(p.file_size for p in parts.infolist() if p.filename.endswith("Strings.xml"))
    require_memory(file, 2.0 * size + 4.0 * shared, "its sheets, unpacked")


def _columns(file: Path, sheet: Any) -> dict[str, AnyArray]:
    rows = _rows(file, sheet)
    header = next(rows, ())
    places = {str(cell).strip(): i for i, cell in enumerate(header) if cell is not None}
    if len(places) != sum(cell is not None for cell in header):
        raise RecordingError(
            "Two columns have the same name.",
            file=file,
            where=f'sheet "{sheet.title}"',
            found=shortened(", ".join(str(cell) for cell in header)),
            expected="a different name for each column",
        )
    values: list[list[object]] = [[] for _ in places]
    for row in rows:
        for held, place in zip(values, places.values(), strict=True):
            held.append(row[place] if place < len(row) else None)
    return {name: _array(held) for name, held in zip(places, values, strict=True)}


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


def _array(cells: Sequence[Any]) -> AnyArray:
    """Numbers with empty cells as NaN, dates as dates; anything else as it is."""
    from datetime import datetime

    import numpy as np

    if all(cell is None or type(cell) in (int, float) for cell in cells):
        return np.array([np.nan if cell is None else cell for cell in cells], dtype=np.float64)
    if all(cell is None or isinstance(cell, datetime) for cell in cells):
        return np.array(cells, dtype="datetime64[us]")
    return np.array(cells, dtype=object)


FORMAT = Format(
    "Excel",
    (".xlsx", ".xlsm"),
    read_excel,
    "openpyxl",
    ((0, b"PK\x03\x04"),),
    "save the sheet as CSV",
)
