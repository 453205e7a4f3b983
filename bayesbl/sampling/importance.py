"""Draws with importance weights: how many independent ones they are worth, and resampling."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bayesbl.recording.types import FloatArray
from bayesbl.sampling.truncated_normal import normal_in_box

PROPOSED = 8000
"""Draws of each proposal."""
ADAPTATIONS = 4
LARGEST_TAIL = 0.7
"""Pareto k̂ up to which so many weights are enough (Vehtari et al. 2024)."""
LEAST_SHARE = 0.25
"""Kish's effective share of the draws from which on they are not drawn again."""
FEWEST = 3.0
"""Effective draws for each coordinate below which a proposal is not adapted, but given up."""
FLATTEST = 0.1
"""Least curvature of a proposal, over that of a normal distribution as wide as the draws: where the
box alone ends them, the quadratic may bend upwards."""


def independent_draws(
    target: Callable[[FloatArray], FloatArray],
    peak: FloatArray,
    covariance: FloatArray,
    box: tuple[FloatArray, FloatArray],
    count: int,
    generator: np.random.Generator,
) -> tuple[FloatArray, float] | None:
    """Draws of a density that is nearly normal within a box, and their effective share.

    Proposed by a normal distribution within the box, weighted with Pareto-smoothed weights,
    resampled. The proposal adapts: a quadratic is fitted to the weighted log density.

    Parameters
    ----------
    target
        Log density of points (m, d), shape (m,).
    peak, covariance
        Of the first proposal without its box, shapes (d,) and (d, d).
    box
        Low and high end of every range, shapes (d,); infinite where there is none.

    Returns
    -------
    Shape (count, d); ``None`` where no proposal is near enough, as for a density of another shape.
    """
    from arviz_stats.base import array_stats

    for _ in range(ADAPTATIONS):
        points, log_proposal = normal_in_box(peak, covariance, box, PROPOSED, generator)
        density = target(points)
        log_weights = density - log_proposal
        if effective_size(log_weights) < FEWEST * peak.size:
            return None
        possible = np.isfinite(log_weights)
        # ArviZ weighs by the inverse of a likelihood.
        log_weights[possible], tail = array_stats.psislw(-log_weights[possible])
        share = effective_size(log_weights) / PROPOSED
        if tail < LARGEST_TAIL and share > LEAST_SHARE:
            return points[resampled(log_weights[None], count, generator)[0]], share
        peak, covariance = _quadratic(points, density, np.exp(log_weights - log_weights.max()))
    return None


def _quadratic(
    points: FloatArray, log_density: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Peak (d,) and covariance (d, d) of the quadratic through the weighted log density (m,).

    No weight is less than a thousandth of the mean: the quadratic also holds where few draws are.
    """
    weights = np.where(np.isfinite(log_density), np.maximum(weights, 1e-3 * weights.mean()), 0.0)
    mean = np.average(points, axis=0, weights=weights)
    sd = np.sqrt(np.average((points - mean) ** 2, axis=0, weights=weights))
    u, root = (points - mean) / sd, np.sqrt(weights)
    first, second = np.triu_indices(len(mean))
    terms = np.column_stack([np.ones(len(u)), u, u[:, first] * u[:, second]])
    values = np.where(weights > 0.0, log_density, 0.0)
    found = np.linalg.lstsq(terms * root[:, None], values * root, rcond=None)[0]
    slope, precision = found[1 : 1 + len(mean)], np.zeros((len(mean), len(mean)))
    precision[first, second] = -found[1 + len(mean) :]
    precision += precision.T
    rates, axes = np.linalg.eigh(precision)
    covariance = axes / np.maximum(rates, FLATTEST) @ axes.T
    return mean + sd * (covariance @ slope), covariance * np.outer(sd, sd)


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
