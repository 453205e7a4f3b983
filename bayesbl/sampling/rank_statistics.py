"""R̂ and effective draws of chains, on the ranks of their draws (Vehtari et al. 2021).

As :mod:`arviz_stats` has them, to the last bit; its import takes half of a second and 20 MB.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import fft, special

from bayesbl.recording.types import FloatArray

FEWEST_CHAINS, FEWEST_DRAWS = 2, 4


def rank_r_hat(draws: FloatArray) -> float:
    """Split R̂ of the ranks, of location or of spread, whichever is larger.

    Parameters
    ----------
    draws
        Shape (chain, draw).

    Returns
    -------
    Not a number where draws are not, are all the same, or too few.
    """
    if not _suffices(draws):
        return math.nan
    halves = _halves(draws)
    about = np.abs(halves - np.median(halves))
    return max(_r_hat(_normal_scores(halves)), _r_hat(_normal_scores(about)))


def bulk_ess(draws: FloatArray) -> float:
    """Effective draws in the bulk of the distribution, of the ranks of split chains.

    Autocorrelations are summed in pairs as long as a pair's sum is positive, each sum at most that
    of the pair before it (Geyer 1992).

    Parameters
    ----------
    draws
        Shape (chain, draw).

    Returns
    -------
    Not a number where draws are not or are too few; their number where all are the same.
    """
    if not _suffices(draws):
        return math.nan
    scores = _normal_scores(_halves(draws))
    if np.ptp(scores) < np.finfo(float).resolution:
        return float(scores.size)
    steps = scores.shape[1]
    covariance = _autocovariance(scores)
    within = covariance[0] * steps / (steps - 1.0)
    total = within * (steps - 1.0) / steps + np.var(scores.mean(axis=1), ddof=1)
    correlation = 1.0 - (within - covariance) / total
    correlation[0] = 1.0
    # A pair that would reach the last lag is not considered.
    pairs = correlation[: max(2, (steps - 1) // 2 * 2)].reshape(-1, 2)
    sums = pairs.sum(axis=1)
    beyond = np.flatnonzero(sums[1:] <= 0.0)
    last = int(beyond[0]) + 1 if beyond.size else len(sums) - 1
    rest = pairs[last, 0] if pairs[last, 0] > 0.0 or sums[last] >= 0.0 else 0.0
    pairs, sums = pairs[:last], sums[:last]
    at_most = np.minimum.accumulate(sums)
    pairs = np.where((sums > at_most)[:, None], 0.5 * at_most[:, None], pairs)
    time = -1.0 + 2.0 * np.sum(pairs.ravel()) + rest
    return float(scores.size / max(time, 1.0 / np.log10(scores.size)))


def _suffices(draws: FloatArray) -> bool:
    chains, steps = draws.shape
    return chains >= FEWEST_CHAINS and steps >= FEWEST_DRAWS and not np.isnan(draws).any()


def _halves(draws: FloatArray) -> FloatArray:
    """Both halves of every chain as chains of their own."""
    half = draws.shape[1] // 2
    return np.vstack((draws[:, :half], draws[:, -half:]))


def _normal_scores(draws: FloatArray) -> FloatArray:
    """Normal quantiles at the ranks among all draws; equal draws share their mean rank."""
    _, place, count = np.unique(draws, return_inverse=True, return_counts=True)
    rank = (np.cumsum(count) - 0.5 * (count - 1))[place.reshape(draws.shape)]
    # Blom's offset.
    return np.asarray(special.ndtri((rank - 0.375) / (draws.size - 0.75 + 1.0)))


def _r_hat(scores: FloatArray) -> float:
    steps = scores.shape[1]
    between = steps * np.var(scores.mean(axis=1), ddof=1)
    within = np.mean(np.var(scores, axis=1, ddof=1))
    with np.errstate(invalid="ignore", divide="ignore"):
        return float(np.sqrt((between / within + steps - 1) / steps))


def _autocovariance(scores: FloatArray) -> FloatArray:
    """At every lag, the mean over the chains, each about its own mean, shape (lag,)."""
    steps = scores.shape[1]
    size = fft.next_fast_len(2 * steps, real=True)
    spectrum = np.fft.rfft(scores - scores.mean(axis=1, keepdims=True), size, axis=1)
    spectrum *= np.conjugate(spectrum)
    covariance = np.fft.irfft(spectrum, size, axis=1)[:, :steps] / steps
    return np.asarray(np.ascontiguousarray(covariance.T).mean(axis=1))
