"""Read a file as a :class:`Recording`: map columns, convert units, check the file.

Only checks that every task needs are here; the others are in :mod:`bayesbl.recording.checks`.
"""

from __future__ import annotations

import glob
import hashlib
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesbl.arguments import File, checked
from bayesbl.errors import RecordingError, UnavailableError, naming, shortened
from bayesbl.recording.array_table import ArrayTable
from bayesbl.recording.channels import (
    CHANNELS,
    LOAD_POSITION,
    MOTOR_POSITION,
    MOTOR_SPEED,
    REFERENCE_POSITION,
    REFERENCE_SPEED,
    TIME,
    ColumnSpec,
)
from bayesbl.recording.columns import Column, choose_columns, stamps_and_values
from bayesbl.recording.formats import CAN_LOG, FORMATS, Format, begins_with_frames
from bayesbl.recording.input_bytes import input_or_refusal, of_two, stem_of, suffix_of, unpacked
from bayesbl.recording.own_process import parsed_apart
from bayesbl.recording.repairs import (
    MOST_SPARED,
    at_shared_times,
    bridge,
    held,
    mended_clock,
    new_values,
    signed,
    told,
    unwrapped,
    without_strays,
)
from bayesbl.recording.text_table import in_columns
from bayesbl.recording.types import FloatArray, Recording, Source

POSITIONS = (MOTOR_POSITION, LOAD_POSITION, REFERENCE_POSITION)
REFERENCES = (REFERENCE_SPEED, REFERENCE_POSITION)
MINIMUM_SAMPLES = 16  # fewer samples are no recording for any task
LATEST_START_S = 1e6  # a time that begins later (seconds since 1970) counts from its first stamp
FASTEST_RPM = 2e4  # no motor of a joint is faster

NO_MEASUREMENT = 1e15  # larger numbers, in any unit, diverged or mark missing values


@checked
def read_recording(
    path: File,
    *,
    name: str | None = None,
    columns: Mapping[str, ColumnSpec] | None = None,
    even: bool = True,
    timed: bool = True,
) -> Recording:
    """Read and check one recording.

    Parameters
    ----------
    path
        The file; its suffix decides the format.
    name
        Short name for results and figures; the file's name without suffix by default.
    columns
        Channel to the column that holds it, where name or unit differ from the package's own.
        Columns that already have a channel's name need no entry.
    even
        Whether the samples are to be even in time: then lost ones are bridged, and too long a loss
        refused. Otherwise rows that lack a value are left out, and holes stay.
    timed
        Whether the file has to say when each sample was taken; otherwise their order is enough.

    Raises
    ------
    RecordingError
        If the file cannot be read, lacks a column, holds anything but numbers over strictly
        increasing time, or lost more samples than can be bridged. The message names line and
        column.
    """
    with naming(path):
        return _recording(Path(path), name, columns or {}, even, timed)


def _recording(
    path: Path, name: str | None, columns: Mapping[str, ColumnSpec], even: bool, timed: bool
) -> Recording:
    table, sha256 = _parsed(path)
    if TIME not in columns and not (timed and table.step_s is None):
        table = table.numbered()
    mapped = [spec.name for spec in columns.values()]
    table = table.at_shared_stamps(mapped, MOST_SPARED if even else math.inf)
    time_column, *others = choose_columns(table, columns)
    repairs = Counter(table.repairs)
    stamps, values = _values(table, time_column, others)
    if stamps.size > 1 and np.all(stamps[1:] < stamps[:-1]):
        repairs["row put in order, as the newest came first"] += stamps.size
        stamps, values, table = stamps[::-1].copy(), values[::-1].copy(), table.reversed()
    table = table.without_values()
    rows = np.flatnonzero(np.isfinite(stamps))
    _check_length(table, time_column, rows.size)
    values = held(values, repairs)
    _check_finite(table, others, values)
    stamped = (stamps, values) if rows.size == len(values) else (stamps[rows], values[rows])
    order, stamps = mended_clock(*stamped, time_column.factor, repairs, even=even)
    rows = rows[order]
    _check_length(table, time_column, rows.size)
    time_s = _seconds(table, time_column, stamps, rows)
    if rows.size < len(values) or np.any(np.diff(rows) < 0):
        values = values[rows]
    del stamped
    strays = [""] * len(others)
    for i, column in enumerate(others):
        called = CHANNELS.get(column.channel, column.channel)
        if column.channel in POSITIONS:
            values[:, i] = unwrapped(values[:, i], column.factor, repairs, called)
        elif column.channel not in REFERENCES:  # which may jump over half of all numbers
            largest = FASTEST_RPM if column.channel == MOTOR_SPEED else math.inf
            values[:, i] = signed(values[:, i], column.factor, repairs, called, largest)
        if column.channel not in REFERENCES:
            strays[i] = without_strays(values[:, i], repairs, called)

    clock, missing = time_column.name, np.isnan(values).sum(axis=0)
    with np.errstate(all="ignore"):  # numbers near the limit of what a double holds
        kept_rows, values = at_shared_times(time_s, values, repairs, even=even)
    if kept_rows.size < time_s.size:
        time_s, values, rows = time_s[kept_rows], values[kept_rows], rows[kept_rows]
        clock = others[int(np.argmax(missing))].name  # the column that sets the times

    def place(row: int, column: int | None) -> str:
        if column is None:
            return table.place(int(rows[row]), clock)
        return table.place(int(rows[row]), others[column].name) + strays[column]

    with np.errstate(all="ignore"):  # numbers near the limit of what a double holds
        bridged = bridge(time_s, values, place, even=even)
        series = {column.channel: bridged.values[:, i] for i, column in enumerate(others)}
        new = new_values(series[MOTOR_SPEED]) if even and MOTOR_SPEED in series else None
    kept, slower = new or (slice(None), "")
    return Recording(
        name=name or stem_of(path),
        time_s=bridged.time_s[kept],
        channels={name: np.ascontiguousarray(values[kept]) for name, values in series.items()},
        source=Source(
            file=str(path),
            sha256=sha256,
            unused_columns=tuple(
                column or f"column {i + 1}"
                for i, column in enumerate(table.columns)
                if column not in {time_column.name, *(column.name for column in others)}
            ),
        ),
        excluded=bridged.excluded[kept] if bridged.excluded[kept].any() else None,
        notes=(
            *(c.note for c in (time_column, *others) if c.note),
            *told(repairs),
            *bridged.notes,
            *((slower,) if slower else ()),
        ),
    )


def read_table(path: str | Path) -> ArrayTable:
    """Columns of a file before any mapping. RecordingError if it is no readable table."""
    with naming(path):
        return _parsed(Path(path))[0]


def _values(
    table: ArrayTable, time_column: Column, others: Sequence[Column]
) -> tuple[FloatArray, FloatArray]:
    """Time in the file's unit, shape (n,), and channels in their own units, shape (n, c).

    Missing, infinite and impossibly large values are NaN.
    """
    names = [column.name for column in others]
    table.samples_of([time_column.name, *names])
    stamps = table.timestamps(time_column.name)
    kinds = ("numbers", "dates") if stamps is None else ("dates", "numbers")
    is_other = time_column.unit not in (None, "s", "datetime")
    if is_other if stamps is not None else time_column.unit == "datetime":
        raise RecordingError(
            "Time is not in its stated unit.",
            where=f'column "{time_column.name}"',
            found=kinds[0],
            expected=f'{kinds[1]}, as unit = "{time_column.unit}" says',
        )
    if stamps is None:
        stamps, values = stamps_and_values(table, time_column.name, names)
    else:
        values = table.numbers(names)
    # In place and by column: a long recording is a good part of the memory.
    stamps[~np.isfinite(stamps)] = np.nan
    with np.errstate(over="ignore"):
        for series, column in zip(values.T, others, strict=True):
            series *= column.factor
            series[~(np.abs(series) < NO_MEASUREMENT)] = np.nan
    return stamps, values


def _seconds(
    table: ArrayTable, column: Column, time: FloatArray, rows: NDArray[np.int64]
) -> FloatArray:
    """Time of the rows in seconds; a late start is subtracted."""
    backward = np.flatnonzero(time[1:] <= time[:-1])
    if backward.size:
        row = int(backward[0]) + 1
        before, after = time[row - 1], time[row]
        problem = "Time does not advance" if after == before else "Time runs backwards"
        raise RecordingError(
            f"{problem} ({backward.size} times in all; this is the first).",
            where=table.place(int(rows[row]), column.name),
            found=f"{after:.12g} after {before:.12g}",
            expected="time that increases from each line to the next",
        )
    with np.errstate(over="ignore"):
        if column.unit == "datenum" or abs(time[0] * column.factor) > LATEST_START_S:
            time = time - time[0]
        seconds = time if column.factor == 1.0 else time * column.factor
    if not (np.isfinite(seconds[-1] - seconds[0]) and np.all(np.diff(seconds) > 0.0)):
        raise RecordingError(
            "Time in seconds does not increase from sample to sample.",
            where=f'column "{column.name}"',
            found=f"from {time[0]:.6g} to {time[-1]:.6g}",
            expected="the time of a recording",
        )
    return seconds


def _read_bytes(path: Path) -> bytes:
    data = input_or_refusal(path, UnavailableError, "an existing recording")
    if not data[:1000].strip() and not data.strip():
        raise RecordingError(
            "The file is empty.", found=f"{len(data)} bytes", expected="a recording"
        )
    return data


def _parsed(path: Path) -> tuple[ArrayTable, str]:
    """The table in a file, and the SHA-256 of the file."""
    data = _read_bytes(path)
    format_ = _format_of(path)
    sha256 = hashlib.sha256(data)
    data = unpacked(path, data)
    if not format_.signatures and begins_with_frames(data):
        format_ = CAN_LOG
    elif not format_.signatures and re.match(rb'\s*\{\s*"', data[:1000]):
        format_ = FORMATS[".json"]
    if format_.beside:
        other = _beside(path, format_.beside)
        sha256.update(other)
        data = of_two(data, other)
    if not format_.signatures:  # text is read by this package itself
        table = in_columns(format_.read(data))
        return replace(table, file=str(path)), sha256.hexdigest()
    if not format_.is_begun_by(data):
        raise RecordingError(
            f"The file cannot be read as {format_.name}.",
            found=f"{len(data)} bytes that do not begin like such a file",
            expected=f"a whole {format_.name} file, and the suffix of what the file holds",
        )
    if format_.library and find_spec(format_.library) is None:
        raise UnavailableError(
            f"Reading {format_.name} needs {format_.library}, which is not installed.",
            found=f"no module {format_.library}",
            expected='pip install "bayesbl[formats]", or the recording as CSV',
        )
    table = in_columns(parsed_apart(format_, data))
    return replace(table, file=str(path)), sha256.hexdigest()


def _beside(path: Path, places: Sequence[str]) -> bytes:
    """Bytes of the file that belongs to a recording; empty if there is none."""
    folder = glob.escape(str(path.parent))
    for place in places:
        found = sorted(glob.glob(f"{folder}/{place.format(stem=glob.escape(stem_of(path)))}"))
        if len(found) > 1:
            raise RecordingError(
                "Several files beside this one may belong to it.",
                found=shortened(", ".join(Path(file).name for file in found), 200),
                expected=f"one of them, called {places[0].format(stem=stem_of(path))}",
            )
        if found:
            return _read_bytes(Path(found[0]))
    return b""


def _format_of(path: Path) -> Format:
    suffix = suffix_of(path)
    if suffix not in FORMATS:
        raise RecordingError(
            "Files of this kind cannot be read as recordings.",
            found=f'"{path.suffix}"' if path.suffix else "no suffix",
            expected=" or ".join(FORMATS) + ", or one of these packed as .gz",
        )
    return FORMATS[suffix]


def _check_length(table: ArrayTable, column: Column, stamps: int) -> None:
    if stamps < MINIMUM_SAMPLES:
        raise RecordingError(
            "The recording is too short.",
            where=f'column "{column.name}"',
            found=f"{stamps} samples with a time",
            expected=f"at least {MINIMUM_SAMPLES}",
        )


def _check_finite(table: ArrayTable, others: Sequence[Column], values: FloatArray) -> None:
    """Refuse a column without a number; single missing values are bridged later."""
    for column, series in zip(others, values.T, strict=True):
        if np.isnan(series).all():
            raise RecordingError(
                "This column holds no number.",
                where=f'column "{column.name}"',
                found=f"NaN, infinite or empty in all {len(values)} samples",
                expected="a finite number in every sample",
            )
