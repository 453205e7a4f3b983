"""Files that hold arrays (NetCDF, MATLAB, Parquet, …) as a table of columns."""

from __future__ import annotations

import io
import logging
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesbl.errors import RecordingError, UnavailableError, UserError, shortened
from bayesbl.recording.timestamps import is_date, seconds_of_calendar, seconds_of_dates
from bayesbl.recording.types import FloatArray

AnyArray = NDArray[Any]


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
    """

    file: str
    arrays: Mapping[str, AnyArray]
    units: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    clocks: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))

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
        return f'sample {row + 1}, column "{self.columns[column]}"'

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
        lengths = {self.columns[column]: self._values(column).size for column in columns}
        if len(set(lengths.values())) > 1:
            raise RecordingError(
                "The columns do not have the same number of samples.",
                file=self.file,
                where=", ".join(f'"{name}"' for name in lengths),
                found=" and ".join(str(length) for length in lengths.values()),
                expected="one value of each for every time stamp",
            )
        return np.column_stack([self._number(column) for column in columns])

    def _values(self, column: int) -> AnyArray:
        return self.arrays[self.columns[column]]

    def _number(self, column: int) -> FloatArray:
        values = self._values(column)
        if values.dtype.kind in "biuf":
            filled = np.ma.filled(np.ma.asarray(values, dtype=np.float64), np.nan)
            return np.asarray(filled, dtype=np.float64)
        if values.dtype.kind == "m":
            return np.asarray(values / np.timedelta64(1, "ns"), dtype=np.float64) * 1e-9
        if values.dtype.kind == "O":
            return self._number_of_objects(values, column)
        kinds = {"M": "dates", "c": "complex numbers", "S": "text", "U": "text"}
        raise RecordingError(
            "This column does not hold numbers.",
            file=self.file,
            where=f'column "{self.columns[column]}"',
            found=kinds.get(values.dtype.kind, str(values.dtype)),
            expected="real numbers",
        )

    def _number_of_objects(self, values: AnyArray, column: int) -> FloatArray:
        numbers = np.full(values.size, np.nan)
        for row, value in enumerate(values.tolist()):
            if _text(value) == "":
                continue
            try:
                if isinstance(value, str | bytes):  # float() would read text too
                    raise TypeError
                numbers[row] = float(value)
            except (TypeError, ValueError, OverflowError):
                raise RecordingError(
                    "There is text in a column of numbers.",
                    file=self.file,
                    where=self.place(row, column),
                    found=repr(shortened(str(value))),
                    expected="a number",
                ) from None
        return numbers


@contextmanager
def readable(file: Path, kind: str, hint: str = "") -> Iterator[None]:
    """Whatever a foreign parser raises on a damaged file becomes one sentence.

    Parsers of binary formats let nearly every exception out (KeyError, MemoryError,
    zlib.error, struct.error, …), so there is no narrower list that would hold.
    """
    try:
        with _without_words():
            yield
    except UserError:
        raise
    except Exception as error:
        lines = str(error).strip().splitlines()
        raise RecordingError(
            f"The file cannot be read as {kind}.",
            file=file,
            found=shortened(lines[0] if lines else type(error).__name__, 160),
            expected=f"a whole {kind} file" + (f"; {hint}" if hint else ""),
        ) from None


@contextmanager
def _without_words() -> Iterator[None]:
    """Keep back what parsers print, log and complain of when a damaged file ends them."""
    hook, level = sys.unraisablehook, logging.root.manager.disable
    sys.unraisablehook = lambda _: None
    logging.disable(logging.CRITICAL)
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            yield
    finally:
        sys.unraisablehook = hook
        logging.disable(level)


def missing_library(file: Path, kind: str, library: str, otherwise: str = "") -> UnavailableError:
    """The optional library that a format needs is not installed."""
    return UnavailableError(
        f"Reading {kind} needs {library}, which is not installed.",
        file=file,
        found=f"no module {library}",
        expected='pip install "bayesbl[formats]"' + (f", or {otherwise}" if otherwise else ""),
    )


def _text(value: object) -> str:
    """Text of a cell; empty for what stands for a missing value."""
    if value is None or value != value or type(value).__name__ in ("NAType", "NaTType"):
        return ""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace").strip()
    return str(value).strip()
