"""Lost samples, found as NaN or as holes in time: bridged where that is safe, else refused. And
recordings whose stamps are not evenly spaced, brought to an even grid by them.

A bridged sample keeps the sampling even, so that later steps can count in samples, and is
marked as excluded, so that a fit does not use it as a measurement.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesbl.errors import RecordingError
from bayesbl.recording.types import BoolArray, FloatArray, Recording

LONGEST_LOSS_S = 0.1
"""Half the ringing of an impact: a longer loss could hide one but for its ends."""

MOST_LOST = 0.05
"""Largest share of lost samples. With more, the logger is at fault."""

MOST_CUT = 0.5
"""Of all samples, at the ends: with more, little of what was meant to be recorded is there."""

GRID_TOLERANCE = 0.45
"""Largest distance of a time stamp from its point of an even grid, in sampling periods."""

_MOST_GROWTH = 100
"""A recording with holes longer than this many times its samples counts as uneven."""

_GRID_BEGINS, _FOLLOWED = 21, 0.05
"""Stamps whose median begins a running grid, and share of each stamp's distance that it follows: it
scatters by a sixth of what they do, and keeps up with a period that is wrong by a hundredth."""

IntArray = NDArray[np.int64]

Place = Callable[[int, int | None], str]
"""Where a value is in the file, by row and column; ``None`` for the column of time."""


@dataclass(frozen=True, slots=True)
class Bridged:
    """Samples on an even grid as far as time allows; shapes (n,), (n, c) and (n,)."""

    time_s: FloatArray
    values: FloatArray
    excluded: BoolArray
    notes: tuple[str, ...]


def deviation_from_grid(time_s: FloatArray, number: FloatArray) -> tuple[FloatArray, float]:
    """Distance of time stamps from the least-squares line over sample number, and its slope.

    The distance, shape (n,), is in sampling periods. Stamps rounded to a resolution r lie within
    r/2 of the line, however long the recording.
    """
    time: FloatArray = time_s - time_s.mean()
    centred = number - number.mean()
    slope = float(centred @ time) / float(centred @ centred)
    time /= slope  # in place: recordings may be long
    time -= centred
    return time, slope


def sample_numbers(time_s: FloatArray) -> FloatArray | None:
    """Which sample of an even grid each time stamp is, shape (n,); numbers are left out at holes.

    ``None`` if the stamps lie on no even grid. Where they do without a hole, that is the answer:
    1 kHz that lost every fifth sample and 800 Hz rounded to 1 ms are the same numbers.
    """
    whole = np.arange(time_s.size, dtype=float)
    if np.abs(deviation_from_grid(time_s, whole)[0]).max() <= GRID_TOLERANCE:
        return whole
    steps = np.diff(time_s)
    middle = float(np.median(steps))
    found: list[FloatArray] = []
    begins = middle, float(steps[steps <= 2.5 * middle].mean())
    for counted in (_step_by_step, _on_a_running_grid):
        for period in begins:
            for _ in range(3):
                number = counted(time_s, period)
                if not number[-1] <= _MOST_GROWTH * time_s.size:
                    break
                deviation, period = deviation_from_grid(time_s, number)
                if np.abs(deviation).max() <= GRID_TOLERANCE:
                    found.append(number)
                    break
        if found:
            return min(found, key=lambda number: float(number[-1]))
    return None


def _step_by_step(time_s: FloatArray, period: float) -> FloatArray:
    """Counted from stamp to stamp, so that an error of the period cannot add up."""
    counts = np.maximum(np.round(np.diff(time_s) / period), 1.0)
    return np.concatenate([[0.0], np.cumsum(counts)])


def _on_a_running_grid(time_s: FloatArray, period: float) -> FloatArray:
    """Counted from a grid that follows the stamps: two stamps are off by more than either is."""
    number = np.full(time_s.size, np.nan)
    first = time_s[:_GRID_BEGINS]
    count, at = 0.0, float(np.median(first - period * np.arange(first.size)))
    if not (math.isfinite(at) and 0.0 < period < math.inf):
        return number
    for i, stamp in enumerate(time_s.tolist()):
        if i:
            passed = max(float(round((stamp - at) / period)), 1.0)
            count, at = count + passed, at + passed * period
        at += _FOLLOWED * (stamp - at)
        number[i] = count
    return number


def without_lost(file: Path, time_s: FloatArray, values: FloatArray, place: Place) -> Bridged:
    """The samples that have a value in every column; arguments as :func:`bridge` takes them."""
    whole = ~np.isnan(values).any(axis=1)
    lost = int(np.sum(~whole))
    if whole.sum() < 2:
        return bridge(file, time_s, values, place)  # which refuses it
    notes = (f"{lost} of {whole.size} samples lack a value and are left out.",) if lost else ()
    return Bridged(time_s[whole], values[whole], np.zeros(whole.size - lost, dtype=bool), notes)


def bridge(file: Path, time_s: FloatArray, values: FloatArray, place: Place) -> Bridged:
    """Bridge short runs of lost samples by straight lines.

    Samples lost at either end are cut off, up to half of all: a sensor may wake up late.

    Parameters
    ----------
    time_s
        Shape (n,), strictly increasing.
    values
        Shape (n, c); NaN where a value is missing. No column is all NaN.

    Raises
    ------
    RecordingError
        If a run is longer than :data:`LONGEST_LOSS_S`, more than :data:`MOST_LOST` of all samples
        are lost, or more than :data:`MOST_CUT` at the ends. The message says where.
    """
    whole = ~np.isnan(values).any(axis=1)
    kept = np.flatnonzero(whole)
    if kept.size < 2:
        raise RecordingError(
            "No two samples have a number in every column.",
            file=file,
            found=f"{kept.size} of {whole.size} samples without a missing value",
            expected="columns that were recorded at the same times",
        )
    first, last = int(kept[0]), int(kept[-1]) + 1
    cut = whole.size - (last - first)
    if cut > MOST_CUT * whole.size:
        raise RecordingError(
            "Most of the recording has no numbers, at its ends.",
            file=file,
            found=f"{whole.size - cut} of {whole.size} samples between the first and the last "
            "that have a number in every column",
            expected=f"at least {100.0 * (1.0 - MOST_CUT):g} %; rename a column that is not needed",
        )
    notes: tuple[str, ...] = ()
    if cut:
        notes = (f"{cut} samples with missing values at the ends of the recording are cut off.",)
    # A row without any value is of other columns, or a loss that the stamps show as well.
    time, values = time_s[first:last], values[first:last]
    row: range | IntArray = range(first, last)
    if kept.size < last - first:
        row = first + np.flatnonzero(~np.isnan(values).all(axis=1))
        time, values = time_s[row], values[row - first]
    number = sample_numbers(time)
    if number is None:
        number = np.arange(time.size, dtype=float)
    if number[-1] == time.size - 1 and not np.isnan(values).any():
        return Bridged(time, values, np.zeros(time.size, dtype=bool), notes)
    at = number.astype(int)
    lost = np.ones(at[-1] + 1, dtype=bool)
    lost[at] = np.isnan(values).any(axis=1)
    full_time = np.interp(np.arange(lost.size), number, time)
    begins, ends = runs(lost)
    lengths = full_time[ends] - full_time[begins - 1]
    longest = int(np.argmax(lengths))
    rows = slice(*np.searchsorted(at, (begins[longest], ends[longest])))
    missing = np.isnan(values[rows]).sum(axis=0)
    where = (
        f"from {place(int(row[rows.start]), int(np.argmax(missing)))}"
        if missing.any()
        else f"after {place(int(row[rows.start - 1]), None)}"
    )
    _refuse_too_much(file, lost, float(lengths[longest]), where)
    full = np.full((lost.size, values.shape[1]), np.nan)
    full[at] = values
    for column in full.T:
        missing = np.isnan(column)
        column[missing] = np.interp(full_time[missing], full_time[~missing], column[~missing])
    note = (
        f"{lost.sum()} of {lost.size} samples are missing, in {begins.size} "
        f"{'run' if begins.size == 1 else 'runs'} of at most {(ends - begins).max()} samples, "
        f"the first after {full_time[begins[0] - 1]:.6g} s: bridged, and left out of the fit."
    )
    return Bridged(full_time, full, lost, (*notes, note))


def _refuse_too_much(file: Path, lost: BoolArray, longest_s: float, where: str) -> None:
    share = lost.mean()
    if longest_s > LONGEST_LOSS_S:
        raise RecordingError(
            "Samples are missing for too long.",
            file=file,
            where=where,
            found=f"nothing for {longest_s:.4g} s",
            expected=f"at most {LONGEST_LOSS_S:g} s in a row; use the part before or after",
        )
    if share > MOST_LOST:
        raise RecordingError(
            "Too many samples are missing.",
            file=file,
            where=f"longest {where}",
            found=f"{lost.sum()} of {lost.size} samples, {100.0 * share:.3g} %",
            expected=f"at most {100.0 * MOST_LOST:g} %; rename a column that is not needed",
        )


def runs(flags: BoolArray) -> tuple[IntArray, IntArray]:
    """First and one-past-last index of each run of true flags."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False]))))
    return edges[::2], edges[1::2]


UNEVEN_STAMPS = "Its samples are not evenly spaced: an even grid was made by their time stamps."


def even(recording: Recording, tolerance: float, harmless_s: float = 0.0) -> Recording:
    """The recording on the even grid nearest to its time stamps, by cubic splines.

    As it is, but for its stamps, where none departs by more than ``tolerance`` periods, or all by
    ``harmless_s`` in the root mean square.
    """
    number = np.arange(recording.samples, dtype=np.float64)
    deviation, period_s = deviation_from_grid(recording.time_s, number)
    grid = recording.time_s.mean() + period_s * (number - number.mean())
    rms_s = period_s * math.sqrt(float(np.mean(deviation**2)))
    if np.max(np.abs(deviation)) <= tolerance or rms_s <= harmless_s:
        return replace(recording, time_s=grid)
    from scipy.interpolate import CubicSpline

    channels = {
        name: CubicSpline(recording.time_s, row)(grid) for name, row in recording.channels.items()
    }
    return replace(
        recording, time_s=grid, channels=channels, excluded=widened(recording.excluded, 1)
    )


def widened(excluded: BoolArray | None, samples: int) -> BoolArray | None:
    """A mask with so many samples more on either side of what it marks, shape (n,)."""
    if excluded is None or not excluded.any():
        return None
    from scipy.ndimage import binary_dilation

    return np.asarray(binary_dilation(excluded, iterations=samples))
