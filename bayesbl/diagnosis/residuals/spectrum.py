"""Spectrum of a residual: the noise's floor, lines above it, which are significant.

Periodograms are |X_k|²/n with X the real FFT of n samples, so white noise of variance σ² has the
floor σ² at every bin, and of noise alone the periodogram over its floor is standard exponential.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from bayesbl.noise.rotation_noise import bic, innovations, levinson, log_variances
from bayesbl.recording.types import FloatArray

HIGHEST_ORDER = 30
MEDIAN_BINS = 201
CLIP = 8.0
"""Ordinates above this many floors are lines for all we know: they count as this many."""
FLOOR_ROUNDS = 3


@dataclass(frozen=True, slots=True)
class WholeRotations:
    """The part of a recording that is looked at: whole load rotations, to the nearest sample.

    ``rotations`` of the load in ``samples``; ``gear_ratio`` motor turns in each;
    ``start_angle_rad`` the load angle at the first sample.
    """

    rotations: int
    samples: int
    sampling_hz: float
    reference_speed_rpm: float
    gear_ratio: float
    start_angle_rad: float

    @property
    def seconds(self) -> float:
        """Length of the record."""
        return self.samples / self.sampling_hz

    @property
    def rotation_hz(self) -> float:
        """Rotations of the load per second."""
        return self.rotations / self.seconds

    @property
    def motor_hz(self) -> float:
        """Turns of the motor per second."""
        return self.rotation_hz * self.gear_ratio

    @property
    def frequency_hz(self) -> FloatArray:
        """Of every bin, shape (n // 2 + 1,)."""
        return np.asarray(np.arange(self.samples // 2 + 1) / self.seconds)


@dataclass(frozen=True, slots=True)
class NoiseFloor:
    """Autoregressive spectrum of one channel's noise.

    Attributes
    ----------
    coefficients
        φ_1 … φ_p of n_t = Σ φ_k n_{t−k} + ε_t, shape (p,); empty for white noise.
    innovation_variance
        Of ε, the channel's unit squared.
    """

    coefficients: FloatArray
    innovation_variance: float

    def at_bins(self, n: int) -> FloatArray:
        """Expected periodogram of n samples, shape (n // 2 + 1,)."""
        transfer = np.fft.rfft(np.concatenate(([1.0], -self.coefficients)), n)
        return np.asarray(self.innovation_variance / np.abs(transfer) ** 2)

    @property
    def at_zero(self) -> float:
        """Expected periodogram at frequency zero: n times the variance of a mean over n samples."""
        return float(self.innovation_variance / (1.0 - self.coefficients.sum()) ** 2)

    @property
    def sd(self) -> float:
        """Standard deviation of the noise."""
        return float(np.sqrt(np.mean(self.at_bins(4096)[:-1])))

    def whiten(self, values: FloatArray) -> FloatArray:
        """Innovations in units of their scatter, shape (n,) to (n − p,)."""
        return innovations(values, self.coefficients) / math.sqrt(self.innovation_variance)


def noise_floor(values: FloatArray, lines_at: NDArray[np.bool_]) -> NoiseFloor:
    """Floor of noise among lines.

    The periodogram, clipped where lines stand out and filled in where ``lines_at`` says that they
    may, gives the autocovariance; Levinson's recursion the autoregression; BIC its order. Two
    or three rounds, the first from a running median.

    Parameters
    ----------
    values
        Shape (n,).
    lines_at
        Bins that hold no noise or more than noise, shape (n // 2 + 1,), bool.
    """
    n = values.size
    frequency = np.arange(n // 2 + 1) / n
    periodogram = np.abs(np.fft.rfft(values)) ** 2 / n
    used = periodogram[~lines_at]
    width = min(MEDIAN_BINS, used.size)
    median = median_filter(used, width, mode="reflect") / math.log(2.0)
    spectrum = np.interp(frequency, frequency[~lines_at], median)
    for _ in range(FLOOR_ROUNDS):
        quiet = np.where(lines_at, spectrum, np.minimum(periodogram, CLIP * spectrum))
        fits = levinson(np.fft.irfft(quiet, n), min(HIGHEST_ORDER, n // 4))
        variance, coefficients = fits[int(np.argmin(bic(log_variances(fits), n)))]
        floor = NoiseFloor(coefficients, variance)
        spectrum = floor.at_bins(n)
    return floor


def comb(n: int, rotations: int) -> NDArray[np.bool_]:
    """Bins of whole load orders, the constant included, shape (n // 2 + 1,), bool."""
    return np.asarray(np.arange(n // 2 + 1) % rotations == 0)


def repeating_part(values: FloatArray, rotations: int) -> FloatArray:
    """What repeats in each of the rotations that ``values`` holds, constant included, (n,)."""
    transform = np.fft.rfft(values)
    return np.asarray(
        np.fft.irfft(np.where(comb(values.size, rotations), transform, 0.0), len(values))
    )


def without_repeating(columns: FloatArray, rotations: int) -> FloatArray:
    """Columns less what repeats of each, same shape (n, k)."""
    parts = [column - repeating_part(column, rotations) for column in columns.T]
    return np.stack(parts, axis=1)


def benjamini_hochberg(probabilities: FloatArray, false_discovery_rate: float) -> float:
    """Largest probability that still counts as a discovery; 0 if none does.

    Benjamini & Hochberg 1995, J. R. Stat. Soc. B 57, 289. If nothing is there, the chance of any
    discovery is the rate.
    """
    ordered = np.sort(probabilities)
    allowed = false_discovery_rate * np.arange(1, ordered.size + 1) / ordered.size
    passed = np.flatnonzero(ordered <= allowed)
    return float(ordered[passed[-1]]) if passed.size else 0.0
