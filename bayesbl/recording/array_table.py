"""Files that hold arrays (NetCDF, MATLAB, Parquet, …) as a table of columns; in some, columns are
sampled in groups, each by its own clock (bags, MDF, TDMS, Scope).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesbl.errors import RecordingError, shortened
from bayesbl.recording.cells import is_date, number_in, seconds_of_calendar, seconds_of_dates
from bayesbl.recording.channels import TIME
from bayesbl.recording.types import FloatArray

AnyArray = NDArray[Any]

LONGEST_TEXT = 60
"""Of a cell: dates are shorter, and messages quote less."""


@dataclass(frozen=True, slots=True)
class ArrayTable:
    """One-dimensional arrays by name.

    Attributes
    ----------
    file
        Path as the user gave it, for messages.
    arrays
        Name to values, shape (n,) each; n may differ between arrays that nobody asks for.
    units
        Units that the file itself states, by name.
    clocks
        Of columns that are sampled in groups, the column that holds their time in s, by name.
    withheld
        Why the values of a column are not read, by its name; its array is empty.
    repairs
        What was left out as the file was read, in words, and how many times.
    lines
        Of a text, the line that each row is in, from 1, shape (n,).
    """

    file: str
    arrays: Mapping[str, AnyArray]
    units: Mapping[str, str] = field(default_factory=dict)
    clocks: Mapping[str, str] = field(default_factory=dict)
    withheld: Mapping[str, str] = field(default_factory=dict)
    repairs: Mapping[str, int] = field(default_factory=dict)
    lines: NDArray[np.int64] | None = None

    @property
    def columns(self) -> tuple[str, ...]:
        """Names in the order of the file."""
        return tuple(self.arrays)

    def unit(self, column: int) -> str | None:
        """What the file says of a column's unit."""
        return self.units.get(self.columns[column])

    def clock(self, column: int) -> int | None:
        """The column that holds a column's time, where the file ties them together."""
        name = self.clocks.get(self.columns[column])
        return None if name is None else self.columns.index(name)

    def place(self, row: int, column: int) -> str:
        """Where a value is, in words."""
        which = f"sample {row + 1}" if self.lines is None else f"line {self.lines[row]}"
        return f'{which}, column "{self.columns[column]}"'

    def without_values(self) -> ArrayTable:
        """Its names and places alone."""
        return replace(self, arrays={name: values[:0] for name, values in self.arrays.items()})

    def timestamps(self, column: int) -> FloatArray | None:
        """Seconds since the first date; ``None`` if the column does not hold dates.

        Raises
        ------
        RecordingError
            At the first value that is no date in a column of dates.
        """
        values = self._values(column)
        if values.dtype.kind == "M":
            return seconds_of_calendar(values)
        if values.dtype.kind not in "OSU":
            return None
        texts = [_text(value) for value in values.tolist()]
        if not is_date(next((text for text in texts if text), "")):
            return None
        return seconds_of_dates(texts, self.file, lambda row: self.place(row, column))

    def numbers(self, columns: Sequence[int]) -> FloatArray:
        """Values of some columns, shape (n, len(columns)); missing ones are NaN.

        Raises
        ------
        RecordingError
            If the columns differ in length, or one does not hold real numbers.
        """
        values: FloatArray = np.empty((self.samples_of(columns), len(columns)), order="F")
        for series, column in zip(values.T, columns, strict=True):
            series[:] = self._number(column)
        return values

    def samples_of(self, columns: Sequence[int]) -> int:
        """Number of samples that these columns have.

        Raises
        ------
        RecordingError
            If it is not the same for all.
        """
        lengths = {self.columns[column]: self._values(column).size for column in columns}
        if len(set(lengths.values())) > 1:
            raise RecordingError(
                "The columns do not have the same number of samples.",
                file=self.file,
                where=", ".join(f'"{name}"' for name in lengths),
                found=" and ".join(str(length) for length in lengths.values()),
                expected="one value of each for every time stamp",
            )
        return lengths.popitem()[1]

    def _values(self, column: int) -> AnyArray:
        name = self.columns[column]
        if name in self.withheld:
            raise RecordingError(
                "The values of this column cannot be used.",
                file=self.file,
                where=f'column "{name}"',
                found=self.withheld[name],
                expected="values as they were measured, or scaled by a factor and an offset",
            )
        return self.arrays[name]

    def _number(self, column: int) -> FloatArray:
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
            file=self.file,
            where=f'column "{self.columns[column]}"',
            found=kinds.get(values.dtype.kind, str(values.dtype)),
            expected="real numbers",
        )

    def _number_in_text(self, values: AnyArray, column: int) -> FloatArray:
        """Numbers among cells of text."""
        numbers = np.full(values.size, np.nan)
        for row, value in enumerate(values.tolist()):
            text = _text(value)
            if text == "":
                continue
            number = number_in(text, ".")
            if number is None:
                raise RecordingError(
                    "There is text in a column of numbers.",
                    file=self.file,
                    where=self.place(row, column),
                    found=repr(shortened(text)),
                    expected="a number",
                )
            numbers[row] = number
        return numbers

    def plain_arrays(self) -> Iterator[AnyArray]:
        """Each column without Python's objects: numbers, dates, or text cut to a length."""
        for values in self.arrays.values():
            if not values.dtype.hasobject:
                yield np.ascontiguousarray(values)
            else:
                texts = [shortened(_text(value), LONGEST_TEXT) for value in values.tolist()]
                yield np.array(texts, dtype=np.str_)


@dataclass(frozen=True, slots=True)
class Group:
    """Columns that were sampled together.

    Attributes
    ----------
    name
        What goes before the name of a column that other groups have too: a joint, a topic.
    columns
        Name to values, shape (n,).
    time
        The group's clock in s, shape (n,), or dates; ``None`` where a column must be named for it.
    units
        Units that the file states, by the column's name.
    withheld
        Why values of a column are not read, by the column's name.
    """

    name: str
    columns: Mapping[str, AnyArray]
    time: AnyArray | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    withheld: Mapping[str, str] = field(default_factory=dict)


def numbered(names: Sequence[str]) -> list[str]:
    """The names, all that come several times numbered: ``n (1)``, ``n (2)``; empty ones stay."""
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


def table_of_groups(
    file: Path, groups: Sequence[Group], *, always_prefixed: bool = False
) -> ArrayTable:
    """All columns of all groups, each with its clock.

    Groups of one name are numbered. A name that only one group has stays as it is, others become
    ``GROUP/NAME``: all of them with ``always_prefixed``. The clock of a group is ``time_s`` among
    them.
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
        if TIME in columns:
            clocks |= dict.fromkeys(full.values(), full[TIME])
    return ArrayTable(str(file), arrays, units, clocks, withheld)


def _text(value: object) -> str:
    """Text of a cell; empty for what stands for a missing value."""
    if value is None or np.any(value != value) or type(value).__name__ in ("NAType", "NaTType"):
        return ""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace").strip()
    return str(value).strip()
