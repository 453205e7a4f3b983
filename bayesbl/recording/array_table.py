"""A table of named columns, and the meaning of a text cell.

A cell holds a number (with a decimal mark, and possibly a unit) or a date. Only differences between
dates and clock times count, as seconds since the first one. So the order of day and month in
03/04/2026 need not be known: a date that differs from the one before it is the next day.

Files of arrays (NetCDF, MATLAB, Parquet, …) are such tables. In some formats (bags, MDF, TDMS,
Scope), columns are sampled in groups, each with its own clock.
"""

from __future__ import annotations

import math
import re
from array import array
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesbl.errors import RecordingError, shortened
from bayesbl.recording.channels import TIME
from bayesbl.recording.types import FloatArray
from bayesbl.units import OTHER_UNITS, is_unit, plain_letters, spelled

MISSING = frozenset(
    "|nan|-nan|nan(ind)|-nan(ind)|1.#qnan|-1.#ind|null|none|nil|n/a|na|#n/a|#na|#value!|#div/0!"  # noqa: SIM905
    "|#num!|-|--|---|?|missing|∞|-∞".split("|")
)
_PLAIN = {mark: re.compile(rf"[+-]?(\d+[{mark}]?\d*|[{mark}]\d+)([eE][+-]?\d+)?") for mark in ".,"}
_GROUPED = {
    mark: re.compile(rf"[+-]?[1-9]\d{{0,2}}(?:[{other}'’\u00a0\u202f ]\d{{3}})+(?:[{mark}]\d*)?")
    for mark, other in ((".", ","), (",", "."))
}
_ONE_GROUP = {mark: re.compile(rf"[+-]?[1-9]\d{{0,2}}[{mark}]\d{{3}}") for mark in ".,"}
_WITH_UNIT = re.compile(r"([+\-−]?\d[^\sA-Za-z]*(?:[eE][+-]?\d+)?)\s?([^\d\s.,:+\-/].*)")
"""A number with its unit, as exports write it: ``0.001 sec``, ``1500.2 rpm``."""


SCALES = r"scal|skal|fa[ck]tor|offset|gain|multiplier"
"""In names of what may have been applied to the values or not: a question to the user."""


def number_in(cell: str, mark: str) -> float | None:
    """The number in a cell, NaN for a missing value, ``None`` for text."""
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
    if text.lower() in MISSING:
        return float("nan")
    if _GROUPED[mark].fullmatch(text):
        plain = re.sub(r"[^\d+.,-]", "", text).replace("." if mark == "," else ",", "")
        return float(plain.replace(",", "."))
    return None


def parted(cell: str) -> tuple[str, str]:
    """Number and unit of a cell; the whole cell and no unit if what follows is no word for one."""
    held = _WITH_UNIT.fullmatch(cell)
    if held is None:
        return cell, ""
    is_unit_here = is_unit(spelled(held[2])) or held[2] in ("%", "‰")
    is_other = plain_letters(held[2]) in OTHER_UNITS
    return (held[1], held[2]) if is_unit_here or is_other else (cell, "")


def is_number(cell: str) -> bool:
    """Whether a cell holds a number with either decimal mark, with or without a unit."""
    return is_bare_number(parted(cell)[0])


def is_bare_number(cell: str) -> bool:
    return any(
        (value := number_in(cell, mark)) is not None and (value == value or cell.lower() == "nan")
        for mark in ".,"
    )


def is_value(cell: str) -> bool:
    """Whether a cell holds a number or a date."""
    return is_date(cell) or is_number(cell)


def decimal_mark(cells: Sequence[str]) -> str:
    """The decimal mark (comma or point) that fits most numbers."""
    cells = [number for cell in cells if is_bare_number(number := parted(cell)[0])]
    if not any("," in cell for cell in cells):
        return "."
    fits = {mark: sum(number_in(cell, mark) is not None for cell in cells) for mark in ".,"}
    if fits["."] == fits[","]:
        raise _may_be_decimal(next(cell for cell in cells if "," in cell), ",")
    return "," if fits[","] > fits["."] else "."


def require_one_mark(cells: Sequence[str], mark: str) -> None:
    """Refuse a column whose cells all have one group of three digits behind the other mark.

    They may be decimals of another program, as time is beside numbers that a person's region sets.
    """
    other = "," if mark == "." else "."
    numbers = [number for cell in cells if is_bare_number(number := parted(cell)[0])]
    if len(numbers) > 2 and all(_ONE_GROUP[other].fullmatch(number) for number in numbers):
        raise _may_be_decimal(numbers[0], other)


def _may_be_decimal(example: str, mark: str) -> RecordingError:
    what = {",": "comma may be a decimal comma", ".": "point may be a decimal point"}[mark]
    return RecordingError(
        f"A {what} here, or part thousands.",
        found=repr(shortened(example)),
        expected=f"{example.replace(mark, '.')} or {example.replace(mark, '')}: numbers without "
        "marks between thousands",
    )


_STAMP = re.compile(
    r"(?:\d+ days? +)?"  # as pandas writes a duration: begun again after a day, it is the next
    r"(?:L?DTL?#)?(?:(\d{1,4})([-./])(\d{1,2})\2(\d{1,4})[T ,;_@-]*)?"
    r"(\d{1,2}):(\d{2})(?:(?<=\d[T ]\d\d:\d\d)|:(\d{2})(?:[.,:;](\d{1,9}))?)"
    r"\s*([AaPp]\.?[Mm]\.?)?\s*(Z|[+-]\d{2}:?\d{2})?"
)
_COMPACT = re.compile(r"(\d{4})([-_.]?)(\d\d)\2(\d\d)[T_](\d\d)([-:]?)(\d\d)\6(\d\d)(?!\d)")
"""Dates of file names and ISO's basic format: ``20261130T083000``, ``2026-11-30_08-30-00``."""

_DAY_S = 86400
_IN_A_SECOND = {"nano": 1e9, "n": 1e9, "micro": 1e6, "u": 1e6, "milli": 1e3, "m": 1e3}
_PART_OF_SECOND = re.compile(
    rf"({'|'.join(_IN_A_SECOND)})(s(?:ecs?|econds?|ek(?:unden)?)?|tm)$", re.IGNORECASE
)

_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_OTHER_MONTHS = {"mär": "mar", "mrz": "mar", "mai": "may", "okt": "oct", "dez": "dec"}
_NAMED_MONTH = re.compile(
    r"(?:[^\W\d_]{2,3}[,.]? +)?(?:(\d{1,2})[-. /]+)?([^\W\d_]{3})[^\W\d_]*[-. /]+(?:(\d{1,2}),? +)?"
    r"(\d{4}|\d\d)(?=[ ,T])"
)


def _stamp(text: str) -> re.Match[str] | None:
    """Match date or time; months may be named: ``14-Mar-26 08:12:33``, ``Mar 14, 2026``."""
    text = _COMPACT.sub(r"\1-\3-\4T\5:\7:\8", text)
    text = re.sub(r"^(\d{1,2}:\d\d[.,]\d+)$", r"0:\1", text)  # minutes and seconds
    text = re.sub(r"^(\D+ \d\d?) ([\d:.,]+) (\d{4})$", r"\1, \3 \2", text)  # of asctime
    named = _NAMED_MONTH.match(text)
    if named and bool(named[1]) != bool(named[3]):
        month = _OTHER_MONTHS.get(named[2].lower(), named[2].lower())
        if month in _MONTHS:
            number = _MONTHS.index(month) + 1
            text = f"{named[1] or named[3]}.{number}.{named[4]}{text[named.end() :]}"
    return _STAMP.fullmatch(text)


def is_date(text: str) -> bool:
    """Whether a text is a date or a time of day, rather than a number such as 20260301."""
    return any(mark in text for mark in ":T_") and _stamp(text.strip()) is not None


def seconds_of_dates(texts: Iterable[str], place: Callable[[int], str]) -> FloatArray:
    """Seconds since the first date, shape (n,); NaN for empty texts.

    A time of day that starts again belongs to the next day. ``place`` gives the place of a row.
    Raises RecordingError at the first text that is not a date of the same form as the first.
    """
    time = array("d")
    days: dict[str, int] = {}
    form: tuple[bool, bool] | None = None
    start = before = day = 0
    for row, given in enumerate(texts):
        text = given.strip()
        if not text:
            time.append(math.nan)
            continue
        stamp = _stamp(text)
        read = stamp and _of_stamp(stamp, days)
        if read is None or (form is not None and read[2] != form):
            raise RecordingError(
                "This is not a date like those before it.",
                where=place(row),
                found=repr(shortened(text)),
                expected="a date with a time, as 2026-03-01T12:00:00.250",
            )
        seconds, fraction, has = read
        if not has[0]:
            seconds += day * _DAY_S
            if form is not None and before - seconds > _DAY_S // 2:
                day += 1
                seconds += _DAY_S
        if form is None:
            start, form = seconds, has
        before = seconds
        # As whole numbers first: seconds since the year 1 do not leave room for microseconds.
        time.append(seconds - start + fraction)
    stamps_s: FloatArray = np.array(time)
    return np.asarray(stamps_s - stamps_s[np.isfinite(stamps_s)][:1].sum())


def _of_stamp(
    stamp: re.Match[str], days: dict[str, int]
) -> tuple[int, float, tuple[bool, bool]] | None:
    """Whole seconds, fraction of a second, and whether the stamp has a date and a time zone.

    ``days`` numbers ambiguous dates in the order in which they occur.
    """
    a, mark, b, c, hours, minutes, seconds, digits, half, zone = stamp.groups()
    hour, minute, second, count = int(hours), int(minutes), int(seconds or 0), 0
    if hour > (12 if half else 23) or (half and not hour) or minute > 59 or second > 60:
        return None
    if half:
        hour = hour % 12 + (12 if half[0] in "Pp" else 0)
    if a is not None:
        of_dots = (c if len(c) == 4 else f"20{c}", b, a) if mark == "." else None
        order = (a, b, c) if len(a) == 4 else of_dots
        try:
            # A date of open order is the day after the last one that was new.
            known = date(*map(int, order)).toordinal() if order else 0
        except ValueError:
            return None
        count = days.setdefault(f"{a}{b}{c}", known or max(days.values(), default=0) + 1)
    total = count * _DAY_S + hour * 3600 + minute * 60 + second
    if zone and zone != "Z":
        size = int(zone[1:3]) * 3600 + int(zone[-2:]) * 60
        total -= size if zone[0] == "+" else -size
    return total, float(f"0.{digits or 0}"), (a is not None, zone is not None)


def seconds_of_calendar(times: NDArray[np.datetime64]) -> FloatArray:
    """Seconds since the first instant, shape (n,); NaN for NaT."""
    known = ~np.isnat(times)
    seconds = np.full(times.shape, np.nan)
    if known.any():
        # As integers first: nanoseconds since 1970 do not fit into a double.
        steps = (times[known] - times[known][0]).astype("timedelta64[ns]")
        seconds[known] = steps.astype(np.int64) * 1e-9
    return seconds


AnyArray = NDArray[Any]
LONGEST_TEXT = 60  # letters kept of a text cell: dates are shorter, and messages quote less


@dataclass(frozen=True, slots=True)
class ArrayTable:
    """One-dimensional arrays by name."""

    arrays: Mapping[str, AnyArray]  # shape (n,) each; n may differ
    units: Mapping[str, str] = field(default_factory=dict)  # that the file states
    clocks: Mapping[str, str] = field(default_factory=dict)  # a column's time column, in s
    withheld: Mapping[str, str] = field(default_factory=dict)  # why an array is empty
    repairs: Mapping[str, int] = field(default_factory=dict)  # what was left out, how many times
    lines: NDArray[np.int64] | None = None  # line in a text of each row, from 1, shape (n,)
    step_s: float | None = None  # time between rows, if the file states it
    one_origin: bool = False  # whether all clocks count from the same instant
    file: str = ""  # path as the user gave it, for messages

    @property
    def columns(self) -> tuple[str, ...]:
        """Names in the order of the file."""
        return tuple(self.arrays)

    def numbered(self) -> ArrayTable:
        """The table with a time column made from row numbers or the stated step, if the file has no
        clock."""
        if TIME in self.arrays or self.clocks or not self.arrays:
            return self
        rows = max(values.size for values in self.arrays.values())
        time = np.arange(rows) * (1.0 if self.step_s is None else self.step_s)
        return replace(self, arrays={TIME: time, **self.arrays})

    def at_shared_stamps(self, names: Sequence[str], most: float = math.inf) -> ArrayTable:
        """These columns at the union of their clocks' stamps, with missing values filled in as NaN.

        The table is unchanged if there is one clock, if clocks cannot be compared, or if one has
        more than ``most`` times as many stamps as another.
        """
        clocks = [*dict.fromkeys(self.clocks[n] for n in names if n in self.clocks)]
        times = {clock: self.arrays[clock] for clock in clocks}
        if len(clocks) < 2 or not self.one_origin or not all(map(_increases, times.values())):
            return self
        sizes = [t.size for t in times.values()]
        if max(t[0] for t in times.values()) >= min(t[-1] for t in times.values()):
            return self
        if max(sizes) > most * min(sizes):
            return self
        stamps = np.unique(np.concatenate([*times.values()]))
        shared = next((name for name in names if name in times), clocks[0])
        arrays: dict[str, AnyArray] = {shared: stamps}
        for name in names:
            if name not in times and name in self.clocks and name not in self.withheld:
                values = self.arrays[name]
                kind, missing = (values.dtype, b"") if values.dtype.kind == "S" else (float, np.nan)
                arrays[name] = np.full(stamps.size, missing, dtype=kind)
                arrays[name][np.searchsorted(stamps, times[self.clocks[name]])] = values
        units = {name: unit for name, unit in self.units.items() if name in arrays}
        return replace(self, arrays=arrays, units=units, clocks=dict.fromkeys(arrays, shared))

    def place(self, row: int, column: str) -> str:
        """Where a value is, in words."""
        which = f"sample {row + 1}" if self.lines is None else f"line {self.lines[row]}"
        return f'{which}, column "{column}"'

    def reversed(self) -> ArrayTable:
        """The table with its rows in reverse order."""
        lines = None if self.lines is None else self.lines[::-1]
        return replace(self, arrays={n: v[::-1] for n, v in self.arrays.items()}, lines=lines)

    def without_values(self) -> ArrayTable:
        """The table with empty columns: names, units and places remain."""
        return replace(self, arrays={name: values[:0] for name, values in self.arrays.items()})

    def timestamps(self, column: str) -> FloatArray | None:
        """Seconds since the first date; ``None`` if the column does not hold dates.

        Raises RecordingError at the first value that is not a date in a column of dates.
        """
        values = self._values(column)
        if values.dtype.kind == "M":
            return seconds_of_calendar(values)
        if values.dtype.kind not in "OSU":
            return None
        texts = [_text(value) for value in values.tolist()]
        if not is_date(next(filter(None, texts), "")):
            return None
        seconds = seconds_of_dates(texts, lambda row: self.place(row, column))
        return self.with_parts(seconds)

    def with_parts(self, stamps: FloatArray, time: str = "") -> FloatArray:
        """Whole seconds, shape (n,), plus the parts of a second in another column.

        That is a column of the same name (``tv_sec`` and ``tv_usec``, ``stamp.nanosec``), or beside
        dates (``Date,Time,Millitm``) any one that is in order within each second.
        """
        steps = np.diff(stamps)
        if np.any(stamps != np.floor(stamps)) or (np.all(steps > 0.0) and not time):
            return stamps
        for name, parts in self.arrays.items():
            called = _PART_OF_SECOND.search(name)
            if called is None or parts.dtype.kind not in "iuf" or parts.size != stamps.size:
                continue
            parts, whole = parts.astype(np.float64), _IN_A_SECOND[called[1].lower()]
            within = np.diff(parts)[steps == 0.0]
            if time:
                fits = (name[: called.start()] + called[2]).lower() == time.lower() != name.lower()
            else:
                fits = not name[: called.start()][-1:].isalnum()
                fits = fits and bool(np.all(within >= 0.0) or np.all(within <= 0.0))
                fits = fits and bool(np.any(within))  # a constant, as a delay, is no clock
            if fits and np.all((parts >= 0.0) & (parts < whole)):
                return np.asarray(stamps - stamps[0] + (parts - parts[0]) / whole)
        return stamps

    def numbers(self, columns: Sequence[str]) -> FloatArray:
        """Values of some columns, shape (n, len(columns)); NaN for missing ones.

        Raises RecordingError if lengths differ, or a column does not hold real numbers.
        """
        values: FloatArray = np.empty((self.samples_of(columns), len(columns)), order="F")
        for series, column in zip(values.T, columns, strict=True):
            series[:] = self._number(column)
        return values

    def samples_of(self, columns: Sequence[str]) -> int:
        """Number of samples of these columns. Raises RecordingError if it differs between them."""
        lengths = {column: self._values(column).size for column in columns}
        if len(set(lengths.values())) > 1:
            raise RecordingError(
                "The columns do not have the same number of samples.",
                where=", ".join(f'"{name}"' for name in lengths),
                found=" and ".join(str(length) for length in lengths.values()),
                expected="one value of each for every time stamp",
            )
        return lengths.popitem()[1]

    def _values(self, column: str) -> AnyArray:
        if column in self.withheld:
            raise RecordingError(
                "The values of this column cannot be used.",
                where=f'column "{column}"',
                found=self.withheld[column],
                expected="values as they were measured, or scaled by a factor and an offset",
            )
        return self.arrays[column]

    def _number(self, column: str) -> FloatArray:
        values = self._values(column)
        if values.dtype.kind in "biuf":
            filled = np.ma.filled(np.ma.asarray(values, dtype=np.float64), np.nan)
            return np.asarray(filled, dtype=np.float64)
        if values.dtype.kind == "m":
            return np.asarray(values / np.timedelta64(1, "ns"), dtype=np.float64) * 1e-9
        if values.dtype.kind in "OSU":
            return self._number_in_text(values, column)
        kinds = {"M": "dates", "c": "complex numbers"}
        raise RecordingError(
            "This column does not hold numbers.",
            where=f'column "{column}"',
            found=kinds.get(values.dtype.kind, str(values.dtype)),
            expected="real numbers",
        )

    def _number_in_text(self, values: AnyArray, column: str) -> FloatArray:
        """Numbers in text cells, NaN for empty ones."""
        numbers = np.full(values.size, np.nan)
        for row, value in enumerate(values.tolist()):
            text = _text(value)
            if text == "":
                continue
            number = number_in(text, ".")
            if number is None:
                raise RecordingError(
                    "There is text in a column of numbers.",
                    where=self.place(row, column),
                    found=repr(shortened(text)),
                    expected="one unit for the whole column, in its name"
                    if " and " in self.units.get(column, "")
                    else "a number, or an empty cell for a lost sample",
                )
            numbers[row] = number
        return numbers

    def plain_arrays(self) -> Iterator[AnyArray]:
        """Columns without Python objects: numbers, dates, or shortened texts."""
        for values in self.arrays.values():
            if not values.dtype.hasobject:
                yield np.ascontiguousarray(values)
            else:
                texts = [shortened(_text(value), LONGEST_TEXT) for value in values.tolist()]
                yield np.array(texts, dtype=np.str_)


@dataclass(frozen=True, slots=True)
class Group:
    """Columns that were sampled together."""

    name: str  # prefix of column names that other groups have too: a joint, a topic
    columns: Mapping[str, AnyArray]  # shape (n,) each
    time: AnyArray | None = None  # clock in s or dates, shape (n,); None to look for a column
    units: Mapping[str, str] = field(default_factory=dict)
    withheld: Mapping[str, str] = field(default_factory=dict)


def _increases(stamps: AnyArray) -> bool:
    return stamps.dtype.kind in "iuf" and stamps.size > 0 and bool(np.all(np.diff(stamps) > 0))


def numbered(names: Sequence[str]) -> list[str]:
    """Make names unique: repeated names become ``n (1)``, ``n (2)``; empty ones stay."""
    times = Counter(names)
    taken = set(times)
    reached: Counter[str] = Counter()
    unique: list[str] = []
    for name in names:
        free = name
        while name and times[name] > 1 and (free == name or free in taken):
            reached[name] += 1
            free = f"{name} ({reached[name]})"
        taken.add(free)
        unique.append(free)
    return unique


_CLOCK = re.compile(
    r"\W*(?:t|time|time ?stamp|zeit|temps|tempo)(?:_?(?:s|ms|us|ns)|\s*[\[(/].*)?", re.IGNORECASE
)


def is_called_time(name: str) -> bool:
    """Whether a column's name says that it is a clock."""
    return _CLOCK.fullmatch(name) is not None


def table_of_groups(
    groups: Sequence[Group], *, always_prefixed: bool = False, one_origin: bool = False
) -> ArrayTable:
    """All columns of all groups, each with the clock of its group (``time``, or a column called
    time).

    Groups of the same name are numbered. A column name that occurs in several groups becomes
    ``GROUP/NAME``; with ``always_prefixed``, all names do. The clock of a group is its ``time_s``.
    """
    prefixes = numbered([group.name for group in groups])
    with_clocks = [
        {TIME: group.time, **group.columns}
        if group.time is not None and TIME not in group.columns
        else dict(group.columns)
        for group in groups
    ]
    times = Counter(name for columns in with_clocks for name in columns)
    arrays: dict[str, AnyArray] = {}
    units: dict[str, str] = {}
    clocks: dict[str, str] = {}
    withheld: dict[str, str] = {}
    for group, prefix, columns in zip(groups, prefixes, with_clocks, strict=True):
        full = {
            name: f"{prefix}/{name}" if always_prefixed or times[name] > 1 else name
            for name in columns
        }
        arrays |= {full[name]: values for name, values in columns.items()}
        stated = {name: unit for name, unit in group.units.items() if name in columns}
        units |= {full[name]: unit for name, unit in stated.items() if unit.strip()}
        withheld |= {full[name]: reason for name, reason in group.withheld.items()}
        called = [name for name in columns if name != TIME and is_called_time(name)]
        increasing = (
            n for n in called if columns[n].dtype.kind not in "iuf" or _increases(columns[n])
        )
        clock = TIME if TIME in columns else next(increasing, None) if len(groups) > 1 else None
        if clock is not None:
            clocks |= dict.fromkeys(full.values(), full[clock])
    return ArrayTable(arrays, units, clocks, withheld, one_origin=one_origin)


def _text(value: object) -> str:
    """Text of a cell; empty for a missing value."""
    if value is None or np.any(value != value) or type(value).__name__ in ("NAType", "NaTType"):
        return ""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace").strip()
    return str(value).strip()
