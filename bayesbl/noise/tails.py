"""Outliers: are the noise's innovations normal, or Student-t with few degrees of freedom?

Only differences of two innovations, one rotation apart, are seen. The difference of two Student-t
variables is not Student-t itself, so its density is integrated.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import gammaln

from bayesbl.recording.types import FloatArray

FREEDOMS = (2.1, 2.3, 2.6, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0, 10.0, 15.0, 20.0, 30.0)
"""Degrees of freedom considered."""

_BINS = 2000
_LARGEST = 1e6
"""Of a difference, in scales of the Student-t variable."""


@dataclass(frozen=True, slots=True)
class Tails:
    """Student-t against normal innovations.

    Attributes
    ----------
    degrees_of_freedom
        The likeliest of :data:`FREEDOMS`.
    evidence
        Gain in log likelihood over normal innovations, less ½ ln n for the extra parameter:
        half the difference in BIC, positive where Student-t is the better description.
    """

    degrees_of_freedom: float
    evidence: float


def tails(differences: FloatArray) -> Tails:
    """Weigh Student-t against normal noise by differences of two innovations each, shape (n,).

    The likelihood is a composite one: an innovation may be in two differences.
    """
    n = differences.size
    size = np.abs(differences)
    middle = float(np.median(size))
    if middle == 0.0:
        return Tails(FREEDOMS[-1], -np.inf)
    edges = np.sinh(np.linspace(0.0, np.arcsinh(float(size.max()) / middle), _BINS + 1))
    count = np.histogram(size / middle, edges)[0].astype(float)
    # The last bin ends at the largest value, which rounding may put a hair beyond it.
    count[-1] += n - count.sum()
    x, count = 0.5 * (edges[1:] + edges[:-1])[count > 0], count[count > 0]
    variance = float(count @ x**2) / n
    normal = -0.5 * n * (np.log(2.0 * np.pi * variance) + 1.0)
    likelihoods = [_log_likelihood(x, count, freedom) for freedom in FREEDOMS]
    best = int(np.argmax(likelihoods))
    gain = likelihoods[best] - normal - 0.5 * np.log(n)
    return Tails(FREEDOMS[best], float(gain))


def _log_likelihood(x: FloatArray, count: FloatArray, freedom: float) -> float:
    """Log likelihood of |differences| x, each ``count`` times, at the best scale."""
    from scipy.optimize import minimize_scalar

    log_z, log_density = _difference_density(freedom)

    def cost(log_scale: float) -> float:
        value = np.interp(np.arcsinh(x / np.exp(log_scale)), log_z, log_density)
        return float(count @ (log_scale - value))

    found = minimize_scalar(cost, bounds=(-5.0, 3.0), method="bounded", options={"xatol": 1e-4})
    return -float(found.fun)


@cache
def _difference_density(freedom: float) -> tuple[FloatArray, FloatArray]:
    """(arsinh z, ln density) of the difference z ≥ 0 of two Student-t variables, shapes (m,)."""
    log_z = np.linspace(0.0, np.arcsinh(_LARGEST), 300)
    half = 0.5 * np.sinh(log_z)
    # The integrand t(x) t(z − x) is symmetric about z/2; below it, x = tan θ resolves its peak.
    node, weight = np.polynomial.legendre.leggauss(300)
    width = 0.5 * (np.arctan(half) + 0.5 * np.pi)
    angle = -0.5 * np.pi + np.outer(width, node + 1.0)
    x = np.tan(angle)
    density = np.exp(_log_t(x, freedom) + _log_t(2.0 * half[:, None] - x, freedom))
    total = 2.0 * (density / np.cos(angle) ** 2) @ weight * width
    return log_z, np.log(total)


def _log_t(x: FloatArray, freedom: float) -> FloatArray:
    constant = gammaln(0.5 * (freedom + 1.0)) - gammaln(0.5 * freedom)
    return np.asarray(
        constant - 0.5 * np.log(freedom * np.pi) - 0.5 * (freedom + 1.0) * np.log1p(x**2 / freedom)
    )
