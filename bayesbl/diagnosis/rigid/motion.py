"""Measured motion, and filters and windows for the inverse comparison.

Derivatives come from a zero-phase low pass: a Butterworth filter of order 4, forward and backward,
with −6 dB at the cut-off and no delay. Uneven time stamps are first resampled by cubic splines.
Both sides of the comparison pass the same window w and low pass H:

    w τ = w (J dω/dt + b ω + …)   at every sample, so   H[w τ] = H[w J dω/dt] + H[w b ω] + …

So both sides have the same frequencies (parallel filtering; Gautier 1997, IEEE ICRA, 3284). The
window makes standstill and lost samples zero on both sides, so the filter does not spread them.
Then only nearly independent samples are kept, so that the answer does not depend on how densely a
recording was sampled.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft
from scipy.integrate import cumulative_trapezoid
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
RECORDER_REACH = 8.0
"""Time constants after which a recorder has forgotten a value: 0.03 % remain."""

FADE_PERIODS = 4.0
"""Periods of the cut-off over which the continuation beyond the ends fades: twice the filter's
reach."""
END_PERIODS = 2.0
"""Reach of the filter from the ends of a recording, in periods of the cut-off."""


def _filtered(
    values: FloatArray,
    period_s: float,
    fade_s: float,
    response: Callable[[FloatArray], ComplexArray],
) -> tuple[FloatArray, float, FloatArray]:
    """Line from the first to the last value, (n,); its slope; and the filtered deviation, (n,).

    The deviation is continued oddly at both ends, with a steady slope, and fades out.
    """
    n = values.size
    slope = (values[-1] - values[0]) / ((n - 1) * period_s)
    line = values[0] + slope * period_s * np.arange(n)
    residual = values - line
    more = min(n - 1, math.ceil(fade_s / period_s))
    fade = np.cos(0.5 * math.pi * np.arange(1, more + 1) / more) ** 2
    before, after = -residual[1 : more + 1] * fade, -residual[-2 : -more - 2 : -1] * fade
    size = fft.next_fast_len(n + 2 * more, real=True)
    around = np.concatenate((residual, after, np.zeros(size - n - 2 * more), before[::-1]))
    spectrum = fft.rfft(around) * response(fft.rfftfreq(size, period_s))
    return line, slope, np.asarray(fft.irfft(spectrum, size)[:n])


@dataclass(frozen=True, slots=True)
class Recorder:
    """What a drive does to a channel before it is recorded: a delay d, and smoothing.

        ln H = −iωd − ω²s²/2 + …,     H = exp(−iω(d − s)) / (1 + iωs)

    A low pass with time constant T has d = s = T, a mean over T has d = T/2 and s = T/√12.
    ``smoothing_s2``: s², s²; none where it is negative.
    """

    delay_s: float = 0.0
    smoothing_s2: float = 0.0

    def __call__(self, values: FloatArray, period_s: float) -> FloatArray:
        """A true signal as it is recorded, (n,)."""
        if not (self.delay_s or self.smoothing_s2):
            return values
        time = math.sqrt(max(self.smoothing_s2, 0.0))
        reach = abs(self.delay_s) + RECORDER_REACH * time

        def response(frequency: FloatArray) -> ComplexArray:
            omega = 2.0 * math.pi * frequency
            delayed = np.exp(1j * omega * (time - self.delay_s))
            return np.asarray(delayed / (1.0 + 1j * omega * time))

        line, slope, made = _filtered(values, period_s, max(reach, 2.0 * period_s), response)
        return np.asarray(line - slope * self.delay_s + made)


@dataclass(frozen=True, slots=True)
class LowPass:
    """Zero-phase low pass, with derivatives.

    Both are exact at every frequency below half the sampling rate: the squared gain of a digital
    Butterworth filter, 1/(1 + (tan(ωT/2)/tan(ω_cT/2))⁸), and (iω)ᵏ are applied to the discrete
    Fourier transform. Differences of samples would lose sin(ωT)/ωT of every derivative.
    """

    cutoff_hz: float
    period_s: float

    def __call__(self, values: FloatArray) -> FloatArray:
        """Low-passed values, same shape."""
        return self.derivative(values, 0)

    def derivative(self, values: FloatArray, times: int = 1) -> FloatArray:
        """Derivative of the low-passed values, same shape (n,)."""
        line, slope, made = _filtered(
            values,
            self.period_s,
            FADE_PERIODS / self.cutoff_hz,
            lambda f: np.asarray((2.0j * math.pi * f) ** times * self._gain(f), complex),
        )
        return np.asarray(made + (line, slope, 0.0)[times])

    def of_white_noise(self, step: int, lags: int) -> FloatArray:
        """Autocovariance of filtered white noise at lags of 0, 1 … times ``step``, (lags,)."""
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
    """Measured motion of the motor, each of shape (n,), SI.

    ``source``: ``position`` or ``speed``, from which the derivatives come. From speed alone, the
    angle is its integral, with an unknown start.
    """

    source: str = "position"


def motion_of(recording: Recording, cutoff_hz: float) -> Motion:
    """Motion from position, or from speed without position.

    Raises
    ------
    RecordingError
        If there is neither, or the cut-off is too high for the sampling rate.
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
        acceleration = low_pass.derivative(resolved(position, 2), 2)
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
    acceleration = low_pass.derivative(resolved(speed, 1))
    sway = _sway(angle, low_pass)
    return Motion(recording.time_s, angle, smooth, acceleration, sway, source="speed")


LARGEST_SHARE = 0.01
"""Largest share of noise in the power of the acceleration. It lowers the inertia by as much."""

BAND = 2.0**0.25
"""Half-width of the band in which a signal is compared with its noise, as a ratio."""


def resolved(values: FloatArray, times: int) -> FloatArray:
    """The part of evenly sampled values that stands out of their white noise, (n,).

    Noise in the acceleration would lower the inertia, most at high frequencies, as a filter of the
    torque does. The mean of the true signal, given the noisy one, does neither (regression
    calibration; Wiener 1949): 1 − noise/power, with the power of a band. ``times``: derivatives
    that follow. Where noise is a large share of these, the noise of encoder steps is not white
    enough to be subtracted, and nothing is left.
    """
    straight = np.linspace(values[0], values[-1], values.size)
    # The sines continue a signal oddly at its ends, as the filter does. A taper would not, and the
    # ends would ring in the acceleration.
    spectrum = np.concatenate([[0.0], fft.dst((values - straight)[1:-1], 1)])
    power, noise = spectrum**2, 2.0 * (values.size - 1) * noise_of(values) ** 2
    line = np.arange(1, power.size)
    first = np.floor(line / BAND).astype(int)
    last = np.minimum(np.ceil(line * BAND).astype(int) + 1, power.size)
    total = np.concatenate([[0.0], np.cumsum(power)])
    level = np.maximum((total[last] - total[first]) / (last - first), np.finfo(float).tiny)
    share = np.maximum(0.0, 1.0 - noise / level)
    rise = (line / power.size) ** (2.0 * times)
    share[np.cumsum(rise) * noise > LARGEST_SHARE * np.cumsum(rise * power[1:])] = 0.0
    straight[1:-1] += fft.idst(share * spectrum[1:], 1)
    return straight


def _sway(angle: FloatArray, low_pass: LowPass) -> ComplexArray:
    sine, cosine = (low_pass.derivative(wave(angle), 2) for wave in (np.sin, np.cos))
    return cosine + 1j * sine


def reach(recording: Recording, cutoff_hz: float) -> int:
    """Number of samples over which the filter spreads one."""
    return math.ceil(round(END_PERIODS / cutoff_hz / recording.sampling_period_s, 6))


SHARPER = 3.0
"""Cut-off for the motion over that of the comparison.

A nonlinear law needs a motion sharper than the comparison. At a third of its cut-off, the filter
passes all but 2e-4.
"""

WIDEST = 0.4
"""Highest cut-off, in sampling rates: higher frequencies may be aliases."""

SAMPLES_PER_PERIOD = 2.5
"""Samples compared in a period of the cut-off. Above 1.25 cut-offs, the filter passes 14 %."""

REST_SHARE = 1e-2
"""Speed, in RMS speeds, below which an axis stands or reverses."""

ROUNDED = 1e-8
"""Relative rounding of a position by its written decimals."""


@dataclass(frozen=True, slots=True)
class Window:
    """Takes a signal over a whole recording, (n, …), to the samples of a piece, (k, …).

    Attributes
    ----------
    window
        Shape (n,): 1 for samples that are compared, else 0; ``None`` for all.
    rows
        Samples of the recording that are kept.
    above
        Whether to keep what lies above the cut-off. The acceleration there is mostly noise, but the
        angle is known, so only motor orders are compared, even beyond half the sampling rate.
    step_rad, position_noise_rad
        Step and noise of the recorded motor position; 0 without.
    """

    low_pass: LowPass
    window: FloatArray | None
    rows: slice
    above: bool = False
    step_rad: float = 0.0
    position_noise_rad: float = 0.0

    def __call__(self, signal: FloatArray) -> FloatArray:
        """A signal, or columns, as it is compared."""
        if signal.ndim > 1:
            return np.column_stack([self(column) for column in signal.T])
        windowed = signal if self.window is None else self.window * signal
        passed = self.low_pass(windowed)
        return (windowed - passed if self.above else passed)[self.rows]

    def part(self, rows: slice) -> Window:
        """The window for some of the samples."""
        chosen = range(self.rows.start, self.rows.stop, self.rows.step)[rows]
        return replace(self, rows=slice(chosen.start, chosen.stop, chosen.step))


def sharper(cutoff_hz: float, period_s: float) -> float:
    """Cut-off for the motion, Hz: :data:`SHARPER` times a cut-off, if sampling allows."""
    return max(cutoff_hz, min(SHARPER * cutoff_hz, WIDEST / period_s))


def inside(recording: Recording, cutoff_hz: float) -> slice:
    """Samples out of the filter's reach from the ends."""
    ends = reach(recording, cutoff_hz)
    return slice(ends, max(recording.samples - ends, ends), 1)


def thinned(recording: Recording, cutoff_hz: float) -> slice:
    """As many of these samples as frequencies below the cut-off need."""
    rows = inside(recording, cutoff_hz)
    samples = 1.0 / (SAMPLES_PER_PERIOD * cutoff_hz * recording.sampling_period_s)
    step = max(1, math.floor(round(samples, 6)))
    return slice(rows.start, rows.stop, step)


def standstill(motion: Motion, position_noise: float, cutoff_hz: float) -> BoolArray | None:
    """Mask of samples at which the axis stands or reverses, shape (n,); ``None`` if it never does.

    At rest, friction balances the torque up to its limit and is no function of the speed. The
    filtered speed does not show how long an axis sticks when it reverses.

    ``position_noise``: standard deviation σ, rad. The noise of its derivative below the frequency f
    is 2π σ √(2 T f³/3).
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
    """Standard deviation of white noise, encoder steps included, rad.

    Third differences have 20 times the variance of white noise, and vanish for smooth motion.
    """
    return math.sqrt(float(np.mean(np.diff(position, 3) ** 2)) / 20.0)


def step_of(position: FloatArray) -> float:
    """Smallest step of a position, rad: that of the encoder, or nearly 0 with noise."""
    moved = np.abs(np.diff(position))
    moved = moved[moved > ROUNDED * np.abs(position).max()]
    return float(moved.min()) if moved.size else 0.0


def turns_of(recordings: Sequence[Recording]) -> float:
    """Motor turns in the recording with the longest travel."""
    turns = [0.0]
    for recording in recordings:
        if MOTOR_POSITION in recording.channels:
            turns.append(float(np.ptp(recording.channels[MOTOR_POSITION])))
        elif MOTOR_SPEED in recording.channels:
            turned = np.cumsum(recording.motor_speed_rpm) * recording.sampling_period_s
            turns.append(float(np.ptp(turned)) / RPM_PER_RAD_PER_S)
    return max(turns) / (2.0 * math.pi)
