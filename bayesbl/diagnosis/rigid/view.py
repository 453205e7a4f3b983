"""How a signal over a whole recording is compared: both sides through one window and one filter.

    w τ = w (J dω/dt + b ω + …)   at every sample, so   H[w τ] = H[w J dω/dt] + H[w b ω] + …

Behind the low pass H both sides hold the same frequencies (parallel filtering; Gautier 1997, IEEE
ICRA, 3284), and what the window w leaves out (standstill, lost samples) is nothing on both sides
instead of a disturbance that the filter spreads. What is compared is then thinned out to samples
that are nearly independent, so that no answer depends on how densely a recording was sampled.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import binary_dilation

from bayesbl.diagnosis.rigid.motion import LowPass, Motion, reach
from bayesbl.recording.types import (
    MOTOR_POSITION,
    MOTOR_SPEED,
    BoolArray,
    FloatArray,
    Recording,
)
from bayesbl.units import RPM_PER_RAD_PER_S

SHARPER = 3.0
"""Cut-off of the filter that the motion is taken from, over the one that both sides pass.

The motion of a nonlinear law must be sharper than what is compared of the law: at a third of its
cut-off a filter of order 4 run twice passes all but 2e-4.
"""

WIDEST = 0.4
"""Highest cut-off, in sampling rates: what lies above can be another frequency."""

SAMPLES_PER_PERIOD = 2.5
"""Samples compared in a period of the cut-off. From 1.25 cut-offs on the filter leaves 14 %."""

REST_SHARE = 1e-2
"""Of the RMS speed: slower than this, an axis stands or turns round."""

MOST_STEPS = 5.5
"""Of a position from sample to sample, up to which its written decimals leave them whole."""

ROUNDED = 1e-8
"""Of a position: what its written decimals may move it by."""

FEWEST_STEPS = 50
SURELY_WHOLE = 0.98
FARTHER = 2.0
WHOLE_STEP = 0.1
"""Share of a step that written decimals may add."""


@dataclass(frozen=True, slots=True)
class Window:
    """From a signal over a whole recording, shape (n,), to the samples of a piece, (k,).

    Attributes
    ----------
    window
        Shape (n,): 0 where nothing is to be compared, else 1; ``None`` for 1 everywhere.
    rows
        Of the recording's samples, those compared.
    above
        What the filter holds back instead of what it passes. There the acceleration is mostly
        noise, but the angle is known: what turns with the motor can be compared, even beyond half
        the sampling rate, and nothing else.
    step_rad, position_noise_rad
        Of the motor's position as recorded; 0 where it has none.
    """

    low_pass: LowPass
    window: FloatArray | None
    rows: slice
    above: bool = False
    step_rad: float = 0.0
    position_noise_rad: float = 0.0

    def __call__(self, signal: FloatArray) -> FloatArray:
        """The signal as it is compared."""
        seen = signal if self.window is None else self.window * signal
        passed = self.low_pass(seen)
        return (seen - passed if self.above else passed)[self.rows]

    def half(self, second: bool) -> Window:
        """The first or the second half of what is compared."""
        first, end, step = self.rows.start, self.rows.stop, self.rows.step
        middle = first + step * (len(range(first, end, step)) // 2)
        rows = slice(middle, end, step) if second else slice(first, middle, step)
        return replace(self, rows=rows)


def sharper(cutoff_hz: float, period_s: float) -> float:
    """Cut-off for the motion, Hz: :data:`SHARPER` times the other one, if sampling allows."""
    return max(cutoff_hz, min(SHARPER * cutoff_hz, WIDEST / period_s))


def inside(recording: Recording, cutoff_hz: float) -> slice:
    """Samples that the filter's ends do not reach."""
    ends = reach(recording, cutoff_hz)
    return slice(ends, max(recording.samples - ends, ends), 1)


def thinned(recording: Recording, cutoff_hz: float) -> slice:
    """Of those, as many as the frequencies below the cut-off need."""
    rows = inside(recording, cutoff_hz)
    samples = 1.0 / (SAMPLES_PER_PERIOD * cutoff_hz * recording.sampling_period_s)
    step = max(1, math.floor(round(samples, 6)))
    return slice(rows.start, rows.stop, step)


def standstill(motion: Motion, position_noise: float, cutoff_hz: float) -> BoolArray | None:
    """Samples at which the axis stands or turns round, shape (n,); ``None`` if it never does.

    At rest friction is whatever balances the torque, up to its limit: no law of the speed gives it.
    How long an axis sticks when it turns round, a filtered speed does not show.

    Parameters
    ----------
    position_noise
        Standard deviation, rad; white noise of a derivative below f is 2π σ √(2 T f³/3).
    """
    period = float(motion.time_s[-1] - motion.time_s[0]) / (motion.time_s.size - 1)
    sharp = sharper(cutoff_hz, period)
    noise = 2.0 * math.pi * position_noise * math.sqrt(2.0 * period * sharp**3 / 3.0)
    rms = math.sqrt(float(np.mean(motion.speed**2)))
    slow = np.abs(motion.speed) < max(3.0 * noise, REST_SHARE * rms)
    slow[1:] |= np.sign(motion.speed[1:]) != np.sign(motion.speed[:-1])
    if not slow.any():
        return None
    return np.asarray(binary_dilation(slow, iterations=math.ceil(round(1.0 / sharp / period, 6))))


def noise_of(position: FloatArray) -> float:
    """Standard deviation of white noise, the encoder's steps included, rad.

    From third differences: of white noise 20 times its variance, of a smooth motion nothing.
    """
    return math.sqrt(float(np.mean(np.diff(position, 3) ** 2)) / 20.0)


def step_of(position: FloatArray) -> float:
    """The step that a position moves in, rad; 0 where it is not seen to.

    From the smallest movements, then from ever longer ways, each a whole number of steps.
    """
    moved = np.abs(np.diff(position))
    moved = moved[moved > ROUNDED * np.abs(position).max()]
    if not moved.size:
        return 0.0
    step = float(np.median(moved[moved < 1.5 * moved.min()]))
    few = moved[moved < MOST_STEPS * step] / step
    if few.size < FEWEST_STEPS or np.mean(np.abs(few - np.round(few)) < WHOLE_STEP) < SURELY_WHOLE:
        return 0.0
    ways = np.abs(position - position[0])
    reach = MOST_STEPS * step
    while reach < FARTHER * ways.max():
        way = ways[ways < reach]
        steps = np.round(way / step)
        if steps.any():
            step = float(way @ steps / (steps @ steps))
        reach *= FARTHER
    return step


def turns_of(recordings: Sequence[Recording]) -> float:
    """Of the motor, in the recording that goes farthest."""
    found = [0.0]
    for recording in recordings:
        if MOTOR_POSITION in recording.channels:
            found.append(float(np.ptp(recording.channels[MOTOR_POSITION])))
        elif MOTOR_SPEED in recording.channels:
            turned = np.cumsum(recording.motor_speed_rpm) * recording.sampling_period_s
            found.append(float(np.ptp(turned)) / RPM_PER_RAD_PER_S)
    return max(found) / (2.0 * math.pi)
