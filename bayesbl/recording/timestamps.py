"""Dates and clock times as seconds since the first, as texts or as calendar arrays.

Only differences count, so that it need not be known whether 03/04/2026 is in March or in April: a
date that differs from the one before it is the next day.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Callable, Iterable
from datetime import date, datetime

import numpy as np
from numpy.typing import NDArray

from bayesbl.errors import RecordingError, shortened
from bayesbl.recording.types import FloatArray

_STAMP = re.compile(
    r"(?:(\d{1,4})([-./])(\d{1,2})\2(\d{1,4})[T ,;_]*)?"
    r"(\d{1,2}):(\d{2}):(\d{2})(?:[.,:;](\d{1,9}))?\s*([AaPp]\.?[Mm]\.?)?\s*(Z|[+-]\d{2}:?\d{2})?"
)
_DAY_S = 86400


def is_date(text: str) -> bool:
    """Whether the text is a date or a time of day, and not a number (20260301)."""
    text = text.strip()
    if ":" not in text and "-" not in text[1:]:
        return False
    return _STAMP.fullmatch(text) is not None or (text[:4].isdigit() and _iso(text) is not None)


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
        read = _of_stamp(stamp, days) if stamp else _of_iso(text)
        if read is None or (first is not None and read[3] != first):
            raise RecordingError(
                "This is not a date like those before it.",
                file=file,
                where=place(row),
                found=repr(shortened(text)),
                expected="a date with a time, as 2026-03-01T12:00:00.250",
            )
        seconds, digits, has_date, first = *read[:3], read[3]
        if not has_date:
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


_Read = tuple[int, str, bool, tuple[bool, bool]]
"""Whole seconds, digits of the fraction, whether there is a date, and what all must share."""


def _of_stamp(stamp: re.Match[str], days: dict[str, int]) -> _Read | None:
    """``days`` numbers the dates whose order of day and month is open, as they come."""
    a, mark, b, c, hours, minutes, seconds, digits, half, zone = stamp.groups()
    hour, minute, second = int(hours), int(minutes), int(seconds)
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
    return total, digits or "", a is not None, (a is not None, zone is not None)


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


def _of_iso(text: str) -> _Read | None:
    at = _iso(text)
    if at is None:
        return None
    offset = at.utcoffset()
    total = at.toordinal() * _DAY_S + at.hour * 3600 + at.minute * 60 + at.second
    total -= int(offset.total_seconds()) if offset is not None else 0
    return total, f"{at.microsecond:06d}", True, (True, offset is not None)


def seconds_of_calendar(times: NDArray[np.datetime64]) -> FloatArray:
    """Seconds since the first instant, shape (n,); NaT is NaN."""
    known = ~np.isnat(times)
    seconds = np.full(times.shape, np.nan)
    if known.any():
        # As integers first: nanoseconds since 1970 do not fit into a double.
        steps = (times[known] - times[known][0]).astype("timedelta64[ns]")
        seconds[known] = steps.astype(np.int64) * 1e-9
    return seconds


def _iso(text: str) -> datetime | None:
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        return None
