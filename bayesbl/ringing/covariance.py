"""The estimate of one recording: its optimum, its noise, and how far the one scatters by the other.

The optimum is least squares whatever the noise, so its covariance is not the inverse curvature but
V = H⁻¹ JᵀΣJ H⁻¹ with Σ the covariance of the noise, J = ∂h/∂θ and H half the second derivative of
the sum of squares (White 1982). As the waveform is not exact, the residual is not small and H is
JᵀJ − Σ r ∂²h: with JᵀJ alone the width of A comes out 4 to 20 % too small on bench recordings, that
of ω 25 to 40 %. Where impacts scatter by more than that noise, V is larger by as much
(:mod:`bayesbl.noise.impact_scatter`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from bayesbl.errors import RecordingError
from bayesbl.noise.impact_scatter import Scatter, early_and_late, normal_quantiles
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


def _symmetric(matrix: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (matrix + matrix.T))


LEAST_LEFT = 0.05
"""Share of A that shaking leaves at least."""


NO_RECORDING = Recording("", np.zeros(0), {})


@dataclass(frozen=True)  # without slots, for what is made of it once
class PointEstimate:
    """Optimum, noise and covariance of one recording: all but the sampling.

    Attributes
    ----------
    recording
        As it was fitted. It is not kept with a finished fit: what was read is there already.
    notes
        What the reader should know about how the optimum was found.
    start
        What the search started from, in a sentence; empty for the full search alone.
    contenders
        Other optima weighed against this one; by their likelihood alone where ``None``.
    mended
        The recording that was fitted, where it is not the one given: lines or drift were removed.
    lines
        Of the motor that were removed.
    shaking
        Lines in time that were removed.
    """

    optimum: Optimum
    noise: Noise
    spread: Covariance
    recording: Recording = field(default=NO_RECORDING, compare=False)
    notes: tuple[str, ...] = ()
    start: str = ""
    contenders: tuple[Contender, ...] | None = None
    mended: Recording | None = None
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

    def shaken(self, by: tuple[OutsideLine, ...]) -> PointEstimate:
        """Beside lines that were removed: A may be another by their RMS in the speed."""
        if not by:
            return self
        rms_rpm = math.sqrt(0.5 * sum(line.size_rpm**2 for line in by))
        size = rms_rpm / self.optimum.symbols[AMPLITUDE]
        losses = self.spread.losses
        moved = size * np.random.default_rng(0).permutation(normal_quantiles(losses.size))
        losses = np.maximum(losses + moved, LEAST_LEFT - 1.0)
        return replace(self, spread=replace(self.spread, losses=losses), shaking=by)

    @property
    def signal_to_noise(self) -> float:
        """A / √V_AA: how many standard deviations the amplitude is above zero."""
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

        With what impacts lose that come early and late given back to A.

        A fixed frequency or decay has zero variance.
        """
        symbols, spread = self.optimum.symbols, self.spread
        values = (symbols[AMPLITUDE], symbols[FREQUENCY], symbols[DECAY])
        centre = np.array([values[0], np.log(values[1]), np.log(values[2])])
        scale = np.array([1.0, 1.0 / values[1], 1.0 / values[2]])
        covariance = np.zeros((3, 3))
        names = (AMPLITUDE, FREQUENCY, DECAY)
        free = [i for i, name in enumerate(names) if name in spread.names]
        places = [spread.names.index(names[i]) for i in free]
        covariance[np.ix_(free, free)] = spread.sandwich[np.ix_(places, places)]
        covariance *= np.outer(scale, scale)
        covariance[0, 0] += float(np.var(centre[0] * spread.losses))
        centre[0] *= 1.0 + float(spread.losses.mean())
        return centre, covariance


def objective_of(model: DisturbanceModel, recording: Recording) -> Objective:
    """Sum of squares between a recording and a model, without excluded samples."""
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
        """RMS of what repeats, without the noise that survives averaging, rpm."""
        excess = float(np.mean(self.mean_rpm**2 - self.standard_error_rpm**2))
        return math.sqrt(max(excess, 0.0))

    def at(
        self, since_begin_s: FloatArray, rotation_period_s: float
    ) -> tuple[FloatArray, FloatArray]:
        """Average and standard error at times since the recording's start, shape (n,) each, rpm."""
        phase = 2.0 * np.pi / rotation_period_s * since_begin_s
        turn = 2.0 * np.pi
        mean = np.interp(phase, self.phase_rad, self.mean_rpm, period=turn)
        return mean, np.interp(phase, self.phase_rad, self.standard_error_rpm, period=turn)


def repeating_misfit(
    time_s: FloatArray, residual_rpm: FloatArray, rotation_period_s: float
) -> RepeatingMisfit:
    """Average the residual, NaN where left out, at equal load phase over the rotations.

    Within a rotation each bin is averaged first; the scatter between rotations, which are
    independent but for noise slower than a rotation, gives the standard error.
    """
    known = np.isfinite(residual_rpm)
    turns = (time_s[known] - time_s[0]) / rotation_period_s
    residual_rpm = residual_rpm[known]
    rotation = np.floor(turns).astype(int)
    bins = np.minimum((PHASE_BINS * (turns - rotation)).astype(int), PHASE_BINS - 1)
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
