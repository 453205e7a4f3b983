"""The noise of a recording, from what does not repeat from one load rotation to the next.

The disturbance model leaves a misfit that repeats every rotation and is almost perfectly
autocorrelated. A noise model learned from the residuals themselves takes that misfit for noise.
In the difference between the residual and the residual one rotation later the misfit cancels; the
rest has the noise's autocorrelation and twice its variance.

The scale is the root mean square whatever the tails of the noise: with outliers, too, the realised
variance decides how far a least-squares optimum was moved.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayesbl.errors import RecordingError
from bayesbl.noise.autoregression import (
    FEWEST_DIFFERENCES,
    bic,
    burg,
    correlated,
    innovations,
    log_variances,
)
from bayesbl.noise.quantisation import SpeedSteps
from bayesbl.noise.tails import tails
from bayesbl.recording.types import FloatArray

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
        Bayesian information criterion of the orders 0 … 15, less the smallest, shape (16,): the
        evidence for the order.
    differences
        Number of rotation differences behind the estimate.
    chosen
        Whether the order was chosen by BIC or given by the user.
    degrees_of_freedom
        Of Student-t innovations; ``None`` for normal ones.
    student_t_evidence
        Gain in log likelihood of Student-t over normal innovations, less ½ ln n.
    differentiated
        x is the change from sample to sample of an autoregressive process, to which φ belongs.
    hidden_sd_rpm
        Standard deviation of the rounding of a quantised speed that repeats every rotation, and
        is therefore not in ``sd_rpm``.
    """

    sd_rpm: float
    coefficients: FloatArray
    bic: FloatArray
    differences: int
    chosen: bool
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
        """Σ X for X of shape (n, p), Σ the noise's covariance without what repeats, rpm²."""
        if not self.order and not self.differentiated:
            return self.sd_rpm**2 * columns
        return self.sd_rpm**2 * correlated(self.coefficients, columns, self.differentiated)


def rotation_difference(
    residual_rpm: FloatArray, rotation_period_s: float, sampling_period_s: float
) -> FloatArray:
    """Residual one load rotation later minus the residual, shape about (n − T_w/Δt,), rpm.

    NaN where either is missing. A rotation is seldom a whole number of samples; the fraction is a
    shift in the frequency domain, which preserves the autocorrelation of the noise.
    """
    n, turn = residual_rpm.size, rotation_period_s / sampling_period_s
    lag = max(1, math.floor(turn))
    phase = 2.0j * np.pi * (turn - lag) * np.fft.rfftfreq(n)
    later = np.fft.irfft(np.fft.rfft(bridged(residual_rpm)) * np.exp(phase), n)
    nearest = max(1, round(turn)) - lag
    later[np.isnan(np.roll(residual_rpm, -nearest))] = np.nan
    return np.asarray(later[lag : n - WRAPPED] - residual_rpm[: max(0, n - WRAPPED - lag)])


def bridged(residual_rpm: FloatArray) -> FloatArray:
    """The residual with straight lines where samples are missing (NaN), shape (n,), rpm."""
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
    """Noise order, coefficients and scale from what does not repeat.

    See docs/design.md, "Statistics".

    Parameters
    ----------
    residual_rpm
        Recording minus its RMSE optimum on an even grid, shape (n,), NaN at samples left out.
    kind, order
        ``auto`` chooses an AR order from 0 to 15 by BIC, and normal or Student-t innovations;
        ``white`` is order 0; ``ar`` takes ``order``, or the best order above 0 where it is not
        given; ``student_t`` chooses the order, and innovations are Student-t.
    steps
        Steps of a quantised speed.

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
    variance = float(np.nansum(d**2)) / (2.0 * count)
    # Rounding that repeats is missing from d; if d has the variance of all rounding, none repeats.
    hidden = 0.0 if steps is None else max(0.0, steps.sd_rpm**2 - variance)
    coarse = steps is not None and variance < steps.size_rpm**2
    differentiated = coarse and steps is not None and steps.differentiated
    series = _summed(d) if differentiated else d
    fits = burg(series, HIGHEST_ORDER)
    evidence = bic(log_variances(fits), count)
    evidence -= evidence.min()
    if kind == "white":
        best = 0
    elif kind == "ar":
        best = order if order is not None else 1 + int(np.argmin(evidence[1:]))
        if best > HIGHEST_ORDER:
            fits = burg(series, best)
    else:
        best = int(np.argmin(evidence))
    coefficients = fits[best][1]
    e = innovations(series, coefficients)
    found = tails(e[np.isfinite(e)])
    # Coarse rounding has a shape of its own, which neither kind of innovation has.
    heavy = kind == "student_t" or (kind == "auto" and found.evidence > 0.0 and not coarse)
    return Noise(
        math.sqrt(variance),
        coefficients,
        evidence,
        count,
        kind == "auto",
        found.degrees_of_freedom if heavy else None,
        found.evidence,
        differentiated,
        math.sqrt(hidden),
    )


def _summed(d: FloatArray) -> FloatArray:
    """Running sum about the mean; NaN where d is."""
    centred = d - np.nanmean(d)
    return np.asarray(np.cumsum(np.nan_to_num(centred)) + 0.0 * centred)
