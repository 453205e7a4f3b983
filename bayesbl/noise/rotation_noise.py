"""The noise of a recording, from differences between load rotations.

The disturbance model leaves a misfit that repeats every rotation and is almost perfectly
autocorrelated. A noise model learned from the residuals themselves would take that misfit for
noise. In the difference between the residual and the residual one rotation later, the misfit
cancels. The difference has the noise's autocorrelation and twice its variance.

The scale is the root mean square for any tails of the noise: with outliers, too, the realised
variance determines how far a least-squares optimum was moved.

The noise is an autoregressive process x_t = Σ φ_k x_{t−k} + ε_t of chosen order. Its innovations
are normal, or Student-t if there are outliers. Only differences of two innovations, one rotation
apart, are observed. The difference of two Student-t variables is not Student-t, so its density is
computed by integration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from scipy import fft
from scipy.special import gammaln

from bayesbl.compiled import compiled
from bayesbl.errors import RecordingError
from bayesbl.noise.quantisation import SpeedSteps
from bayesbl.recording.types import FloatArray

FEWEST_DIFFERENCES = 200
"""Fewest samples from which noise is estimated."""


def require_differences(count: int, found: str) -> None:
    """Raise a RecordingError if these are too few samples with a counterpart a rotation later."""
    if count < FEWEST_DIFFERENCES:
        raise RecordingError(
            "The recording is too short to tell noise from what repeats every load rotation.",
            found=found,
            expected=f"at least {FEWEST_DIFFERENCES}; record two rotations or more",
        )


def burg(x: FloatArray, highest: int) -> tuple[FloatArray, list[FloatArray]]:
    """Fit every order up to ``highest`` to a series of shape (n,) (Burg 1975).

    Returns ln variance of the innovations ε, (orders,), and φ_1 … φ_p of each order, (p,).
    NaN in ``x`` spreads to the predictions that need it, and these are left out.
    """
    forward, backward = x[1:], x[:-1]
    variances, coefficients = [float(np.nanmean(x**2))], [np.zeros(0)]
    for _ in range(highest):
        product = forward * backward
        known = np.isfinite(product)
        power = float(np.sum(forward[known] ** 2 + backward[known] ** 2))
        reflection = 2.0 * float(product[known].sum()) / power if power > 0.0 else 0.0
        last = coefficients[-1]
        coefficients.append(np.r_[last - reflection * last[::-1], reflection])
        variances.append(variances[-1] * (1.0 - reflection**2))
        forward, backward = (
            (forward - reflection * backward)[1:],
            (backward - reflection * forward)[:-1],
        )
    return np.log(np.maximum(variances, 1e-300)), coefficients


def bic(log_variance: FloatArray, count: int, parameters: int = 1) -> FloatArray:
    """Bayesian information criterion of the orders 0, 1, 2 …, shape (orders,).

    Parameters
    ----------
    log_variance
        ln variance of the innovations; for several channels ln determinant of their covariance.
    count
        Samples behind the fits.
    parameters
        Additional parameters per order: the square of the number of channels.
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
    """ρ(0) … ρ(lags − 1) of a process, or of its change from sample to sample.

    By the Yule-Walker equations ρ_k = Σ φ_j ρ_|k−j|, ρ_0 = 1, and by recursion beyond the order.
    """
    if differentiated:
        rho = autocorrelation(coefficients, lags + 1)
        change = 2.0 * rho[:-1] - rho[1:] - np.r_[rho[1], rho[: lags - 1]]
        return np.asarray(change / change[0])
    p = coefficients.size
    matrix, k = np.eye(p + 1), np.arange(1, p + 1)
    for j, phi in enumerate(coefficients, start=1):
        matrix[k, np.abs(k - j)] -= phi
    rho = np.linalg.solve(matrix, np.eye(p + 1)[0])
    beyond = recursion(coefficients, np.zeros(max(0, lags - p - 1)), rho[:0:-1])
    return np.concatenate((rho, beyond))[:lags]


def correlated(
    coefficients: FloatArray, columns: FloatArray, differentiated: bool = False
) -> FloatArray:
    """R X for X of shape (n, p) or (n,), with R the Toeplitz matrix of :func:`autocorrelation`.

    R is embedded in a circulant matrix whose size suits the fast Fourier transform.
    """
    n = len(columns)
    rho = autocorrelation(coefficients, n, differentiated)
    size = fft.next_fast_len(2 * n - 1, real=True)
    circulant = np.concatenate((rho, np.zeros(size - 2 * n + 1), rho[:0:-1]))
    spectrum = fft.rfft(circulant).reshape(-1, *(1,) * (columns.ndim - 1))
    product = fft.irfft(spectrum * fft.rfft(columns, size, axis=0), size, axis=0)
    return np.asarray(product[:n])


@compiled(nogil=True)
def recursion(coefficients, drive, past):  # type: ignore[no-untyped-def]
    """x_t = Σ φ_k x_{t−k} + drive_t, shape (n,), in the unit of ``drive``.

    ``coefficients``: φ, shape (p,); ``drive``: shape (n,); ``past``: the p samples before the
    first, the latest first, shape (p,). ``scipy.signal`` has this too, but its import takes half a
    second.
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


FREEDOMS = (2.1, 2.3, 2.6, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0, 10.0, 15.0, 20.0, 30.0)
"""Candidate degrees of freedom."""

_BINS = 2000
_LARGEST = 1e6
"""Largest tabulated difference, in scales of the Student-t variable."""


def tails(differences: FloatArray) -> tuple[float, float]:
    """Compare Student-t and normal noise, from differences of two innovations each, shape (n,).

    The likelihood is a composite one: an innovation may be in two differences.

    Returns
    -------
    The most likely of :data:`FREEDOMS`; and the gain in log likelihood over normal innovations,
    minus ½ ln n for the extra parameter: half the difference in BIC, positive if Student-t is the
    better description.
    """
    n = differences.size
    size = np.abs(differences)
    median = float(np.median(size))
    if median == 0.0:
        return FREEDOMS[-1], -math.inf
    edges = np.sinh(np.linspace(0.0, np.arcsinh(float(size.max()) / median), _BINS + 1))
    count = np.histogram(size / median, edges)[0].astype(float)
    # The last bin ends at the largest value, which rounding may put just outside.
    count[-1] += n - count.sum()
    x, count = 0.5 * (edges[1:] + edges[:-1])[count > 0], count[count > 0]
    variance = float(count @ x**2) / n
    normal = -0.5 * n * (np.log(2.0 * np.pi * variance) + 1.0)
    likelihoods = [_log_likelihood(x, count, freedom) for freedom in FREEDOMS]
    best = int(np.argmax(likelihoods))
    gain = likelihoods[best] - normal - 0.5 * np.log(n)
    return FREEDOMS[best], float(gain)


def _log_likelihood(x: FloatArray, count: FloatArray, freedom: float) -> float:
    """Log likelihood of |differences| x, each ``count`` times, at the best scale."""
    from scipy.optimize import minimize_scalar

    log_z, log_density = _difference_density(freedom)

    def cost(log_scale: float) -> float:
        value = np.interp(np.arcsinh(x / np.exp(log_scale)), log_z, log_density)
        return float(count @ (log_scale - value))

    optimum = minimize_scalar(cost, bounds=(-5.0, 3.0), method="bounded", options={"xatol": 1e-4})
    return -float(optimum.fun)


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
    density = np.exp(log_t(x, freedom) + log_t(2.0 * half[:, None] - x, freedom))
    total = 2.0 * (density / np.cos(angle) ** 2) @ weight * width
    return log_z, np.log(total)


def log_t(x: FloatArray, freedom: float) -> FloatArray:
    """ln density of Student's t."""
    constant = gammaln(0.5 * (freedom + 1.0)) - gammaln(0.5 * freedom)
    return np.asarray(
        constant - 0.5 * np.log(freedom * np.pi) - 0.5 * (freedom + 1.0) * np.log1p(x**2 / freedom)
    )


def log_normal(x: FloatArray) -> FloatArray:
    """ln density of the standard normal distribution."""
    return np.asarray(-0.5 * x**2 - 0.5 * math.log(2.0 * math.pi))


NoiseKind = Literal["auto", "white", "ar", "student_t"]

HIGHEST_ORDER = 15
WRAPPED = 20
"""Samples at the end of a shifted residual that its start has leaked into."""


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
        Bayesian information criterion of the orders 0 … 15, minus the smallest, shape (16,): the
        evidence for the order.
    differences
        Number of rotation differences behind the estimate.
    degrees_of_freedom
        Degrees of freedom of Student-t innovations; ``None`` for normal ones.
    student_t_evidence
        Gain in log likelihood of Student-t over normal innovations, minus ½ ln n.
    differentiated
        Whether the noise is the change from sample to sample of an autoregressive process, to which
        φ belongs.
    hidden_sd_rpm
        Standard deviation of the rounding of a quantised speed that repeats every rotation and is
        therefore not in ``sd_rpm``.
    """

    sd_rpm: float
    coefficients: FloatArray
    bic: FloatArray
    differences: int
    degrees_of_freedom: float | None = None
    student_t_evidence: float = -math.inf
    differentiated: bool = False
    hidden_sd_rpm: float = 0.0

    @property
    def order(self) -> int:
        """p, 0 for white noise."""
        return int(self.coefficients.size)

    @property
    def kind(self) -> str:
        """``white``, ``ar`` or ``student_t``, which may be autoregressive too."""
        if self.degrees_of_freedom is not None:
            return "student_t"
        return "ar" if self.order or self.differentiated else "white"

    @property
    def rounding_repeats(self) -> bool:
        """Whether much of the noise is rounding that is the same in every rotation."""
        return self.hidden_sd_rpm > 0.5 * self.sd_rpm

    def covariance_times(self, columns: FloatArray) -> FloatArray:
        """Σ X for X of shape (n, p), rpm², with noise covariance Σ excluding repeating rounding."""
        if not self.order and not self.differentiated:
            return self.sd_rpm**2 * columns
        return self.sd_rpm**2 * correlated(self.coefficients, columns, self.differentiated)


def rotation_difference(
    residual_rpm: FloatArray, rotation_period_s: float, sampling_period_s: float
) -> FloatArray:
    """Residual one load rotation later minus the residual, shape about (n − T_w/Δt,), rpm.

    NaN where either is missing. A rotation is seldom a whole number of samples. The fraction is a
    shift in the frequency domain, which preserves the autocorrelation of the noise.
    """
    n, rotation_samples = residual_rpm.size, rotation_period_s / sampling_period_s
    lag = max(1, math.floor(rotation_samples))
    phase = 2.0j * np.pi * (rotation_samples - lag) * np.fft.rfftfreq(n)
    shifted = np.fft.irfft(np.fft.rfft(bridged(residual_rpm)) * np.exp(phase), n)
    nearest = max(1, round(rotation_samples)) - lag
    shifted[np.isnan(np.roll(residual_rpm, -nearest))] = np.nan
    return np.asarray(shifted[lag : n - WRAPPED] - residual_rpm[: max(0, n - WRAPPED - lag)])


def bridged(residual_rpm: FloatArray) -> FloatArray:
    """The residual, interpolated linearly where samples are missing (NaN), shape (n,), rpm."""
    missing = np.isnan(residual_rpm)
    if not missing.any():
        return residual_rpm
    at = np.arange(residual_rpm.size)
    return np.interp(at, at[~missing], residual_rpm[~missing])


def estimate_noise(
    residual_rpm: FloatArray,
    rotation_period_s: float,
    sampling_period_s: float,
    kind: NoiseKind = "auto",
    order: int | None = None,
    steps: SpeedSteps | None = None,
) -> Noise:
    """Estimate noise order, coefficients and scale from rotation differences.

    See docs/design.md, "Statistics".

    Parameters
    ----------
    residual_rpm
        Recording minus its RMSE optimum on an even grid, shape (n,), NaN at samples left out.
    kind, order
        ``auto`` chooses an AR order from 0 to 15 by BIC, and normal or Student-t innovations;
        ``white`` is order 0; ``ar`` takes ``order``, or the best order above 0 if none is given;
        ``student_t`` chooses the order and takes Student-t innovations.
    steps
        Steps of a quantised speed.

    Raises
    ------
    RecordingError
        If too little of the recording has a counterpart one rotation later.
    """
    d = rotation_difference(residual_rpm, rotation_period_s, sampling_period_s)
    count = int(np.isfinite(d).sum())
    require_differences(
        count, f"{count} samples with a counterpart one rotation ({rotation_period_s:.3g} s) later"
    )
    variance = float(np.nansum(d**2)) / (2.0 * count)
    # If differences show the variance of all rounding, none repeats in every rotation.
    hidden = 0.0 if steps is None else max(steps.sd_rpm**2 - variance, 0.0)
    coarse = steps is not None and variance < steps.size_rpm**2
    differentiated = coarse and steps is not None and steps.differentiated
    series = d
    if differentiated:
        centred = d - np.nanmean(d)
        series = np.cumsum(np.nan_to_num(centred)) + 0.0 * centred  # nan where d is
    log_variances, by_order = burg(series, HIGHEST_ORDER)
    evidence = bic(log_variances, count)
    evidence -= evidence.min()
    if kind == "white":
        best = 0
    elif kind == "ar":
        best = order if order is not None else 1 + int(np.argmin(evidence[1:]))
        if best > HIGHEST_ORDER:
            _, by_order = burg(series, best)
    else:
        best = int(np.argmin(evidence))
    coefficients = by_order[best]
    e = innovations(series, coefficients)
    freedom, heaviness = tails(e[np.isfinite(e)])
    # Coarse rounding has a distribution of its own, unlike both kinds of innovation.
    heavy = kind == "student_t" or (kind == "auto" and heaviness > 0.0 and not coarse)
    return Noise(
        math.sqrt(variance),
        coefficients,
        evidence,
        count,
        freedom if heavy else None,
        heaviness,
        differentiated,
        math.sqrt(hidden),
    )
