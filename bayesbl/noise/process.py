"""Measurement: coloured noise, encoder counts."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from bayesbl.errors import BenchError
from bayesbl.noise.rotation_noise import autocorrelation, recursion
from bayesbl.recording.types import FloatArray


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Stationary autoregressive noise: n_t = Σ φ_k n_{t−k} + ε_t.

    Attributes
    ----------
    standard_deviation
        Of the noise itself (not of ε), in its channel's unit.
    coefficients
        φ_1 … φ_p; empty for white noise. They hold for one sampling rate only.
    degrees_of_freedom
        Of Student-t ε_t, above 2, scaled to the same variance: outliers. ``None`` for Gaussian
        ε_t.

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
        if self.coefficients:
            roots = np.roots(np.concatenate(([1.0], -np.asarray(self.coefficients))))
            if not np.all(np.abs(roots) < 1.0):
                raise BenchError(
                    "Autoregressive noise with these coefficients grows without bound.",
                    where="coefficients",
                    found=list(self.coefficients),
                    expected="roots of z^p - φ_1 z^(p-1) - … inside the unit circle",
                )

    def autocorrelation(self, lags: int) -> FloatArray:
        """Autocorrelation at lags 0 … ``lags``, shape (lags + 1,)."""
        return autocorrelation(np.asarray(self.coefficients), lags + 1)

    def draw(self, size: int, rng: np.random.Generator) -> FloatArray:
        """Stationary from the first sample on, shape (size,), the channel's unit."""
        order = len(self.coefficients)
        rho = self.autocorrelation(order)
        innovation = math.sqrt(1.0 - float(np.dot(self.coefficients, rho[1:])))
        if self.degrees_of_freedom is not None:
            return self._draw_with_outliers(size, rng, self.degrees_of_freedom, innovation)
        white = rng.standard_normal(size)
        if order == 0:
            return self.standard_deviation * white
        start = linalg.cholesky(linalg.toeplitz(rho[:order]), lower=True) @ rng.standard_normal(
            order
        )
        coefficients = np.asarray(self.coefficients, dtype=np.float64)
        noise = recursion(coefficients, innovation * white, start)
        return np.asarray(self.standard_deviation * noise)

    def _draw_with_outliers(
        self, size: int, rng: np.random.Generator, freedom: float, innovation: float
    ) -> FloatArray:
        """Like :meth:`draw`, but run in from zero: the stationary law has no closed form."""
        roots = np.roots(np.concatenate(([1.0], -np.asarray(self.coefficients))))
        slowest = float(np.max(np.abs(roots), initial=0.0))
        run_in = math.ceil(math.log(1e-6) / math.log(slowest)) if slowest > 0.0 else 0
        white = rng.standard_t(freedom, run_in + size) * math.sqrt((freedom - 2.0) / freedom)
        coefficients = np.asarray(self.coefficients, dtype=np.float64)
        drive = self.standard_deviation * innovation * white
        return np.asarray(recursion(coefficients, drive, np.zeros(coefficients.size))[run_in:])


NO_NOISE = NoiseModel(0.0)


def quantised(angle_rad: FloatArray, counts: int) -> FloatArray:
    """Angle as an encoder of ``counts`` per turn shows it, nearest count, rad."""
    count = 2.0 * math.pi / counts
    shown: FloatArray = np.rint(angle_rad / count) * count
    return shown
