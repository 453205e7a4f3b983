"""Recordings whose samples are not evenly spaced, brought to an even grid by their time stamps."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import binary_dilation

from bayesbl.recording.lost_samples import deviation_from_grid
from bayesbl.recording.types import BoolArray, Recording

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
    return np.asarray(binary_dilation(excluded, iterations=samples))
