"""How probable it is that a true value within its tolerance leaves draws so pressed at an edge."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import log_ndtr

from bayesbl.probabilities import normal_sf
from bayesbl.recording.types import FloatArray

FURTHEST = 30.0
"""Standard deviations of a peak beyond an edge; from there on the draws look exponential."""


def chance_at_edge(distances: FloatArray, width: float) -> float:
    """Probability of a likelihood whose peak lies so far beyond an edge, or further.

    With the peak t standard deviations s beyond the edge, draws have their mean at s (λ − t) and
    the variance s² (1 + tλ − λ²), λ = φ(t)/Q(t) and Q the upper tail of the normal distribution.
    The true value lies anywhere within the tolerance with equal probability, so a peak t or
    further beyond has the probability s/width (φ(t) − t Q(t)).

    Parameters
    ----------
    distances
        Of the draws from the edge, none negative, any shape.
    width
        Of the tolerance, in the same unit.

    Returns
    -------
    At most one; one where the peak does not lie beyond the edge.
    """
    mean, sd = float(distances.mean()), float(distances.std())
    if mean >= sd * _shape(0.0)[0]:
        return 1.0
    beyond = FURTHEST
    if mean > sd * _shape(FURTHEST)[0]:
        from scipy.optimize import brentq

        beyond = float(brentq(lambda t: _shape(t)[0] - mean / sd, 0.0, FURTHEST))
    own = sd / _shape(beyond)[1]
    tail = _density(beyond) - beyond * normal_sf(beyond)
    return min(1.0, own / width * tail)


def _density(z: float) -> float:
    """Of the standard normal distribution."""
    return math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)


def _shape(beyond: float) -> tuple[float, float]:
    """Mean over standard deviation of the draws, and the latter over that of the likelihood."""
    hazard = _density(beyond) * math.exp(-log_ndtr(-beyond))
    sd = float(np.sqrt(1.0 + beyond * hazard - hazard**2))
    return (hazard - beyond) / sd, sd
