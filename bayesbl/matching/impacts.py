"""Scatter of impacts between rotations, and its effect on the gap.

A recorder's noise is the same at an impact and elsewhere. Noise fed back by the speed loop moves
the motor, so the load meets a flank a little earlier or harder than the last time; other axes have
the same effect. So each impact has its own best gap, with two consequences.

First, the impacts' scores scatter by v times what the noise of the channels implies
(:mod:`bayesbl.noise.impact_scatter`). The expected v is simulated
(:mod:`bayesbl.matching.loop_noise`). The draws become those of a recording with v times the noise
variance. With P the prior's precision and r the residual at the fit, their precision becomes P +
JᵀJ/v instead of P + JᵀJ, and they move by −(P + JᵀJ/v)⁻¹ (1 − 1/v) Jᵀr. So the prior's information
stays sharp, and nothing becomes wider than its prior.

Second, the mean rotation is smeared: its ringing is that of no single impact. The resulting shift
of the fit is simulated, and each draw is corrected for it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.loop_noise import loop_noise, turns_of
from bayesbl.matching.signals import GAP, START_ANGLE
from bayesbl.noise.impact_scatter import FACTORS, Scatter, early_and_late
from bayesbl.recording.types import FloatArray

IMPACTS_ABOVE = 8
"""Load order above which the derivative shows ringing; slower parts come from gravity."""

BETWEEN_IMPACTS = 8
"""Inverse share of a rotation that is quiet between two impacts."""


@dataclass(frozen=True, slots=True)
class Impacts:
    """The impacts of one recording: both halves of each rotation, or of each cycle of a motion.

    A half begins where the gap's score is quietest.

    Attributes
    ----------
    index
        Index of the recording.
    derivatives
        Jacobian J of its whitened signals, shape (n, d).
    scatter
        Scatter of its gap scores.
    factors
        Equally likely values of v, shape (k,).
    timing_variance
        Mean square timing deviation of its impacts for each factor, rad², shape (k,).
    """

    index: int
    derivatives: FloatArray
    scatter: Scatter
    factors: FloatArray
    timing_variance: FloatArray


def by_impact(fit: SimulatedFit, covariance: FloatArray) -> list[Impacts]:
    """Impacts of each recording; ``covariance``: C, (d, d)."""
    model, derivatives = fit.model, fit.derivatives()
    curvature = derivatives.T @ derivatives
    # Covariance that the fit removes from residuals, as seen by the scores.
    hidden = 2.0 * covariance - covariance @ curvature @ covariance
    rows = [model.by_recording(row) for row in (fit.residual, *derivatives.T)]
    impacts = []
    for index, observation in enumerate(model.recordings):
        residual, *columns = (turns_of(row[index], observation) for row in rows)
        slopes = np.stack(columns, axis=-1)
        gap = model.place_of(GAP, observation.name)
        assert gap is not None
        gap_direction = slopes @ covariance[gap]
        halves = _halves(gap_direction, len(observation.signals))
        scores = partial(_scores, residual=residual, slopes=slopes, halves=halves, hidden=hidden)
        loop = loop_noise(fit, index)
        scatter = Scatter.of(
            *scores(gap_direction), None if loop is None else loop.factors(gap_direction)
        )
        factors = scatter.likely()
        timing_variance = np.zeros(factors.size)
        angle = model.place_of(START_ANGLE, observation.name)
        if angle is not None and observation.motion is None and scatter.freedom > 0.0:
            fast = _fast(slopes[..., angle], len(observation.signals))
            power = np.median(np.sum((fast[:, None] * halves) ** 2, axis=2))
            if power > 0.0:
                timing_variance = early_and_late(*scores(fast / power), factors)
        jacobian = np.stack([row[index].ravel() for row in rows[1:]], axis=1)
        impacts.append(Impacts(index, jacobian, scatter, factors, timing_variance))
    return impacts


def _scores(
    weights: FloatArray,
    residual: FloatArray,
    slopes: FloatArray,
    halves: FloatArray,
    hidden: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Scores of impacts, (g,), with their covariance by the recorder's noise and halves."""
    weighted = weights[:, None] * halves
    power = np.sum(weighted**2, axis=2)
    # A lost impact says nothing.
    kept = power > 0.5 * np.median(power, axis=0)
    kinds = np.broadcast_to(np.arange(2.0), power.shape)
    by_unknown = np.einsum("rhm,rmd->rhd", weighted, slopes)[kept]
    spread = np.diag(power[kept]) - by_unknown @ hidden @ by_unknown.T
    return np.sum(weighted * residual[:, None], axis=2)[kept], spread, kinds[kept]


def scattered(
    fit: SimulatedFit, draws: FloatArray, covariance: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Add the scatter of impacts beyond the recorder's noise to draws, shape (m, d).

    ``covariance``: C, (d, d), of the draws.
    """
    by_recording = by_impact(fit, covariance)
    cases = rng.integers(FACTORS, size=(len(by_recording), len(draws)))
    shares = [
        1.0 / impacts.factors[case] for impacts, case in zip(by_recording, cases, strict=True)
    ]
    # Scaled so that all variances are near one.
    unit = np.sqrt(np.diag(covariance))
    precision = fit.model.prior_precision() * np.outer(unit, unit)
    by_noise = np.repeat(precision[None], len(draws), axis=0)
    pull = np.zeros(draws.shape)
    residuals = fit.model.by_recording(fit.residual)
    for impacts, share in zip(by_recording, shares, strict=True):
        slopes = impacts.derivatives * unit
        gram = slopes.T @ slopes
        precision = precision + gram
        by_noise += share[:, None, None] * gram
        pull -= np.outer(1.0 - share, slopes.T @ residuals[impacts.index].ravel())
    wide_covariance = np.linalg.inv(by_noise)
    values, vectors = np.linalg.eigh(wide_covariance - np.linalg.inv(precision))
    root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None]
    moves = np.einsum("mij,mj->mi", root, rng.standard_normal(draws.shape))
    widened = draws + unit * (moves + np.einsum("mij,mj->mi", wide_covariance, pull))
    for impacts, case in zip(by_recording, cases, strict=True):
        widened -= impacts.timing_variance[case, None] * smeared(fit, impacts)
    return np.asarray(widened)


def smeared(fit: SimulatedFit, impacts: Impacts) -> FloatArray:
    """Error of the point per rad² of timing scatter, (d,).

    Two simulations are shifted to either side by the root mean square. Their mean minus the
    unshifted simulation is what smeared ringing lacks. Zero if one of them cannot be simulated.
    """
    model, square = fit.model, float(impacts.timing_variance.mean())
    angle = model.place_of(START_ANGLE, model.recordings[impacts.index].name)
    if square == 0.0 or angle is None:
        return np.zeros(fit.point.size)
    shifted = np.repeat(fit.point[None], 2, axis=0)
    shifted[:, angle] += np.array([-1.0, 1.0]) * math.sqrt(square)
    residual = model.by_recording(fit.residual)[impacts.index].ravel()
    missing = residual - model.whitened_of(shifted, impacts.index).mean(axis=0)
    shift = fit.covariance @ (impacts.derivatives.T @ missing) / square
    return np.nan_to_num(shift) if np.all(np.isfinite(shift)) else np.zeros(shift.size)


def _fast(slopes: FloatArray, channels: int) -> FloatArray:
    """Part of rotations, (r, c lag), above load order ``IMPACTS_ABOVE``."""
    spectrum = np.fft.rfft(slopes.reshape(len(slopes), channels, -1))
    spectrum[..., : IMPACTS_ABOVE + 1] = 0.0
    return np.fft.irfft(spectrum, slopes.shape[1] // channels).reshape(slopes.shape)


def _halves(direction: FloatArray, channels: int) -> FloatArray:
    """Indicators of the two halves of a rotation of channels, (2, c lag)."""
    power = np.sum(direction.reshape(-1, direction.shape[1] // channels) ** 2, axis=0)
    half, window = power.size // 2, max(power.size // BETWEEN_IMPACTS, 1)
    smoothed = np.convolve(np.tile(power, 2), np.ones(window), "valid")
    begin = int(np.argmin(smoothed[:half] + smoothed[half : 2 * half])) + window // 2
    is_first = (np.arange(power.size) - begin) % power.size < half
    return np.tile(np.stack([is_first, ~is_first]), (1, channels)).astype(np.float64)
