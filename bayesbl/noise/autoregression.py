"""Autoregressive processes x_t = Σ φ_k x_{t−k} + ε_t: estimated, their order chosen, whitened."""

from __future__ import annotations

import math

import numpy as np
from scipy import fft

from bayesbl.compiled import compiled
from bayesbl.recording.types import FloatArray

FEWEST_DIFFERENCES = 200
"""Samples from which noise is estimated."""

Fits = list[tuple[float, FloatArray]]
"""For the orders 0, 1, 2 …: variance of the innovations ε, and φ_1 … φ_p of shape (p,)."""


def burg(x: FloatArray, highest: int) -> Fits:
    """Fits of every order up to ``highest`` to a series of shape (n,) (Burg 1975).

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


def levinson(autocovariance: FloatArray, highest: int) -> Fits:
    """Fits of every order up to ``highest`` to γ(0), γ(1) … (Levinson and Durbin's recursion).

    They end before the order at which nothing is left to explain.
    """
    variance = max(float(autocovariance[0]), 1e-300)
    phi = np.zeros(0)
    fits = [(variance, phi)]
    for order in range(1, highest + 1):
        past = autocovariance[order - 1 : 0 : -1]
        reflection = (autocovariance[order] - phi @ past) / variance
        phi = np.concatenate((phi - reflection * phi[::-1], [reflection]))
        variance *= 1.0 - reflection**2
        if not variance > 0.0:
            break
        fits.append((variance, phi))
    return fits


def log_variances(fits: Fits) -> FloatArray:
    """ln of the innovations' variance for every order, shape (orders,)."""
    return np.asarray(np.log(np.maximum([variance for variance, _ in fits], 1e-300)))


def bic(log_variance: FloatArray, count: int, parameters: int = 1) -> FloatArray:
    """Bayesian information criterion of the orders 0, 1, 2 …, shape (orders,).

    Parameters
    ----------
    log_variance
        Of the innovations; of several channels the logarithm of their covariance's determinant.
    count
        Samples behind the fits.
    parameters
        That one order more has: the square of the number of channels.
    """
    orders = np.arange(log_variance.size)
    return np.asarray(count * log_variance + orders * parameters * math.log(count))


def innovations(series: FloatArray, coefficients: FloatArray) -> FloatArray:
    """x_t − Σ φ_k x_{t−k}, shape (n − p,)."""
    return np.convolve(series, np.r_[1.0, -coefficients], "valid")


def innovation_share(coefficients: FloatArray) -> float:
    """Variance of the innovations over the variance of the process."""
    rho = autocorrelation(coefficients, coefficients.size + 1)
    return float(1.0 - coefficients @ rho[1:])


def autocorrelation(
    coefficients: FloatArray, lags: int, differentiated: bool = False
) -> FloatArray:
    """ρ(0) … ρ(lags − 1) of a process, or of its change from sample to sample."""
    if not differentiated:
        return _yule_walker(coefficients, lags)
    rho = _yule_walker(coefficients, lags + 1)
    change = 2.0 * rho[:-1] - rho[1:] - np.r_[rho[1], rho[: lags - 1]]
    return np.asarray(change / change[0])


def correlated(
    coefficients: FloatArray, columns: FloatArray, differentiated: bool = False
) -> FloatArray:
    """R X for X of shape (n, p) or (n,), R the Toeplitz matrix of :func:`autocorrelation`.

    As part of a circulant matrix of a size whose Fourier transform is fast.
    """
    n = len(columns)
    rho = autocorrelation(coefficients, n, differentiated)
    size = fft.next_fast_len(2 * n - 1, real=True)
    around = np.concatenate((rho, np.zeros(size - 2 * n + 1), rho[:0:-1]))
    spectrum = fft.rfft(around).reshape(-1, *(1,) * (columns.ndim - 1))
    product = fft.irfft(spectrum * fft.rfft(columns, size, axis=0), size, axis=0)
    return np.asarray(product[:n])


def _yule_walker(coefficients: FloatArray, lags: int) -> FloatArray:
    """ρ(0) … ρ(lags − 1) by the Yule-Walker equations, and by recursion beyond the order."""
    p = coefficients.size
    rho = np.zeros(max(lags, p + 1))
    rho[0] = 1.0
    if p:
        # ρ_k = Σ φ_j ρ_|k−j| for k = 1 … p, with ρ_0 = 1
        matrix, right = np.eye(p), np.zeros(p)
        for k in range(1, p + 1):
            for j, phi in enumerate(coefficients, start=1):
                if j == k:
                    right[k - 1] += phi
                else:
                    matrix[k - 1, abs(k - j) - 1] -= phi
        rho[1 : p + 1] = np.linalg.solve(matrix, right)
    if 0 < p < rho.size - 1:
        rho[p + 1 :] = recursion(coefficients, np.zeros(rho.size - p - 1), rho[p:0:-1])
    return rho[:lags]


@compiled(nogil=True)
def recursion(coefficients, drive, past):  # type: ignore[no-untyped-def]
    """x_t = Σ φ_k x_{t−k} + drive_t, shape (n,), in the unit of ``drive``.

    ``coefficients``: φ, shape (p,); ``drive``: shape (n,); ``past``: x of the p samples before the
    first, the last one first, shape (p,). ``scipy.signal`` has this too, at half a second for its
    import.
    """
    p = coefficients.size
    x = np.empty(p + drive.size)
    for k in range(p):
        x[p - 1 - k] = past[k]
    for t in range(p, x.size):
        value = drive[t - p]
        for k in range(p):
            value += coefficients[k] * x[t - 1 - k]
        x[t] = value
    return x[p:]
