"""Noise of several channels together, from the differences between load rotations.

The counterpart of :mod:`bayesbl.noise.rotation_noise`, which treats the speed alone. Noise that
passes through the controller is in speed and current. A likelihood that treats them as independent
would count it twice.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from bayesbl.errors import RecordingError
from bayesbl.noise.rotation_noise import FEWEST_DIFFERENCES, bic, require_differences
from bayesbl.recording.types import BoolArray, FloatArray

HIGHEST_ORDER = 10
CIRCLE = 1000
"""Samples after which noise is forgotten."""

NEGLIGIBLE = 0.01
"""Share of a channel's variance below which unseen rounding is neglected."""


@dataclass(frozen=True, slots=True)
class ChannelNoise:
    """Vector autoregressive noise x_t = Σ_k Φ_k x_{t−k} + ε_t, ε_t ~ N(0, L Lᵀ).

    Attributes
    ----------
    coefficients
        Φ_k, shape (p, c, c); p = 0 is white.
    root
        L, lower triangular, shape (c, c), in the channels' units.
    sd
        Standard deviation of each channel, shape (c,).
    differences
        Number of rotation differences behind the estimate.
    repeats
        Whether part of the noise is the same in every rotation, as rounding may be. Differences
        between rotations then do not measure it.
    """

    coefficients: FloatArray
    root: FloatArray
    sd: FloatArray
    differences: int
    repeats: bool = False

    @property
    def order(self) -> int:
        """p, 0 for white noise."""
        return len(self.coefficients)

    def whiten(self, signals: FloatArray) -> FloatArray:
        """Whiten signals: innovations in units of their scatter, shape (…, c, n) to (…, c, n − p).

        Noise becomes independent standard normal. The first p samples only condition the others.
        """
        p, n = self.order, signals.shape[-1]
        innovations = signals[..., p:].copy()
        for k, phi in enumerate(self.coefficients, start=1):
            innovations -= np.einsum("ab,...bn->...an", phi, signals[..., p - k : n - k])
        inverse = np.linalg.inv(self.root)
        return np.asarray(np.einsum("ab,...bn->...an", inverse, innovations))

    def draw(self, samples: int, count: int, generator: np.random.Generator) -> FloatArray:
        """Draw noise for ``count`` recordings, shape (count, c, n), in the channels' units.

        Drawn as a circular process that is longer than needed, so that its ends are independent.
        """
        size = samples + CIRCLE
        white = generator.standard_normal((count, len(self.root), size))
        delay = np.exp(-2j * np.pi * np.fft.rfftfreq(size))[:, None, None]
        polynomial = np.eye(len(self.root)) - sum(
            (phi * delay**k for k, phi in enumerate(self.coefficients, start=1)), 0.0 * delay
        )
        response = np.linalg.solve(polynomial, np.broadcast_to(self.root, polynomial.shape))
        spectrum = np.einsum("fab,rbf->raf", response, np.fft.rfft(white))
        return np.asarray(np.fft.irfft(spectrum, size)[..., :samples])


def estimate_channel_noise(
    residual: FloatArray,
    lag: int,
    kept: BoolArray | None = None,
    rounding: FloatArray | None = None,
) -> ChannelNoise:
    """Noise of all channels from differences over one load rotation; the order is chosen by BIC.

    Rounding that the differences do not show repeats every rotation. All rotations together then
    tell no more than one, so its variance is multiplied by their number.

    Parameters
    ----------
    residual
        Shape (c, n): recording minus anything that repeats every rotation.
    lag
        Samples in a rotation.
    kept
        Shape (n,): samples to use; all if ``None``.
    rounding
        Shape (c, HIGHEST_ORDER + 1): least autocovariance of the channels' rounding.

    Raises
    ------
    RecordingError
        If too little of the recording has a counterpart one rotation later.
    """
    count = residual.shape[1] - lag
    require_differences(count, f"{max(count, 0)} samples with a counterpart one rotation later")
    both_kept = None if kept is None else kept[lag:] & kept[:-lag]
    differences = residual[:, lag:] - residual[:, :-lag]
    return _noise_of(differences, 0.5, both_kept, rounding, residual.shape[1] / lag)


def estimate_fast_noise(
    residual: FloatArray,
    samples: int,
    kept: BoolArray | None = None,
    rounding: FloatArray | None = None,
) -> ChannelNoise:
    """Noise of all channels of a recording without repetition: the part faster than a running mean.

    A mean over w samples takes 1/w of the power of white noise, for which the result is corrected.
    Noise that is correlated over more than w samples is underestimated.

    Parameters
    ----------
    residual
        Shape (c, n): recording minus its simulation.
    samples
        w, at most a third of n.
    kept
        Shape (n,): samples to use; all if ``None``.
    rounding
        As :func:`estimate_channel_noise` takes it.

    Raises
    ------
    RecordingError
        If the recording is too short.
    """
    count = residual.shape[1] - samples + 1
    if count < FEWEST_DIFFERENCES:
        raise RecordingError(
            "The recording is too short to separate noise from motion.",
            found=f"{residual.shape[1]} samples",
            expected=f"at least {FEWEST_DIFFERENCES + samples}",
        )
    sums = np.cumsum(np.pad(residual, ((0, 0), (1, 0))), axis=1)
    mean = (sums[:, samples:] - sums[:, :-samples]) / samples
    middle = residual[:, samples // 2 : samples // 2 + count]
    kept_middle = None if kept is None else kept[samples // 2 : samples // 2 + count]
    return _noise_of(middle - mean, 1.0 / (1.0 - 1.0 / samples), kept_middle, rounding)


def _noise_of(
    noise: FloatArray,
    share: float,
    kept: BoolArray | None,
    rounding: FloatArray | None,
    rotations: float = 1.0,
) -> ChannelNoise:
    """The process that has this share of the power of a stretch, (c, n), at the kept samples."""
    channels, count = noise.shape
    complete_past: BoolArray | None = None
    if kept is not None:
        complete_past = np.asarray(sliding_window_view(kept, HIGHEST_ORDER + 1).all(axis=1))
        count = int(complete_past.sum())
        if count < FEWEST_DIFFERENCES:
            raise RecordingError(
                "Too little of the recording is compared to estimate its noise.",
                found=f"{count} samples",
                expected=f"at least {FEWEST_DIFFERENCES}",
            )
    variance = share * np.mean((noise if kept is None else noise[:, kept]) ** 2, axis=1)
    unseen = np.zeros((channels, HIGHEST_ORDER + 1))
    if rounding is not None:
        missing = np.maximum(rounding[:, 0] - variance, 0.0)
        if np.any(missing > NEGLIGIBLE * variance):
            unseen = rounding * (missing / np.maximum(rounding[:, 0], 1e-300))[:, None]
    repeats, orders = bool(unseen.any()), range(HIGHEST_ORDER + 1)
    if repeats:
        shown = noise if kept is None else np.where(kept, noise, 0.0)
        unseen = unseen + _passed_on(shown, unseen)
        # With zeros around it, the noise has the biased autocovariance of Yule and Walker.
        delayed = _delayed(np.pad(shown, ((0, 0), (HIGHEST_ORDER, HIGHEST_ORDER))))
        lags = np.abs(np.subtract.outer(orders, orders))
        repeating = np.einsum("ajk,ab->jakb", rotations * unseen[:, lags], np.eye(channels))
        moment = delayed @ delayed.T * (share / (count if kept is None else kept.sum()))
        root = np.linalg.cholesky(moment + repeating.reshape(moment.shape)).T
        orders = orders[-1:]
    else:
        # All orders use the same samples, so that their likelihoods can be compared.
        delayed = _delayed(noise)[:, slice(None) if complete_past is None else complete_past]
        root = np.asarray(np.linalg.qr(delayed.T, mode="r"))
        root *= math.sqrt(share / delayed.shape[1])
    least_share = delayed.shape[1] * np.finfo(np.float64).eps
    fits = [_autoregression(root, channels, order, least_share) for order in orders]
    tiny = 1e-24 * share * np.diag(np.maximum(np.mean(noise**2, axis=1), 1e-300))
    determinants = np.array([np.linalg.slogdet(covariance + tiny)[1] for _, covariance in fits])
    coefficients, covariance = fits[int(np.argmin(bic(determinants, count, channels**2)))]
    scatter = np.asarray(np.linalg.cholesky(covariance + tiny))
    return ChannelNoise(coefficients, scatter, np.sqrt(variance + unseen[:, 0]), count, repeats)


def _passed_on(noise: FloatArray, unseen: FloatArray) -> FloatArray:
    """Unseen rounding of the first channel as the controller passes it to the others. The gains are
    those of that channel's noise (c, n), by regression. A correlation between the channels is not
    assumed: if the recorder rounds, not the encoder, there is none."""
    power = float(noise[0] @ noise[0])
    if power == 0.0:
        return np.zeros_like(unseen)
    gain_square = (noise @ noise[0] / power) ** 2
    # Even unrelated channels have a gain by chance.
    gain_square -= np.mean(noise**2, axis=1) / power
    gain_square[0] = 0.0
    return np.asarray(np.clip(gain_square, 0.0, None)[:, None] * unseen[0])


def _delayed(x: FloatArray) -> FloatArray:
    """x_t, x_{t−1} … of (c, n) for every t with a complete past, (c (HIGHEST_ORDER + 1), n − …)."""
    n = x.shape[1]
    return np.concatenate([x[:, HIGHEST_ORDER - k : n - k] for k in range(HIGHEST_ORDER + 1)])


def _autoregression(
    root: FloatArray, channels: int, order: int, least_share: float
) -> tuple[FloatArray, FloatArray]:
    """Φ of one order by least squares, shape (p, c, c), and the innovations' covariance (c, c).

    ``root``: R with RᵀR the second moment of (x_t, x_{t−1} …). Singular values below
    ``least_share`` of the largest are taken for zero.
    """
    present, past = np.split(root[:, : channels * (order + 1)], [channels], axis=1)
    stacked = np.linalg.lstsq(past, present, rcond=least_share)[0]
    innovations = present - past @ stacked
    coefficients = stacked.reshape(order, channels, channels).swapaxes(1, 2)
    return np.asarray(coefficients), innovations.T @ innovations
