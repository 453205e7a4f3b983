"""How a signal over a whole recording is compared: both sides through one window and one filter.

    w τ = w (J dω/dt + b ω + …)   at every sample, so   H[w τ] = H[w J dω/dt] + H[w b ω] + …

Behind the low pass H both sides hold the same frequencies (parallel filtering; Gautier 1997, IEEE
ICRA, 3284), and what the window w leaves out (standstill, lost samples) is nothing on both sides
instead of a disturbance that the filter spreads. What is compared is then thinned out to samples
that are nearly independent, so that no answer depends on how densely a recording was sampled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation, binary_opening

from bayesbl.diagnosis.rigid.motion import LowPass, Motion, reach
from bayesbl.recording.types import BoolArray, FloatArray, Recording

SHARPER = 3.0
"""Cut-off of the filter that the motion is taken from, over the one that both sides pass.

The motion of a nonlinear law must be sharper than what is compared of the law: at a third of its
cut-off a filter of order 4 run twice passes all but 2e-4.
"""

SAMPLES_PER_PERIOD = 2.5
"""Samples compared in a period of the cut-off. From 1.25 cut-offs on the filter leaves 14 %."""

REST_SHARE = 1e-2
"""Of the RMS speed: slower than this for half a period of the cut-off, an axis stands."""


@dataclass(frozen=True, slots=True)
class View:
    """From a signal over a whole recording, shape (n,), to the samples of a piece, (k,).

    Attributes
    ----------
    window
        Shape (n,): 0 where nothing is to be compared, else 1; ``None`` for 1 everywhere.
    rows
        Of the recording's samples, those compared.
    """

    low_pass: LowPass
    window: FloatArray | None
    rows: slice

    def __call__(self, signal: FloatArray) -> FloatArray:
        """The signal as it is compared."""
        seen = signal if self.window is None else self.window * signal
        return self.low_pass(seen)[self.rows]

    def half(self, second: bool) -> View:
        """The first or the second half of what is compared."""
        first, end, step = self.rows.start, self.rows.stop, self.rows.step
        middle = first + step * (len(range(first, end, step)) // 2)
        rows = slice(middle, end, step) if second else slice(first, middle, step)
        return View(self.low_pass, self.window, rows)


def sharper(cutoff_hz: float, period_s: float) -> float:
    """Cut-off for the motion, Hz: :data:`SHARPER` times that of the comparison, if sampling allows."""
    return max(cutoff_hz, min(SHARPER * cutoff_hz, 0.4 / period_s))


def compared_rows(recording: Recording, cutoff_hz: float) -> slice:
    """Samples that are compared: not those that the filter's ends reach, and thinned out."""
    ends = reach(recording, cutoff_hz)
    step = max(1, math.floor(1.0 / (SAMPLES_PER_PERIOD * cutoff_hz * recording.sampling_period_s)))
    return slice(ends, max(recording.samples - ends, ends), step)


def standstill(motion: Motion, position_noise: float, cutoff_hz: float) -> BoolArray | None:
    """Samples at which the axis stands, shape (n,); ``None`` if it never does.

    At rest friction is whatever balances the torque, up to its limit: no law of the speed gives it.
    A reversal is no standstill.

    Parameters
    ----------
    position_noise
        Standard deviation, rad; white noise of a derivative below f is 2π σ √(2 T f³/3).
    """
    period = float(motion.time_s[-1] - motion.time_s[0]) / (motion.time_s.size - 1)
    sharp = sharper(cutoff_hz, period)
    noise = 2.0 * math.pi * position_noise * math.sqrt(2.0 * period * sharp**3 / 3.0)
    slow = np.abs(motion.speed) < max(
        3.0 * noise, REST_SHARE * math.sqrt(float(np.mean(motion.speed**2)))
    )
    shortest = math.ceil(0.5 / cutoff_hz / period) | 1
    resting = binary_opening(slow, np.ones(shortest, dtype=bool))
    if not resting.any():
        return None
    return np.asarray(binary_dilation(resting, iterations=math.ceil(1.0 / sharp / period)))


def noise_of(position: FloatArray) -> float:
    """Standard deviation of white noise, the encoder's steps included, rad.

    From third differences: of white noise 20 times its variance, of a smooth motion nothing.
    """
    return math.sqrt(float(np.mean(np.diff(position, 3) ** 2)) / 20.0)
