"""What is put right in every recording, whatever its format.

Repairs that lose nothing are made only where the numbers leave one reading, and are counted; the
reader tells all of them in one note. What is ambiguous, or would lose or make up samples, stays as
it is and is refused by the place that it is at.

Lost samples, found as NaN or as holes in time, are bridged where that is safe, else refused. A
bridged sample keeps the sampling even, so that later steps can count in samples, and is marked as
excluded, so that a fit does not use it as a measurement. Stamps that are not evenly spaced are
brought to an even grid.
"""

from __future__ import annotations

import math
from collections import Counter
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

MOST_SPARED = 2.5
"""Samples of the fastest column for one of the slowest, up to which the slowest sets the times."""

HOLE = 3.0
"""Usual steps of a column, over which nothing is known between two of its values."""

_MOST_GROWTH = 100
"""A recording with holes longer than this many times its samples counts as uneven."""

_GRID_BEGINS, _FOLLOWED = 21, 0.05
"""Stamps that begin a running grid, and share of each stamp's distance that it follows: it scatters
by a sixth of what they do, and keeps up with a period that is wrong by a hundredth."""

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
    numbers: list[FloatArray] = []
    for period in (middle, float(steps[steps <= 2.5 * middle].mean())):
        for _ in range(3):
            number = _on_a_running_grid(time_s, period)
            if not number[-1] <= _MOST_GROWTH * time_s.size:
                break
            deviation, period = deviation_from_grid(time_s, number)
            if np.abs(deviation).max() <= GRID_TOLERANCE:
                numbers.append(number)
                break
    return min(numbers, key=lambda number: float(number[-1])) if numbers else None


def _on_a_running_grid(time_s: FloatArray, period: float) -> FloatArray:
    """Counted from a grid that follows the stamps: two stamps are off by more than either is."""
    number = np.full(time_s.size, np.nan)
    if not 0.0 < period < math.inf:
        return number
    # The phase of the first stamps within a period, whatever is lost between them.
    turn = np.exp(2j * math.pi * (time_s[:_GRID_BEGINS] - time_s[0]) / period).sum()
    count, at = 0.0, float(time_s[0] + period * np.angle(turn) / (2.0 * math.pi))
    for i, stamp in enumerate(time_s.tolist()):
        if i:
            passed = max(float(round((stamp - at) / period)), 1.0)
            count, at = count + passed, at + passed * period
        at += _FOLLOWED * (stamp - at)
        number[i] = count
    return number


def at_shared_times(
    time_s: FloatArray, values: FloatArray, repairs: Counter[str], *, even: bool
) -> tuple[IntArray, FloatArray]:
    """Rows to keep, and all values, where columns have times of their own, each a row.

    The times are those of the column with the fewest; others get straight lines between their
    values. Of even samples no more than :data:`MOST_SPARED` times as many are given up for it.
    """
    there = ~np.isnan(values)
    whole, some, counts = there.all(axis=1), there.any(axis=1), there.sum(axis=0)
    shared = whole.sum() >= (1.0 - MOST_LOST) * some.sum() or counts.min() < 2
    if shared or (even and counts.max() > MOST_SPARED * counts.min()):
        return np.arange(time_s.size), values
    rows = there[:, np.argmin(counts)]
    repairs["value put between two of the times of its own column"] += int(np.sum(~there[rows]))
    values = values.copy()
    for column, known in zip(values.T, there.T, strict=True):
        at, steps = time_s[known], np.diff(time_s[known])
        before = np.clip(np.searchsorted(at, time_s, "right") - 1, 0, steps.size - 1)
        near = rows & ~known & (steps[before] <= HOLE * np.median(steps))
        column[near] = np.interp(time_s[near], at, column[known], np.nan, np.nan)
    return np.flatnonzero(rows), values


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

    ``time_s``: shape (n,), strictly increasing. ``values``: shape (n, c); NaN where a value is
    missing. No column is all NaN. Raises RecordingError if a run is longer than
    :data:`LONGEST_LOSS_S`, more than :data:`MOST_LOST` of all samples are lost, or more than
    :data:`MOST_CUT` at the ends. The message says where.
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
    lost = recording.excluded
    if lost is not None:
        # A clock that drifts is many samples from an even grid.
        lost = np.interp(grid, recording.time_s, lost.astype(float)) > 0.0
    return replace(recording, time_s=grid, channels=channels, excluded=widened(lost, 1))


def widened(excluded: BoolArray | None, samples: int) -> BoolArray | None:
    """A mask with so many samples more on either side of what it marks, shape (n,)."""
    if excluded is None or not excluded.any():
        return None
    from scipy.ndimage import binary_dilation

    return np.asarray(binary_dilation(excluded, iterations=samples))


MOST_DISPLACED = 0.05
"""Share of rows out of order, up to which they are sorted: more are two recordings in one file."""

SHARED_STAMPS = 0.05
"""Share of stamps that repeat the one before, from which on the clock is coarse; fewer are an error
in the file."""

LONGEST_TICK_S = 0.1
"""A coarser clock says too little of when its samples were taken. Those of computers tick in
15.6 ms or less."""

_COUNTERS = (2.0**16, 2.0**24, 2.0**32)
_WORDS = (2.0**16, 2.0**32)
_DAY_S = 86400.0
_POWERS = tuple(2.0**bits for bits in range(8, 33))
"""At which counts positions begin again, beside a turn."""

_SLOWEST = 20
"""Samples from one new value to the next, up to which a slower rate is looked for."""

_ENOUGH = 1_000_000
"""Samples that tell it, of a longer recording."""

_FEWEST_LEVELS = 12
"""Different values of a signal whose largest or smallest may be a stray."""

_ELSEWHERE = 0.05
"""Share of the change at new values that may be between them, where these are made up."""


def mended_clock(
    stamps: FloatArray,
    values: FloatArray,
    factor: float,
    repairs: Counter[str],
    *,
    even: bool = True,
) -> tuple[IntArray, FloatArray]:
    """Which rows are kept, in the order of time, and their time in the unit of the stamps.

    Counters that begin again are continued, exact repeats dropped, single rows sorted, and the
    samples of a coarse clock spread by the line that fits all of them.

    ``stamps``, ``values``: shapes (n,), finite, and (n, c). ``factor``: seconds in the unit of the
    stamps. ``repairs``: gains what was done and how many times. ``even``: whether samples are to be
    even in time. Then a single stamp that repeats the one before is an error in the file; else its
    sample came before the next stamp, which is all that counts.
    """
    stamps = _continued(stamps, factor, repairs)
    order = _in_order(stamps, values, repairs)
    time = stamps[order]
    return order, _spread(time, factor, repairs, even=even)


def _continued(stamps: FloatArray, factor: float, repairs: Counter[str]) -> FloatArray:
    steps = np.diff(stamps)
    back = steps < 0.0
    if not back.any() or not (steps > 0.0).any():
        return stamps
    usual = float(np.median(steps[steps > 0.0]))
    for modulus in (*_COUNTERS, _DAY_S / factor):
        onward = steps[back] + modulus
        fits = onward.min() > 0.0 and onward.max() <= 20.0 * usual
        if fits and float(np.ptp(stamps)) < modulus:
            repairs["start of the time counter anew"] += int(back.sum())
            continued: FloatArray = stamps.copy()
            continued[1:] += modulus * np.cumsum(back)
            return continued
    return stamps


def _in_order(stamps: FloatArray, values: FloatArray, repairs: Counter[str]) -> IntArray:
    """Rows by time without exact repeats; as they are where that does not make an even clock."""
    rows = np.arange(stamps.size)
    steps = np.diff(stamps)
    if np.all(steps > 0.0):
        return rows
    order = np.argsort(stamps, kind="stable")
    same = np.flatnonzero(np.diff(stamps[order]) == 0.0) + 1
    if same.size:
        here, before = values[order[same]], values[order[same - 1]]
        if not np.all((here == before) | (np.isnan(here) & np.isnan(before))):
            return rows
        order = np.delete(order, same)
    moved = order != np.sort(order)
    if moved.any():
        time = stamps[order]
        there = np.flatnonzero(moved)
        near = np.diff(time)[np.unique(np.clip(np.r_[there - 1, there], 0, time.size - 2))]
        usual = float(np.median(np.diff(time)))
        even = near.min() > 0.5 * usual and near.max() < 1.5 * usual
        if moved.mean() > MOST_DISPLACED or not even:
            return rows
    repairs["exact repeat of a row"] += int(same.size)
    repairs["row out of order"] += int(moved.sum())
    return order


def _spread(time: FloatArray, factor: float, repairs: Counter[str], *, even: bool) -> FloatArray:
    """Samples of a coarse clock on the line through all of them, or evenly within its ticks."""
    steps = np.diff(time)
    is_coarse = np.mean(steps == 0.0) >= SHARED_STAMPS
    if np.any(steps < 0.0) or not np.any(steps == 0.0) or (even and not is_coarse):
        return time
    starts = np.concatenate([[0], np.flatnonzero(steps > 0.0) + 1])
    if starts.size < 3:
        return time
    ticks = np.diff(time[starts])
    usual = float(np.median(ticks))
    if not 0.0 < usual * factor <= LONGEST_TICK_S:
        return time
    name = f"row spread within the clock's ticks of {1e3 * usual * factor:.2g} ms"
    repairs[name] += int(time.size - starts.size)
    ordinary = ticks <= 1.6 * usual
    counts = np.diff(np.append(starts, time.size))
    period = float(ticks[ordinary].sum()) / float(counts[:-1][ordinary].sum())
    # At a hole of the clock the numbers of the samples jump by what is missing.
    lost = np.zeros(time.size)
    lost[starts[1:][~ordinary]] = np.round((ticks[~ordinary] - usual) / period)
    number: FloatArray = np.arange(float(time.size)) + np.cumsum(lost)
    deviation, slope = deviation_from_grid(time, number)
    if is_coarse and np.ptp(deviation) * slope <= 1.5 * float(ticks[ordinary].max()):
        on_line: FloatArray = time.mean() + slope * (number - number.mean())
        return on_line
    # Rows do not come evenly: the last tick ends where the next one would have come.
    ends = np.append(time[starts[1:]], time[starts[-1]] + usual)
    # Samples that follow a hole belong to its end: they came within an ordinary tick.
    lengths = np.minimum(ends - time[starts], usual * 1.5)
    within = np.arange(time.size) - np.repeat(starts, counts)
    within_ticks: FloatArray = time + within / np.repeat(counts, counts) * np.repeat(
        lengths, counts
    )
    return within_ticks


def held(values: FloatArray, repairs: Counter[str]) -> FloatArray:
    """Values (n, c) of a log on change with each cell that is empty as the last one above it.

    A log on change writes no value twice in a row, and at no even rate; other files lost samples.
    """
    missing = np.isnan(values)
    if not missing.any():
        return values
    # A row without any of them is of other columns, and changes none.
    there = ~missing.all(axis=1)
    part, missing = values[there], missing[there]
    if missing.any(axis=1).sum() <= MOST_LOST * len(part):
        return values
    for column, empty in zip(part.T, missing.T, strict=True):
        rows = np.flatnonzero(~empty)
        if rows.size < 3 or (empty.any() and np.any(np.diff(column[rows]) == 0.0)):
            return values
        if empty.any() and np.ptp(np.diff(rows)) <= 1:  # a slower channel, at its own even rate
            return values
    last = np.where(missing, 0, np.arange(len(part))[:, None])
    full = np.take_along_axis(part, np.maximum.accumulate(last, axis=0), axis=0)
    repairs["empty cell of a log on change, held"] += int(missing.sum() - np.isnan(full).sum())
    whole = values.copy()
    whole[there] = full
    return whole


def filled(values: FloatArray) -> FloatArray:
    """Values, shape (n,), with straight lines over the rows that lack one."""
    rows = np.flatnonzero(np.isfinite(values))
    return np.interp(np.arange(values.size), rows, values[rows])


def unwrapped(position: FloatArray, unit: float, repairs: Counter[str], name: str) -> FloatArray:
    """A position, shape (n,), that goes on where it began again at the end of a turn.

    ``unit``: the file's, in that of the position. As it is where its jumps are no turn of any unit
    or counter.
    """
    there = np.isfinite(position)
    values = position[there]
    values /= unit
    if values.size < 3:
        return position
    steps = np.diff(values)
    span = float(np.ptp(values))
    jumps = np.abs(steps) > 0.5 * span
    if not jumps.any() or jumps.mean() > 0.25:
        return position
    usual = float(np.max(np.abs(steps[~jumps])))
    turns = (2.0 * math.pi / abs(unit), *_POWERS)
    turn = next((t for t in turns if -1e-6 * t <= t - span <= 2.0 * usual + 1e-3 * t), None)
    if turn is None:
        return position
    onward = np.where(jumps, steps - np.sign(steps) * turn, steps)
    for at in map(int, np.flatnonzero(jumps)):
        # It goes on as fast as just before and after, or it was no turn.
        near = np.abs(np.delete(onward[max(0, at - 5) : at + 6], min(at, 5)))
        if near.size == 0 or abs(onward[at]) > 1.5 * float(near.max()) + 1e-3 * turn:
            return position
    repairs[f"turn of the {name} put on ({turn:.6g})"] += int(jumps.sum())
    whole: FloatArray = position.copy()
    whole[there] += unit * turn * np.concatenate([[0.0], np.cumsum(-np.sign(steps) * jumps)])
    return whole


def signed(values: FloatArray, unit: float, repairs: Counter[str], name: str) -> FloatArray:
    """Values, shape (n,), with the signs of whole numbers that were written as unsigned words.

    Of -300 bus servos make 33068, with the sign in the highest bit of 16, others the complement
    65236. Either leaves numbers near 0 and near half or all of the word, and none between them.
    """
    there = np.isfinite(values)
    written = values[there] / unit
    counts = np.round(written)
    if counts.size == 0 or counts.min() < 0.0 or np.max(np.abs(written - counts)) > 1e-5:
        return values
    for word in _WORDS:
        quarters = np.unique(counts // (word / 4.0)).tolist()
        if quarters in ([0.0, 2.0], [0.0, 3.0]):
            high = counts >= word / 2.0
            signs = word / 2.0 - counts[high] if 2.0 in quarters else counts[high] - word
            if -signs.max() > counts[~high].max():
                break  # large beside all others: a speed beside a standstill
            counts[high] = signs
            repairs[f"sign of the {name} in an unsigned word"] += int(high.sum())
            whole: FloatArray = values.copy()
            whole[there] = unit * counts
            return whole
    return values


def without_strays(values: FloatArray, repairs: Counter[str], name: str) -> str:
    """Take values, shape (n,), out that lie farther from all others than these from one another.

    They become NaN. A signal jumps to such a rail (a dropout to 0, an overflow to 65535) and says
    nothing there; a limit that cuts peaks off is next to other values. Which they were, in words.
    """
    strays: list[float] = []
    # Both ends may have one; a third value would be noise of another kind.
    for _ in range(2):
        levels = np.unique(values[np.isfinite(values)])
        ends = (levels[[-1, -2, 0]], levels[[0, 1, -1]]) if levels.size >= _FEWEST_LEVELS else ()
        rail = next((float(e) for e, near, far in ends if abs(e - near) > abs(near - far)), None)
        if rail is None:
            break
        repairs[f"stray sample of the {name} ({rail:.6g}) left out"] += int(np.sum(values == rail))
        values[values == rail] = np.nan
        strays.append(rail)
    return f", {' and '.join(f'{s:.6g}' for s in strays)} far from all others" if strays else ""


def new_values(speed: FloatArray) -> tuple[slice, str] | None:
    """Which samples of an evenly sampled speed are new, where the recorder made up those between,
    and a note that says so.

    The recorder repeated the last new value (the first differences vanish but at every kth sample)
    or drew a line from one to the next (the second do). ``None`` where all are new.
    """
    for order, how in ((1, "repeated"), (2, "interpolated")):
        change = np.abs(np.diff(speed[:_ENOUGH], order))
        for every in range(min(_SLOWEST, speed.size // 10), 1, -1):
            rows = change[: change.size // every * every].reshape(-1, every)
            sizes = rows.mean(axis=0)
            phase = int(np.argmax(sizes))
            others = float(np.delete(sizes, phase).max())
            often = float(np.median(rows[:, phase])) > 0.2 * sizes[phase]
            if sizes[phase] > 0.0 and others <= _ELSEWHERE * sizes[phase] and often:
                nth = {2: "2nd", 3: "3rd"}.get(every, f"{every}th")
                return slice((phase + 1) % every, None, every), (
                    f"The speed has a new value in every {nth} sample and is {how} between them: "
                    "only samples with a new value are used."
                )
    return None


def told(repairs: Counter[str]) -> tuple[str, ...]:
    """All repairs in one sentence with their counts."""
    made = [f"{count} × {what}" for what, count in repairs.items() if count > 0]
    return (f"Put right while reading: {'; '.join(made)}.",) if made else ()
