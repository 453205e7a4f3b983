"""Scatter between impacts: how far it widens an estimate beyond the noise.

The error of an estimate is a sum over impacts. With residual r, its derivative J_g at impact g, and
the row a of the covariance that belongs to the estimate, impact g adds the score u_g = aᵀJ_gᵀr. If
the noise is everywhere as the fit assumes, the scatter of the scores follows from that noise. It is
v times as large if noise is louder around impacts, another axis moves, or impacts differ. The
variance of the estimate is then v times as large. This is a cluster-robust covariance (Liang and
Zeger 1986). The clusters are few and the scores come from the residual of a fit, so the degrees of
freedom are those of Bell and McCaffrey (2002).

Early and late impacts scatter the scores of their time instead, and smear their mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from bayesbl.recording.types import FloatArray

SURPRISE = 0.2
"""Probability that impacts scatter more than expected. A judgement: with 1/2, intervals of three
rotations without such scatter would be a sixth wider, with 1/5 a twentieth."""

FACTORS = 400
"""Number of likely values of v that are kept."""

SHARES = 1000
"""Grid points of a share between 0 and 1."""

TIMING, SHAKING = range(2)
"""Streams of the errors by early and late impacts and by outside vibration."""


@dataclass(frozen=True, slots=True)
class Scatter:
    """How the scores of impacts scatter.

    Attributes
    ----------
    square
        χ² with ``freedom`` if v is 1, else v times that.
    freedom
        Degrees of freedom; 0 if nothing repeats.
    expected
        Equally likely prior values of v, shape (k,).
    """

    square: float
    freedom: float
    expected: FloatArray

    @classmethod
    def of(
        cls,
        scores: FloatArray,
        covariance: FloatArray,
        kinds: FloatArray,
        expected: FloatArray | None = None,
    ) -> Scatter:
        """Estimate from scores (g,) and their covariance under the noise of the fit, (g, g).

        ``kinds``, (g,): a repeating misfit is the same at all impacts of a kind.
        """
        expected = np.ones(1) if expected is None else expected
        deviations, spread = about_their_kind(scores, covariance, kinds)
        trace = float(np.trace(spread))
        if not trace > 0.0:
            return cls(0.0, 0.0, expected)
        freedom = trace**2 / float(np.sum(spread**2))
        return cls(freedom * float(deviations @ deviations) / trace, freedom, expected)

    def likely(self, count: int = FACTORS) -> FloatArray:
        """Equally likely posterior values of v, in ascending order, shape (count,).

        A priori v is ``expected``, or with probability ``SURPRISE`` larger: ``expected`` is then a
        uniform share of v. If nothing repeats, v is ``expected``.
        """
        share = np.concatenate(([1.0], (np.arange(SHARES) + 0.5) / SHARES))
        prior = np.concatenate(([1.0 - SURPRISE], np.full(SHARES, SURPRISE / SHARES)))
        if self.freedom == 0.0:
            share, prior = share[:1], prior[:1]
        values = (self.expected[:, None] / share).ravel()
        weight = np.log(np.tile(prior, self.expected.size))
        weight -= 0.5 * self.freedom * np.log(values) + 0.5 * self.square / values
        weight = np.exp(weight - weight.max())
        order = np.argsort(values)
        cumulative = np.cumsum(weight[order])
        indices = np.searchsorted(cumulative, (np.arange(count) + 0.5) / count * cumulative[-1])
        return np.asarray(values[order][np.minimum(indices, order.size - 1)])


def about_their_kind(
    scores: FloatArray, covariance: FloatArray, kinds: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Scores (g,) minus the mean of their kind, and their covariance (g, g)."""
    alike = np.equal.outer(kinds, kinds)
    centring = np.eye(kinds.size) - alike / alike.sum(axis=1)
    return centring @ scores, centring @ covariance @ centring


def early_and_late(
    delays: FloatArray, covariance: FloatArray, kinds: FloatArray, factors: FloatArray
) -> FloatArray:
    """Mean square of the true part of delays (g,), one for each factor of the noise, (k,).

    For ν values of variance s² + v n², the mean square minus v n² estimates s², with variance (2 v²
    n⁴ + 4 v n² s²)/ν. Negative values become 0.
    """
    deviations, spread = about_their_kind(delays, covariance, kinds)
    trace = float(np.trace(spread))
    if not trace > 0.0:
        return np.zeros(factors.size)
    squares = float(np.sum(spread**2))
    freedom = kinds.size - np.unique(kinds).size
    noise = factors * trace / freedom
    excess = float(deviations @ deviations) / freedom - noise
    true_square = np.maximum(excess, 0.0)
    sd = np.sqrt(2.0 * squares * (factors / freedom) ** 2 + 4.0 * noise * true_square / freedom)
    return np.maximum(excess + sd * normal_sample(factors.size, TIMING), 0.0)


def normal_sample(count: int, stream: int) -> FloatArray:
    """Equally likely values of a standard normal variable in a fixed random order, (count,).

    Errors that are independent take a ``stream`` each.
    """
    quantiles = special.ndtri((np.arange(count) + 0.5) / count)
    return np.random.default_rng(stream).permutation(quantiles)
