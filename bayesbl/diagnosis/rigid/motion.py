"""Measured motion as the inverse comparison needs it: angle, speed and acceleration of the motor.

Derivatives come from a zero-phase low pass: Butterworth of order 4, run forward and backward, so
that −6 dB lie at the cut-off and nothing is delayed. Recordings with uneven time stamps are first
brought to an even grid of the same mean period by cubic splines.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import fft
from scipy.interpolate import make_interp_spline

from bayesbl.errors import RecordingError
from bayesbl.recording.types import (
    MOTOR_POSITION,
    MOTOR_SPEED,
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
        left = values - line
        more = min(n - 1, math.ceil(FADE_PERIODS / (self.cutoff_hz * self.period_s)))
        fade = np.cos(0.5 * math.pi * np.arange(1, more + 1) / more) ** 2
        before, after = -left[1 : more + 1] * fade, -left[-2 : -more - 2 : -1] * fade
        size = fft.next_fast_len(n + 2 * more, real=True)
        around = np.concatenate((left, after, np.zeros(size - n - 2 * more), before[::-1]))
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
class Motion:
    """Motion of the motor, each of shape (n,), SI.

    ``sway`` is d²/dt² exp(i θ_m), differentiated as the rest: what an eccentric encoder adds.
    ``source``: ``position`` or ``speed``, whichever the derivatives come from; from speed alone the
    angle is its integral, known but for where it starts. ``friction_width``: speed over which dry
    friction changes its sign, rad/s; 0 for a sign that jumps.
    """

    time_s: FloatArray
    angle: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    sway: ComplexArray
    source: str
    friction_width: float = 0.0

    def shifted(self, time_s: float) -> Motion:
        """The motion as it was ``time_s`` earlier; the ends stand still beyond the recording.

        By splines of degree 7: a straight line between samples would take noise from the
        acceleration, and a shift by half a sample would then fit better than none.
        """
        when = np.clip(self.time_s - time_s, self.time_s[0], self.time_s[-1])
        degree = min(7, (self.time_s.size - 1) // 2 * 2 - 1)

        def at(values: Any) -> Any:
            return make_interp_spline(self.time_s, values, k=degree)(when)

        return self._each(at)

    def _each(self, change: Callable[[Any], Any]) -> Motion:
        names = ("angle", "speed", "acceleration", "sway")
        return replace(self, **{name: change(getattr(self, name)) for name in names})


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
            "The cut-off of the derivatives' filter lies beyond what the sampling shows.",
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
        return Motion(recording.time_s, angle, speed, acceleration, sway, "position")
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
    steps = 0.5 * (smooth[1:] + smooth[:-1]) * period
    angle = np.concatenate(([0.0], np.cumsum(steps)))
    acceleration = low_pass.derivative(speed)
    return Motion(recording.time_s, angle, smooth, acceleration, _sway(angle, low_pass), "speed")


def _sway(angle: FloatArray, low_pass: LowPass) -> ComplexArray:
    sine, cosine = (low_pass.derivative(wave(angle), 2) for wave in (np.sin, np.cos))
    return cosine + 1j * sine


def reach(recording: Recording, cutoff_hz: float) -> int:
    """Samples over which the filter carries what is wrong with one."""
    return math.ceil(round(END_PERIODS / cutoff_hz / recording.sampling_period_s, 6))
