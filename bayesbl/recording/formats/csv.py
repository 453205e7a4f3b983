"""A CSV file as a table of numbers: quick where it is clean, exact about the place where not.

numpy's parser reads the body in one go. Only if it stumbles is the body read again cell by cell,
to read what can be read (empty rows, quoted numbers) and to name line and column of what cannot.
"""

from __future__ import annotations

import codecs
import csv
import re
from array import array
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from bayesbl.errors import RecordingError, shortened
from bayesbl.recording.formats import Format
from bayesbl.recording.formats.scope_export import is_scope_export, read_scope_export
from bayesbl.units import is_unit, spelled

if TYPE_CHECKING:
    from bayesbl.recording.columns import Table
    from bayesbl.recording.types import FloatArray

_SEPARATORS = ("\t", ";", ",")
_BYTE_ORDER_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_THOUSANDS = re.compile(r"[+-]?\d{1,3}(?:(?:\.\d{3})+,|(?:,\d{3})+\.)\d*")
_CONTROL_CHARACTER = re.compile(r"[\x00-\x08\x0e-\x1f\x7f]")
_KANA = re.compile("[\u3041-\u30fa]|[\uff66-\uff9d]{2}")
_KANJI = re.compile("(?<![A-Za-z])[\u4e00-\u9fff]+(?![A-Za-z])")
_KANJI_IN_A_WORD = re.compile("[A-Za-z][\u4e00-\u9fff]|[\u4e00-\u9fff][A-Za-z]")
"""An accented letter of Latin-1 and the one after it may read as a kanji within a word."""
MOST_ABOVE = 50
"""Lines in which the header is looked for."""
MOST_COLUMNS = 1000
"""A file may have more if it has as many lines."""

_EXPECTED = "a CSV file: a header line with column names, then one line of numbers per sample"


class _Lines:
    """Some lines of a text, cut out when asked for: copies would take twice the text."""

    def __init__(self, text: str, begins: array[int], ends: array[int]) -> None:
        self._text, self._begins, self._ends = text, begins, ends

    def __len__(self) -> int:
        return len(self._begins)

    def __getitem__(self, row: int) -> str:
        return self._text[self._begins[row] : self._ends[row]]

    def __iter__(self) -> Iterator[str]:
        for begin, end in zip(self._begins, self._ends, strict=True):
            yield self._text[begin:end]


@dataclass(frozen=True, slots=True)
class CsvTable:
    """The text of a CSV file, split into a header and the lines that hold samples.

    Attributes
    ----------
    file
        Path as the user gave it, for messages.
    columns
        Column names without surrounding spaces; empty where the header has none.
    separator
        Tab, semicolon or comma.
    lines, line_numbers
        The lines that are not blank, and their numbers in the file, counted from 1.
    """

    file: str
    columns: tuple[str, ...]
    separator: str
    lines: _Lines
    line_numbers: Sequence[int]

    def place(self, row: int, column: int) -> str:
        """Where a cell is, in words."""
        return f'line {self.line_numbers[row]}, column "{self.columns[column]}"'

    def unit(self, column: int) -> None:
        """A CSV file states no units but in its columns' names."""

    def clock(self, column: int) -> None:
        """Any column may be the time of any other."""

    def timestamps(self, column: int) -> FloatArray | None:
        """Seconds since the first date; ``None`` if the column does not begin with a date.

        Raises
        ------
        RecordingError
            At the first cell that is no date in a column of dates.
        """
        from bayesbl.recording.timestamps import is_date, seconds_of_dates

        if not is_date(self._cells(0)[column]):
            return None
        texts = [self._cells(row)[column] for row in range(len(self.lines))]
        return seconds_of_dates(texts, self.file, lambda row: self.place(row, column))

    def numbers(self, columns: Sequence[int]) -> FloatArray:
        """The values of some columns, shape (rows, len(columns)); empty cells are NaN.

        Raises
        ------
        RecordingError
            At the first cell that is no number or the first line with too few or many cells.
        """
        import numpy as np

        if self._is_clean():
            comma_is_decimal = self.separator != ","
            # Line by line: the whole text once more would be a multiple of the file in memory.
            lines = (line.replace(",", ".") if comma_is_decimal else line for line in self.lines)
            try:
                values: FloatArray = np.loadtxt(
                    lines,
                    delimiter=self.separator,
                    comments=None,
                    usecols=list(columns),
                    ndmin=2,
                )
            except ValueError:
                return self._numbers_cell_by_cell(columns)
            if values.shape[0] == len(self.lines):
                return values
        return self._numbers_cell_by_cell(columns)

    def _is_clean(self) -> bool:
        """Whether each line surely has one cell per column and one kind of decimal point."""
        marks, lines = len(self.columns) - 1, self.lines
        if self.separator != "," and _in_any(",", lines) and _in_any(".", lines):
            return False
        return not _in_any('"', lines) and all(
            line.count(self.separator) == marks for line in lines
        )

    def _numbers_cell_by_cell(self, columns: Sequence[int]) -> FloatArray:
        import numpy as np

        rows = [self._cells(row) for row in range(len(self.lines))]
        used = [[cells[column] for column in columns] for cells in rows]
        self._refuse_thousands(used, columns)
        comma_is_decimal = self.separator != "," and not any(
            "." in c for cells in used for c in cells
        )
        values = np.empty((len(used), len(columns)))
        for row, cells in enumerate(used):
            for index, cell in enumerate(cells):
                text = cell.replace(",", ".") if comma_is_decimal else cell
                values[row, index] = self._number(text, cell, row, columns[index])
        return values

    def _refuse_thousands(self, used: Sequence[Sequence[str]], columns: Sequence[int]) -> None:
        """First of all: one such number leaves open what a comma means in every other."""
        for row, cells in enumerate(used):
            for cell, column in zip(cells, columns, strict=True):
                if _THOUSANDS.fullmatch(cell):
                    mark = min(".,", key=cell.index)
                    raise RecordingError(
                        "A number has a thousands separator.",
                        file=self.file,
                        where=self.place(row, column),
                        found=repr(shortened(cell)),
                        expected=f"{cell.replace(mark, '')}, and no such separator in the file",
                    )

    def _cells(self, row: int) -> list[str]:
        try:
            cells = next(csv.reader([self.lines[row]], delimiter=self.separator))
        except csv.Error as error:
            raise self._error(f"This line cannot be read ({error}).", row) from None
        width = len(self.columns)
        # Some loggers end each line of samples with a separator, but not the header.
        if len(cells) < width or any(cell.strip() for cell in cells[width:]):
            raise self._error(
                "This line does not have one cell for each column.",
                row,
                found=f"{len(cells)} cells",
                expected=f"{width}, as in the header",
            )
        return [cell.strip() for cell in cells[:width]]

    def _number(self, text: str, cell: str, row: int, column: int) -> float:
        if not text:
            return float("nan")
        if not _is_number(text):
            expected = "a number"
            if row == 0 and not any(map(_is_number, self._cells(0))):
                expected += "; delete a row of units, and state the units under [columns]"
            raise RecordingError(
                "There is text in a column of numbers.",
                file=self.file,
                where=self.place(row, column),
                found=repr(shortened(cell)),
                expected=expected,
            )
        return float(text)

    def _error(
        self, problem: str, row: int, *, found: str | None = None, expected: str | None = None
    ) -> RecordingError:
        where = f"line {self.line_numbers[row]}"
        return RecordingError(problem, file=self.file, where=where, found=found, expected=expected)


def read_csv(file: Path, data: bytes) -> Table:
    """Split the bytes of a CSV file into header and lines, or read an export of TwinCAT Scope.

    Raises
    ------
    RecordingError
        If they are not text, or not a table with a header, or hold no sample.
    """
    text = _decode(file, data).replace("\r\n", "\n").replace("\r", "\n")
    if is_scope_export(text):
        return read_scope_export(file, text)
    ends = array("q", _ends_of_lines(text))
    begins = array("q", [0])
    begins.extend(end + 1 for end in ends[:-1])
    lines = _Lines(text, begins, ends)
    written = list(islice((i for i, line in enumerate(lines) if line.strip()), MOST_ABOVE))
    if not written:
        raise RecordingError("The file is empty.", file=file, found="nothing", expected=_EXPECTED)
    amid = next((i for i in range(len(lines) // 2, 0, -1) if lines[i].strip()), written[-1])
    header_index = _header_index(lines, written, amid)
    separator, columns = _header(file, lines, header_index)
    blank = f' "\t{separator}'
    rows = range(header_index + 1, len(lines))
    kept = array("q", (i for i in rows if lines[i].strip(blank)))
    if not kept:
        raise RecordingError(
            "The file has a header but no sample.",
            file=file,
            found="a header only",
            expected=_EXPECTED,
        )
    return CsvTable(
        file=str(file),
        columns=columns,
        separator=separator,
        lines=_Lines(text, _picked(begins, kept), _picked(ends, kept)),
        line_numbers=array("q", (i + 1 for i in kept)),
    )


def _header_index(lines: _Lines, written: Sequence[int], amid: int) -> int:
    """The last line above the samples with a name for each of their cells.

    Drives write lines of their own above it; a row of units below it is left for the message. The
    first line of all where there is none such. ``written``: the first lines that are not blank;
    ``amid``: one of the samples.
    """
    separator = next((mark for mark in _SEPARATORS if mark in lines[amid]), None)
    if separator is None:
        return written[0]
    width = lines[amid].count(separator) + 1
    # Some loggers end each line of samples with a separator, but not the header.
    widths = (width - 1, width) if lines[amid].rstrip(" \r").endswith(separator) else (width,)
    names: list[int] = []
    for i in written:
        line = re.sub(r'"([^"]*)"', lambda quoted: quoted[1].replace(separator, ""), lines[i])
        cells = [cell.strip() for cell in line.split(separator)]
        if len(cells) not in widths:
            names.clear()
        elif any(map(_is_cell, cells)):
            break
        elif all(cells[: widths[0]]):
            names.append(i)
    if not names:
        return written[0]
    last = [cell.strip(' "[]()') for cell in lines[names[-1]].split(separator)]
    has_units = len(names) > 1 and any(is_unit(spelled(cell)) for cell in last)
    return names[-2] if has_units else names[-1]


def _is_cell(text: str) -> bool:
    """Whether it may be a sample: a number, with either mark."""
    return _is_number(text.strip().replace(",", "."))


def _decode(file: Path, data: bytes) -> str:
    encodings = [name for mark, name in _BYTE_ORDER_MARKS if data.startswith(mark)] or ["utf-8"]
    try:
        text = data.decode(encodings[0])
    except UnicodeDecodeError:
        text = _decode_old(data)
    if _CONTROL_CHARACTER.search(text):
        raise RecordingError(
            "This is not a CSV file.", file=file, found="binary data", expected=_EXPECTED
        )
    return text


def _decode_old(data: bytes) -> str:
    """Text of an older program: Japanese where it reads as such, else Latin."""
    try:
        text = data.decode("cp932")
    except UnicodeDecodeError:
        text = ""
    is_japanese = _KANA.search(text) or (_KANJI.search(text) and not _KANJI_IN_A_WORD.search(text))
    # Any byte is a character of Latin-1.
    return text if is_japanese else data.decode("latin-1")


def _picked(places: array[int], kept: Iterable[int]) -> array[int]:
    return array("q", (places[i] for i in kept))


def _ends_of_lines(text: str) -> Iterator[int]:
    end = text.find("\n")
    while end >= 0:
        yield end
        end = text.find("\n", end + 1)
    yield len(text)


def _header(file: Path, lines: _Lines, index: int) -> tuple[str, tuple[str, ...]]:
    """Separator and column names of the header line."""
    line, where = lines[index], f"line {index + 1}"
    unquoted = re.sub(r'"[^"]*"', "", line)
    separator = next((mark for mark in _SEPARATORS if mark in unquoted), None)
    if separator is None:
        raise RecordingError(
            "This is not a CSV file: its first line has no comma, semicolon or tab.",
            file=file,
            where=where,
            found=repr(shortened(line.strip())),
            expected=_EXPECTED,
        )
    try:
        cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    except csv.Error as error:
        raise RecordingError(
            f"The header cannot be read ({error}).", file=file, where=where, expected=_EXPECTED
        ) from None
    columns = tuple(cell.strip() for cell in cells)
    if len(columns) > max(MOST_COLUMNS, len(lines)):
        raise RecordingError(
            "The file has more columns than lines: is it transposed?",
            file=file,
            where=where,
            found=f"{len(columns)} columns in {len(lines)} lines",
            expected="a column for each channel and a line for each sample",
        )
    if any(columns) and all(_is_number(name.replace(",", ".")) for name in columns if name):
        raise RecordingError(
            "The columns have no names.",
            file=file,
            where=where,
            found=repr(shortened(line.strip())),
            expected="a header line with column names",
        )
    twice = sorted(name for name, times in Counter(columns).items() if name and times > 1)
    if twice:
        raise RecordingError(
            "Two columns have the same name.",
            file=file,
            where=where,
            found=", ".join(f'"{shortened(name)}"' for name in twice),
            expected="a different name for each column",
        )
    return separator, columns


def _in_any(mark: str, lines: Iterable[str]) -> bool:
    return any(mark in line for line in lines)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    # float() reads "1_000" as a number; no instrument writes that.
    return "_" not in text


FORMAT = Format("CSV, TSV", (".csv", ".tsv", ".txt"), read_csv)
