"""Recordings whose samples are not evenly spaced, brought to an even grid by their time stamps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import binary_dilation

from bayesbl.recording.types import BoolArray, Recording

UNEVEN = 1e-3
"""Departure of a time stamp from the even grid, in periods, up to which it is even."""


def even(recording: Recording, tolerance: float = UNEVEN) -> Recording:
    """The recording on an even grid of the same mean period, by cubic splines.

    Itself where no stamp departs by more than ``tolerance`` periods.
    """
    n = recording.samples
    begin, end = recording.time_s[0], recording.time_s[-1]
    grid = begin + np.arange(n) * ((end - begin) / (n - 1))
    if np.max(np.abs(recording.time_s - grid)) <= tolerance * recording.sampling_period_s:
        return replace(recording, time_s=grid)
    channels = {
        n: CubicSpline(recording.time_s, row)(grid) for n, row in recording.channels.items()
    }
    return replace(
        recording, time_s=grid, channels=channels, excluded=widened(recording.excluded, 1)
    )


def widened(excluded: BoolArray | None, samples: int) -> BoolArray | None:
    """A mask with so many samples more on either side of what it marks, shape (n,)."""
    if excluded is None or not excluded.any():
        return None
    return np.asarray(binary_dilation(excluded, iterations=samples))
