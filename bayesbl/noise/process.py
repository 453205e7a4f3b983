"""Coloured noise of a simulated measurement."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from bayesbl.errors import BenchError
from bayesbl.noise.rotation_noise import autocorrelation, innovation_share, recursion
from bayesbl.recording.types import FloatArray


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Stationary autoregressive noise: n_t = Σ φ_k n_{t−k} + ε_t.

    Attributes
    ----------
    standard_deviation
        Standard deviation of the noise n (not of ε), in its channel's unit.
    coefficients
        φ_1 … φ_p; empty for white noise. They hold for one sampling rate only.
    degrees_of_freedom
        Degrees of freedom of Student-t ε_t (outliers), above 2, scaled to the same variance.
        ``None`` for Gaussian ε_t.

    Raises
    ------
    BenchError
        If the standard deviation is negative, the coefficients are not stationary or the variance
        is infinite.
    """

    standard_deviation: float
    coefficients: tuple[float, ...] = ()
    degrees_of_freedom: float | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.standard_deviation) and self.standard_deviation >= 0.0):
            raise BenchError(
                "The standard deviation of noise must be zero or positive.",
                found=self.standard_deviation,
            )
        if self.degrees_of_freedom is not None and not self.degrees_of_freedom > 2.0:
            raise BenchError(
                "Student-t noise has a standard deviation only above 2 degrees of freedom.",
                where="degrees_of_freedom",
                found=self.degrees_of_freedom,
                expected="above 2",
            )
        if not np.all(np.abs(self._roots) < 1.0):
            raise BenchError(
                "Autoregressive noise with these coefficients grows without bound.",
                where="coefficients",
                found=list(self.coefficients),
                expected="roots of z^p - φ_1 z^(p-1) - … inside the unit circle",
            )

    def draw(self, size: int, rng: np.random.Generator) -> FloatArray:
        """Draw noise that is stationary from the first sample, shape (size,), channel's unit."""
        coefficients = np.asarray(self.coefficients, dtype=np.float64)
        order, freedom = coefficients.size, self.degrees_of_freedom
        innovation = math.sqrt(innovation_share(coefficients))
        if freedom is not None:
            # Discard a run-in from zero: the stationary distribution has no closed form.
            slowest = float(np.max(np.abs(self._roots), initial=0.0))
            run_in = math.ceil(math.log(1e-6) / math.log(slowest)) if slowest > 0.0 else 0
            white = rng.standard_t(freedom, run_in + size) * math.sqrt((freedom - 2.0) / freedom)
            drive = self.standard_deviation * innovation * white
            return np.asarray(recursion(coefficients, drive, np.zeros(order))[run_in:])
        white = rng.standard_normal(size)
        if order == 0:
            return self.standard_deviation * white
        rho = autocorrelation(coefficients, order)
        start = linalg.cholesky(linalg.toeplitz(rho), lower=True) @ rng.standard_normal(order)
        return np.asarray(
            self.standard_deviation * recursion(coefficients, innovation * white, start)
        )

    @property
    def _roots(self) -> NDArray[np.complex128]:
        """Roots of z^p − φ_1 z^(p−1) − …, shape (p,)."""
        return np.asarray(np.roots(np.concatenate(([1.0], -np.asarray(self.coefficients)))))


NO_NOISE = NoiseModel(0.0)
