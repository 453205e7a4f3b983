"""Draws with importance weights: how many independent ones they are worth, and resampling."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesbl.recording.types import FloatArray


def effective_size(log_weights: FloatArray) -> float:
    """Kish's effective sample size of unnormalised weights, shape (m,)."""
    if not np.any(np.isfinite(log_weights)):
        return 0.0
    weights = np.exp(log_weights - log_weights.max())
    return float(weights.sum() ** 2 / (weights**2).sum())


def resampled(
    log_weights: FloatArray, count: int, generator: np.random.Generator
) -> NDArray[np.int64]:
    """Systematic resampling within each chain; evenly spread where no weight is finite.

    Parameters
    ----------
    log_weights
        Unnormalised, shape (chain, candidate).

    Returns
    -------
    Indices of the candidates in their chain, shape (chain, count). Systematic resampling puts equal
    draws side by side, but draws must pair at random, so they are shuffled.
    """
    chains, candidates = log_weights.shape
    picked = np.empty((chains, count), np.int64)
    for chain, own in enumerate(log_weights):
        ticks = (np.arange(count) + generator.uniform()) / count
        if np.any(np.isfinite(own)):
            edges = np.cumsum(np.exp(own - own.max()))
            index = np.searchsorted(edges / edges[-1], ticks)
        else:
            index = np.linspace(0, candidates - 1, count).round().astype(np.int64)
        picked[chain] = generator.permutation(index)
    return picked
