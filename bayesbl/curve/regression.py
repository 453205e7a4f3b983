"""The A→δ polynomial with everything a sweep leaves uncertain about it.

Relative weights throughout: the model of one sweep point is

    1 = Σ c_k A^k / δ + g(ln A) + scatter,

c the coefficients with a flat prior, g a smooth lack of fit (Gaussian process with squared
exponential covariance), scatter the start angle's. Coefficients and lack of fit are inferred
together (universal kriging; Rasmussen and Williams 2006, section 2.7), the process' size and
length by restricted maximum likelihood on a grid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import polynomial
from scipy.linalg import cho_factor, cho_solve

from bayesbl.errors import CurveError
from bayesbl.recording.types import FloatArray

SIZES = np.geomspace(1e-5, 6e-3, 12)
"""Relative; a lack of fit beyond half a percent calls for another degree, not for a correction."""
LENGTHS = np.geomspace(0.15, 0.7, 5)
"""In ln A; longer ones would only compete with the polynomial."""
SMALLEST_SCATTER = 1e-5


@dataclass(frozen=True, slots=True)
class Regression:
    """Joint posterior of coefficients and lack of fit, at given knots.

    Attributes
    ----------
    coefficients
        Posterior mean of c_0 … c_degree, δ in rad and A in rpm, shape (k,).
    knots_rpm
        Shape (g,).
    lack_of_fit
        Posterior mean of g at the knots, relative, shape (g,).
    lack_of_fit_size, lack_of_fit_length
        Standard deviation (relative) and length (in ln A) of the process.
    log_evidence
        Restricted log likelihood, for comparing degrees.
    """

    coefficients: FloatArray
    knots_rpm: FloatArray
    lack_of_fit: FloatArray
    lack_of_fit_size: float
    lack_of_fit_length: float
    log_evidence: float
    _coefficient_root: FloatArray
    _sensitivity: FloatArray
    _remaining_root: FloatArray

    @property
    def log_gap(self) -> FloatArray:
        """ln δ at the knots, polynomial and lack of fit together, shape (g,)."""
        value = polynomial.polyval(self.knots_rpm, self.coefficients)
        return np.asarray(np.log(value) - np.log1p(-self.lack_of_fit))

    def draws(self, count: int, generator: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Departures of ln δ at the knots: by the coefficients, by the lack of fit, (count, g).

        The lack of fit moves with the coefficients, as far as the sweep points demand it.
        """
        k = self.coefficients.size
        shifts = generator.standard_normal((count, k)) @ self._coefficient_root.T
        powers = self.knots_rpm ** np.arange(k)[:, None]
        nominal = self.coefficients @ powers
        moved = self.lack_of_fit + shifts @ self._sensitivity.T
        by_coefficients = np.log1p(shifts @ powers / nominal) - np.log(
            (1.0 - moved) / (1.0 - self.lack_of_fit)
        )
        noise = generator.standard_normal((count, self.knots_rpm.size)) @ self._remaining_root.T
        by_lack_of_fit = -np.log1p(-noise / (1.0 - self.lack_of_fit))
        return by_coefficients, by_lack_of_fit


def regress(
    amplitude_rpm: FloatArray,
    gap_rad: FloatArray,
    relative_scatter: FloatArray,
    knots_rpm: FloatArray,
    degree: int,
) -> Regression:
    """Regress δ on A.

    Parameters
    ----------
    amplitude_rpm, gap_rad
        Sweep points, shape (n,).
    relative_scatter
        Standard deviation of ln δ from the scatter of A over start angles, shape (n,).

    Raises
    ------
    CurveError
        If there are too few different gaps for the degree.
    """
    if np.unique(gap_rad).size < degree + 3:
        raise CurveError(
            "The sweep has too few gaps for this degree.",
            where="[sweep] gap_rad.count",
            found=np.unique(gap_rad).size,
            expected=f"at least {degree + 3} for degree {degree}",
        )
    scale = float(np.exp(np.mean(np.log(amplitude_rpm))))
    columns = (amplitude_rpm[:, None] / scale) ** np.arange(degree + 1) / gap_rad[:, None]
    norms = np.linalg.norm(columns, axis=0)
    columns = columns / norms
    logs = np.log(amplitude_rpm)
    ones = np.ones(logs.size)
    variance = np.maximum(relative_scatter, SMALLEST_SCATTER) ** 2

    evidence, size, length = max(
        (_log_evidence(columns, ones, _kernel(logs, logs, s, h) + np.diag(variance)), s, h)
        for s in SIZES
        for h in LENGTHS
    )
    total = cho_factor(_kernel(logs, logs, size, length) + np.diag(variance), lower=True)
    weighted = cho_solve(total, columns)
    covariance = np.linalg.inv(columns.T @ weighted)
    scaled = covariance @ (weighted.T @ ones)
    across = _kernel(np.log(knots_rpm), logs, size, length)
    pull = cho_solve(total, across.T).T
    remaining = _kernel(np.log(knots_rpm), np.log(knots_rpm), size, length) - pull @ across.T
    back = 1.0 / (norms * scale ** np.arange(degree + 1))
    coefficients = back * scaled
    return Regression(
        coefficients=coefficients,
        knots_rpm=knots_rpm,
        lack_of_fit=pull @ (ones - columns @ scaled),
        lack_of_fit_size=float(size),
        lack_of_fit_length=float(length),
        log_evidence=float(evidence),
        _coefficient_root=back[:, None] * np.linalg.cholesky(covariance),
        _sensitivity=-(pull @ columns) / back,
        _remaining_root=_root(remaining),
    )


def relative_fit(amplitude_rpm: FloatArray, gap_rad: FloatArray, degree: int) -> FloatArray:
    """Coefficients of plain relative least squares, without lack of fit, shape (degree + 1,)."""
    return np.asarray(polynomial.polyfit(amplitude_rpm, gap_rad, degree, w=1.0 / gap_rad))


def _kernel(x: FloatArray, y: FloatArray, size: float, length: float) -> FloatArray:
    return np.asarray(size**2 * np.exp(-0.5 * ((x[:, None] - y[None, :]) / length) ** 2))


def _log_evidence(columns: FloatArray, y: FloatArray, covariance: FloatArray) -> float:
    """Restricted log likelihood: coefficients integrated out under a flat prior."""
    factor = cho_factor(covariance, lower=True)
    weighted = cho_solve(factor, columns)
    gram = columns.T @ weighted
    scaled = np.linalg.solve(gram, weighted.T @ y)
    residual = y - columns @ scaled
    return float(
        -0.5 * residual @ cho_solve(factor, residual)
        - np.sum(np.log(np.diag(factor[0])))
        - 0.5 * np.linalg.slogdet(gram)[1]
        - 0.5 * (y.size - columns.shape[1]) * math.log(2.0 * math.pi)
    )


def _root(covariance: FloatArray) -> FloatArray:
    """Square root of a covariance that rounding may have left slightly indefinite."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
