"""Draws of a normal distribution within a box, however much of it the box cuts off."""

from __future__ import annotations

import numpy as np

from bayesbl.recording.types import FloatArray

TRIALS = 20
"""Normal draws for each draw needed, before hit-and-run takes over."""
STEPS_PER_DIMENSION = 200
"""A peak twenty standard deviations beyond the box makes the distribution so much narrower across
than along, and a random direction goes the way of the narrow side."""


def truncated_normal(
    peak: FloatArray,
    covariance: FloatArray,
    start: FloatArray,
    box: tuple[FloatArray, FloatArray],
    count: int,
    generator: np.random.Generator,
) -> FloatArray:
    """Independent draws: by rejection where that is quick, else by hit-and-run.

    The latter goes along random lines, each time to a draw of what the box leaves of one. Bélisle,
    Romeijn & Smith 1993, Mathematics of Operations Research 18, 255.

    Parameters
    ----------
    peak, covariance
        Of the normal distribution without the box, shapes (d,) and (d, d); the peak may lie out.
    start
        A point in the box, shape (d,).
    box
        Low and high end of every range, shapes (d,); infinite where there is none.

    Returns
    -------
    Shape (count, d).
    """
    low, high = box
    d = peak.size
    root = np.linalg.cholesky(covariance)
    tried = peak + generator.standard_normal((TRIALS * count, d)) @ root.T
    inside = tried[np.all((tried > low) & (tried < high), axis=1)]
    if len(inside) >= count:
        return inside[:count]
    white = np.repeat(np.linalg.solve(root, start - peak)[None], count, axis=0)
    for _ in range(STEPS_PER_DIMENSION * d):
        direction = generator.standard_normal((count, d))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        at, ahead = peak + white @ root.T, direction @ root.T
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.stack([(low - at) / ahead, (high - at) / ahead])
        # Rounding may leave a point a little outside; it goes on from the end.
        begin = np.minimum(np.fmin(*ends).max(axis=1), 0.0)
        end = np.maximum(np.fmax(*ends).min(axis=1), 0.0)
        middle = -np.einsum("md,md->m", white, direction)
        moved = middle + _between(begin - middle, end - middle, generator.random(count))
        white += moved[:, None] * direction
    return np.asarray(np.clip(peak + white @ root.T, low, high))


def normal_in_box(
    peak: FloatArray,
    covariance: FloatArray,
    box: tuple[FloatArray, FloatArray],
    count: int,
    generator: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Points (count, d) in a box, roughly those of a normal distribution, and their log density.

    One coordinate after the other, the shortest range first, each normal given those before it and
    within its range (Geweke 1989, Hajivassiliou and McFadden 1998). The density, up to a constant,
    is that by which they were drawn.
    """
    from scipy.special import log_ndtr

    low, high = box
    order = np.argsort((high - low) / np.sqrt(np.diag(covariance)))
    root = np.linalg.cholesky(covariance[np.ix_(order, order)])
    white, log_mass = np.empty((count, peak.size)), np.zeros(count)
    points = np.empty((count, peak.size))
    for k, i in enumerate(order):
        before = peak[i] + white[:, :k] @ root[k, :k]
        begin, end = (low[i] - before) / root[k, k], (high[i] - before) / root[k, k]
        white[:, k] = _between(begin, end, generator.random(count))
        points[:, i] = np.clip(before + root[k, k] * white[:, k], low[i], high[i])
        mirrored = begin > -end
        above = log_ndtr(np.where(mirrored, -begin, end))
        below = log_ndtr(np.where(mirrored, -end, begin))
        log_mass += above + np.log1p(-np.exp(below - above))
    return points, -0.5 * np.sum(white**2, axis=1) - log_mass


def _between(low: FloatArray, high: FloatArray, share: FloatArray) -> FloatArray:
    """Quantiles of the standard normal distribution between two ends, all (m,)."""
    from scipy.special import log_ndtr, ndtri_exp

    # Mirrored, so that the ends lie where the logarithm of the distribution is exact.
    mirrored = low > -high
    low, high = np.where(mirrored, -high, low), np.where(mirrored, -low, high)
    below, above = log_ndtr(low), log_ndtr(high)
    quantile = ndtri_exp(above + np.log(share + (1.0 - share) * np.exp(below - above)))
    found = np.clip(quantile, low, high)
    return np.asarray(np.where(mirrored, -found, found))
