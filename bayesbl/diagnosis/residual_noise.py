"""Noise of a comparison, from its residual: autoregressive, so that smooth misfit is not believed.

The whole residual of a fit, misfit included, counts as noise here: what a bench that is still wrong
leaves blurs what it could show.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from bayesbl.noise.rotation_noise import HIGHEST_ORDER, bic, burg, innovation_share, log_variances
from bayesbl.recording.types import FloatArray

AROUND = 25
"""Samples: their mean square is good to 0.28 of itself where they are independent."""

_FREQUENCIES = np.linspace(0.0, math.pi, 2001)
"""rad per sample."""


@dataclass(frozen=True, slots=True)
class ResidualNoise:
    """Autoregressive noise in the unit of its channel; order by BIC over 0 to 15."""

    sd: float
    coefficients: FloatArray
    residual: FloatArray

    @classmethod
    def of(cls, residual: FloatArray) -> ResidualNoise:
        """Burg's estimate on a residual of shape (n,)."""
        n = residual.size
        fits = burg(residual, min(HIGHEST_ORDER, n // 20))
        order = int(np.argmin(bic(log_variances(fits), n)))
        return cls(math.sqrt(float(residual @ residual) / n), fits[order][1], residual)

    @property
    def innovation(self) -> float:
        """Standard deviation of what does not follow from the samples before."""
        return self.sd * math.sqrt(max(0.0, innovation_share(self.coefficients)))

    @property
    def strongest(self) -> float:
        """Standard deviation per sample at the frequency where the noise is strongest."""
        waves = np.exp(-1j * np.outer(_FREQUENCIES, np.arange(1, self.coefficients.size + 1)))
        return float(np.max(self.innovation / np.abs(1.0 - waves @ self.coefficients)))

    @property
    def local(self) -> FloatArray:
        """The same where the residual is as large as around each of its samples, (n,).

        What a bench leaves comes in bursts, where the axis starts, slips or turns round.
        """
        power = uniform_filter1d(self.residual**2, min(AROUND, self.residual.size), mode="nearest")
        return np.asarray(self.strongest * np.sqrt(power) / max(self.sd, np.finfo(float).tiny))
