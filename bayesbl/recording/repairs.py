"""What is put right in every recording, whatever its format: repairs that lose nothing.

Each is made only where the numbers leave one reading, and is counted; the reader tells all of them
in one note. What is ambiguous, or would lose or make up samples, stays as it is and is refused
later by the place that it is at.
"""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from bayesbl.recording.lost_samples import MOST_LOST, deviation_from_grid
from bayesbl.recording.types import FloatArray

IntArray = NDArray[np.int64]

MOST_DISPLACED = 0.05
"""Share of rows out of order, up to which they are sorted: more are two recordings in one file."""

SHARED_STAMPS = 0.05
"""Share of stamps that repeat the one before, from which on the clock is coarse; fewer are an error
in the file."""

LONGEST_TICK_S = 0.1
"""A coarser clock says too little of when its samples were taken. Those of computers tick in
15.6 ms or less."""

_COUNTERS = (2.0**16, 2.0**24, 2.0**32)
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

    Parameters
    ----------
    stamps, values
        Shapes (n,), finite, and (n, c).
    factor
        Seconds in the unit of the stamps.
    repairs
        Gains what was done and how many times.
    even
        Whether samples are to be even in time. Then a single stamp that repeats the one before is
        an error in the file; else its sample came before the next stamp, which is all that counts.
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
    added = np.concatenate([[0.0], np.cumsum(-np.sign(steps) * jumps)])
    whole: FloatArray = position.copy()
    whole[there] += added * turn * abs(unit) * np.sign(unit)
    return whole


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
