"""Measured motion as an inverse comparison needs it, and how signals over it are compared.

Derivatives come from a zero-phase low pass: Butterworth of order 4, run forward and backward, so
that −6 dB lie at the cut-off and nothing is delayed. Recordings with uneven time stamps are first
brought to an even grid of the same mean period by cubic splines. What is compared passes one window
and one filter on both sides:

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
from typing import Any

import numpy as np
from scipy import fft
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import make_interp_spline
from scipy.ndimage import binary_dilation

from bayesbl.bench.effect_declaration import RigidMotion
from bayesbl.errors import RecordingError
from bayesbl.recording.types import (
    MOTOR_POSITION,
    MOTOR_SPEED,
    BoolArray,
    ComplexArray,
    FloatArray,
    Recording,
)
from bayesbl.units import RPM_PER_RAD_PER_S

FILTER_ORDER = 4
FADE_PERIODS = 4.0
"""Of the cut-off frequency, in which what is beyond the ends fades: twice what the filter carries
from there."""
END_PERIODS = 2.0
"""Of the cut-off frequency: how far the ends of a recording disturb what is filtered."""


@dataclass(frozen=True, slots=True)
class LowPass:
    """The stated zero-phase filter and the derivatives behind it.

    Both are exact at every frequency below half the sampling rate: a digital Butterworth filter's
    squared gain 1/(1 + (tan(ωT/2)/tan(ω_cT/2))⁸) and (iω)ᵏ, applied to the recording's discrete
    Fourier transform. Differences of samples would lose sin(ωT)/ωT of every derivative.
    """

    cutoff_hz: float
    period_s: float

    def __call__(self, values: FloatArray) -> FloatArray:
        """Low-passed, same shape."""
        return self.derivative(values, 0)

    def derivative(self, values: FloatArray, times: int = 1) -> FloatArray:
        """Derivative of the low-passed values, same shape (n,).

        What is left of a line from the first to the last sample goes on oddly at either end, with a
        steady slope, and fades out.
        """
        n = values.size
        slope = (values[-1] - values[0]) / ((n - 1) * self.period_s)
        line = values[0] + slope * self.period_s * np.arange(n)
        residual = values - line
        more = min(n - 1, math.ceil(FADE_PERIODS / (self.cutoff_hz * self.period_s)))
        fade = np.cos(0.5 * math.pi * np.arange(1, more + 1) / more) ** 2
        before, after = -residual[1 : more + 1] * fade, -residual[-2 : -more - 2 : -1] * fade
        size = fft.next_fast_len(n + 2 * more, real=True)
        around = np.concatenate((residual, after, np.zeros(size - n - 2 * more), before[::-1]))
        frequency = fft.rfftfreq(size, self.period_s)
        gain = (2.0j * math.pi * frequency) ** times * self._gain(frequency)
        made = fft.irfft(fft.rfft(around) * gain, size)[:n]
        return np.asarray(made + (line, slope, 0.0)[times])

    def of_white_noise(self, step: int, lags: int) -> FloatArray:
        """Autocovariance of white noise behind it, at 0, 1 … times ``step`` samples, (lags,)."""
        size = fft.next_fast_len(
            2 * step * lags + math.ceil(FADE_PERIODS / (self.cutoff_hz * self.period_s)), real=True
        )
        power = self._gain(fft.rfftfreq(size, self.period_s)) ** 2
        return np.asarray(fft.irfft(power, size)[: step * lags : step])

    def _gain(self, frequency: FloatArray) -> FloatArray:
        ratio = np.tan(math.pi * frequency * self.period_s)
        ratio /= math.tan(math.pi * self.cutoff_hz * self.period_s)
        return np.asarray(1.0 / (1.0 + ratio ** (2 * FILTER_ORDER)))


@dataclass(frozen=True, slots=True)
class Motion(RigidMotion):
    """Motion of the motor as it was measured, each of shape (n,), SI.

    ``source``: ``position`` or ``speed``, whichever the derivatives come from; from speed alone the
    angle is its integral, known but for where it starts.
    """

    source: str = "position"

    def shifted(self, time_s: float) -> Motion:
        """The motion as it was ``time_s`` earlier; the ends stand still beyond the recording.

        By splines of degree 7: a straight line between samples would take noise from the
        acceleration, and a shift by half a sample would then fit better than none.
        """
        when = np.clip(self.time_s - time_s, self.time_s[0], self.time_s[-1])
        degree = min(7, (self.time_s.size - 1) // 2 * 2 - 1)

        def at(values: Any) -> Any:
            return make_interp_spline(self.time_s, values, k=degree)(when)

        moved = {n: at(getattr(self, n)) for n in ("angle", "speed", "acceleration", "sway")}
        return replace(self, **moved)


def motion_of(recording: Recording, cutoff_hz: float) -> Motion:
    """Motion from position, or from speed where there is none.

    Raises
    ------
    RecordingError
        If there is neither, or the cut-off lies beyond what the sampling shows.
    """
    period = recording.sampling_period_s
    if not cutoff_hz < 0.45 / period:
        raise RecordingError(
            "The cut-off of the derivatives' filter is above what the sampling shows.",
            file=recording.place,
            found=f"{cutoff_hz:g} Hz at {1.0 / period:.4g} samples per second",
            expected=f"below {0.45 / period:.4g} Hz",
        )
    low_pass = LowPass(cutoff_hz, period)
    position = recording.channels.get(MOTOR_POSITION)
    if position is not None:
        angle, speed = low_pass(position), low_pass.derivative(position)
        acceleration = low_pass.derivative(position, 2)
        sway = _sway(angle, low_pass)
        return Motion(recording.time_s, angle, speed, acceleration, sway)
    measured = recording.channels.get(MOTOR_SPEED)
    if measured is None:
        raise RecordingError(
            "There is neither position nor speed of the motor, so no motion to start from.",
            file=recording.place,
            found=", ".join(recording.channels),
            expected=f"{MOTOR_POSITION} or {MOTOR_SPEED}",
        )
    speed = measured / RPM_PER_RAD_PER_S
    smooth = low_pass(speed)
    angle = np.asarray(cumulative_trapezoid(smooth, dx=period, initial=0.0))
    acceleration = low_pass.derivative(speed)
    sway = _sway(angle, low_pass)
    return Motion(recording.time_s, angle, smooth, acceleration, sway, source="speed")


def _sway(angle: FloatArray, low_pass: LowPass) -> ComplexArray:
    sine, cosine = (low_pass.derivative(wave(angle), 2) for wave in (np.sin, np.cos))
    return cosine + 1j * sine


def reach(recording: Recording, cutoff_hz: float) -> int:
    """Samples over which the filter carries what is wrong with one."""
    return math.ceil(round(END_PERIODS / cutoff_hz / recording.sampling_period_s, 6))


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

ROUNDED = 1e-8
"""Of a position: what its written decimals may move it by."""


@dataclass(frozen=True, slots=True)
class Window:
    """From a signal over a whole recording, shape (n, …), to the samples of a piece, (k, …).

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
        """The signal, or columns, as it is compared."""
        if signal.ndim > 1:
            return np.column_stack([self(column) for column in signal.T])
        windowed = signal if self.window is None else self.window * signal
        passed = self.low_pass(windowed)
        return (windowed - passed if self.above else passed)[self.rows]

    def part(self, rows: slice) -> Window:
        """Some of the samples that are compared."""
        chosen = range(self.rows.start, self.rows.stop, self.rows.step)[rows]
        return replace(self, rows=slice(chosen.start, chosen.stop, chosen.step))


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
    """The smallest step that a position moves in, rad: an encoder's, or of noise almost none."""
    moved = np.abs(np.diff(position))
    moved = moved[moved > ROUNDED * np.abs(position).max()]
    return float(moved.min()) if moved.size else 0.0


def turns_of(recordings: Sequence[Recording]) -> float:
    """Of the motor, in the recording that goes farthest."""
    turns = [0.0]
    for recording in recordings:
        if MOTOR_POSITION in recording.channels:
            turns.append(float(np.ptp(recording.channels[MOTOR_POSITION])))
        elif MOTOR_SPEED in recording.channels:
            turned = np.cumsum(recording.motor_speed_rpm) * recording.sampling_period_s
            turns.append(float(np.ptp(turned)) / RPM_PER_RAD_PER_S)
    return max(turns) / (2.0 * math.pi)
