"""Does a channel lag its simulation by a fixed time?"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from bayesbl.diagnosis.residuals.spectrum import NoiseFloor
from bayesbl.recording.types import FloatArray

ROUNDS = 4
LONGEST_SHIFT = 0.05
"""Of the record: a shift beyond it is no skew."""


@dataclass(frozen=True, slots=True)
class Skew:
    """recorded(t) ≈ simulated(t − lag).

    Attributes
    ----------
    lag_s, standard_error_s
        Positive if the recording comes later.
    explained
        Share of the residual beyond noise that the lag explains, at most 1; negative never.
    """

    lag_s: float
    standard_error_s: float
    explained: float


def time_skew(
    recorded: FloatArray, simulated: FloatArray, sampling_hz: float, floor: NoiseFloor
) -> Skew:
    """Generalised least squares of the difference on the simulation's slope, repeated.

    Shifts what is a start angle in truth as well: only differences between channels mean skew.
    A constant difference is left out. Both signals of shape (n,), same unit.
    """
    n = recorded.size
    time = np.arange(n) / sampling_hz
    spline = CubicSpline(time, simulated)
    lag = 0.0
    error = math.inf
    first = last = 0.0
    for turn in range(ROUNDS):
        shifted = np.clip(time - lag, time[0], time[-1])
        left = _centred(floor.whiten(recorded - spline(shifted)))
        slope = _centred(floor.whiten(-spline(shifted, 1)))
        weight = float(slope @ slope)
        if weight < 1e-12 * n:
            return Skew(0.0, math.inf, 0.0)
        step = float(slope @ left) / weight
        if turn == 0:
            first = float(left @ left)
        error = 1.0 / math.sqrt(weight)
        last = float(left @ left) - step**2 * weight
        lag += step
        if abs(lag) > LONGEST_SHIFT * time[-1]:
            return Skew(0.0, error, 0.0)
    beyond = first - left.size
    explained = (first - last) / beyond if beyond > 0.0 else 0.0
    return Skew(lag, error, min(max(explained, 0.0), 1.0))


def _centred(values: FloatArray) -> FloatArray:
    return np.asarray(values - values.mean())
