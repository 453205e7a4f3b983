"""After what time a recording at constant speed repeats, by the recording alone.

Speed, gear ratio and the recorder's clock say when the load has turned once. So do the impacts, far
more sharply, and whichever of the three is a little off shows in the difference.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.interpolate import CubicSpline

from bayesbl.recording.types import FloatArray
from bayesbl.units import RPM_PER_RAD_PER_S

WITHIN = 0.02
"""Of the period stated, where it is sought. The ringing looks much like itself one of its own
periods later too, 1.4 % of a rotation on the reference bench, but never as much as a turn later."""

STEP = 0.05
"""Between periods that are tried, in samples; the lowest is refined by a parabola."""

MOTOR_ORDERS = 12
SWELLS = 2
"""Orders of the motor that are taken out first, as they do not repeat with the load's turn, and
orders of the load to either side: such lines swell and ebb with gravity."""

SMOOTHED = 15
"""Neighbouring orders of a rotation over which its spectrum is averaged: of ringing that has died
away in a fifteenth of a rotation they are alike."""

STANDS_OUT = 6.0
"""Standard deviations by which what repeats must stand out of the noise at an order to count."""

SPREAD_OF_MEDIAN = 1.25
"""Standard deviation of the median of many normal values over that of their mean."""

PLACES = 24
"""Parts of a rotation that a gain is told apart in: impacts are in a few, what goes on all the time
in all of them."""

LOWEST_BINS = 6
"""Of a rotation's spectrum, by which noise of the mean speed is judged."""


@dataclass(frozen=True, slots=True)
class Repetition:
    """How a recording repeats.

    ``gain``: χ² by which impacts agree better after this period than after the one stated. 0 where
    what gains goes on all the time, as a line of the motor does, and where no impacts stand out of
    the noise: gravity's wave alone tells the period to a few thousandths. ``mean_rpm``: over whole
    periods, without sign, with its standard deviation.
    """

    period_s: float
    gain: float
    mean_rpm: float
    mean_sd_rpm: float

    @property
    def motor_turns(self) -> float:
        """Of the motor in a period: the gear ratio, where the load turns once in it."""
        return self.mean_rpm / 60.0 * self.period_s


def repetition(
    speed_rpm: FloatArray, sampling_hz: float, stated_s: float, least_sd_rpm: float = 0.0
) -> Repetition | None:
    """The period, near the one stated, after which all rotations are most alike.

    ``None`` where there are less than two, or nothing repeats that stands out of the noise.

    ``speed_rpm``: shape (n,), evenly sampled. ``least_sd_rpm``: of what is not exact in each
    sample, whether it differs between rotations or not.
    """
    stated = stated_s * sampling_hz
    if speed_rpm.size - 1 < 2.0 * stated * (1.0 + WITHIN):
        return None
    speed_rpm = math.copysign(1.0, speed_rpm.mean()) * speed_rpm
    cleaned = _without_motor_lines(speed_rpm, sampling_hz, stated)
    period = _most_alike(cleaned, stated)
    for _ in range(2):
        # The weights are those of the rotations that they bring together.
        if period is None:
            return None
        weights = _weights(_folded(cleaned, period), least_sd_rpm**2)
        if not np.any(weights):
            return None
        weighted = _filtered(cleaned, weights, period)
        period = _most_alike(weighted, stated)
    if period is None:
        return None
    gain = _of_impacts(_differs(weighted, stated) - _differs(weighted, period))
    if not _shows_impacts(_folded(cleaned, period), least_sd_rpm**2):
        gain = 0.0
    turns = _folded(speed_rpm, period)
    noise = float(_noise_power(turns)[:LOWEST_BINS].mean()) + least_sd_rpm**2
    return Repetition(
        period / sampling_hz,
        2.0 * period * gain,
        float(turns.mean()),
        math.sqrt(noise / turns.size),
    )


def _without_motor_lines(speed_rpm: FloatArray, sampling_hz: float, period: float) -> FloatArray:
    """The speed about its mean without what goes with the motor's angle."""
    mean = float(speed_rpm.mean())
    cleaned = speed_rpm - mean
    turn = np.exp(1j * np.cumsum(speed_rpm) / RPM_PER_RAD_PER_S / sampling_hz)
    load = np.exp(2j * math.pi / period * np.arange(speed_rpm.size))
    swells = np.stack([load**swell for swell in range(-SWELLS, SWELLS + 1)])
    overlap = swells.conj() @ swells.T
    wave = np.ones_like(turn)
    for _ in range(min(MOTOR_ORDERS, int(0.5 * sampling_hz / (mean / 60.0)))):
        wave = wave * turn
        sizes = np.linalg.solve(overlap, swells.conj() @ (cleaned * wave.conj()))
        cleaned = cleaned - 2.0 * np.real(wave * (sizes @ swells))
    return cleaned


def _most_alike(values: FloatArray, stated: float) -> float | None:
    """The period in samples after which values (n,) differ least; ``None`` at an end of the range.

    From themselves one period later, two, and so on.
    """
    tried = np.arange(stated * (1.0 - WITHIN), stated * (1.0 + WITHIN), STEP)
    squares = _mean_square(values, stated)(tried)
    place = int(np.argmin(squares))
    if not 0 < place < tried.size - 1:
        return None
    before, here, after = squares[place - 1 : place + 2]
    bend = before - 2.0 * here + after
    return float(tried[place] + (STEP * 0.5 * (before - after) / bend if bend > 0.0 else 0.0))


def _mean_square(values: FloatArray, stated: float) -> Callable[[FloatArray], FloatArray]:
    """Of the differences between values (n,) and themselves whole periods later, by the period."""
    size = values.size
    products = np.fft.irfft(np.abs(np.fft.rfft(values, 2 * size)) ** 2)
    energy = np.concatenate([[0.0], np.cumsum(values**2)])
    at = np.arange(size + 1.0)
    later: list[CubicSpline] = []
    for k in range(1, int((size - 1) / (stated * (1.0 + WITHIN))) + 1):
        low, high = (k * stated * (1.0 + end) for end in (-WITHIN, WITHIN))
        lags = np.arange(max(int(low) - 2, 0), min(int(high) + 4, size))
        later.append(CubicSpline(lags, products[lags]))

    def mean_square(periods: FloatArray) -> FloatArray:
        squares, samples = np.zeros(periods.size), np.zeros(periods.size)
        for k, product in enumerate(later, start=1):
            lag = k * periods
            squares += np.interp(size - lag, at, energy) + energy[-1] - np.interp(lag, at, energy)
            squares -= 2.0 * product(lag)
            samples += size - lag
        return squares / samples

    return mean_square


def _folded(values: FloatArray, period: float) -> FloatArray:
    """Whole rotations of values (n,), shape (m, k)."""
    size = round(period)
    at = (np.arange(size) / size + np.arange(int(values.size / period))[:, None]) * period
    return np.interp(at, np.arange(values.size), values)


def _weights(turns: FloatArray, least_variance: float) -> FloatArray:
    """By which two rotations of (m, k) are laid onto each other most surely, of each order.

    ψ = G/(P² + 2 G P) of the power G that repeats and P of noise (Hannan and Thomson 1973,
    Biometrika 60, 469): the products of two then sum up to ln of a likelihood. 0 where nothing
    stands out.
    """
    pairs = len(turns) * (len(turns) - 1)
    repeats = _smooth(_repeating_power(turns))
    noise = turns.shape[1] * (_smooth(_noise_power(turns)) + least_variance)
    stands_out = repeats > STANDS_OUT * noise / math.sqrt(SMOOTHED * pairs)
    weights = np.zeros(repeats.size)
    some, none = repeats[stands_out], noise[stands_out]
    weights[stands_out] = some / (none**2 + 2.0 * some * none)
    return weights


def _shows_impacts(turns: FloatArray, least_variance: float) -> bool:
    """Whether what repeats in rotations (m, k) stands out of the noise in most of some neighbouring
    orders, as impacts do and gravity's wave does not."""
    pairs = len(turns) * (len(turns) - 1)
    noise = turns.shape[1] * (_smooth(_noise_power(turns)) + least_variance)
    ratio = np.pad(_repeating_power(turns) / noise, SMOOTHED // 2, "reflect")
    most = np.median(sliding_window_view(ratio, SMOOTHED), axis=1)
    return bool(np.max(most) > STANDS_OUT * SPREAD_OF_MEDIAN / math.sqrt(SMOOTHED * pairs))


def _repeating_power(turns: FloatArray) -> FloatArray:
    """Of what is alike in rotations (m, k), by order, without bias."""
    whole = len(turns)
    spectra = np.fft.rfft(turns)
    alike = np.abs(spectra.sum(axis=0)) ** 2 - (np.abs(spectra) ** 2).sum(axis=0)
    return np.asarray(alike / (whole * (whole - 1)))


def _noise_power(turns: FloatArray) -> FloatArray:
    """Of what differs between rotations (m, k), by order: their variance, if it is white."""
    whole, size = turns.shape
    differs = np.abs(np.fft.rfft(turns - turns.mean(axis=0))) ** 2
    return np.asarray(differs.sum(axis=0) / ((whole - 1) * size))


def _smooth(power: FloatArray) -> FloatArray:
    padded = np.pad(power, SMOOTHED // 2, "reflect")
    return np.convolve(padded, np.ones(SMOOTHED) / SMOOTHED, "valid")


def _filtered(values: FloatArray, weights: FloatArray, period: float) -> FloatArray:
    """Values (n,) with powers weighted; the weights are of whole orders of a period in samples."""
    orders = np.fft.rfftfreq(values.size) * period
    gain = np.sqrt(np.interp(orders, np.arange(weights.size), weights))
    return np.fft.irfft(np.fft.rfft(values) * gain, values.size)


def _of_impacts(gain: FloatArray) -> float:
    """What a few parts of a rotation gain, (PLACES,), beyond what all do; 0 if that is more."""
    total = float(gain.sum())
    steady = max(gain.size * float(np.median(gain)), 0.0)
    return total - steady if steady < 0.5 * total else 0.0


def _differs(values: FloatArray, period: float) -> FloatArray:
    """Squares by which rotations of values (n,) are off their mean, in parts of one, (PLACES,)."""
    turns = _folded(values, period)
    squares = np.sum((turns - turns.mean(axis=0)) ** 2, axis=0)
    return np.array([part.sum() for part in np.array_split(squares, PLACES)])
