"""Importance-weighted draws of a normal distribution in a box, and of nearly normal densities."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesbl.recording.types import FloatArray

TRIALS = 20
"""Candidates per draw of a normal distribution in a box."""
SWEEPS = 100
"""Sweeps of the Gibbs sampler over the coordinates that a box cuts."""
WITHIN_SD = 4.0
"""Standard deviations from the peak beyond which an end of a range cuts nothing."""
PROPOSED = 8000
"""Draws per proposal, unless stated otherwise."""
ADAPTATIONS = 6
LEAST_SHARE = 0.25
"""Kish's effective share of the draws from which the proposal is good enough."""
FLATTEST = 0.1
"""Smallest curvature of a proposal, relative to a normal distribution as wide as the draws. If only
the box limits the draws, the fitted quadratic may curve upward."""


@dataclass(frozen=True, slots=True)
class _Proposal:
    """Draws of a normal distribution within a box, weighted by a density.

    ``points``, (m, d); ``log_density`` and Pareto-smoothed ``log_weights``, (m,); ``tail``: k̂.
    """

    peak: FloatArray
    covariance: FloatArray
    points: FloatArray
    log_density: FloatArray
    log_weights: FloatArray
    tail: float

    @property
    def effective(self) -> float:
        """Kish's effective sample size."""
        return effective_size(self.log_weights)

    @property
    def weights(self) -> FloatArray:
        """Weights, the largest one, (m,)."""
        return np.asarray(np.exp(self.log_weights - self.log_weights.max()))

    def is_good(self, least: float) -> bool:
        """Whether so many weights with this tail suffice, and at least ``least`` are effective.

        n weights suffice up to k̂ = 1 − 1/log₁₀ n (Vehtari et al. 2024).
        """
        return self.tail < 1.0 - 1.0 / math.log10(len(self.points)) and self.effective > least

    def quadratic(self) -> tuple[FloatArray, FloatArray]:
        """Peak and covariance of the quadratic through the weighted log density."""
        return _quadratic(self.points, self.log_density, self.weights)

    def moments(self) -> tuple[FloatArray, FloatArray]:
        """Mean and covariance of the weighted draws."""
        return (
            np.average(self.points, axis=0, weights=self.weights),
            np.atleast_2d(np.cov(self.points.T, aweights=self.weights)),
        )


def independent_draws(
    target: Callable[[FloatArray], FloatArray],
    peak: FloatArray,
    covariance: FloatArray,
    box: tuple[FloatArray, FloatArray],
    count: int,
    generator: np.random.Generator,
    proposed: int = PROPOSED,
    most: int = 0,
) -> tuple[FloatArray, NDArray[np.int64], float] | None:
    """Draws of a density that is roughly normal within a box.

    Draws of a normal distribution within the box get Pareto-smoothed weights and are resampled. The
    proposal adapts: a quadratic is fitted to the weighted log density, or if that is no better, the
    mean and covariance of the weighted draws are taken.

    Parameters
    ----------
    target
        Log density of points (m, d), shape (m,).
    peak, covariance
        Peak and covariance of the first proposal without its box, shapes (d,) and (d, d).
    box
        Low and high end of every range, shapes (d,); infinite where there is none.
    proposed, most
        Draws of each proposal, and at most of the best one if they are too few.

    Returns
    -------
    The last points that ``target`` was given, (m, d); the index among them of each draw, (count,);
    and the number of effective draws by ``proposed``, at most one. ``None`` if no proposal is close
    enough, as for a density of another shape.
    """
    least = LEAST_SHARE * proposed
    best = _proposal(target, peak, covariance, box, proposed, generator)
    for _ in range(ADAPTATIONS):
        if best is None or best.is_good(least):
            break
        for adapted in (best.quadratic, best.moments):
            # A singular fit: no variation is left in some direction.
            with suppress(np.linalg.LinAlgError):
                trial = _proposal(target, *adapted(), box, proposed, generator)
                if trial is not None and trial.effective > best.effective:
                    best = trial
                    break
        else:
            break
    if best is not None and most > proposed:
        # Twice as many as seem to suffice, because a larger sample shows more of a tail.
        enough = math.ceil(2.0 * least * proposed / best.effective)
        for size in (min(max(enough, 2 * proposed), most), most):
            if best is not None and not best.is_good(least):
                best = _proposal(target, best.peak, best.covariance, box, size, generator)
    if best is None or not best.is_good(least):
        return None
    chosen = resampled(best.log_weights[None], count, generator)[0]
    return best.points, chosen, min(best.effective / proposed, 1.0)


def _proposal(
    target: Callable[[FloatArray], FloatArray],
    peak: FloatArray,
    covariance: FloatArray,
    box: tuple[FloatArray, FloatArray],
    count: int,
    generator: np.random.Generator,
) -> _Proposal | None:
    """Weighted draws of one proposal; ``None`` if none has weight."""
    from arviz_stats.base import array_stats

    points, log_proposal = normal_in_box(peak, covariance, box, count, generator)
    density = target(points)
    log_weights = density - log_proposal
    finite = np.isfinite(log_weights)
    if np.count_nonzero(finite) <= peak.size:
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        # ArviZ weights by the inverse of a likelihood; without a tail, k̂ is not a number.
        log_weights[finite], tail = array_stats.psislw(-log_weights[finite])
    # Weights that all underflow, far from the density, have no tail that could be smoothed.
    if not np.isfinite(log_weights).any():
        return None
    return _Proposal(peak, covariance, points, density, log_weights, float(tail))


def _quadratic(
    points: FloatArray, log_density: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Peak (d,) and covariance (d, d) of the quadratic through the weighted log density (m,).
    Weights are at least a thousandth of their mean, so that the quadratic also fits where draws are
    rare."""
    weights = np.where(np.isfinite(log_density), np.maximum(weights, 1e-3 * weights.mean()), 0.0)
    mean = np.average(points, axis=0, weights=weights)
    sd = np.sqrt(np.average((points - mean) ** 2, axis=0, weights=weights))
    u, root = (points - mean) / sd, np.sqrt(weights)
    terms = quadratic_terms(u)
    values = np.where(weights > 0.0, log_density, 0.0)
    coefficients = np.linalg.lstsq(terms * root[:, None], values * root, rcond=None)[0]
    slope, precision = coefficients[1 : 1 + len(mean)], np.zeros((len(mean), len(mean)))
    precision[np.triu_indices(len(mean))] = -coefficients[1 + len(mean) :]
    precision += precision.T
    rates, axes = np.linalg.eigh(precision)
    covariance = axes / np.maximum(rates, FLATTEST) @ axes.T
    return mean + sd * (covariance @ slope), covariance * np.outer(sd, sd)


def quadratic_terms(u: FloatArray) -> FloatArray:
    """1, u and all products of two, shape (m, d) to (m, p)."""
    first, second = np.triu_indices(u.shape[1])
    return np.column_stack([np.ones(len(u)), u, u[:, first] * u[:, second]])


def effective_size(log_weights: FloatArray) -> float:
    """Kish's effective sample size of unnormalised weights, shape (m,)."""
    if not np.any(np.isfinite(log_weights)):
        return 0.0
    weights = np.exp(log_weights - log_weights.max())
    return float(weights.sum() ** 2 / (weights**2).sum())


def resampled(
    log_weights: FloatArray, count: int, generator: np.random.Generator
) -> NDArray[np.int64]:
    """Systematic resampling within each chain; evenly spaced if no weight is finite.

    Parameters
    ----------
    log_weights
        Unnormalised, shape (chain, candidate).

    Returns
    -------
    Indices of the candidates in their chain, shape (chain, count). They are shuffled: systematic
    resampling puts equal draws side by side, but draws must pair at random.
    """
    chains, candidates = log_weights.shape
    indices = np.empty((chains, count), np.int64)
    for chain, chain_weights in enumerate(log_weights):
        quantiles = (np.arange(count) + generator.uniform()) / count
        if np.any(np.isfinite(chain_weights)):
            edges = np.cumsum(np.exp(chain_weights - chain_weights.max()))
            index = np.searchsorted(edges / edges[-1], quantiles)
        else:
            index = np.linspace(0, candidates - 1, count).round().astype(np.int64)
        indices[chain] = generator.permutation(index)
    return indices


def truncated_normal(
    peak: FloatArray,
    covariance: FloatArray,
    box: tuple[FloatArray, FloatArray],
    count: int,
    generator: np.random.Generator,
) -> FloatArray:
    """Draws of a normal distribution within a box, shape (count, d).

    By rejection if that is fast, else by weighted resampling from :func:`normal_in_box`, followed
    by Gibbs sampling if few weights are effective.

    Parameters
    ----------
    peak, covariance
        Of the normal distribution without the box, shapes (d,) and (d, d); the peak may lie
        outside.
    box
        Low and high end of every range, shapes (d,); infinite where there is none.
    """
    low, high = box
    root = np.linalg.cholesky(covariance)
    candidates = peak + generator.standard_normal((TRIALS * count, peak.size)) @ root.T
    inside = candidates[np.all((candidates > low) & (candidates < high), axis=1)]
    if len(inside) >= count:
        return inside[:count]
    points, log_density = normal_in_box(peak, covariance, box, TRIALS * count, generator)
    whitened = np.linalg.solve(root, (points - peak).T)
    log_weights = -0.5 * np.sum(whitened**2, axis=0) - log_density
    sample = np.asarray(points[resampled(log_weights[None], count, generator)[0]])
    if effective_size(log_weights) >= count:
        return sample
    return _mixed(sample, peak, covariance, box, generator)


def _mixed(
    points: FloatArray,
    peak: FloatArray,
    covariance: FloatArray,
    box: tuple[FloatArray, FloatArray],
    generator: np.random.Generator,
) -> FloatArray:
    """Move points (m, d) in a box by Gibbs sampling of the coordinates that the box cuts. In a
    narrow corner few proposals have weight, such as coordinates near zero of which only the sum is
    known."""
    low, high = box
    sd = np.sqrt(np.diag(covariance))
    correlation, begin, end = covariance / np.outer(sd, sd), (low - peak) / sd, (high - peak) / sd
    cut = np.maximum(begin, -end) > -WITHIN_SD
    precision, z = np.linalg.inv(correlation[np.ix_(cut, cut)]), ((points - peak) / sd)[:, cut]
    for i in np.tile(np.arange(z.shape[1]), SWEEPS):
        conditional_sd = precision[i, i] ** -0.5
        mean = z[:, i] - z @ precision[i] * conditional_sd**2
        share = generator.random(len(z))
        ends = (begin[cut][i] - mean) / conditional_sd, (end[cut][i] - mean) / conditional_sd
        z[:, i] = mean + conditional_sd * normal_between(*ends, share)
    slope = correlation[np.ix_(~cut, cut)] @ precision
    # Rounding may leave a negative variance if the cut coordinates nearly determine the others.
    values, vectors = np.linalg.eigh(
        correlation[np.ix_(~cut, ~cut)] - slope @ correlation[np.ix_(cut, ~cut)]
    )
    conditional_root = vectors * np.sqrt(np.maximum(values, 0.0))
    whitened = np.empty(points.shape)
    whitened[:, cut] = z
    whitened[:, ~cut] = z @ slope.T
    whitened[:, ~cut] += generator.standard_normal((len(points), len(values))) @ conditional_root.T
    return np.clip(peak + sd * whitened, low, high)


def normal_in_box(
    peak: FloatArray,
    covariance: FloatArray,
    box: tuple[FloatArray, FloatArray],
    count: int,
    generator: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Points (count, d) in a box, roughly normally distributed, and their log density.

    Coordinates are drawn one after the other, each normal given the previous ones and within its
    range, starting with the one whose range holds least of its normal distribution (Geweke 1989,
    Hajivassiliou and McFadden 1998). The log density, up to a constant, is that of this sampling.
    """
    from scipy.special import log_ndtr, ndtr

    low, high = box
    sd = np.sqrt(np.diag(covariance))
    outside = ndtr((low - peak) / sd) + ndtr((peak - high) / sd)
    order = np.lexsort(((high - low) / sd, -outside))
    root = np.linalg.cholesky(covariance[np.ix_(order, order)])
    whitened, log_mass = np.empty((count, peak.size)), np.zeros(count)
    points = np.empty((count, peak.size))
    for k, i in enumerate(order):
        mean = peak[i] + whitened[:, :k] @ root[k, :k]
        begin, end = (low[i] - mean) / root[k, k], (high[i] - mean) / root[k, k]
        whitened[:, k] = normal_between(begin, end, generator.random(count))
        points[:, i] = np.clip(mean + root[k, k] * whitened[:, k], low[i], high[i])
        mirrored = begin > -end
        above = log_ndtr(np.where(mirrored, -begin, end))
        below = log_ndtr(np.where(mirrored, -end, begin))
        log_mass += above + np.log1p(-np.exp(below - above))
    return points, -0.5 * np.sum(whitened**2, axis=1) - log_mass


def normal_between(low: FloatArray, high: FloatArray, share: FloatArray) -> FloatArray:
    """Quantiles of the standard normal distribution between two ends, all (m,)."""
    from scipy.special import log_ndtr, ndtri_exp

    # Mirrored, so that the ends lie where the logarithm of the distribution is exact.
    mirrored = low > -high
    low, high = np.where(mirrored, -high, low), np.where(mirrored, -low, high)
    below, above = log_ndtr(low), log_ndtr(high)
    quantile = ndtri_exp(above + np.log(share + (1.0 - share) * np.exp(below - above)))
    values = np.clip(quantile, low, high)
    return np.asarray(np.where(mirrored, -values, values))
