"""The point estimate of one recording: optimum, noise, and the covariance of the optimum.

The optimum is least squares whatever the noise. Its covariance is therefore not the inverse
curvature but V = H⁻¹ JᵀΣJ H⁻¹, with noise covariance Σ, J = ∂h/∂θ, and H half the second derivative
of the sum of squares (White 1982). The waveform is not exact, so the residual is not small and H is
JᵀJ − Σ r ∂²h. With JᵀJ alone, the width of A comes out 4 to 20 % too small on bench recordings,
that of ω 25 to 40 %. If impacts scatter by more than that noise, V is larger accordingly
(:mod:`bayesbl.noise.impact_scatter`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from bayesbl.errors import RecordingError
from bayesbl.noise.impact_scatter import SHAKING, Scatter, early_and_late, normal_sample
from bayesbl.noise.outside_lines import OutsideLine
from bayesbl.noise.rotation_noise import Noise
from bayesbl.recording.types import BoolArray, FloatArray, Recording
from bayesbl.ringing.cleaning import MotorLine
from bayesbl.ringing.objective import Objective
from bayesbl.ringing.optimum import Optimum
from bayesbl.ringing.symbols import (
    AMPLITUDE,
    DECAY,
    FREQUENCY,
    ROTATION,
    START,
    WINDOW_END,
    WINDOW_START,
    DisturbanceModel,
)
from bayesbl.ringing.waveform import impacts, jacobian, jacobian_columns, misfit_curvature
from bayesbl.sampling.convergence import Contender

SAFE_SHARE = 0.2
"""Least ratio of the smallest eigenvalues of H and JᵀJ; below it, JᵀJ replaces H."""


@dataclass(frozen=True, slots=True)
class Covariance:
    """Covariance of the optimum, columns named as by :func:`jacobian_columns` (A first).

    Attributes
    ----------
    names
        The p free symbols and baseline coefficients.
    sandwich
        V, shape (p, p).
    inverse_curvature
        H⁻¹, shape (p, p), without any noise variance.
    factors
        Equally likely factors of V, mean 1, shape (k,). They scatter because the variance between
        impacts is estimated from few of them.
    losses
        Share of A lost because impacts come early or late, one for each factor, shape (k,).
    impact_sd_rpm
        Standard deviation of the amplitude between impacts, beyond noise, shape (k,).
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
        """Standard deviations by name, in the symbols' own units."""
        return dict(zip(self.names, np.sqrt(np.diag(self.sandwich)).tolist(), strict=True))

    @property
    def calibration(self) -> FloatArray:
        """Lower triangular C that turns scatter κH⁻¹ into V, shape (p, p).

        Draws from exp(−SSE / 2κ) have the right width for A but not for the other symbols. C, from
        Cholesky factors with A first, corrects those and leaves A as it is (the open-faced sandwich
        of Shaby 2014).
        """
        source = np.linalg.cholesky(self.scale * self.inverse_curvature)
        return np.asarray(np.linalg.cholesky(self.sandwich) @ np.linalg.inv(source))


def covariance(
    optimum: Optimum, time_s: FloatArray, residual_rpm: FloatArray, noise: Noise
) -> Covariance:
    """Sandwich covariance of an optimum under autoregressive noise.

    If the residual makes H indefinite (pulses hardly above the noise), JᵀJ replaces it.

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
    # Keep excluded samples at zero weight, so that lags stay right.
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
    residual = np.where(left_out, 0.0, residual_rpm)
    residual_curvature = misfit_curvature(optimum.model, time_s, optimum.symbols, residual)
    inverse = _inverse_curvature(gram, residual_curvature / np.outer(norms, norms))
    sandwich = inverse @ (columns.T @ noise.covariance_times(columns)) @ inverse
    signs, inside = _samples_of_impacts(optimum, time_s)

    def scores(weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Scores of the impacts, (g,), for a weight per sample, and their noise covariance."""
        weighted = weights * inside
        projected = weighted - columns @ (inverse @ (columns.T @ weighted))
        return weighted.T @ residual, projected.T @ noise.covariance_times(projected)

    scatter = Scatter.of(*scores(columns @ inverse[:, :1]), signs)
    factors = scatter.likely()
    impact_sd_rpm = np.sqrt(signs.size * sandwich[0, 0] * (factors - 1.0)) / norms[0]
    losses = np.zeros(factors.size)
    if START in names and signs.size:
        start_derivative = columns[:, [names.index(START)]]
        power = norms[names.index(START)] * (start_derivative**2 * inside).sum(axis=0)
        delay_scores = scores(start_derivative / np.where(power > 0.0, power, np.inf))
        # Averaging waves with time shifts s loses ω²s²/2 of the amplitude.
        losses = early_and_late(*delay_scores, signs, factors)
        losses *= 0.5 * optimum.symbols[FREQUENCY] ** 2
    sandwich = factors.mean() * sandwich
    if noise.hidden_sd_rpm:
        turn = optimum.symbols[ROTATION] * (time_s.size - 1) / (time_s[-1] - time_s[0])
        sandwich += inverse @ _repeating_rounding_scatter(columns, round(turn), noise) @ inverse
    rescale = 1.0 / np.outer(norms, norms)
    return Covariance(
        names,
        _symmetric(sandwich) * rescale,
        _symmetric(inverse) * rescale,
        factors / factors.mean(),
        losses,
        impact_sd_rpm,
    )


def _samples_of_impacts(optimum: Optimum, time_s: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Signs of the complete impacts of a recording, (g,), and the samples of each, (n, g)."""
    symbols = optimum.symbols
    period_s = float(time_s[-1] - time_s[0]) / (time_s.size - 1)
    reach = symbols[WINDOW_END] - symbols[WINDOW_START] + period_s
    complete = [
        (sign, start)
        for sign, start, _ in impacts(symbols, time_s[0], time_s[-1], period_s)
        if time_s[0] <= start - period_s and start + reach <= time_s[-1]
    ]
    signs, starts = np.array(complete).reshape(-1, 2).T
    since = time_s[:, None] - starts
    return signs, (since >= -period_s) & (since <= reach)


def _repeating_rounding_scatter(columns: FloatArray, lag: int, noise: Noise) -> FloatArray:
    """JᵀΣJ of rounding that repeats every rotation: white, or the change of white rounding."""
    variance = noise.hidden_sd_rpm**2
    if noise.differentiated:
        columns = np.diff(np.pad(columns, ((1, 1), (0, 0))), axis=0)
        variance *= 0.5
    rows = -(-len(columns) // lag) * lag
    folded = np.pad(columns, ((0, rows - len(columns)), (0, 0)))
    folded = folded.reshape(-1, lag, columns.shape[1]).sum(axis=0)
    return np.asarray(variance * folded.T @ folded)


def _inverse_curvature(gram: FloatArray, residual_curvature: FloatArray) -> FloatArray:
    """(JᵀJ − r ∂²h)⁻¹ if that is safely positive definite, else (JᵀJ)⁻¹."""
    smallest = np.linalg.eigvalsh(gram - residual_curvature)[0]
    safe = smallest > SAFE_SHARE * np.linalg.eigvalsh(gram)[0]
    factor = cho_factor(gram - residual_curvature if safe else gram)
    return np.asarray(cho_solve(factor, np.eye(len(gram))))


def _symmetric(matrix: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (matrix + matrix.T))


LEAST_LEFT = 0.05
"""Least share of A that shaking may leave."""


@dataclass(frozen=True)  # no slots, because of the cached properties
class PointEstimate:
    """Optimum, noise and covariance of one recording: everything but the sampling.

    Attributes
    ----------
    recording
        The recording as it was fitted.
    notes
        What the reader should know about how the optimum was found.
    start
        A sentence on the start of the search; empty for the full search alone.
    contenders
        Other optima weighted against this one; ``None`` to weight them by their likelihood alone.
    mended
        Whether it differs from the given one (lines or drift removed).
    lines
        Lines of the motor that were removed.
    shaking
        Lines at fixed frequencies that were removed.
    """

    optimum: Optimum
    noise: Noise
    spread: Covariance
    recording: Recording
    notes: tuple[str, ...] = ()
    start: str = ""
    contenders: tuple[Contender, ...] | None = None
    mended: bool = False
    lines: tuple[MotorLine, ...] = ()
    shaking: tuple[OutsideLine, ...] = ()

    @cached_property
    def objective(self) -> Objective:
        """Sum of squares between the recording and the optimum's model."""
        return objective_of(self.optimum.model, self.recording)

    @cached_property
    def residual_rpm(self) -> FloatArray:
        """Recording minus optimum, shape (n,), rpm; NaN at samples left out."""
        return residual_of(self.objective, self.optimum)

    def shaken(self, outside_lines: tuple[OutsideLine, ...]) -> PointEstimate:
        """Allow for removed outside lines: A may be wrong by their RMS in the speed."""
        if not outside_lines:
            return self
        rms_rpm = math.sqrt(0.5 * sum(line.size_rpm**2 for line in outside_lines))
        relative_rms = rms_rpm / self.optimum.symbols[AMPLITUDE]
        losses = self.spread.losses
        amplitude_errors = relative_rms * normal_sample(losses.size, SHAKING)
        losses = np.maximum(losses + amplitude_errors, LEAST_LEFT - 1.0)
        return replace(self, spread=replace(self.spread, losses=losses), shaking=outside_lines)

    @property
    def signal_to_noise(self) -> float:
        """A / √V_AA: distance of the amplitude from zero in standard deviations."""
        return float(self.optimum.symbols[AMPLITUDE] / math.sqrt(self.spread.sandwich[0, 0]))

    @property
    def misfit(self) -> RepeatingMisfit:
        """The part of the residual that repeats every load rotation."""
        return repeating_misfit(
            self.objective.time_s, self.residual_rpm, self.optimum.symbols[ROTATION]
        )

    @property
    def ringing(self) -> tuple[FloatArray, FloatArray]:
        """Optimum of (A, ln ω, ln τ), shape (3,), and its covariance, shape (3, 3).

        A is corrected for the loss by early and late impacts. A fixed frequency or decay has zero
        variance.
        """
        symbols, spread = self.optimum.symbols, self.spread
        values = (symbols[AMPLITUDE], symbols[FREQUENCY], symbols[DECAY])
        centre = np.array([values[0], np.log(values[1]), np.log(values[2])])
        scale = np.array([1.0, 1.0 / values[1], 1.0 / values[2]])
        covariance = np.zeros((3, 3))
        names = (AMPLITUDE, FREQUENCY, DECAY)
        kept = [i for i, name in enumerate(names) if name in spread.names]
        columns = [spread.names.index(names[i]) for i in kept]
        covariance[np.ix_(kept, kept)] = spread.sandwich[np.ix_(columns, columns)]
        covariance *= np.outer(scale, scale)
        covariance[0, 0] += float(np.var(centre[0] * spread.losses))
        centre[0] *= 1.0 + float(spread.losses.mean())
        return centre, covariance


def objective_of(model: DisturbanceModel, recording: Recording) -> Objective:
    """Sum of squares between a recording and a model, excluded samples left out."""
    return Objective(
        model, recording.time_s, recording.motor_speed_rpm, excluded=recording.excluded
    )


def residual_of(objective: Objective, optimum: Optimum) -> FloatArray:
    """Recording minus optimum, shape (n,), rpm; NaN at samples left out."""
    residual = objective.speed_rpm - optimum.predict(objective.time_s)
    return np.where(objective.used, residual, np.nan)


PHASE_BINS = 360


@dataclass(frozen=True, slots=True)
class RepeatingMisfit:
    """Rotation-averaged residual.

    Attributes
    ----------
    phase_rad
        Load phase from the start of the recording, bin centres, shape (b,), in [0, 2π).
    mean_rpm, standard_error_rpm
        Average of the residual over rotations and its standard error from their scatter,
        shape (b,), rpm.
    """

    phase_rad: FloatArray
    mean_rpm: FloatArray
    standard_error_rpm: FloatArray

    @property
    def rms_rpm(self) -> float:
        """RMS of the repeating part, without the noise that survives averaging, rpm."""
        excess = float(np.mean(self.mean_rpm**2 - self.standard_error_rpm**2))
        return math.sqrt(max(excess, 0.0))

    def at(
        self, since_begin_s: FloatArray, rotation_period_s: float
    ) -> tuple[FloatArray, FloatArray]:
        """Average and standard error at times since the recording's start, shape (n,) each, rpm."""
        phase = 2.0 * np.pi / rotation_period_s * since_begin_s
        full_turn = 2.0 * np.pi
        mean = np.interp(phase, self.phase_rad, self.mean_rpm, period=full_turn)
        return mean, np.interp(phase, self.phase_rad, self.standard_error_rpm, period=full_turn)


def repeating_misfit(
    time_s: FloatArray, residual_rpm: FloatArray, rotation_period_s: float
) -> RepeatingMisfit:
    """Average the residual (NaN where left out) at equal load phase over the rotations.

    Each bin is averaged within a rotation first. The standard error comes from the scatter between
    rotations, which are independent but for noise slower than a rotation.
    """
    known = np.isfinite(residual_rpm)
    elapsed_rotations = (time_s[known] - time_s[0]) / rotation_period_s
    residual_rpm = residual_rpm[known]
    rotation = np.floor(elapsed_rotations).astype(int)
    bins = np.minimum((PHASE_BINS * (elapsed_rotations - rotation)).astype(int), PHASE_BINS - 1)
    cell = rotation * PHASE_BINS + bins
    cells = (rotation[-1] + 1) * PHASE_BINS
    count = np.bincount(cell, minlength=cells).reshape(-1, PHASE_BINS)
    total = np.bincount(cell, residual_rpm, minlength=cells).reshape(-1, PHASE_BINS)
    filled = count > 0
    mean_by_rotation = np.where(filled, total / np.maximum(count, 1), np.nan)
    rotations = filled.sum(axis=0)
    mean = np.nansum(mean_by_rotation, axis=0) / np.maximum(rotations, 1)
    scatter = np.nansum((mean_by_rotation - mean) ** 2, axis=0)
    error = np.sqrt(scatter / np.maximum(rotations - 1, 1) / np.maximum(rotations, 1))
    phase = 2.0 * np.pi * (np.arange(PHASE_BINS) + 0.5) / PHASE_BINS
    return RepeatingMisfit(phase, mean, error)
