"""Time written as dates: from ISO 8601 text or calendar arrays to seconds since the first."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from bayesbl.errors import RecordingError, shortened
from bayesbl.recording.types import FloatArray


def is_date(text: str) -> bool:
    """Whether the text is an ISO date, and not a number that could be read as one (20260301)."""
    return "-" in text[1:] and _date(text) is not None


def seconds_of_dates(texts: Sequence[str], file: str, place: Callable[[int], str]) -> FloatArray:
    """Seconds since the first date, to a microsecond, shape (n,); empty texts are NaN.

    Raises
    ------
    RecordingError
        At the first text that is no date like the first one; ``place`` says where a row is.
    """
    first: datetime | None = None
    seconds = np.full(len(texts), np.nan)
    for row, text in enumerate(texts):
        if not text.strip():
            continue
        date = _date(text)
        if date is None or (first is not None and (date.tzinfo is None) != (first.tzinfo is None)):
            raise RecordingError(
                "This is not a date like those before it.",
                file=file,
                where=place(row),
                found=repr(shortened(text)),
                expected="a date with a time, as 2026-03-01T12:00:00.250",
            )
        first = first or date
        seconds[row] = (date - first).total_seconds()
    return seconds


def seconds_of_calendar(times: NDArray[np.datetime64]) -> FloatArray:
    """Seconds since the first instant, shape (n,); NaT is NaN."""
    known = ~np.isnat(times)
    seconds = np.full(times.shape, np.nan)
    if known.any():
        # As integers first: nanoseconds since 1970 do not fit into a double.
        steps = (times[known] - times[known][0]).astype("timedelta64[ns]")
        seconds[known] = steps.astype(np.int64) * 1e-9
    return seconds


def _date(text: str) -> datetime | None:
    try:
        return datetime.fromisoformat(text.strip())
    except ValueError:
        return None
