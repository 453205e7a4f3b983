"""How far the RMSE optimum scatters under the recording's noise: the sandwich covariance.

The optimum is least squares whatever the noise, so its covariance is not the inverse curvature but
V = H⁻¹ JᵀΣJ H⁻¹ with Σ the covariance of the noise, J = ∂h/∂θ and H half the second derivative of
the sum of squares (White 1982). As the waveform is not exact, the residual is not small and H is
JᵀJ − Σ r ∂²h: with JᵀJ alone the width of A comes out 4 to 20 % too small on bench recordings, that
of ω 25 to 40 %. Where impacts scatter by more than that noise, V is larger by as much
(:mod:`bayesbl.noise.impact_scatter`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from bayesbl.errors import RecordingError
from bayesbl.noise.impact_scatter import Scatter, early_and_late
from bayesbl.noise.rotation_noise import Noise
from bayesbl.recording.types import BoolArray, FloatArray
from bayesbl.ringing.optimum import Optimum
from bayesbl.ringing.symbols import FREQUENCY, ROTATION, START, WINDOW_END, WINDOW_START
from bayesbl.ringing.waveform import impacts, jacobian, jacobian_columns, misfit_curvature

FACTORS = 400
"""Likely values of the variance's factor that are kept."""

SAFE_SHARE = 0.2
"""Least eigenvalue of H, as a share of that of JᵀJ, below which JᵀJ replaces it."""


@dataclass(frozen=True, slots=True)
class Covariance:
    """Scatter of the optimum, columns named as by :func:`jacobian_columns` (A first).

    Attributes
    ----------
    names
        The p free symbols and baseline coefficients.
    sandwich
        V, shape (p, p).
    inverse_curvature
        H⁻¹, shape (p, p), before any noise variance is applied.
    factors
        Of V, mean 1, as likely each, shape (k,): how far impacts scatter is known from few.
    losses
        Share of A that impacts which come early and late take, one for each factor, shape (k,).
    impact_sd_rpm
        Standard deviation of the amplitude from impact to impact, beyond noise; the same.
    """

    names: tuple[str, ...]
    sandwich: FloatArray
    inverse_curvature: FloatArray
    factors: FloatArray = field(default_factory=lambda: np.ones(1))
    losses: FloatArray = field(default_factory=lambda: np.zeros(1))
    impact_sd_rpm: FloatArray = field(default_factory=lambda: np.zeros(1))

    @property
    def scale(self) -> float:
        """κ = V_AA / [H⁻¹]_AA in rpm²: exp(−SSE / 2κ) has the right width for A."""
        return float(self.sandwich[0, 0] / self.inverse_curvature[0, 0])

    @property
    def standard_deviations(self) -> dict[str, float]:
        """By name, in the symbol's own unit."""
        return dict(zip(self.names, np.sqrt(np.diag(self.sandwich)).tolist(), strict=True))

    @property
    def calibration(self) -> FloatArray:
        """Lower triangular C that turns scatter κH⁻¹ into V, shape (p, p).

        Draws from exp(−SSE / 2κ) have the right width for A but not for the other symbols; C,
        from Cholesky factors with A first, corrects those and leaves A as it is (the open-faced
        sandwich of Shaby 2014).
        """
        source = np.linalg.cholesky(self.scale * self.inverse_curvature)
        return np.asarray(np.linalg.cholesky(self.sandwich) @ np.linalg.inv(source))


def covariance(
    optimum: Optimum, time_s: FloatArray, residual_rpm: FloatArray, noise: Noise
) -> Covariance:
    """Sandwich covariance of an optimum under autoregressive noise.

    Where the residual makes H indefinite, as with pulses close to the noise, JᵀJ replaces it.

    Parameters
    ----------
    residual_rpm
        Recording minus optimum on an even grid, shape (n,), rpm, NaN at samples left out.

    Raises
    ------
    RecordingError
        If the recording does not determine the free symbols (singular JᵀJ).
    """
    names = jacobian_columns(optimum.model)
    columns = jacobian(optimum.model, time_s, optimum.symbols, optimum.baseline_rpm)
    # An excluded sample keeps its place, so that lags stay right, and has no weight.
    left_out = np.isnan(residual_rpm)
    columns[left_out] = 0.0
    norms = np.sqrt((columns**2).sum(axis=0))
    norms[norms == 0.0] = 1.0
    columns = columns / norms
    gram = columns.T @ columns
    if np.linalg.cond(gram) > 1e12:
        raise RecordingError(
            "The recording does not determine all free symbols of the disturbance model.",
            found="free: " + ", ".join(optimum.model.free),
            expected="more rotations, or fewer free symbols under [estimator.model]",
        )
    known = np.where(left_out, 0.0, residual_rpm)
    bent = misfit_curvature(optimum.model, time_s, optimum.symbols, known)
    inverse = _inverse_curvature(gram, bent / np.outer(norms, norms))
    sandwich = inverse @ (columns.T @ noise.covariance_times(columns)) @ inverse
    signs, inside = _by_impact(optimum, time_s)

    def scores(weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of the impacts, (g,), by a weight of each sample, and their covariance by the noise."""
        own = weights * inside
        beside_fit = own - columns @ (inverse @ (columns.T @ own))
        return own.T @ known, beside_fit.T @ noise.covariance_times(beside_fit)

    scatter = Scatter.of(*scores(columns @ inverse[:, :1]), signs)
    factors = scatter.likely(FACTORS)
    impact_sd_rpm = np.sqrt(signs.size * sandwich[0, 0] * (factors - 1.0)) / norms[0]
    losses = np.zeros(factors.size)
    if START in names and signs.size:
        later = columns[:, [names.index(START)]]
        power = norms[names.index(START)] * (later**2 * inside).sum(axis=0)
        delays = scores(later / np.where(power > 0.0, power, np.inf))
        # Waves out of step by s lose ω²s²/2.
        losses = early_and_late(*delays, signs, factors)
        losses *= 0.5 * optimum.symbols[FREQUENCY] ** 2
    sandwich = factors.mean() * sandwich
    if noise.hidden_sd_rpm:
        turn = optimum.symbols[ROTATION] * (time_s.size - 1) / (time_s[-1] - time_s[0])
        sandwich += inverse @ _of_repeating_rounding(columns, round(turn), noise) @ inverse
    rescale = 1.0 / np.outer(norms, norms)
    return Covariance(
        names,
        _symmetric(sandwich) * rescale,
        _symmetric(inverse) * rescale,
        factors / factors.mean(),
        losses,
        impact_sd_rpm,
    )


def _by_impact(optimum: Optimum, time_s: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Signs of the whole impacts of a recording, (g,), and which samples are in each, (n, g)."""
    symbols = optimum.symbols
    period_s = float(time_s[-1] - time_s[0]) / (time_s.size - 1)
    reach = symbols[WINDOW_END] - symbols[WINDOW_START] + period_s
    whole = [
        (sign, start)
        for sign, start, _ in impacts(symbols, time_s[0], time_s[-1], period_s)
        if time_s[0] <= start - period_s and start + reach <= time_s[-1]
    ]
    signs, starts = np.array(whole).reshape(-1, 2).T
    since = time_s[:, None] - starts
    return signs, (since >= -period_s) & (since <= reach)


def _of_repeating_rounding(columns: FloatArray, lag: int, noise: Noise) -> FloatArray:
    """JᵀΣJ of rounding that repeats every rotation: white, or the change of white rounding."""
    variance = noise.hidden_sd_rpm**2
    if noise.differentiated:
        columns = np.diff(np.pad(columns, ((1, 1), (0, 0))), axis=0)
        variance *= 0.5
    rows = -(-len(columns) // lag) * lag
    folded = np.pad(columns, ((0, rows - len(columns)), (0, 0)))
    folded = folded.reshape(-1, lag, columns.shape[1]).sum(axis=0)
    return np.asarray(variance * folded.T @ folded)


def _inverse_curvature(gram: FloatArray, bent: FloatArray) -> FloatArray:
    """(JᵀJ − bent)⁻¹ where that is safely positive definite, else (JᵀJ)⁻¹."""
    least = np.linalg.eigvalsh(gram - bent)[0]
    safe = least > SAFE_SHARE * np.linalg.eigvalsh(gram)[0]
    factor = cho_factor(gram - bent if safe else gram)
    return np.asarray(cho_solve(factor, np.eye(len(gram))))


def signal_to_noise(optimum: Optimum, spread: Covariance) -> float:
    """A / √V_AA: how many standard deviations the amplitude is above zero."""
    amplitude = optimum.symbols[spread.names[0]]
    return float(amplitude / math.sqrt(spread.sandwich[0, 0]))


def _symmetric(matrix: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (matrix + matrix.T))
