"""Repairs of every recording, whatever its format.

A repair that loses nothing is made only if the numbers allow one reading. It is counted, and one
note lists all repairs. Anything ambiguous, or that would lose or invent samples, is refused with
its place.

Short losses (NaN, or holes in time) are bridged if that is safe. Bridged samples keep the sampling
even, so that later steps can count samples, and are marked as excluded from the fit. Uneven stamps
are brought to an even grid.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesbl.errors import RecordingError
from bayesbl.recording.types import BoolArray, FloatArray, Recording

LONGEST_LOSS_S = 0.1  # half the ringing of an impact: a longer loss could hide all but its ends
MOST_LOST = 0.05  # largest share of lost samples; with more, the logger is at fault
MOST_CUT = 0.5  # largest share cut off at the ends; with more, little of the recording is left
GRID_TOLERANCE = 0.45  # a stamp's largest distance from an even grid, in sampling periods
MOST_SPARED = 2.5  # largest ratio of sample counts at which the slowest column sets the times
HOLE = 3.0  # multiple of a column's usual step, above which nothing is known between two values
_MOST_GROWTH = 100  # A recording whose holes make it longer than this multiple counts as uneven

_GRID_BEGINS, _FOLLOWED = 21, 0.05
"""Stamps at the start of a running grid, and share of each stamp's distance that the grid follows.
It scatters by a sixth of the stamps' scatter, and follows a period that is wrong by one per cent.
"""

IntArray = NDArray[np.int64]
Place = Callable[[int, int | None], str]  # row and column of a value; ``None`` for the time column


@dataclass(frozen=True, slots=True)
class Bridged:
    """Samples on an even grid as far as possible; shapes (n,), (n, c) and (n,)."""

    time_s: FloatArray
    values: FloatArray
    excluded: BoolArray
    notes: tuple[str, ...]


def deviation_from_grid(time_s: FloatArray, number: FloatArray) -> tuple[FloatArray, float]:
    """Distance of stamps from their least-squares line over sample numbers, and its slope.

    The distance, shape (n,), is in sampling periods. Stamps rounded to a resolution r are within
    r/2 of the line, for any length.
    """
    time: FloatArray = time_s - time_s.mean()
    centred = number - number.mean()
    slope = float(centred @ time) / float(centred @ centred)
    time /= slope  # in place: recordings may be long
    time -= centred
    return time, slope


def sample_numbers(time_s: FloatArray) -> FloatArray | None:
    """Number of each stamp on an even grid, shape (n,); numbers are skipped at holes.

    ``None`` if the stamps are not on an even grid. A grid without holes is preferred, because 1 kHz
    that lost every fifth sample and 800 Hz rounded to 1 ms are the same numbers.
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
    """Numbers counted on a grid that follows the stamps; differences of two stamps scatter more."""
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
    """Rows to keep, and all values, if columns have times of their own and each row is one of
    these.

    The column with the fewest values sets the times; the others are interpolated linearly. If
    samples must be even, this holds up to a ratio of :data:`MOST_SPARED`.
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


def bridge(time_s: FloatArray, values: FloatArray, place: Place, *, even: bool = True) -> Bridged:
    """Bridge short runs of lost samples by straight lines, or leave them out if not ``even``.

    Lost samples at the ends are cut off, up to half of all, because a sensor may wake up late.
    ``time_s``, shape (n,), increases strictly; ``values``, shape (n, c), are NaN where missing.
    Raises RecordingError, with the place, if a run is longer than :data:`LONGEST_LOSS_S`, or more
    than :data:`MOST_LOST` of all samples (:data:`MOST_CUT` at the ends) are lost.
    """
    whole = ~np.isnan(values).any(axis=1)
    kept = np.flatnonzero(whole)
    if kept.size < 2:
        raise RecordingError(
            "No two samples have a number in every column.",
            found=f"{kept.size} of {whole.size} samples without a missing value",
            expected="columns that were recorded at the same times",
        )
    if not even:
        told = f"{whole.size - kept.size} of {whole.size} samples lack a value and are left out."
        none_lost = np.zeros(kept.size, dtype=bool)
        return Bridged(time_s[whole], values[whole], none_lost, (told,) * (kept.size < whole.size))
    first, last = int(kept[0]), int(kept[-1]) + 1
    cut = whole.size - (last - first)
    if cut > MOST_CUT * whole.size:
        raise RecordingError(
            "Too much of the recording has no numbers at its start or end.",
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
    _refuse_too_much(lost, float(lengths[longest]), where)
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


def _refuse_too_much(lost: BoolArray, longest_s: float, where: str) -> None:
    share = lost.mean()
    if longest_s > LONGEST_LOSS_S:
        raise RecordingError(
            "Samples are missing for too long.",
            where=where,
            found=f"nothing for {longest_s:.4g} s",
            expected=f"at most {LONGEST_LOSS_S:g} s in a row; use the part before or after",
        )
    if share > MOST_LOST:
        raise RecordingError(
            "Too many samples are missing.",
            where=f"longest {where}",
            found=f"{lost.sum()} of {lost.size} samples, {100.0 * share:.3g} %",
            expected=f"at most {100.0 * MOST_LOST:g} %; rename a column that is not needed",
        )


def runs(flags: BoolArray) -> tuple[IntArray, IntArray]:
    """First and one-past-last index of each run of true flags."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False]))))
    return edges[::2], edges[1::2]


UNEVEN_STAMPS = "Its samples are not evenly spaced: an even grid was made by their time stamps."


EVEN = 0.1
"""Largest distance of a time stamp from an even grid, in sampling periods, that counts as even.
Time stamps rounded to a tenth of the period are common, and real jitter of that size is harmless.
It moves a 10 Hz ringing of 30 rpm by less than 0.2 rpm at 1 kHz."""


def even(recording: Recording, tolerance: float, harmless_s: float = 0.0) -> Recording:
    """The recording on the even grid nearest to its stamps, by cubic splines.

    Values are unchanged if no stamp deviates by more than ``tolerance`` periods, or all by less
    than ``harmless_s`` RMS.
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
    """A mask, shape (n,), widened by this number of samples on either side."""
    if excluded is None or not excluded.any():
        return None
    from scipy.ndimage import binary_dilation

    return np.asarray(binary_dilation(excluded, iterations=samples))


MOST_DISPLACED = 0.05  # share of rows out of order; more are two recordings in one file
SHARED_STAMPS = 0.05  # share of repeated stamps from which the clock is coarse, not faulty
LONGEST_TICK_S = 0.1  # longest tick of a usable clock. Clocks of computers tick in 15.6 ms or less.
_COUNTERS = (2.0**16, 2.0**24, 2.0**32)
_WORDS = (2.0**16, 2.0**32)
_DAY_S = 86400.0
_POWERS = tuple(2.0**bits for bits in range(8, 33))  # counts at which positions wrap, or a turn
_SLOWEST = 20  # largest number of samples between new values at which a slower rate is sought
_ENOUGH = 1_000_000  # samples of a long recording that this search uses
_FEWEST_LEVELS = 12  # fewest different values of a signal whose largest or smallest may be a stray
_ELSEWHERE = 0.05  # largest share of the change that may occur between new values


def mended_clock(
    stamps: FloatArray,
    values: FloatArray,
    factor: float,
    repairs: Counter[str],
    *,
    even: bool = True,
) -> tuple[IntArray, FloatArray]:
    """Rows to keep in the order of time, and their time in the unit of the stamps.

    Counters that wrap are continued, exact repeats are dropped, single rows are sorted, and the
    samples of a coarse clock are spread. ``stamps``: shape (n,), finite; ``values``: (n, c);
    ``factor``: seconds per unit. ``repairs`` counts what was done. If samples must be ``even``, a
    single repeated stamp is an error in the file; otherwise the sample counts as earlier than the
    next stamp.
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
    """Rows by time without exact repeats; unchanged if that does not give an even clock."""
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
    """Spread the samples of a coarse clock along the line through all, or evenly within ticks."""
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
    """Fill the empty cells of values (n, c) of a log on change with the last value above.

    Such a log never writes a value twice in a row, and at no even rate; other files have lost
    samples.
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
    """Values, shape (n,), with missing ones interpolated linearly."""
    rows = np.flatnonzero(np.isfinite(values))
    return np.interp(np.arange(values.size), rows, values[rows])


def unwrapped(position: FloatArray, unit: float, repairs: Counter[str], name: str) -> FloatArray:
    """Continue a position, shape (n,), over its wraps at the end of a turn.

    ``unit`` is the size of the file's unit. The position is unchanged if its jumps are no turn of
    any unit or counter.
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


def signed(
    values: FloatArray, unit: float, repairs: Counter[str], name: str, largest: float = math.inf
) -> FloatArray:
    """Restore the signs of whole numbers, shape (n,), that were written as unsigned words.

    A bus servo writes −300 as 33068 (sign in the highest of 16 bits) or as 65236 (complement).
    Numbers are then near 0 and near half or all of the word, with none between; or all near all of
    it, if nothing else is so large, as no number of 32 bits and no channel above ``largest``.
    """
    there = np.isfinite(values)
    written = values[there] / unit
    counts = np.round(written)
    if counts.size == 0 or counts.min() < 0.0 or np.max(np.abs(written - counts)) > 1e-5:
        return values
    for word in _WORDS:
        quarters = np.unique(counts // (word / 4.0)).tolist()
        only_negative = quarters == [3.0] and (
            word == _WORDS[-1] or abs(unit) * counts.min() > largest
        )
        if quarters in ([0.0, 2.0], [0.0, 3.0]) or only_negative:
            high = counts >= word / 2.0
            signs = word / 2.0 - counts[high] if 2.0 in quarters else counts[high] - word
            if not only_negative and -signs.max() > counts[~high].max():
                break  # large beside all others: a speed beside a standstill
            counts[high] = signs
            repairs[f"sign of the {name} in an unsigned word"] += int(high.sum())
            whole: FloatArray = values.copy()
            whole[there] = unit * counts
            return whole
    return values


def without_strays(values: FloatArray, repairs: Counter[str], name: str) -> str:
    """Replace values, shape (n,), by NaN that are farther from all others than these from one
    another.

    A signal jumps to such a rail in a dropout (0) or an overflow (65535). The limit of a clipped
    signal is next to other values. Returns the rails in words.
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
    """Samples at which an evenly sampled speed has new values, and a note; ``None`` if all are new.

    A recorder may repeat the last value (first differences vanish but at every kth sample) or
    interpolate (second differences do).
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
    """All repairs with their counts, in one sentence."""
    made = [f"{count} × {what}" for what, count in repairs.items() if count > 0]
    return (f"Put right while reading: {'; '.join(made)}.",) if made else ()
