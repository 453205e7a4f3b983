"""Noise of a comparison, from its residual: autoregressive, so that smooth misfit is not believed.

The whole residual of a fit, misfit included, counts as noise here. That makes every test
conservative: a bench that is still wrong elsewhere blurs what it could show.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesbl.noise.rotation_noise import (
    HIGHEST_ORDER,
    autocorrelation,
    bic,
    burg,
    correlated,
    innovation_share,
    log_variances,
)
from bayesbl.recording.types import FloatArray

_FREQUENCIES = np.linspace(0.0, math.pi, 2001)
"""rad per sample."""


@dataclass(frozen=True, slots=True)
class ResidualNoise:
    """Autoregressive noise in the unit of its channel; order by BIC over 0 to 15."""

    sd: float
    coefficients: FloatArray

    @classmethod
    def of(cls, residual: FloatArray) -> ResidualNoise:
        """Burg's estimate on a residual of shape (n,)."""
        n = residual.size
        fits = burg(residual, min(HIGHEST_ORDER, n // 20))
        order = int(np.argmin(bic(log_variances(fits), n)))
        return cls(math.sqrt(float(residual @ residual) / n), fits[order][1])

    @property
    def innovation(self) -> float:
        """Standard deviation of what does not follow from the samples before."""
        return self.sd * math.sqrt(max(0.0, innovation_share(self.coefficients)))

    @property
    def strongest(self) -> float:
        """Standard deviation per sample at the frequency where the noise is strongest."""
        waves = np.exp(-1j * np.outer(_FREQUENCIES, np.arange(1, self.coefficients.size + 1)))
        return float(np.max(self.innovation / np.abs(1.0 - waves @ self.coefficients)))

    def covariance_times(self, columns: FloatArray) -> FloatArray:
        """Σ X for X of shape (n, p) or (n,)."""
        if not self.coefficients.size:
            return self.sd**2 * columns
        return self.sd**2 * correlated(self.coefficients, columns)

    def effective_samples(self, n: int) -> float:
        """Independent samples that n are worth for the mean square: n / Σ ρ²."""
        rho = autocorrelation(self.coefficients, min(n, 2000))
        return n / float(2.0 * (rho**2).sum() - 1.0)


def sandwich(columns: Sequence[FloatArray], noises: Sequence[ResidualNoise]) -> FloatArray:
    """Covariance of least-squares parameters under coloured noise, shape (p, p).

    ``columns`` are ∂prediction/∂parameter of each piece, shape (k, p).

    V = (JᵀJ)⁻¹ JᵀΣJ (JᵀJ)⁻¹ with Σ block-diagonal over the used pieces (White 1982); by
    pseudo-inverse where the recordings leave a parameter undetermined.
    """
    scale = np.sqrt(sum((part**2).sum(axis=0) for part in columns))
    scale = np.where(scale > 0.0, scale, 1.0)
    parts = [part / scale for part in columns]
    inverse = np.linalg.pinv(sum(part.T @ part for part in parts), hermitian=True)
    middle = sum(
        part.T @ noise.covariance_times(part) for part, noise in zip(parts, noises, strict=True)
    )
    return np.asarray(inverse @ middle @ inverse / np.outer(scale, scale))


def distance(
    first: list[FloatArray], other: list[FloatArray], noises: list[ResidualNoise]
) -> float:
    """|z| between two predictions: ‖d‖² / √(dᵀΣd), what least squares could tell them apart by."""
    differences = [a - b for a, b in zip(first, other, strict=True)]
    size = sum(float(d @ d) for d in differences)
    if size == 0.0:
        return 0.0
    spread = sum(
        float(d @ noise.covariance_times(d)) for d, noise in zip(differences, noises, strict=True)
    )
    return size / math.sqrt(max(spread, 1e-300))
