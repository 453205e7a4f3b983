"""Excel workbooks as tables; names and units are sought above the samples, as in text."""

from __future__ import annotations

import io
import re
import zipfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import openpyxl

from bayesbl.errors import RecordingError
from bayesbl.recording.array_table import (
    ArrayTable,
    Group,
    decimal_mark,
    number_in,
    table_of_groups,
)
from bayesbl.recording.columns import stated_unit
from bayesbl.recording.input_bytes import require_memory
from bayesbl.recording.text_table import NoTable, layout_of, middle_of, table_of_text

_MOST_COLUMNS = 1000
_MOST_LINES = 2**20  # Excel's limit; a damaged file may claim any line, and all are made
_HEAD, _MIDDLE = 400, 200


def read(data: bytes) -> ArrayTable:
    """Columns of all sheets; ``SHEET/NAME`` if two sheets have the same name.

    Raises RecordingError if the file is no workbook, or would take too much memory.
    """
    _check_size(data)
    book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)
    repairs: Counter[str] = Counter()
    groups = [_group(sheet, repairs) for sheet in book.worksheets]
    return replace(table_of_groups(groups), repairs=repairs)


def _check_size(data: bytes) -> None:
    with zipfile.ZipFile(io.BytesIO(data)) as parts:
        size = sum(part.file_size for part in parts.infolist())
        # A text that many cells share is a few letters in the file and an object in memory.
        shared = sum(p.file_size for p in parts.infolist() if p.filename.endswith("Strings.xml"))
    require_memory(2.0 * size + 4.0 * shared, "its sheets, unpacked")


def _group(sheet: Any, repairs: Counter[str]) -> Group:
    """A sheet, converted to text with all digits of its numbers."""

    rows = list(_rows(sheet))
    written = [i for i, row in enumerate(rows) if any(cell is not None for cell in row)]
    rows = rows[: written[-1] + 1] if written else []
    middle = [rows[i] for i in written]
    middle = middle[len(middle) // 2 :][:_MIDDLE]
    mark = decimal_mark([cell for row in middle for cell in row if isinstance(cell, str)])
    width = max(map(len, rows), default=0)
    lines = ["\t".join([_text(c, mark) for c in row] + [""] * (width - len(row))) for row in rows]
    text = "\n".join(lines).encode()
    try:
        some = middle_of(text)
        layout = layout_of(lines[:_HEAD], some, len(lines), "\t", fewest=1, mark=mark)
    except NoTable:  # a sheet of remarks
        return Group(sheet.title, {})
    table = table_of_text(text, layout)
    cells = (cell for row in rows[layout.begin :] for cell in row if isinstance(cell, str))
    written_as_text = sum((number := number_in(c, mark)) == number is not None for c in cells)
    repairs.update({"number written as text": written_as_text}, **table.repairs)
    # A cell that shows 45 % holds 0.45.
    first = next(sheet.iter_rows(layout.begin + 1, layout.begin + 1), ())
    shares = {
        name
        for name, cell in zip(table.columns, first, strict=False)
        if _is_share(cell) and table.arrays[name].dtype.kind == "f"
        if (of_name := stated_unit(table, name)).unit is None and of_name.unknown in (None, "%")
    }
    arrays = {n: 100.0 * v if n in shares else v for n, v in table.arrays.items()}
    return Group(sheet.title, arrays, units={**dict.fromkeys(shares, "%"), **table.units})


def _is_share(cell: Any) -> bool:
    return "%" in str(getattr(cell, "number_format", "")) and cell.data_type == "n"


def _text(cell: object, mark: str) -> str:
    """A cell as text, on one line and without quotation marks."""
    if isinstance(cell, float):
        return repr(cell).replace(".", mark)
    return "" if cell is None else re.sub(r'[\s"]+', " ", str(cell)).strip()


def _rows(sheet: Any) -> Iterator[Sequence[object]]:
    """All rows; the size that the sheet states is ignored."""
    sheet.reset_dimensions()
    for number, row in enumerate(sheet.iter_rows(values_only=True), 1):
        if len(row) > _MOST_COLUMNS or number > _MOST_LINES:
            raise RecordingError(
                "The sheet is too large.",
                where=f'sheet "{sheet.title}"',
                found=f"{len(row)} columns in line {number}",
                expected=f"at most {_MOST_COLUMNS} columns and {_MOST_LINES} lines",
            )
        yield row
