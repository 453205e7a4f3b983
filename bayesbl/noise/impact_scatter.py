"""Impacts that are not alike: how far they scatter an estimate beyond the noise.

The error of an estimate is a sum over impacts. With r the residual, J_g its derivative at impact g
and a the row of the covariance that belongs to the estimate, impact g adds the score
u_g = aᵀJ_gᵀr. If noise is everywhere what the fit takes it for, the scores scatter by what that
noise makes of them. They scatter by v times as much where noise is louder around impacts, another
axis moves, or impacts differ. The variance of the estimate is then v times as large: a covariance
robust to clusters (Liang and Zeger 1986), the clusters few and the scores of a fit's residual, so
that their number of degrees of freedom is that of Bell and McCaffrey (2002).

Impacts that come early and late scatter the scores of their time instead, and smear their mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from bayesbl.recording.types import FloatArray

SURPRISE = 0.2
"""Chance that impacts scatter by more than is expected. A judgement: with one of two, intervals
of three rotations without any such scatter are a sixth wider, with one of five a twentieth."""

SHARES = 1000
"""Places between 0 and 1 that a share is drawn from."""


@dataclass(frozen=True, slots=True)
class Scatter:
    """How the scores of impacts scatter.

    Attributes
    ----------
    square
        χ² of ``freedom`` if v is 1, else v times that.
    freedom
        Degrees of freedom; 0 where nothing repeats.
    expected
        v before the scores are looked at, all values as likely, shape (k,).
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
        """Of scores (g,), by their covariance under the noise of the fit, (g, g).

        ``kinds``, (g,): a misfit that repeats is the same at impacts of a kind.
        """
        expected = np.ones(1) if expected is None else expected
        deviations, spread = about_their_kind(scores, covariance, kinds)
        trace = float(np.trace(spread))
        if not trace > 0.0:
            return cls(0.0, 0.0, expected)
        freedom = trace**2 / float(np.sum(spread**2))
        return cls(freedom * float(deviations @ deviations) / trace, freedom, expected)

    def likely(self, count: int) -> FloatArray:
        """Values of v, all as likely, in order, shape (count,).

        Before the scores are seen it is what is expected, but for a chance of ``SURPRISE``; then
        that is a share of it, which may be anything between 0 and 1. Where nothing repeats it is
        what is expected.
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
        below = np.cumsum(weight[order])
        places = np.searchsorted(below, (np.arange(count) + 0.5) / count * below[-1])
        return np.asarray(values[order][np.minimum(places, order.size - 1)])


def about_their_kind(
    scores: FloatArray, covariance: FloatArray, kinds: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Scores (g,) less the mean of their kind, and the covariance (g, g) of that."""
    alike = np.equal.outer(kinds, kinds)
    centring = np.eye(kinds.size) - alike / alike.sum(axis=1)
    return centring @ scores, centring @ covariance @ centring


def early_and_late(
    delays: FloatArray, covariance: FloatArray, kinds: FloatArray, factors: FloatArray
) -> FloatArray:
    """Mean square of the true part of delays (g,), one for each factor of the noise, (k,).

    Of ν values of variance s² + v n² the mean square less v n² is s², with the variance
    (2 v² n⁴ + 4 v n² s²)/ν; what is negative is none.
    """
    deviations, spread = about_their_kind(delays, covariance, kinds)
    trace = float(np.trace(spread))
    if not trace > 0.0:
        return np.zeros(factors.size)
    squares = float(np.sum(spread**2))
    number = kinds.size - np.unique(kinds).size
    noise = factors * trace / number
    true = np.maximum(float(deviations @ deviations) / number - noise, 0.0)
    sd = np.sqrt(2.0 * squares * (factors / number) ** 2 + 4.0 * noise * true / number)
    normal = np.random.default_rng(0).permutation(normal_quantiles(factors.size))
    return np.asarray(
        np.maximum(float(deviations @ deviations) / number - noise + sd * normal, 0.0)
    )


def normal_quantiles(count: int) -> FloatArray:
    """Values of a standard normal, as likely each, (count,)."""
    return np.asarray(special.ndtri((np.arange(count) + 0.5) / count))
