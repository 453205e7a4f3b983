"""Does a posterior hold what it promises? Coverage and simulation-based calibration.

Both look at the *rank* of a truth among the draws of its posterior, the share of the posterior
below it. An equal-tailed interval of probability p holds a truth of rank u if |u − ½| ≤ p/2; and
where truths come from the prior, ranks are uniform (Talts et al. 2018, arXiv:1804.06788).
"""

from __future__ import annotations

from functools import cache

import numpy as np

from bayesbl.recording.types import FloatArray

LEVELS = (0.5, 0.8, 0.9, 0.95)
"""Interval probabilities at which coverage is reported."""

BAND = 0.99
"""Share of exact posteriors whose coverage at a level lies in :func:`coverage_band`."""

FALSE_ALARM = 0.01
"""Share of exact posteriors for which :func:`uniformity` is below this."""

POINTS = 100
"""Parts of [0, 1] at whose ends ranks are counted."""


def rank(truth: float, draws: FloatArray, generator: np.random.Generator) -> float:
    """The share of the posterior below the truth: uniform on (0, 1) if it is a draw like them.

    The place among the draws is discrete; ``generator`` picks a point within it, and a place among
    draws that are equal to the truth.
    """
    below, equal = int(np.sum(draws < truth)), int(np.sum(draws == truth))
    return (below + (1 + equal) * generator.uniform()) / (draws.size + 1)


def coverage(ranks: FloatArray, level: float) -> float:
    """Share of the truths inside their equal-tailed interval of probability ``level``."""
    return float(np.mean(np.abs(ranks - 0.5) <= 0.5 * level))


def coverage_band(count: int, level: float, probability: float = BAND) -> tuple[float, float]:
    """Range of :func:`coverage` over ``count`` truths that exact intervals rarely leave.

    The tails beyond each end have at most (1 − probability)/2 of the binomial distribution.
    """
    from scipy.stats import binom

    tail = 0.5 * (1.0 - probability)
    low, high = binom.ppf([tail, 1.0 - tail], count, level) / count
    return float(low), float(high)


def levels_missed(ranks: FloatArray, probability: float = BAND) -> list[float]:
    """The :data:`LEVELS` at which coverage lies outside its band."""
    bands = {level: coverage_band(ranks.size, level, probability) for level in LEVELS}
    return [
        level for level, (low, high) in bands.items() if not low <= coverage(ranks, level) <= high
    ]


def uniformity(ranks: FloatArray) -> float:
    """p value of the hypothesis that ranks are uniform: below α in a share α of uniform samples.

    The statistic is the least of the two-sided binomial tail probabilities of the counts below
    k/:data:`POINTS`, which weighs the tails like the middle; its distribution is computed
    (Säilynoja, Bürkner and Vehtari 2022, Stat Comput 32:32, with an exact sum in place of the
    simulation). It is discrete, so the share is at most α, and close to it for 100 ranks or more.
    """
    return 1.0 - _share_within(ranks.size, _least_tail(ranks))


def ecdf_band(count: int, probability: float = 1.0 - FALSE_ALARM) -> tuple[FloatArray, FloatArray]:
    """Simultaneous band of the share of ``count`` uniform ranks below k/:data:`POINTS`.

    Returns
    -------
    Lowest and highest share for k = 1 … POINTS − 1, each of shape (POINTS − 1,).
    """
    least, most = _counts_within(count, _tail(count, probability))
    return least / count, most / count


def ecdf(ranks: FloatArray) -> FloatArray:
    """Share of the ranks below k/:data:`POINTS`, k = 1 … POINTS − 1, shape (POINTS − 1,)."""
    return np.asarray(np.searchsorted(np.sort(ranks), _points(), side="right") / ranks.size)


def _points() -> FloatArray:
    return np.arange(1, POINTS) / POINTS


def _least_tail(ranks: FloatArray) -> float:
    """The least two-sided tail probability of the counts below each point."""
    from scipy.stats import binom

    counts = np.round(ecdf(ranks) * ranks.size)
    below = binom.cdf(counts, ranks.size, _points())
    above = binom.sf(counts - 1, ranks.size, _points())
    return float(np.minimum(1.0, 2.0 * np.minimum(below, above)).min())


def _counts_within(count: int, tail: float) -> tuple[FloatArray, FloatArray]:
    """Least and largest count below each point with a two-sided tail above ``tail``."""
    from scipy.stats import binom

    every = np.arange(count + 1)[:, None]
    below = binom.cdf(every, count, _points())
    above = binom.sf(every - 1, count, _points())
    within = 2.0 * np.minimum(below, above) > tail
    return np.argmax(within, axis=0) * 1.0, count - np.argmax(within[::-1], axis=0) * 1.0


def _share_within(count: int, tail: float) -> float:
    """Probability that all counts of ``count`` uniform ranks lie in :func:`_counts_within`.

    Counts between points are multinomial: independent Poisson counts, given that they add up to
    ``count``. So the distribution of their sum is carried from point to point, less what lies
    outside.
    """
    from scipy.stats import poisson

    least, most = _counts_within(count, tail)
    every = np.arange(count + 1)
    step = poisson.pmf(every, count / POINTS)
    share = (every == 0) * 1.0
    for low, high in zip(least, most, strict=True):
        share = np.convolve(share, step)[: count + 1]
        share[(every < low) | (every > high)] = 0.0
    whole = float(np.convolve(share, step)[count])
    return min(1.0, whole / float(poisson.pmf(count, count)))


@cache
def _tail(count: int, probability: float) -> float:
    """The largest tail probability whose band holds at least ``probability``, by bisection."""
    low, high = 0.0, 1.0 - probability
    for _ in range(40):
        middle = 0.5 * (low + high)
        if _share_within(count, middle) >= probability:
            low = middle
        else:
            high = middle
    return low
