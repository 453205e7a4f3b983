"""Text as a table of numbers: what is no sample is left out and counted, what is one is read whole.

The policy, for every dialect alike:

* the separator is the one that cuts the middle of the file into equal rows of numbers;
* names are the last line above the samples with a name for each cell, units a line of units below;
* lines that are no samples (comments, repeated headers, text, a cut last line) are left out; so are
  incomplete lines, as lost samples, up to :data:`MOST_INCOMPLETE` of all;
* one decimal mark holds for the whole file, and thousands are grouped in threes by another mark;
* everything else is refused with its line and column.

The text is gone through in blocks of lines, twice (what is there, then the numbers), so that memory
is that of the file and its numbers; of a block in which all lines are samples none is cut here.
"""

from __future__ import annotations

import codecs
import csv
import re
from array import array
from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from bayesbl.errors import RecordingError, shortened
from bayesbl.recording.formats import Format
from bayesbl.recording.formats.event_log import form_of_events, read_events
from bayesbl.recording.formats.scope_export import is_scope_export, read_scope_export
from bayesbl.recording.input_bytes import require_memory
from bayesbl.units import is_unit, spelled

if TYPE_CHECKING:
    from bayesbl.recording.columns import Table
    from bayesbl.recording.types import FloatArray

_SEPARATORS = ("\t", ";", ",", "|", " ")
_BYTE_ORDER_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_CONTROL = dict.fromkeys([*range(9), *range(0x0E, 0x20), *range(0x7F, 0xA0), 0xFEFF])
_CONTROL_BYTES = bytes([*range(9), *range(0x0E, 0x20), *range(0x7F, 0xA0), 0xEF])
_KANA = re.compile("[\u3041-\u30fa]|[\uff66-\uff9d]{2}")
_KANJI = re.compile("(?<![A-Za-z])[\u4e00-\u9fff]+(?![A-Za-z])")
_KANJI_IN_A_WORD = re.compile("[A-Za-z][\u4e00-\u9fff]|[\u4e00-\u9fff][A-Za-z]")
"""An accented letter of Latin-1 and the one after it may read as a kanji within a word."""

_BRACKETS = re.compile(r"[(\[{][^()\[\]{}]*[)\]}]")
_COMMENT = ("#", "%", "//")
_REMARKS = ("comment", "comments", "kommentar")
_BEGINS = tuple(b"0123456789+-.")
"""With what most lines of samples begin, and hardly any other line."""

_MISSING = frozenset(
    "|nan|-nan|nan(ind)|-nan(ind)|1.#qnan|-1.#ind|null|none|nil|n/a|na|#n/a|#na|#value!|#div/0!"  # noqa: SIM905
    "|#num!|-|--|---|?|missing".split("|")
)
_PLAIN = {mark: re.compile(rf"[+-]?(\d+[{mark}]?\d*|[{mark}]\d+)([eE][+-]?\d+)?") for mark in ".,"}
_GROUPED = {
    mark: re.compile(rf"[+-]?[1-9]\d{{0,2}}(?:[{other}'’\u00a0\u202f ]\d{{3}})+(?:[{mark}]\d*)?")
    for mark, other in ((".", ","), (",", "."))
}
_WITH_UNIT = re.compile(r"([+\-−]?\d[^\sA-Za-z]*(?:[eE][+-]?\d+)?)\s?([^\d\s.,:+\-/].*)")
"""As exports write durations and formatted values: ``0.001 sec``, ``1500.2 rpm``."""

_NUMBER_IN = {".": "a number", ",": "a number, with a decimal comma as the others"}

MOST_ABOVE = 50
"""Lines that are not blank in which the first sample is looked for."""
MOST_COLUMNS = 1000
"""A file may have more if it has as many lines."""
MOST_INCOMPLETE = 0.05
"""Share of lines without one cell for each column, up to which they are lost samples."""

_INCOMPLETE = "incomplete line left out, as a lost sample"
_HEAD_LINES, _MIDDLE_LINES, _MIDDLE_BYTES = 400, 200, 1 << 16
_BLOCK_BYTES = 1 << 20
_LONGEST_LINE = 4_000_000
_MOST_SKIPPED = 1_000_000
"""Lines that are no samples, beyond as many as samples."""

_SCOPE_TIMES = 12.0
"""Times its size that an export of Scope takes, whose cells are texts until all are there."""

_EVENT_TIMES = 10.0
"""The same of a log of events."""

_EXPECTED = "a CSV file: a header line with column names, then one line of numbers per sample"


@dataclass(frozen=True, slots=True)
class _Text:
    """A file in UTF-8, its lines ended alike, and whether it has no control characters."""

    data: bytes
    is_clean: bool

    @classmethod
    def of(cls, file: Path, data: bytes) -> _Text:
        encoding = _encoding(data)
        copies = 3.0 if encoding != "utf-8" else 2.0 if b"\r" in data else 1.0
        require_memory(file, copies * len(data), "a text and its copy in UTF-8")
        if encoding != "utf-8":
            data = data.decode(encoding, "replace").encode()
        if b"\r" in data:
            data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        text = cls(data, False)
        cleaned = sum(len(block.translate(None, _CONTROL_BYTES)) for block in text.blocks())
        return replace(text, is_clean=cleaned == len(data))

    def blocks(self) -> Iterator[bytes]:
        """Whole lines, some tens of thousands at a time."""
        begin = 0
        while begin < len(self.data):
            end = self.data.find(b"\n", begin + _BLOCK_BYTES) + 1 or len(self.data)
            yield self.data[begin:end]
            begin = end

    def cut(self, block: bytes) -> list[str]:
        """The lines of a block without control characters."""
        text = block.decode()
        text = text if self.is_clean else text.translate(_CONTROL)
        return text.removesuffix("\n").split("\n")

    def lines(self) -> Iterator[str]:
        """All lines without control characters."""
        return (line for block in self.blocks() for line in self.cut(block))

    def middle(self) -> list[str]:
        """Some lines from amid the samples that are not blank."""
        size = len(self.data)
        if size <= 4 * _MIDDLE_BYTES:
            written = [line for line in self.lines() if line.strip()]
            return written[len(written) // 2 :][:_MIDDLE_LINES]
        text = self.data[size // 2 : size // 2 + _MIDDLE_BYTES].decode("utf-8", "replace")
        cut = text.translate(_CONTROL).split("\n")[1:-1]
        return [line for line in cut if line.strip()][:_MIDDLE_LINES]


@dataclass(frozen=True, slots=True)
class _Layout:
    """Where the table of a text begins, and how its lines are cut."""

    separator: str
    width: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    header: tuple[tuple[str, ...], ...]
    begin: int
    mark: str

    def cells(self, line: str) -> list[str]:
        """A line's cells, without empty ones beyond the last column."""
        cells = _split(line, self.separator)
        while len(cells) > self.width and not cells[-1]:
            cells.pop()
        return cells


@dataclass(frozen=True, slots=True)
class CsvTable:
    """A text, the layout of its table, and which of its lines are samples.

    Attributes
    ----------
    file
        Path as the user gave it, for messages.
    columns
        Column names without surrounding spaces; empty where the header has none.
    repairs
        What was left out or read as something else, in words, and how many times.
    """

    file: str
    columns: tuple[str, ...]
    repairs: Mapping[str, int]
    _text: _Text
    _layout: _Layout
    _skipped: array[int]
    _rows: int

    def place(self, row: int, column: int) -> str:
        """Where a cell is, in words."""
        return f'line {self._line(row) + 1}, column "{self.columns[column]}"'

    def without_values(self) -> CsvTable:
        """Its names and places alone."""
        return replace(self, _text=_Text(b"", True))

    def unit(self, column: int) -> str | None:
        """The unit in a line of units below the names."""
        return self._layout.units[column] or None if self._layout.units else None

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

        def cells() -> Iterator[str]:
            return (self._layout.cells(x)[column] for block in self._samples() for x in block)

        if not is_date(next(cells(), "")):
            return None
        return seconds_of_dates(cells(), self.file, lambda row: self.place(row, column))

    def numbers(self, columns: Sequence[int]) -> FloatArray:
        """The values of some columns, shape (rows, len(columns)); empty cells are NaN.

        Raises
        ------
        RecordingError
            At the first cell that is no number.
        """
        import numpy as np

        needed = len(self._text.data) + 24.0 * self._rows * len(columns)
        require_memory(Path(self.file), needed, f"{self._rows} lines of text and numbers")
        values: FloatArray = np.empty((self._rows, len(columns)), order="F")
        row = 0
        for block in self._samples():
            read = self._quickly(block, columns)
            if read is None:
                for number, line in enumerate(block, row):
                    cells = self._layout.cells(line)
                    values[number] = [self._number(cells[c], number, c) for c in columns]
            else:
                values[row : row + len(block)] = read
            row += len(block)
        return values

    def _samples(self) -> Iterator[list[str]]:
        """Lines that are samples, a block at a time."""
        first = 0
        for block in self._text.blocks():
            lines = self._text.cut(block)
            low, high = (bisect_left(self._skipped, at) for at in (first, first + len(lines)))
            skipped = set(self._skipped[low:high])
            samples = (
                [x for i, x in enumerate(lines, first) if i not in skipped] if skipped else lines
            )
            first += len(lines)
            if samples:
                yield samples

    def _line(self, row: int) -> int:
        """The line, from 0, of a sample: as many were skipped before it as lie before it."""
        line = row
        while (moved := row + bisect_right(self._skipped, line)) != line:
            line = moved
        return line

    def _quickly(self, block: list[str], columns: Sequence[int]) -> FloatArray | None:
        """Numbers by NumPy's parser, where no line has anything but numbers and separators."""
        import numpy as np

        separator, mark = self._layout.separator, self._layout.mark
        text = "\n".join(block)
        # A quoted cell may hold more separators; no sample has fewer.
        if separator != " " and text.count(separator) != (self._layout.width - 1) * len(block):
            return None
        if any(bracket in text for bracket in "([{'’"):
            return None
        lines = block
        if '"' in text:
            text = text.replace('"', "")
            lines = text.split("\n")
        if separator != ",":
            if ("," if mark == "." else ".") in text:
                return None
            if "," in text:
                lines = text.replace(",", ".").split("\n")
        delimiter = None if separator == " " else separator
        try:
            read: FloatArray = np.loadtxt(
                lines, delimiter=delimiter, comments=None, usecols=list(columns), ndmin=2
            )
        except ValueError:
            return None
        return read if len(read) == len(block) else None

    def _number(self, cell: str, row: int, column: int) -> float:
        value = number_in(cell, self._layout.mark)
        if value is None:
            number, unit = _parted(cell)
            if unit and unit == self.unit(column):
                value = number_in(number, self._layout.mark)
        if value is None:
            raise RecordingError(
                "There is text in a column of numbers.",
                file=self.file,
                where=self.place(row, column),
                found=repr(shortened(cell)),
                expected=_NUMBER_IN[self._layout.mark],
            )
        return value


def read_csv(file: Path, data: bytes) -> Table:
    """Find the table in a text, or read an export of TwinCAT Scope.

    Raises
    ------
    RecordingError
        If it is not text, or holds no table or no sample. Nothing of it is quoted before its lines
        have proved to be numbers.
    """
    for begin in range(0, len(data), _LONGEST_LINE):
        part = data[begin : begin + _LONGEST_LINE]
        if len(part) == _LONGEST_LINE and b"\n" not in part and b"\r" not in part:
            found = f"a line of more than {_LONGEST_LINE // 1_000_000} MB"
            raise RecordingError(
                "This is not a CSV file.", file=file, found=found, expected=_EXPECTED
            )
    text = _Text.of(file, data)
    head = list(islice(text.lines(), _HEAD_LINES))
    if is_scope_export("\n".join(head)):
        require_memory(file, _SCOPE_TIMES * len(data), "cells of text")
        return read_scope_export(file, "\n".join(text.lines()))
    if form := form_of_events(head):
        require_memory(file, _EVENT_TIMES * len(data), "events")
        return read_events(file, text.lines(), form)
    layout = _layout(file, text, head)
    skipped, rows, repairs = _scanned(file, text, layout)
    return CsvTable(str(file), layout.names, repairs, text, layout, skipped, rows)


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


def _split(line: str, separator: str) -> list[str]:
    if "(" in line or "[" in line or "{" in line:
        inner = "_" if separator == " " else " "
        line = _BRACKETS.sub(lambda held: held[0].replace(separator, inner), line)
    if '"' in line:
        try:
            cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
        except csv.Error:
            cells = line.split(separator)
        cells = [cell for cell in cells if cell.strip()] if separator == " " else cells
    elif separator == " ":
        return line.split()
    else:
        cells = line.split(separator)
    return [cell.strip() for cell in cells]


def number_in(cell: str, mark: str) -> float | None:
    """The number that a cell holds, NaN for a missing one; ``None`` if it is text."""
    text = cell.replace("−", "-")
    if mark == "," and "," in text:
        if _PLAIN[","].fullmatch(text):
            return float(text.replace(",", "."))
    elif mark == "." or "." not in text:
        try:
            if text.isascii() and "_" not in text:  # float() reads "1_000"; no instrument does
                return float(text)
        except ValueError:
            pass
    if text.lower() in _MISSING:
        return float("nan")
    if _GROUPED[mark].fullmatch(text):
        plain = re.sub(r"[^\d+.,-]", "", text).replace("." if mark == "," else ",", "")
        return float(plain.replace(",", "."))
    return None


def _parted(cell: str) -> tuple[str, str]:
    """A cell's number and the unit behind it; the cell where there is none that is known."""
    held = _WITH_UNIT.fullmatch(cell)
    return (held[1], held[2]) if held and is_unit(spelled(held[2])) else (cell, "")


def _units_of(file: Path, rows: Sequence[Sequence[str]], column: int) -> str:
    """The unit that a column's cells state.

    Raises
    ------
    RecordingError
        If they state several: a value is then another multiple of its unit than the one above it.
    """
    cells = [row[column] for row in rows if column < len(row)]
    units = {_parted(cell)[1] for cell in cells if _is_value(cell)}
    if len(units) > 1:
        raise RecordingError(
            "The cells of a column are in different units.",
            file=file,
            where=f"column {column + 1}",
            found=" and ".join(sorted(unit or "none" for unit in units)),
            expected="one unit for the whole column, in its name",
        )
    return next(iter(units), "")


def _is_number(cell: str) -> bool:
    """Whether it may be a number with either mark, bare or before its unit; never if missing."""
    return _is_bare_number(_parted(cell)[0])


def _is_bare_number(cell: str) -> bool:
    return any(
        (value := number_in(cell, mark)) is not None and (value == value or cell.lower() == "nan")
        for mark in ".,"
    )


def _is_value(cell: str) -> bool:
    from bayesbl.recording.timestamps import is_date

    return _is_number(cell) or is_date(cell)


def _layout(
    file: Path, text: _Text, head: Sequence[str], separators: Sequence[str] = _SEPARATORS
) -> _Layout:
    middle = text.middle()
    separator, width, values = _dialect(middle, separators)
    written = [i for i, line in enumerate(head) if line.strip()]
    if not written:
        raise RecordingError("The file is empty.", file=file, found="nothing", expected=_EXPECTED)
    if len(values) < 2:
        raise _no_table(file, text, [head[i] for i in written])
    if width > max(MOST_COLUMNS, text.data.count(b"\n")):
        raise RecordingError(
            "The file has more columns than lines: is it transposed?",
            file=file,
            found=f"{width} columns",
            expected="a column for each channel and a line for each sample",
        )
    head = _joined(head)
    written = [i for i, line in enumerate(head) if line.strip()]
    cut = [_split(line, separator) for line in head]
    first = first_sample([cut[i] for i in written[: MOST_ABOVE + 1]], values)
    if first is None:
        raise _no_table(file, text, [head[i] for i in written])
    # Some loggers end each line of samples with a separator, but not the header.
    trailing = all(line.rstrip().endswith(separator) for line in middle) and separator != " "
    above = written[:first]
    for i in above:
        if head[i].lstrip().startswith(_COMMENT):
            cut[i] = _split(head[i].lstrip().lstrip("#%/").strip(), separator)
        if len(cut[i]) == width + 1 and cut[i][-1].lower() in _REMARKS:
            cut[i].pop()  # LabVIEW ends its header so, and no line of samples
    found = header_of([cut[i] for i in above], {width, width - 1} if trailing else {width})
    rows = [cut[i] for i in written[first:]] + [_split(line, separator) for line in middle]
    mark = decimal_mark(file, rows, values)
    stated = tuple(_units_of(file, rows, k) if k in values else "" for k in range(width))
    if found is None and separator == "\t" and _dialect(middle, (" ",))[1] == width:
        return _layout(file, text, head, (" ",))  # tabs among spaces
    if found is None:
        nearest = cut[above[-1]] if above else []
        if len(nearest) > 1 and not any(map(_is_number, nearest)):
            raise RecordingError(
                "This line does not have one cell for each column.",
                file=file,
                where=f"line {written[first] + 1}",
                found=f"{width} cells",
                expected=f"{len(nearest)}, as in the header",
            )
        return _Layout(separator, width, unnamed(width), stated, (), written[first], mark)
    last, names, units = found
    units = stated[: len(names)] if any(stated) else units
    lines = tuple(tuple(cut[i]) for i in above[max(0, last - 1) : last + 1])
    return _Layout(separator, len(names), names, units, lines, written[first], mark)


def _joined(head: Sequence[str]) -> list[str]:
    """Lines with those that a quoted name goes on over in one; the others are blank."""
    joined = list(head)
    at = 0
    for i, line in enumerate(head):
        if i > at and joined[at].count('"') % 2 and joined[at].count('"') + line.count('"') < 200:
            joined[at] += f" {line}"
            joined[i] = ""
        else:
            at = i
    return joined


def header_of(
    above: Sequence[list[str]], widths: set[int]
) -> tuple[int, tuple[str, ...], tuple[str, ...]] | None:
    """The last of the rows above the samples that belongs to the header, names, and units if any.

    Names are a row of as many cells as the samples have (``widths``) without a number; a row of
    units may follow them.
    """
    from bayesbl.recording.array_table import numbered

    named: list[int] = []
    for i, cells in enumerate(above):
        while len(cells) > max(widths) and not cells[-1]:
            cells.pop()
        if not any(cells):
            continue
        if len(cells) in widths and not any(map(_is_bare_number, cells)):
            named.append(i)
        elif len(cells) > 1:
            named.clear()
    if not named:
        return None
    bare = [cell.strip("[]() ") for cell in above[named[-1]]]
    has_units = len(named) > 1 and any(is_unit(spelled(cell)) for cell in bare)
    names = above[named[-2] if has_units else named[-1]]
    names = [name or f"column {i}" for i, name in enumerate(names, 1)]
    units = tuple(bare[: len(names)]) if has_units else ()
    return named[-1], tuple(numbered(names)), units


def unnamed(width: int) -> tuple[str, ...]:
    """What columns without names are called."""
    return tuple(f"column {i + 1}" for i in range(width))


def is_sample(cells: Sequence[str], values: Sequence[int]) -> bool:
    """Whether a line's cells hold values where those amid the file do."""
    if len(cells) <= values[-1]:
        return False
    here = [cells[i] for i in values]
    return any(map(_is_value, here)) and all(
        cell.lower() in _MISSING or _is_value(cell) for cell in here
    )


def first_sample(rows: Sequence[Sequence[str]], values: Sequence[int]) -> int | None:
    """The first row that is a sample; numbers of columns are none, they stand above their names."""
    followed = [any(map(_is_value, row)) for row in rows[1:]] + [True]
    pairs = zip(rows, followed, strict=True)
    return next((i for i, (row, on) in enumerate(pairs) if on and is_sample(row, values)), None)


def _dialect(lines: Sequence[str], separators: Sequence[str]) -> tuple[str, int, list[int]]:
    """Separator, number of cells and which of them hold values: equal rows, most of numbers."""
    best, chosen = 0.0, (",", 0, list[int]())
    for separator in separators:
        rows = [_split(line, separator) for line in lines]
        widths = Counter(map(len, rows))
        if not widths:
            continue
        width, count = widths.most_common(1)[0]
        if width < 2:
            continue
        alike = [row for row in rows if len(row) == width]
        values, share = value_columns(alike[:1] if width > MOST_COLUMNS else alike)
        score = count / len(rows) * share
        if len(values) >= 2 and score > 1.001 * best:
            best, chosen = score, (separator, width, values)
    return chosen


def value_columns(rows: Sequence[Sequence[str]]) -> tuple[list[int], float]:
    """Which columns of rows alike hold numbers or dates, and the share of cells that do."""
    values: list[int] = []
    share = 0.0
    for column, cells in enumerate(zip(*rows, strict=True)):
        held = [cell for cell in cells if cell.lower() not in _MISSING]
        good = sum(map(_is_value, held))
        share += (good + len(cells) - len(held)) / len(cells) / len(rows[0])
        if good >= 0.5 * len(held) if held else any(cells):
            values.append(column)
    return values, share


def decimal_mark(file: Path, rows: Sequence[Sequence[str]], values: Sequence[int]) -> str:
    """Whether numbers have a decimal comma or a decimal point, by all of them together."""
    cells = [_parted(row[i])[0] for row in rows for i in values if i < len(row)]
    cells = [cell for cell in cells if _is_number(cell)]
    if not any("," in cell for cell in cells):
        return "."
    fits = {mark: sum(number_in(cell, mark) is not None for cell in cells) for mark in ".,"}
    if fits["."] == fits[","]:
        example = next(cell for cell in cells if "," in cell)
        raise RecordingError(
            "A comma may be a decimal comma here, or part thousands.",
            file=file,
            found=repr(shortened(example)),
            expected=f"{example.replace(',', '.')} or {example.replace(',', '')}: numbers without "
            "marks between thousands",
        )
    return "," if fits[","] > fits["."] else "."


def _no_table(file: Path, text: _Text, lines: Sequence[str]) -> RecordingError:
    """Nothing is quoted: a name may lead to any file."""
    if re.search(rb"[\x00-\x08\x0e-\x1f\x7f]", text.data[:_MIDDLE_BYTES]):
        found = "binary data"
    elif len(lines) == 1 and any(mark in lines[0] for mark in _SEPARATORS[:3]):
        return RecordingError(
            "The file has a header but no sample.",
            file=file,
            found="a header only",
            expected=_EXPECTED,
        )
    else:
        found = "no lines with a number in two columns or more"
    return RecordingError("This is not a CSV file.", file=file, found=found, expected=_EXPECTED)


def _scanned(file: Path, text: _Text, layout: _Layout) -> tuple[array[int], int, Mapping[str, int]]:
    """Lines below the header that are no samples, how many are, and what was left out."""
    separator, width = layout.separator, layout.width
    skipped, incomplete = array("q", range(layout.begin)), array("q")
    counts: Counter[str] = Counter()
    rows, index = 0, -1
    first_incomplete = (0, 0)
    blank = f' "\t{separator}'
    for block in text.blocks():
        require_memory(file, len(text.data) + 48.0 * rows, f"{rows} lines, or more")
        if len(skipped) > rows + _MOST_SKIPPED:
            raise _no_table(file, text, [])
        if text.is_clean and index + 1 >= layout.begin and _are_samples(block, separator, width):
            rows += block.count(b"\n")
            index += block.count(b"\n")
            continue
        lines = text.cut(block)
        if not text.is_clean:
            counts["control character left out"] += len(block.decode()) - len("\n".join(lines)) - 1
        for line in lines:
            index += 1
            if index < layout.begin:
                continue
            bare = line.strip(blank)
            if not bare:
                skipped.append(index)
                continue
            cells = layout.cells(line)
            if bare.startswith(_COMMENT):
                kind = "comment left out"
            elif tuple(cells) in layout.header:
                kind = "repeated header left out"
            elif len(cells) == width and (
                any(map(_is_value, cells)) or all(cell.lower() in _MISSING for cell in cells)
            ):
                rows += 1
                continue
            elif any(map(_is_number, cells)):
                kind = _INCOMPLETE
                first_incomplete = first_incomplete if incomplete else (index, len(cells))
                incomplete.append(index)
            elif len(cells) == width and set(cells) & set(layout.names):
                raise RecordingError(
                    "There is another header among the samples.",
                    file=file,
                    where=f"line {index + 1}",
                    found=shortened(", ".join(cells)),
                    expected="one table in a file, its columns in one order",
                )
            else:
                kind = "line of text left out"
            counts[kind] += 1
            skipped.append(index)
    if incomplete and incomplete[-1] == index:
        counts[_INCOMPLETE] -= 1
        counts["cut last line left out"] += 1
    if counts[_INCOMPLETE] > MOST_INCOMPLETE * rows:
        place, found = first_incomplete
        raise RecordingError(
            "This line does not have one cell for each column.",
            file=file,
            where=f"line {place + 1}",
            found=f"{found} cells",
            expected=f"{width}, as in the header",
        )
    if not rows:
        raise _no_table(file, text, [])
    return skipped, rows, {kind: count for kind, count in counts.items() if count > 0}


def _are_samples(block: bytes, separator: str, width: int) -> bool:
    """Whether every line begins as samples do and has as many cells, without cutting one."""
    import numpy as np

    codes = np.frombuffer(block, np.uint8)
    ends = np.flatnonzero(codes == ord("\n"))
    begins = np.concatenate([[0], ends[:-1] + 1])
    if block[-1:] != b"\n" or not np.isin(codes[begins], _BEGINS).all():
        return False
    if separator == " ":
        gaps = codes <= ord(" ")
        cells = np.flatnonzero(~gaps & np.concatenate([[True], gaps[:-1]]))
    else:
        cells = np.flatnonzero(codes == ord(separator))
        width -= 1
    return bool(np.all(np.diff(np.searchsorted(cells, ends), prepend=0) == width))


_SUFFIXES = (".csv", ".tsv", ".txt", ".log", ".lvm", ".asc", ".prn")

FORMAT = Format("CSV, TSV", _SUFFIXES, read_csv)
