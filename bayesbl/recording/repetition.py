"""The period after which a recording at constant speed repeats, from the recording alone.

Speed, gear ratio and the recorder's clock state when the load has turned once. The impacts show it
far more sharply, so a small error of one of the three is visible as a difference.
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
"""Relative range of the search. The ringing resembles itself after one of its own periods (1.4 % of
a rotation on the reference bench), but never as closely as after a turn."""

STEP = 0.05  # step between tried periods, in samples; a parabola refines the best one
MOTOR_ORDERS = 12
SWELLS = 2
"""Motor orders that are removed first, because they do not repeat with the load, and load orders on
either side, because gravity modulates these lines."""

SMOOTHED = 15
"""Neighbouring orders over which spectra are averaged; ringing that decays within a fifteenth of a
rotation has similar ones."""

STANDS_OUT = 6.0  # standard deviations above noise at which the repeating part of an order counts
SPREAD_OF_MEDIAN = 1.25  # standard deviation of many values' median over their mean's
PLACES = 24  # parts of a rotation: impacts are in a few, steady lines in all
LOWEST_BINS = 6  # lowest orders, which determine the noise of the mean speed


@dataclass(frozen=True, slots=True)
class Repetition:
    """How a recording repeats.

    ``gain`` is the χ² by which impacts agree better after this period than after the stated one. It
    is 0 if the gain is spread over the rotation, as for a line of the motor, or if no impacts stand
    out: gravity's wave alone shows the period only to some thousandths. ``mean_rpm`` is over whole
    periods, without sign.
    """

    period_s: float
    gain: float
    mean_rpm: float
    mean_sd_rpm: float

    @property
    def motor_turns(self) -> float:
        """Motor turns in a period: the gear ratio, if the load turns once."""
        return self.mean_rpm / 60.0 * self.period_s


def repetition(
    speed_rpm: FloatArray, sampling_hz: float, stated_s: float, least_sd_rpm: float = 0.0
) -> Repetition | None:
    """The period near ``stated_s`` after which all rotations are most alike.

    ``None`` below two rotations, or if nothing that repeats stands out. ``speed_rpm``: shape (n,),
    evenly sampled; ``least_sd_rpm``: further error of each sample, repeating or not.
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
        weights = _weights(folded(cleaned, period), least_sd_rpm**2)
        if not np.any(weights):
            return None
        weighted = _filtered(cleaned, weights, period)
        period = _most_alike(weighted, stated)
    if period is None:
        return None
    gain = _of_impacts(_differs(weighted, stated) - _differs(weighted, period))
    if not _shows_impacts(folded(cleaned, period), least_sd_rpm**2):
        gain = 0.0
    turns = folded(speed_rpm, period)
    noise = float(_noise_power(turns)[:LOWEST_BINS].mean()) + least_sd_rpm**2
    return Repetition(
        period / sampling_hz,
        2.0 * period * gain,
        float(turns.mean()),
        math.sqrt(noise / turns.size),
    )


def _without_motor_lines(speed_rpm: FloatArray, sampling_hz: float, period: float) -> FloatArray:
    """The speed minus its mean and its lines at motor orders."""
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
    """Period in samples at which values (n,) differ least from themselves whole periods later;
    ``None`` at an end of the range."""
    tried = np.arange(stated * (1.0 - WITHIN), stated * (1.0 + WITHIN), STEP)
    squares = _mean_square(values, stated)(tried)
    place = int(np.argmin(squares))
    if not 0 < place < tried.size - 1:
        return None
    before, here, after = squares[place - 1 : place + 2]
    bend = before - 2.0 * here + after
    return float(tried[place] + (STEP * 0.5 * (before - after) / bend if bend > 0.0 else 0.0))


def _mean_square(values: FloatArray, stated: float) -> Callable[[FloatArray], FloatArray]:
    """Mean square of values (n,) minus those whole periods later, as a function of the period."""
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


def folded(values: FloatArray, period: float) -> FloatArray:
    """Whole rotations of values (n,) by linear interpolation, shape (m, k)."""
    size = round(period)
    # The last value lies one step before the end of its rotation.
    turns = math.floor((values.size - 1 + period / size) / period + 1e-9)
    at = (np.arange(size) / size + np.arange(turns)[:, None]) * period
    return np.interp(at, np.arange(values.size), values)


def _weights(turns: FloatArray, least_variance: float) -> FloatArray:
    """Weights of the orders for aligning two rotations of (m, k); 0 if nothing stands out.

    ψ = G/(P² + 2 G P), with the power G that repeats and the power P of noise (Hannan and Thomson
    1973, Biometrika 60, 469). Sums of weighted products are then log likelihoods.
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
    """Whether the repeating part of rotations (m, k) stands out in most of some neighbouring
    orders, as that of impacts does and gravity's wave does not."""
    pairs = len(turns) * (len(turns) - 1)
    noise = turns.shape[1] * (_smooth(_noise_power(turns)) + least_variance)
    ratio = np.pad(_repeating_power(turns) / noise, SMOOTHED // 2, "reflect")
    most = np.median(sliding_window_view(ratio, SMOOTHED), axis=1)
    return bool(np.max(most) > STANDS_OUT * SPREAD_OF_MEDIAN / math.sqrt(SMOOTHED * pairs))


def _repeating_power(turns: FloatArray) -> FloatArray:
    """Unbiased power, by order, of the part that repeats in rotations (m, k)."""
    whole = len(turns)
    spectra = np.fft.rfft(turns)
    alike = np.abs(spectra.sum(axis=0)) ** 2 - (np.abs(spectra) ** 2).sum(axis=0)
    return np.asarray(alike / (whole * (whole - 1)))


def _noise_power(turns: FloatArray) -> FloatArray:
    """Power, by order, of the differences between rotations (m, k); their variance if white."""
    whole, size = turns.shape
    differs = np.abs(np.fft.rfft(turns - turns.mean(axis=0))) ** 2
    return np.asarray(differs.sum(axis=0) / ((whole - 1) * size))


def _smooth(power: FloatArray) -> FloatArray:
    padded = np.pad(power, SMOOTHED // 2, "reflect")
    return np.convolve(padded, np.ones(SMOOTHED) / SMOOTHED, "valid")


def _filtered(values: FloatArray, weights: FloatArray, period: float) -> FloatArray:
    """Values (n,) with the power of each order of the period (in samples) weighted."""
    orders = np.fft.rfftfreq(values.size) * period
    gain = np.sqrt(np.interp(orders, np.arange(weights.size), weights))
    return np.fft.irfft(np.fft.rfft(values) * gain, values.size)


def _of_impacts(gain: FloatArray) -> float:
    """Gain of a few parts of a rotation, (PLACES,), beyond that of all; 0 if that is larger."""
    total = float(gain.sum())
    steady = max(gain.size * float(np.median(gain)), 0.0)
    return total - steady if steady < 0.5 * total else 0.0


def _differs(values: FloatArray, period: float) -> FloatArray:
    """Squared deviation of rotations of values (n,) from their mean, by place, (PLACES,)."""
    turns = folded(values, period)
    squares = np.sum((turns - turns.mean(axis=0)) ** 2, axis=0)
    return np.array([part.sum() for part in np.array_split(squares, PLACES)])
