"""Time stamps of a coarse clock: several samples share each tick."""

from __future__ import annotations

import numpy as np

from bayesbl.recording.types import FloatArray

SAMPLES_PER_TICK = 2.0
"""From this mean on the clock is coarse; fewer repeated stamps are an error in the file."""

LONGEST_TICK_S = 0.1
"""A coarser clock says too little of when its samples were taken. Those of computers tick in
15.6 ms or less."""


def spread_ticks(time_s: FloatArray) -> tuple[FloatArray, str | None]:
    """Samples of one tick spread evenly until the next one, and a sentence that says so.

    Time as given, and no sentence, unless it never runs back and ticks hold
    :data:`SAMPLES_PER_TICK` samples or more on average. Shape (n,).
    """
    steps = np.diff(time_s)
    starts = np.concatenate([[0], np.flatnonzero(steps > 0.0) + 1])
    if np.any(steps < 0.0) or starts.size < 3 or time_s.size < SAMPLES_PER_TICK * starts.size:
        return time_s, None
    ticks = np.diff(time_s[starts])
    usual = float(np.median(ticks))
    if usual > LONGEST_TICK_S:
        return time_s, None
    # The last tick ends where the next one would have come.
    ends = np.append(time_s[starts[1:]], time_s[starts[-1]] + usual)
    counts = np.diff(np.append(starts, time_s.size))
    # Samples that follow a hole belong to its end: they came within an ordinary tick.
    lengths = np.minimum(ends - time_s[starts], usual * 1.5)
    within = np.arange(time_s.size) - np.repeat(starts, counts)
    spread = time_s + within / np.repeat(counts, counts) * np.repeat(lengths, counts)
    return spread, (
        f"The clock ticks in {1e3 * usual:.2g} ms, with several samples a tick: they are spread "
        "evenly within it."
    )
