"""The noise of a recording, from what does not repeat from one load rotation to the next.

The disturbance model leaves a misfit that repeats every rotation and is almost perfectly
autocorrelated. A noise model learned from the residuals themselves takes that misfit for noise.
In the difference between the residual and the residual one rotation later it cancels, and what is
left has the noise's autocorrelation and twice its variance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayesbl.errors import RecordingError
from bayesbl.recording.types import FloatArray

NoiseKind = Literal["auto", "white", "ar"]

HIGHEST_ORDER = 15
FEWEST_DIFFERENCES = 200


@dataclass(frozen=True, slots=True)
class Noise:
    """Autoregressive noise of the motor speed; order 0 is white.

    Attributes
    ----------
    sd_rpm
        Standard deviation σ, rpm.
    coefficients
        φ of x_t = Σ φ_k x_{t−k} + ε_t, shape (p,).
    bic
        Bayesian information criterion of the orders 0 … 15, less the smallest, shape (16,): the
        evidence the order was chosen by.
    differences
        Number of rotation differences behind the estimate.
    chosen
        Whether the order was chosen by BIC or given by the user.
    """

    sd_rpm: float
    coefficients: FloatArray
    bic: FloatArray
    differences: int
    chosen: bool

    @property
    def order(self) -> int:
        """p, 0 for white noise."""
        return int(self.coefficients.size)

    @property
    def kind(self) -> str:
        """``white`` or ``ar``."""
        return "ar" if self.order else "white"

    def autocovariance(self, lags: int) -> FloatArray:
        """γ(0) … γ(lags − 1), rpm²."""
        return self.sd_rpm**2 * autocorrelation(self.coefficients, lags)

    def draw(self, samples: int, generator: np.random.Generator) -> FloatArray:
        """A realisation of the noise, shape (samples,), rpm."""
        from scipy.signal import lfilter

        settle = 0 if not self.order else 2000
        innovation = self.sd_rpm * math.sqrt(innovation_share(self.coefficients))
        white = innovation * generator.standard_normal(samples + settle)
        return np.asarray(lfilter([1.0], np.r_[1.0, -self.coefficients], white)[settle:])


def rotation_difference(
    residual_rpm: FloatArray, rotation_period_s: float, sampling_period_s: float
) -> FloatArray:
    """Residual one load rotation later minus the residual, shape (n − T_w/Δt,), rpm.

    NaN where either is missing.
    """
    lag = max(1, round(rotation_period_s / sampling_period_s))
    return residual_rpm[lag:] - residual_rpm[:-lag]


def estimate_noise(
    residual_rpm: FloatArray,
    rotation_period_s: float,
    sampling_period_s: float,
    kind: NoiseKind = "auto",
    order: int | None = None,
) -> Noise:
    """Noise order, coefficients and scale from what does not repeat (design.md section 5).

    Parameters
    ----------
    residual_rpm
        Recording minus its RMSE optimum on an even grid, shape (n,), NaN at samples left out.
    kind, order
        ``auto`` chooses an AR order from 0 to 15 by BIC; ``white`` is order 0; ``ar`` takes
        ``order``, or the best order above 0 where it is not given.

    Raises
    ------
    RecordingError
        If too little of the recording has a counterpart one rotation later.
    """
    d = rotation_difference(residual_rpm, rotation_period_s, sampling_period_s)
    count = int(np.isfinite(d).sum())
    if count < FEWEST_DIFFERENCES:
        raise RecordingError(
            "The recording is too short to tell noise from what repeats every load rotation.",
            found=f"{count} samples with a counterpart one rotation "
            f"({rotation_period_s:.3g} s) later",
            expected=f"at least {FEWEST_DIFFERENCES}; record two rotations or more",
        )
    sd = math.sqrt(float(np.nansum(d**2)) / (2.0 * count))
    fits = burg(d, HIGHEST_ORDER)
    variances = np.array([variance for variance, _ in fits])
    orders = np.arange(HIGHEST_ORDER + 1)
    bic = count * np.log(np.maximum(variances, 1e-300)) + orders * math.log(count)
    bic -= bic.min()
    if kind == "white":
        best = 0
    elif kind == "ar":
        best = order if order is not None else 1 + int(np.argmin(bic[1:]))
        if best > HIGHEST_ORDER:
            fits = burg(d, best)
    else:
        best = int(np.argmin(bic))
    return Noise(sd, fits[best][1], bic, count, kind == "auto")


def burg(x: FloatArray, highest: int) -> list[tuple[float, FloatArray]]:
    """Innovation variance and coefficients for every AR order up to ``highest`` (Burg 1975).

    NaN in ``x`` spreads to the predictions that would need it, and those are left out.
    """
    forward, backward = x[1:], x[:-1]
    variance = float(np.nanmean(x**2))
    coefficients = np.zeros(0)
    fits = [(variance, coefficients)]
    for _ in range(highest):
        product = forward * backward
        both = np.isfinite(product)
        power = float(np.sum(forward[both] ** 2 + backward[both] ** 2))
        reflection = 2.0 * float(product[both].sum()) / power if power > 0.0 else 0.0
        coefficients = np.r_[coefficients - reflection * coefficients[::-1], reflection]
        variance *= 1.0 - reflection**2
        fits.append((variance, coefficients))
        forward, backward = (
            (forward - reflection * backward)[1:],
            (backward - reflection * forward)[:-1],
        )
    return fits


def innovation_share(coefficients: FloatArray) -> float:
    """Variance of the innovations over the variance of the process."""
    rho = autocorrelation(coefficients, coefficients.size + 1)
    return float(1.0 - coefficients @ rho[1:])


def autocorrelation(coefficients: FloatArray, lags: int) -> FloatArray:
    """ρ(0) … ρ(lags − 1) of an AR process by the Yule-Walker equations."""
    from scipy.signal import lfilter, lfiltic

    p = coefficients.size
    rho = np.zeros(max(lags, p + 1))
    rho[0] = 1.0
    if p:
        matrix = np.eye(p)
        rhs = np.zeros(p)
        for i in range(1, p + 1):
            for k in range(1, p + 1):
                if i == k:
                    rhs[i - 1] += coefficients[k - 1]
                else:
                    matrix[i - 1, abs(i - k) - 1] -= coefficients[k - 1]
        rho[1 : p + 1] = np.linalg.solve(matrix, rhs)
        if rho.size > p + 1:
            polynomial = np.r_[1.0, -coefficients]
            state = lfiltic([1.0], polynomial, rho[p:0:-1])
            rho[p + 1 :] = lfilter([1.0], polynomial, np.zeros(rho.size - p - 1), zi=state)[0]
    return rho[:lags]
