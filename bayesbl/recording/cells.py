"""A cell of text: a number, with how its decimals are marked and a unit behind it, or a date.

Of dates and clock times only differences count, as seconds since the first, so that it need not be
known whether 03/04/2026 is in March or in April: a date that differs from the one before it is the
next day.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Callable, Iterable, Sequence
from datetime import date
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesbl.errors import RecordingError, shortened
from bayesbl.recording.types import FloatArray
from bayesbl.units import is_unit, spelled

MISSING = frozenset(
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
    if text.lower() in MISSING:
        return float("nan")
    if _GROUPED[mark].fullmatch(text):
        plain = re.sub(r"[^\d+.,-]", "", text).replace("." if mark == "," else ",", "")
        return float(plain.replace(",", "."))
    return None


def parted(cell: str) -> tuple[str, str]:
    """A cell's number and the unit behind it; the cell where there is none that is known."""
    held = _WITH_UNIT.fullmatch(cell)
    return (held[1], held[2]) if held and is_unit(spelled(held[2])) else (cell, "")


def is_number(cell: str) -> bool:
    """Whether it may be a number with either mark, bare or before its unit; never if missing."""
    return is_bare_number(parted(cell)[0])


def is_bare_number(cell: str) -> bool:
    return any(
        (value := number_in(cell, mark)) is not None and (value == value or cell.lower() == "nan")
        for mark in ".,"
    )


def is_value(cell: str) -> bool:
    """Whether it is a number or a date."""
    return is_date(cell) or is_number(cell)


def decimal_mark(file: Path, cells: Sequence[str]) -> str:
    """Whether numbers have a decimal comma or a decimal point, by all of them together."""
    cells = [number for cell in cells if is_bare_number(number := parted(cell)[0])]
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


_STAMP = re.compile(
    r"(?:(\d{1,4})([-./])(\d{1,2})\2(\d{1,4})[T ,;_]*)?"
    r"(\d{1,2}):(\d{2})(?:(?<=\d[T ]\d\d:\d\d)|:(\d{2})(?:[.,:;](\d{1,9}))?)"
    r"\s*([AaPp]\.?[Mm]\.?)?\s*(Z|[+-]\d{2}:?\d{2})?"
)
_DAY_S = 86400


def is_date(text: str) -> bool:
    """Whether the text is a date or a time of day, and not a number (20260301)."""
    return ":" in text and _STAMP.fullmatch(text.strip()) is not None


def seconds_of_dates(texts: Iterable[str], file: str, place: Callable[[int], str]) -> FloatArray:
    """Seconds since the first date, shape (n,); empty texts are NaN.

    A time of day that begins again is one of the next day. Where the digits of the fraction are not
    padded (``12:00:00.9`` before ``12:00:00.10``), they count milliseconds.

    Raises
    ------
    RecordingError
        At the first text that is no date like the first one; ``place`` says where a row is.
    """
    whole, fraction, milliseconds, missing = array("q"), array("d"), array("d"), array("b")
    days: dict[str, int] = {}
    first: tuple[bool, bool] | None = None
    day = before = 0
    lengths = set()
    for row, given in enumerate(texts):
        text = given.strip()
        missing.append(not text)
        if not text:
            whole.append(before)
            fraction.append(0.0)
            milliseconds.append(0.0)
            continue
        stamp = _STAMP.fullmatch(text)
        read = stamp and _of_stamp(stamp, days)
        if read is None or (first is not None and read[2] != first):
            raise RecordingError(
                "This is not a date like those before it.",
                file=file,
                where=place(row),
                found=repr(shortened(text)),
                expected="a date with a time, as 2026-03-01T12:00:00.250",
            )
        seconds, digits, first = read
        if not first[0]:
            seconds += day * _DAY_S
            if whole and before - seconds > _DAY_S // 2:
                day += 1
                seconds += _DAY_S
        before = seconds
        lengths.add(len(digits))
        whole.append(seconds)
        fraction.append(float(f"0.{digits}") if digits else 0.0)
        milliseconds.append(float(digits or 0) / 1000.0)
    # As whole numbers first: seconds since the year 1 do not leave room for microseconds.
    known = ~np.array(missing, dtype=bool)
    counted = np.array(whole)
    counted -= counted[known][:1].sum()
    time: FloatArray = counted + np.array(fraction)
    if len(lengths - {0}) > 1 and max(lengths) == 3 and np.any(np.diff(time[known]) < 0.0):
        other = counted + np.array(milliseconds)
        time = other if np.all(np.diff(other[known]) >= 0.0) else time
    time[~known] = np.nan
    return time - time[known][0] if known.any() else time


def _of_stamp(
    stamp: re.Match[str], days: dict[str, int]
) -> tuple[int, str, tuple[bool, bool]] | None:
    """Whole seconds, digits of the fraction, and whether there are a date and a zone.

    ``days`` numbers the dates whose order of day and month is open, as they come.
    """
    a, mark, b, c, hours, minutes, seconds, digits, half, zone = stamp.groups()
    hour, minute, second = int(hours), int(minutes), int(seconds or 0)
    if half:
        if not 1 <= hour <= 12:
            return None
        hour = hour % 12 + (12 if half[0] in "Pp" else 0)
    if hour > 23 or minute > 59 or second > 60:
        return None
    count = 0
    if a is not None:
        text = f"{a}{mark}{b}{mark}{c}"
        if text not in days:
            dated = _ordinal(a, mark, b, c)
            if dated is None:
                return None
            # A date of open order is the day after the last one that was new.
            days[text] = dated if dated else max(days.values(), default=0) + 1
        count = days[text]
    total = count * _DAY_S + hour * 3600 + minute * 60 + second
    if zone and zone != "Z":
        size = int(zone[1:3]) * 3600 + int(zone[-2:]) * 60
        total -= size if zone[0] == "+" else -size
    return total, digits or "", (a is not None, zone is not None)


def _ordinal(a: str, mark: str, b: str, c: str) -> int | None:
    """Day number of a date; 0 where the order of day and month is open, ``None`` if it is none."""
    try:
        if len(a) == 4:
            return date(int(a), int(b), int(c)).toordinal()
        year = int(c) + (2000 if len(c) <= 2 else 0)
        if mark == ".":
            return date(year, int(b), int(a)).toordinal()
        day, month = (int(a), int(b)) if int(a) > 12 else (int(b), int(a))
        date(year, month, day)
    except ValueError:
        return None
    return 0


def seconds_of_calendar(times: NDArray[np.datetime64]) -> FloatArray:
    """Seconds since the first instant, shape (n,); NaT is NaN."""
    known = ~np.isnat(times)
    seconds = np.full(times.shape, np.nan)
    if known.any():
        # As integers first: nanoseconds since 1970 do not fit into a double.
        steps = (times[known] - times[known][0]).astype("timedelta64[ns]")
        seconds[known] = steps.astype(np.int64) * 1e-9
    return seconds
