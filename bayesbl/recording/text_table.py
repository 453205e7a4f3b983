"""Text as a table of numbers: samples are read whole, all other lines are left out and counted.

These rules hold for every dialect:

* the separator is the one that splits the middle of the file into equal rows of numbers;
* names are the last line above the samples with a name for each cell; units are a line of units
  below it, or a line above that begins with the word; a line may state the time between samples;
* columns behind times of their own become rows at the stamps of any of these times;
* comments, repeated headers, other text and a cut last line are left out; so are incomplete lines,
  as lost samples, up to :data:`MOST_INCOMPLETE` of all;
* the whole file has one decimal mark, and may group thousands with another mark;
* everything else is refused with its line and column.

The text is read once, in blocks of lines, so memory is that of the file and its numbers. NumPy
reads blocks of numbers only.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise, zip_longest

import numpy as np

from bayesbl.errors import RecordingError, shortened
from bayesbl.recording.array_table import (
    LONGEST_TEXT,
    MISSING,
    SCALES,
    AnyArray,
    ArrayTable,
    decimal_mark,
    is_bare_number,
    is_called_time,
    is_date,
    is_number,
    is_value,
    number_in,
    numbered,
    parted,
    require_one_mark,
)
from bayesbl.recording.channels import MOTOR_SPEED, TIME
from bayesbl.recording.input_bytes import require_memory
from bayesbl.recording.types import FloatArray
from bayesbl.units import conversion_factor, is_accepted, is_unit, spelled

_SEPARATORS = ("\t", ";", ",", "|", " ")
_BRACKETS = re.compile(r"[(\[{][^()\[\]{}]*[)\]}]")
_NUMBERED = re.compile(r" \(\d+\)$")
_OPEN = re.compile(r'(?:^|[\t;,|])\s*"[^"]+$')
"""A cell that begins with a quotation mark and does not end; inside a cell, as in ["], it is
text."""
_COMMENT = ("#", "%", "//")
_REMARKS = ("comment", "comments", "kommentar")
_UNITS, _LABELS = r"^(?![hx]).*(?:unit|einheit)", r"^(?:trace|channel|signal)?.?(?:name|label)s?$"
_KIND = re.compile(
    r"l?real|u?[dls]?int|(?:float|double|u?int)\d*|[fus](?:8|16|32|64)|[ld]?word|byte|bool",
    re.IGNORECASE,
)
"""A kind of number, in a row of its own below the names."""
_STEP = re.compile(
    r"\W*(?:(?P<rate>(?:sampl(?:e|ing)|scan).?(?:rate|frequency)|abtastrate)|abtast\w*"
    r"|delta.?x|[xt].?inc|x?.?increment|d[tx]"
    r"|(?:sampl(?:e|ing)|scan).?time"  # the time of a recording or trace is its length
    r"|(?:sampl(?:e|ing)|scan|record(?:er|ing)?|trace).?(?:interval|period|resolution))"
    r"\s*(?:[\[(](?P<unit>[^\])]*)[\])])?\s*(?:[:=]|is )?\s*(?P<value>.*)",
    re.IGNORECASE,
)
_LONGEST_STEP_S = 0.1  # A longer step may be in ms, or the length of the recording
MOST_ABOVE = 50  # non-blank lines in which the first sample is sought
MOST_COLUMNS = 1000  # A file may have more columns if it has as many lines
MOST_INCOMPLETE = 0.05  # largest share of incomplete lines that count as lost samples
_INCOMPLETE = "incomplete line left out, as a lost sample"
_BLOCK_BYTES = 1 << 20
_MIDDLE_LINES, _MIDDLE_BYTES = 200, 1 << 16
_MOST_SKIPPED = 1_000_000  # largest excess of other lines over samples
EXPECTED = "a CSV file: a header line with column names, then one line of numbers per sample"


class NoTable(RecordingError):
    """A text without lines of numbers."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Where a table begins in a text, and how its lines are split."""

    separator: str
    names: tuple[str, ...]
    mark: str = "."
    units: tuple[str, ...] = ()
    header: tuple[tuple[str, ...], ...] = ()
    begin: int = 0
    step_s: float | None = None

    def cells(self, line: str) -> list[str]:
        """Cells of a line, without empty ones beyond the last column."""
        cells = _split(line, self.separator)
        while len(cells) > len(self.names) and not cells[-1]:
            cells.pop()
        return cells


def _blocks(text: bytes) -> Iterator[list[str]]:
    """Blocks of some tens of thousands of lines."""
    begin = 0
    while begin < len(text):
        end = text.find(b"\n", begin + _BLOCK_BYTES) + 1 or len(text)
        yield text[begin:end].decode().removesuffix("\n").split("\n")
        begin = end


def lines_of(text: bytes) -> Iterator[str]:
    """All lines of a text in UTF-8."""
    return (line for block in _blocks(text) for line in block)


def middle_of(text: bytes) -> list[str]:
    """Some non-blank lines from the middle of the text."""
    size = len(text)
    if size <= 4 * _MIDDLE_BYTES:
        written = [line for line in lines_of(text) if line.strip()]
        return written[len(written) // 2 :][:_MIDDLE_LINES]
    part = text[size // 2 : size // 2 + _MIDDLE_BYTES].decode("utf-8", "replace")
    return [line for line in part.split("\n")[1:-1] if line.strip()][:_MIDDLE_LINES]


_STAMPED = re.compile(r"\s*(?:\[([^\]]*\d:\d\d[^\]]*)\](?=\s)|(\S+) ->\s)\s*")
"""A stamp that a terminal puts in front of each line: ``[2026-03-14 08:12:33.250] …``."""


def _split(line: str, separator: str) -> list[str]:
    stamp = _STAMPED.match(line)
    if stamp and is_date(stamped := stamp[1] or stamp[2]):
        return [stamped, *_split(line[stamp.end() :], separator)]
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


def _unit_of(rows: Sequence[Sequence[str]], column: int) -> str:
    """The unit that the cells state; several (``ms and s``) are none that is known."""
    cells = [row[column] for row in rows if column < len(row)]
    units = {parted(cell)[1] for cell in cells if is_value(cell)}
    return " and ".join(sorted(unit or "none" for unit in units)) if units - {""} else ""


def layout_of(
    head: Sequence[str],
    middle: Sequence[str],
    lines: int,
    separators: Sequence[str] = _SEPARATORS,
    *,
    fewest: int = 2,
    mark: str | None = None,
    is_binary: bool = False,
) -> Layout:
    """Layout of a table, from its first lines and some in the middle.

    ``lines``: number of lines; ``fewest``: cells of numbers in a sample; ``mark``: the decimal
    mark, if known; ``is_binary``: whether control characters were found. Raises NoTable if these
    lines are no table of numbers.
    """
    separator, width, values = _dialect(middle, separators, fewest)
    if width > max(MOST_COLUMNS, lines):
        raise RecordingError(
            "The file has more columns than lines: is it transposed?",
            found=f"{width} columns",
            expected="a column for each channel and a line for each sample",
        )
    head = _joined(head)
    written = [i for i, line in enumerate(head) if line.strip()]
    if not written:
        raise NoTable("The file is empty.", found="nothing", expected=EXPECTED)
    cut = [_split(line, separator) for line in head]
    first = None
    if len(values) >= fewest:
        samples = [row for row in (_split(line, separator) for line in middle) if len(row) == width]
        empty = [i for i, cells in enumerate(zip(*samples, strict=True)) if not any(cells)]
        first = _first_sample([cut[i] for i in written[: MOST_ABOVE + 1]], values, empty)
    if first is None:
        raise _no_table([head[i] for i in written], is_binary)
    # Some loggers end each line of samples with a separator, but not the header.
    trailing = all(line.rstrip().endswith(separator) for line in middle) and separator != " "
    above = written[:first]
    for i in above:
        if head[i].lstrip().startswith(_COMMENT):
            cut[i] = _split(head[i].lstrip().lstrip("#%/").strip(), separator)
        if any(len(cut[j]) == len(cut[i]) for j in above[: above.index(i)]):
            cut[i] = _of_one_key(cut[i])
        if len(cut[i]) == width + 1 and cut[i][-1].lower() in _REMARKS:
            cut[i].pop()  # LabVIEW ends its header so, and no line of samples
    above_cells = [cut[i] for i in above]
    step_s = _stated_step([[head[i]] for i in above] if separator == " " else above_cells)
    heading = _header_of(above_cells, {width, width - 1} if trailing else {width})
    rows = [cut[i] for i in written[first:]] + [_split(line, separator) for line in middle]
    numbers = [row[i] for row in rows for i in values if i < len(row)]
    mark = mark or decimal_mark(numbers)
    for k in values:
        require_one_mark([row[k] for row in rows if k < len(row)], mark)
    stated = tuple(_unit_of(rows, k) if k in values else "" for k in range(width))
    labels = _of_key(_LABELS, above_cells, width)
    if heading is None and any(labels):
        heading = len(above) - 1, ("",) * width, ()
    if heading is None and separator == "\t" and _dialect(middle, (" ",))[1] == width:
        return layout_of(head, middle, lines, (" ",))  # tabs among spaces
    begin = written[first]
    if heading is None:
        nearest = cut[above[-1]] if above else []
        if len(nearest) > 1 and not any(map(is_number, nearest)):
            raise _of_other_width(begin, width, len(nearest))
        unnamed = [f"column {i + 1}" for i in range(width)]
        words = [i for i in range(values[-1]) if i not in values]
        alternate = len(words) > 1 and words == [*range(words[0], values[-1], 2)]
        units_follow = any(cell for row in samples for cell in row[values[-1] + 1 :])
        if alternate and not units_follow:  # names before the values
            for i in words:
                called = {row[i] for row in samples}
                unnamed[i + 1] = called.pop() if len(called) == 1 else unnamed[i + 1]
        names = tuple(numbered(unnamed))
        return Layout(separator, names, mark, stated, begin=begin, step_s=step_s)
    last, names, units = heading
    units = units or _of_key(_UNITS, above_cells, width)
    scales = _rows_of_key(SCALES, above_cells, width)
    every = zip_longest(stated, units, *scales, fillvalue="")
    each = [with_scales(of_cells or of_row, more) for of_cells, of_row, *more in every]
    units = tuple(each[: len(names)])
    if heading[2] or not any(labels):
        labels = ()
    pairs = zip(labels, names, strict=False)
    names = tuple(n if n == label else f"{label} {n}" for label, n in pairs) + names[len(labels) :]
    names = tuple(name.strip() or f"column {i}" for i, name in enumerate(names, 1))
    header = tuple(tuple(cut[i]) for i in above[max(0, last - 1) : last + 1])
    return Layout(separator, names, mark, units, header, begin, step_s)


def _joined(head: Sequence[str]) -> list[str]:
    """Lines joined where a quoted name spans several; the others become blank."""
    joined = list(head)
    at = 0
    for i, line in enumerate(head):
        if i > at and _OPEN.search(joined[at]) and joined[at].count('"') < 200:
            joined[at] += f" {line}"
            joined[i] = ""
        else:
            at = i
    return joined


def _header_of(
    above: Sequence[list[str]], widths: set[int]
) -> tuple[int, tuple[str, ...], tuple[str, ...]] | None:
    """Index of the last header row above the samples, names, and units if any.

    Names are a row of one of these ``widths`` without numbers; a row of units may be below or
    above.
    """
    named: list[int] = []
    for i, cells in enumerate(above):
        while len(cells) > max(widths) and not cells[-1]:
            cells.pop()
        of_units = re.match(r"\w*(?:unit|einheit)", cells[0], re.IGNORECASE) if cells else None
        if not any(cells) or (of_units and any(is_unit(spelled(cell)) for cell in cells[1:])):
            continue
        if all(_KIND.fullmatch(cell) for cell in cells if cell):
            continue
        numbers = sum(map(is_bare_number, cells))
        if len(cells) in widths and not numbers:
            named.append(i)
        elif len(cells) > 1 and not 0 < numbers < sum(map(bool, cells)):
            named.clear()  # by a row of another table, but not by a word and its value
    if not named:
        return None
    titled = [above[i] for i in named]
    names = titled.pop()
    before = titled[-1] if titled else []
    below, on_top = ([cell.strip("[]() ") for cell in row] for row in (names, before))
    of_below, of_top = ([cell for cell in row if is_unit(spelled(cell))] for row in (below, on_top))
    units: list[str] = []
    if before and of_below and len(of_below) >= len(of_top):
        names, units = titled.pop(), below
        before = titled[-1] if titled else []
    elif len(set(of_top)) > 1 and len(of_top) == sum(map(bool, on_top)):
        units = on_top
        before = []
    if len(set(names)) < len(names) and len(set(filter(None, before))) > 1:
        # A title over each of several columns that are called alike: "Speed,,Current," over "X,Y";
        # or a kind below each of names that are all there: "date,D,D".
        if len(set(before)) == len(before) and all(before):
            names = ["" if names.count(name) > 1 else name for name in names]
        titles: Iterator[str] = accumulate(before, lambda last, title: title or last)
        names = [f"{title} {name}".strip() for title, name in zip(titles, names, strict=False)]
    return named[-1], tuple(numbered(names)), tuple(units[: len(names)])


def _of_one_key(cells: list[str]) -> list[str]:
    """Units of a row with "Unit: rpm" in every cell; empty for a row with another key."""
    keys = {cell.partition(":")[0] for cell in cells if cell}
    if len(cells) < 2 or len(keys) != 1 or not all(":" in cell for cell in cells if cell):
        return cells
    is_of_units = re.match(_UNITS, keys.pop(), re.IGNORECASE)
    return [cell.partition(":")[2].strip() for cell in cells] if is_of_units else []


def _rows_of_key(words: str, rows: Iterable[Sequence[str]], width: int) -> list[tuple[str, ...]]:
    """The rows whose first cell matches, without that cell; empty if a row is too long."""
    matching = [row for row in rows if len(row) > 2 and re.search(words, row[0], re.IGNORECASE)]
    return [() if any(row[width:]) else ("", *row[1:]) for row in matching]


def _of_key(words: str, rows: Iterable[Sequence[str]], width: int) -> tuple[str, ...]:
    """The last row whose first cell matches; empty without one."""
    return next(reversed(_rows_of_key(words, rows, width)), ())


def with_scales(unit: str, cells: Iterable[str]) -> str:
    """A unit and the factors or offsets that change anything, applied already or not."""
    for cell in filter(is_bare_number, cells):
        if not {number_in(cell, mark) for mark in ".,"} <= {None, 0.0, 1.0}:
            unit = f"{unit} (scale {cell})"
    return unit


def _stated_step(rows: Sequence[Sequence[str]]) -> float | None:
    """Seconds between samples stated above them, beside or below a word for it."""
    rows = [[re.sub("(?i)hz", "rps", cell) for cell in row] for row in rows]
    for row, below in zip(rows, [*rows[1:], []], strict=False):
        for i, cell in enumerate(row):
            match = _STEP.match(cell)
            beside = row[i + 1 : i + 3]
            if beside[1:] and is_unit(spelled(beside[1].strip("[]() "))):  # in a cell of its own
                beside = [" ".join(beside).strip()]
            for held in (match["value"], *beside[:1], *below[i : i + 1]) if match else ():
                number, unit = parted(held.translate(dict.fromkeys(map(ord, "[]()"))))
                value = number_in(number, decimal_mark([number]))
                if value and value > 0.0 and match is not None:
                    channel, usual = (MOTOR_SPEED, "rps") if match["rate"] else (TIME, "s")
                    unit = spelled(unit or match["unit"] or usual)
                    if is_accepted(channel, unit):
                        size = value * conversion_factor(channel, unit)
                        step = 60.0 / size if match["rate"] else size
                        return step if step <= _LONGEST_STEP_S else None
    return None


def _first_sample(
    rows: Sequence[Sequence[str]], values: Sequence[int], empty: Sequence[int]
) -> int | None:
    """The first row with values where the middle of the file has them, followed by another one, and
    with nothing in columns that are empty there.

    Column numbers are no sample, because names follow; nor are units with numbers above cells
    without units.
    """

    def is_sample(cells: Sequence[str]) -> bool:
        here = [cells[i] for i in values] if len(cells) > values[-1] else []
        known = all(cell.lower() in MISSING or is_value(cell) for cell in here)
        filled = any(cells[i] for i in empty if i < len(cells))
        return known and any(map(is_value, here)) and not filled

    in_cells = [[bool(parted(cell)[1]) for cell in row if cell] for row in rows]
    of_units = [all(here) and not any(below) for here, below in pairwise(in_cells)]
    followed = [any(map(is_value, row)) for row in rows[1:]]
    followed = [on and not units for on, units in zip(followed, of_units, strict=True)] + [True]
    pairs = zip(rows, followed, strict=True)
    return next((i for i, (row, on) in enumerate(pairs) if on and is_sample(row)), None)


def _dialect(
    lines: Sequence[str], separators: Sequence[str], fewest: int = 2
) -> tuple[str, int, list[int]]:
    """Separator, number of cells, and columns of values that give equal rows with most numbers."""
    best, chosen = 0.0, (",", 0, list[int]())
    for separator in separators:
        rows = [_split(line, separator) for line in lines]
        widths = Counter(map(len, rows))
        if not widths:
            continue
        width, count = widths.most_common(1)[0]
        if width < fewest:
            continue
        alike = [row for row in rows if len(row) == width]
        values, share = _value_columns(alike[:1] if width > MOST_COLUMNS else alike)
        score = count / len(rows) * share
        if len(values) >= fewest and score > 1.001 * best:
            best, chosen = score, (separator, width, values)
    return chosen


def _value_columns(rows: Sequence[Sequence[str]]) -> tuple[list[int], float]:
    """Columns of equal rows that hold numbers or dates, and the share of such cells."""
    values: list[int] = []
    share = 0.0
    for column, cells in enumerate(zip(*rows, strict=True)):
        held = [cell for cell in cells if cell.lower() not in MISSING]
        good = sum(map(is_value, held))
        share += (good + len(cells) - len(held)) / len(cells) / len(rows[0])
        if good >= 0.5 * len(held) if held else any(cells):
            values.append(column)
    return values, share


def _of_other_width(index: int, cells: int, expected: int) -> RecordingError:
    return RecordingError(
        "This line does not have one cell for each column.",
        where=f"line {index + 1}",
        found=f"{cells} cells",
        expected=f"{expected}, as in the header",
    )


def _no_table(lines: Sequence[str], is_binary: bool = False) -> NoTable:
    """The error for a text without a table; it quotes nothing, as a name may lead to any file."""
    if len(lines) == 1 and not is_binary and any(mark in lines[0] for mark in _SEPARATORS[:3]):
        problem, found = "The file has a header but no sample.", "a header only"
        return NoTable(problem, found=found, expected=EXPECTED)
    found = "binary data" if is_binary else "no lines with a number in two columns or more"
    return NoTable("This is not a CSV file.", found=found, expected=EXPECTED)


def table_of_text(text: bytes, layout: Layout, control: int = 0) -> ArrayTable:
    """The samples below the header, and counts of what is left out.

    ``control``: characters removed before. Raises RecordingError if there is no sample, another
    header among the samples, or too many incomplete lines.
    """
    width = len(layout.names)
    parts: list[list[AnyArray]] = [[] for _ in range(width)]
    places: list[AnyArray] = []
    counts = Counter({"control character left out": control} if control else {})
    incomplete: list[tuple[int, int]] = []
    rows, index, held = 0, 0, 0
    for block in _blocks(text):
        require_memory(len(text) + 2.0 * held, f"{rows} lines, or more")
        if index - rows > rows + _MOST_SKIPPED:
            raise _no_table([])
        lines = block[max(0, layout.begin - index) :]
        first = index + len(block) - len(lines)
        index += len(block)
        read = _quickly(lines, layout)
        if read is None:
            cut = _cut(lines, first, layout, counts, incomplete)
            places.append(np.array(list(cut), dtype=np.int64))
            columns = zip(*cut.values(), strict=True) if cut else ()
            units = (*layout.units, *[""] * width)
            each = zip(columns, units, strict=False)
            series = [_series(cells, unit, layout.mark) for cells, unit in each]
        else:
            places.append(np.arange(first, index))
            series = [np.ascontiguousarray(values) for values in read.T]
        rows += places[-1].size
        held += sum(values.nbytes for values in (places[-1], *series))
        for part, values in zip(parts, series, strict=bool(series)):
            part.append(values)
    if incomplete and incomplete[-1][0] == index - 1:
        counts[_INCOMPLETE] -= 1
        counts["cut last line left out"] += 1
    if counts[_INCOMPLETE] > MOST_INCOMPLETE * rows:
        raise _of_other_width(*incomplete[0], width)
    if not rows:
        raise _no_table([])
    arrays: dict[str, AnyArray] = {}
    for name, part in zip(layout.names, parts, strict=True):
        is_text = any(values.dtype.kind != "f" for values in part)
        joined = np.concatenate([v.astype("S") for v in part] if is_text else part)
        arrays[name] = _without_words(joined, counts) if is_text else joined
        part.clear()
    stated = {n: u for n, u in zip(layout.names, layout.units, strict=False) if u}
    repairs = {kind: count for kind, count in counts.items() if count > 0}
    numbers = np.concatenate(places) + 1
    return _with_one_clock(ArrayTable(arrays, stated, {}, {}, repairs, numbers, layout.step_s))


def _with_one_clock(table: ArrayTable) -> ArrayTable:
    """Merge columns behind several times of one name, at the stamps of any of these."""
    shared = _NUMBERED.sub("", table.columns[0])
    clocks = [name for name in table.columns if _NUMBERED.sub("", name) == shared]
    times = [table.arrays[name] for name in clocks]
    if len(times) < 2 or any(time.dtype.kind != "f" for time in times):
        return table
    new = [np.isfinite(t) & (np.diff(t, prepend=np.nan) != 0.0) for t in times]
    own = dict(zip(clocks, new, strict=True))
    behind: list[str] = []
    for name in table.columns:
        behind.append(name if name in own else behind[-1])
    called = {name: shared if name == clocks[0] else name for name in table.columns}
    of_clock = {called[n]: called[c] for n, c in zip(called, behind, strict=True)}
    rows = {name: own[clock] for name, clock in zip(called, behind, strict=True)}
    arrays = {called[n]: values[rows[n]] for n, values in table.arrays.items()}
    units = {called[n]: unit for n, unit in table.units.items()}
    apart = replace(table, arrays=arrays, units=units, clocks=of_clock, one_origin=True)
    stamps = np.concatenate([arrays[called[clock]] for clock in clocks])
    places = np.concatenate([np.flatnonzero(there) for there in new])
    lines = None if table.lines is None else table.lines[places[np.unique(stamps, True)[1]]]
    joined = apart.at_shared_stamps(apart.columns)
    return table if joined is apart else replace(joined, clocks={}, lines=lines)


def _quickly(lines: list[str], layout: Layout) -> FloatArray | None:
    """The numbers of lines by NumPy, shape (n, columns); ``None`` if they hold anything else."""
    separator, mark, text = layout.separator, layout.mark, "\n".join(lines)
    # A quoted cell may hold more separators; no sample has fewer.
    if separator != " " and text.count(separator) != (len(layout.names) - 1) * len(lines):
        return None
    if not text.strip() or any(bracket in text for bracket in "([{'’"):
        return None
    if '"' in text:
        text = text.replace('"', "")
    if separator != ",":
        if ("," if mark == "." else ".") in text:
            return None
        text = text.replace(",", ".")
    delimiter = None if separator == " " else separator
    try:
        read: FloatArray = np.loadtxt(text.split("\n"), delimiter=delimiter, comments=None, ndmin=2)
    except ValueError:
        return None
    return read if read.shape == (len(lines), len(layout.names)) else None


def _cut(
    lines: Sequence[str],
    first: int,
    layout: Layout,
    counts: Counter[str],
    incomplete: list[tuple[int, int]],
) -> dict[int, list[str]]:
    """Cells of each line that is a sample, by line number; the other lines are counted.

    ``incomplete`` gains line number and cell count of incomplete samples.
    """
    width, blank = len(layout.names), f' "\t{layout.separator}'
    samples: dict[int, list[str]] = {}
    for index, line in enumerate(lines, first):
        bare = line.strip(blank)
        if not bare:
            continue
        cells = layout.cells(line)
        if bare.startswith(_COMMENT):
            kind = "comment left out"
        elif tuple(cells) in layout.header and layout.step_s is None:
            kind = "repeated header left out"
        elif len(cells) == width and (
            any(map(is_value, cells)) or all(cell.lower() in MISSING for cell in cells)
        ):
            samples[index] = cells
            continue
        elif any(map(is_number, cells)):
            kind = _INCOMPLETE
            incomplete.append((index, len(cells)))
        elif set(cells) & set(layout.names) and (len(cells) == width or layout.step_s is not None):
            raise RecordingError(
                "There is another header among the samples.",
                where=f"line {index + 1}",
                found=shortened(", ".join(cells)),
                expected="one table in a file, its columns in one order",
            )
        else:
            kind = "line of text left out"
        counts[kind] += 1
    return samples


def _series(cells: Sequence[str], unit: str, mark: str) -> AnyArray:
    """Numbers, (n,), NaN if missing; texts if a cell is none, with numbers as in Python."""
    are_dates = is_date(cells[0])
    bare = (c if c.lower() in MISSING else c.removesuffix(unit).rstrip() for c in cells)
    numbers = [None if are_dates else number_in(cell, mark) for cell in bare]
    if None not in numbers:
        return np.array(numbers, dtype=float)
    texts = [
        cell if number is None else "" if number != number else repr(number)
        for cell, number in zip(cells, numbers, strict=True)
    ]
    return np.array([text.encode()[:LONGEST_TEXT] for text in texts])


def _without_words(texts: AnyArray, counts: Counter[str]) -> AnyArray:
    """Numbers, (n,), if all but a few texts are: words (``Bad``, ``No Data``) are lost samples."""
    letters = texts.view(np.uint8).reshape(texts.size, -1)
    no_digit = ~np.any((letters >= ord("0")) & (letters <= ord("9")), axis=1)
    lost = no_digit & (texts != b"") & (texts != b"nan")
    if not 0 < lost.sum() <= MOST_INCOMPLETE * texts.size:
        return texts
    try:
        numbers: FloatArray = np.where(no_digit, b"nan", texts).astype(float)
    except ValueError:
        return texts
    for word, count in zip(*np.unique(texts[lost], return_counts=True), strict=True):
        shown = shortened(word.decode(errors="replace"))
        counts[f'"{shown}" for a number, a lost sample'] += int(count)
    return numbers


_DATE = r"\d{4}-\d\d-\d\d[ T]\d\d:\d\d:\d\d(?:[.,]\d+)?"
_STAMP = rf"(?P<stamp>{_DATE}|\(?\d{{9,10}}\.\d+\)?)"
_NAME = r"(?P<name>[^\s\d(#%]\S*)"
_FORMS = tuple(
    re.compile(form + r"\s+(?P<value>\S+)(?:\s.*)?")
    for form in (rf"{_NAME}\s+{_STAMP}", rf"{_STAMP}\s+{_NAME}", rf"(?P<stamp>{_DATE})(?P<name>)")
)
_VALUE = re.compile(r"(?:^|[\W_]|(?<=[a-z]))(?:value|val|wert|payload)$", re.IGNORECASE)
_KEY = re.compile(
    r"(?:tag|name|signal|variable|field|joint|axis|achse|motor_?id|node)"
    r"(?:[\s_.]*(?:id|no|nr|name|number|nummer|index|\d+))?\W*$",
    re.IGNORECASE,
)
"""End of the name of a column that names what a line is of: not axis 1.SetVelo."""

_MOST_NAMES = 64
TIMES = 13.0  # memory, in sizes of the file, for a log or export whose cells are texts first
_LONGEST_EVENT = 1000
_ALIKE = 0.8  # share of events among the first lines from which a text is a log of events


_AHEAD = (
    ("clock", re.compile(rf"{_DATE}|\d\d:\d\d:\d\d[.,]\d+")),
    ("clock [ms]", re.compile(r"(?<=[A-Z] \()\d+(?=\))")),
)
"""Date, or milliseconds since a controller's start, in front of pairs."""

_PAIR = re.compile(
    r"(?<![^\s,;|])([^\W\d][^\s:=,;|]*)\s*[:=]\s*"
    r"([+-]?\d[\d.]*(?:[eE][+-]?\d+)?(?:\s?[^\W\d][^\s,;|:=]*(?!\s*[:=]))?)"
    r"(?=[\s,;|]|$)[\s,;|]*"
)


_LINE_PROTOCOL = re.compile(
    r"(?P<name>[^\s=]+(?:,[^\s=]+=\S+)?) (?P<fields>\S+=\S+) (?P<time>\d{10,})"
)
"""A line as databases of time series take it: ``drive,host=plc speed=1500.2,current=2.3 177…``."""


def in_lines(head: Sequence[str]) -> list[str] | None:
    """A whole text with a line for each channel (name, perhaps unit, samples) as lines of samples.

    ``None`` for any other text: the first line of a table does not end with a number.
    """
    for separator in _SEPARATORS[:3]:
        cut = [_split(line, separator) for line in head if line.strip()]
        width = max(map(len, cut), default=0)
        # A line that holds more than half of the cells is a channel, perhaps one that was cut off.
        rows = [row for row in cut if len(row) > width // 2]
        whole = sum(len(row) == width for row in rows)
        named = all(is_number(row[-1]) and not is_value(row[0]) for row in rows)
        if not (named and 1 < whole < width):
            continue
        for row in rows:
            if len(row) < width:
                raise RecordingError(
                    "The channels, a line each, differ in length.",
                    where=row[0],
                    found=f"{len(row)} cells, {width} in other lines",
                    expected="as many samples in every line",
                )
        return [separator.join(cells) for cells in zip(*rows, strict=True)]
    return None


def in_cells(text: bytes, head: Sequence[str]) -> ArrayTable | None:
    """A text whose lines name their values as a table: of changes, as by EPICS's camonitor, or of
    pairs of name and value.

    ::

        axis:Enc-PosAct 2020-12-08 16:17:33.317076 1.12222
        1607444253.317 axis:Enc-PosAct 1.12222
        [12:30:01.123] I (1234) motor: vel=12.3, cur=0.4
    """
    written = [line for line in head if line.strip()]
    may_be_table = any(len(line.split()) > 3 for line in written)
    for form in (None, *(_FORMS[:-1] if may_be_table else _FORMS)):
        rows = [row for line in written if (row := _row(form, line))]
        names, count = Counter(map(tuple, rows)).most_common(1)[0] if rows else ((), 0)
        if len(names) < 2 or count < max(2, _ALIKE * len(written)):
            continue
        require_memory(TIMES * len(text), "events")
        read = ((_row(form, line), line) for line in lines_of(text))
        cells = [
            [*r.values()] if tuple(r) == names else ["-"[: len(line.strip())]] for r, line in read
        ]
        units = tuple(_unit_of(cells, column) for column in range(len(names)))
        layout = Layout("\t", names, units=units)
        return table_of_text("\n".join(map("\t".join, cells)).encode(), layout)
    return None


def _row(form: re.Pattern[str] | None, line: str) -> dict[str, str]:
    """Names and values of an event's line, or of pairs without a form; empty for other lines."""
    line = line.strip()
    if len(line) > _LONGEST_EVENT:
        return {}
    if form is None and (protocol := _LINE_PROTOCOL.fullmatch(line)):
        pairs = (pair.partition("=") for pair in protocol["fields"].split(","))
        fields = {name: value.removesuffix("i") for name, _, value in pairs}
        fields = {name: value for name, value in fields.items() if is_bare_number(value)}
        return {"name": protocol["name"], **fields, "time": protocol["time"]} if fields else {}
    if form is None:
        first = _PAIR.search(line)
        if first is None or _PAIR.sub("", line[first.start() :]):
            return {}
        ahead = ((name, of.search(line[: first.start()])) for name, of in _AHEAD)
        return dict(_PAIR.findall(line)) | {name: found[0] for name, found in ahead if found}
    match = form.fullmatch(line)
    if match is None or number_in(match["value"], ".") is None:
        return {}
    name = {"name": match["name"]} if match["name"] else {}
    return {"time_s": match["stamp"].strip("()"), **name, "value": match["value"]}


_QUALITY = re.compile(r"(?:^|[\W_]|(?<=[a-z]))(?:quality|status|status_?code)$", re.IGNORECASE)
_BAD = re.compile(r"(?:bad|uncertain)|0x[48]\w{3}(?:0000|0[4-7]\w\w)$", re.IGNORECASE)
"""Words, or codes of OPC UA. These have reserved bits of 0, which a drive's status seldom has."""


def without_bad(table: ArrayTable) -> ArrayTable:
    """NaN for numbers in rows that OPC's quality or status calls bad or uncertain."""
    sizes = {values.size for values in table.arrays.values()}
    bad = np.zeros(max(sizes, default=0), dtype=bool)
    for name in filter(_QUALITY.search, table.columns if len(sizes) == 1 else ()):
        words, rows, counts = np.unique(
            table.arrays[name].astype("U"), return_inverse=True, return_counts=True
        )
        are_bytes = words[np.argmax(counts)] in ("192", "192.0")  # of OPC DA; good from 192 on
        bad |= np.array(
            [
                float(word) < 192.0
                if are_bytes and is_bare_number(word)
                else bool(_BAD.match(word))
                for word in words.tolist()
            ]
        )[rows]
    if not bad.any():
        return table
    arrays = {
        name: np.where(bad, np.nan, v) if v.dtype.kind in "iuf" and not is_called_time(name) else v
        for name, v in table.arrays.items()
    }
    told = {"row of bad quality, a lost sample": int(bad.sum())}
    return replace(table, arrays=arrays, repairs={**table.repairs, **told})


def in_columns(table: ArrayTable) -> ArrayTable:
    """Columns by name, from a table with one value on each line (historians, InfluxDB) or one line
    for each joint.

    ::

        TagName,Timestamp,Value,Quality
        J3.Position,2026-03-14T08:12:33.005Z,1.12222,192
    """
    table = without_bad(table)
    if table.clocks or len({v.size for v in table.arrays.values()}) != 1:
        return table
    numbers = {
        n: v.astype(float, copy=False) for n, v in table.arrays.items() if v.dtype.kind in "iuf"
    }
    held = {n: v for n, v in numbers.items() if _VALUE.search(n)}
    values = [*held.values()]
    # Several such columns are copies, or one for each kind of number.
    if values and np.array_equal(np.fmin.reduce(values), np.fmax.reduce(values), equal_nan=True):
        values = [np.fmin.reduce(values)]
    keys = []
    for name, cells in table.arrays.items():
        is_called, is_text = _KEY.search(name) is not None, cells.dtype.kind in "SUO"
        if name in held or not (is_called or is_text):
            continue
        if cells.dtype.kind in "UO":
            cells = np.array([b"" if c is None else str(c).encode() for c in cells.tolist()])
        if is_text and is_date(next(filter(None, cells.tolist()), b"").decode()):
            continue
        words, index, times = np.unique(cells, return_inverse=True, return_counts=True)
        repeats = times[times > 1].sum() >= _ALIKE * index.size and words.size <= _MOST_NAMES
        if repeats and (is_called or (values and words.size > 1)):
            keys.append(((not is_called, -words.size), name, words, index, times))
    dates = {n: t for n in table.columns if keys and (t := table.timestamps(n)) is not None}
    for _, name, words, index, times in sorted(keys, key=lambda key: key[0]):
        key = np.array([w.decode() if isinstance(w, bytes) else f"{w:g}" for w in words])[index]
        most = index == np.argmax(times)
        clocks = dates | {n: v for n, v in numbers.items() if n not in held}
        for clock, time in sorted(clocks.items(), key=lambda each: not is_called_time(each[0])):
            steps = np.diff(time[most])
            if clock == name or not (np.all(steps > 0.0) or np.all(steps < 0.0)):
                continue
            columns = {"": values[0]} if len(values) == 1 else {}
            turns = np.mean(index[1:] != index[:-1]) > 0.5 or np.any(np.diff(time) <= 0.0)
            if not values and words.size > 1 and turns:
                columns = {f"/{n}": v for n, v in numbers.items() if n not in (clock, name)}
            if columns:
                return _of_events(table, clock, time, key, columns, dates)
    return table


def _of_events(
    table: ArrayTable,
    clock: str,
    time: FloatArray,
    names: AnyArray,
    columns: Mapping[str, FloatArray],
    dates: Mapping[str, FloatArray],
) -> ArrayTable:
    """Columns over all stamps from the first at which every name has a value; shapes (n,).

    A value is held until the next one of its name. Lines of several values (``NAME/velocity``) are
    samples, of which nothing is held. Dates that are too coarse for a clock may show its unit.
    """
    repairs = Counter(table.repairs)
    order = np.argsort(time, kind="stable")
    there = np.any([np.isfinite(values) for values in columns.values()], axis=0)
    of_name = {name: order[names[order] == name] for name in dict.fromkeys(names.tolist())}
    of_name = {name: own for name, own in of_name.items() if there[own].sum() > 1}
    rows = np.unique(time[np.isin(names, [*of_name])])
    if "" in columns:
        rows = rows[rows >= max((time[own[0]] for own in of_name.values()), default=0.0)]
    arrays: dict[str, AnyArray] = {}
    for name, seconds in list(dates.items())[: clock not in dates]:
        at = order[np.searchsorted(time[order], rows)]
        arrays[name] = np.datetime64(0, "ns") + (1e9 * seconds[at]).astype("m8[ns]")
    arrays[TIME if clock in dates else clock] = rows
    for name, own in of_name.items():
        last = own[np.searchsorted(time[own], rows, "right") - 1]
        late = time[last] != rows
        if "" in columns:
            arrays[name] = columns[""][last]
            repairs["value of an event log, held until the next"] += int(late.sum())
        else:
            arrays |= {name + key: np.where(late, np.nan, v[last]) for key, v in columns.items()}
    units = {name: unit for name, unit in table.units.items() if name == clock}
    return ArrayTable(arrays, units, repairs=repairs)
