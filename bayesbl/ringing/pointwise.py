"""Model of a recording by waveform and noise alone: likelihood by rotation, draws, predictions.

The noise is that of :mod:`bayesbl.noise.rotation_noise`. The model does not contain the misfit that
repeats every rotation, so model comparisons see it. The posterior of the answer is a different one.
It is centred on the least-squares optimum and has the width of that optimum's scatter
(:mod:`bayesbl.ringing.posterior`), so its draws do not belong to this likelihood.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from bayesbl.noise.process import NoiseModel
from bayesbl.noise.rotation_noise import (
    Noise,
    autocorrelation,
    innovation_share,
    innovations,
    log_normal,
    log_t,
)
from bayesbl.recording.types import FloatArray
from bayesbl.ringing.estimator import PointEstimate
from bayesbl.ringing.optimum import bounds
from bayesbl.ringing.symbols import AMPLITUDE, ROTATION, SYMBOLS
from bayesbl.ringing.waveform import jacobian, model_speed
from bayesbl.sampling.importance import independent_draws

PROPOSED = 1000
"""Proposed points to resample draws from: with nine symbols, half of them are effective."""


def rotations_of(point: PointEstimate) -> NDArray[np.int64]:
    """Index of the rotation that each sample lies in, shape (n,).

    A final part shorter than half a rotation belongs to the rotation before it.
    """
    time = point.objective.time_s
    turns = (time - time[0]) / point.optimum.symbols[ROTATION]
    number = np.floor(turns).astype(np.int64)
    last = max(round(float(turns[-1])) - 1, 0)
    return np.asarray(np.minimum(number, last), dtype=np.int64)


def log_likelihood(
    point: PointEstimate, draws: Mapping[str, FloatArray], baseline_rpm: FloatArray
) -> FloatArray:
    """Log density of each rotation given each draw, shape (…, rotation).

    Parameters
    ----------
    draws
        Free symbols by name, each of shape (…).
    baseline_rpm
        Shape (…, 2k).
    """
    noise, rotation = point.noise, rotations_of(point)[point.noise.order :]
    begins = np.searchsorted(rotation, np.arange(rotation[-1] + 1))
    known, scale = _known_innovations(point), innovation_sd(noise)
    freedom = noise.degrees_of_freedom
    if freedom is not None:
        scale *= math.sqrt((freedom - 2.0) / freedom)
    densities = np.empty((*baseline_rpm.shape[:-1], begins.size))
    for place in np.ndindex(densities.shape[:-1]):
        residual = point.objective.speed_rpm - speed_at(point, draws, baseline_rpm, place)
        e = _innovations(point, residual[None])[0] / scale
        log_density = log_normal(e) if freedom is None else log_t(e, freedom)
        densities[place] = np.add.reduceat(known * (log_density - math.log(scale)), begins)
    return densities


def speed_at(
    point: PointEstimate,
    draws: Mapping[str, FloatArray],
    baseline_rpm: FloatArray,
    place: int | tuple[int, ...],
) -> FloatArray:
    """Speed of the model at one of the draws of :func:`log_likelihood`, shape (n,), rpm."""
    symbols = {**point.optimum.symbols, **{n: float(v[place]) for n, v in draws.items()}}
    return model_speed(point.objective.time_s, symbols, baseline_rpm[place])


def likelihood_draws(
    point: PointEstimate,
    log_prior: Callable[[FloatArray], FloatArray],
    count: int,
    generator: np.random.Generator,
) -> tuple[dict[str, FloatArray], FloatArray, FloatArray] | None:
    """Draws of prior times likelihood: free symbols by name, (count,), and baseline, (count, 2k).

    Their :func:`log_likelihood`, (count, rotation), comes third. The first proposal is a normal
    distribution around one Gauss-Newton step from the optimum.

    Parameters
    ----------
    log_prior
        Log prior of the amplitude in rpm, shape (m,) to (m,). The prior is flat in all other
        symbols within their ranges.

    Returns
    -------
    ``None`` if the posterior is too far from a normal distribution.
    """
    objective, optimum, names = point.objective, point.optimum, point.spread.names
    columns = jacobian(optimum.model, objective.time_s, optimum.symbols, optimum.baseline_rpm)
    rows = np.vstack([columns.T, np.nan_to_num(point.residual_rpm)])
    whitened = _innovations(point, rows) / innovation_sd(point.noise) * _known_innovations(point)
    curvature = whitened[:-1] @ whitened[:-1].T
    covariance = np.asarray(np.linalg.inv(curvature), dtype=np.float64)
    symbols = [name for name in names if name in SYMBOLS]
    centre = np.r_[[optimum.symbols[name] for name in symbols], optimum.baseline_rpm]
    low, high = np.full(centre.size, -np.inf), np.full(centre.size, np.inf)
    searched_columns = [symbols.index(name) for name in objective.searched]
    low[searched_columns], high[searched_columns] = bounds(objective)

    def named(points: FloatArray) -> tuple[dict[str, FloatArray], FloatArray]:
        return dict(zip(symbols, points.T, strict=False)), points[:, len(symbols) :]

    by_rotation = np.empty(0)

    def density(points: FloatArray) -> FloatArray:
        nonlocal by_rotation
        by_rotation = log_likelihood(point, *named(points))
        prior = log_prior(points[:, symbols.index(AMPLITUDE)])
        return np.asarray(by_rotation.sum(axis=1) + prior)

    peak = centre + covariance @ (whitened[:-1] @ whitened[-1])
    peak = np.clip(peak, low, high)
    sample = independent_draws(density, peak, covariance, (low, high), count, generator, PROPOSED)
    if sample is None:
        return None
    points, chosen, _ = sample
    return *named(points[chosen]), by_rotation[chosen]


def _innovations(point: PointEstimate, rows: FloatArray) -> FloatArray:
    """Innovations of rows (p, n), of any value where samples are missing, (p, n − order)."""
    noise, used = point.noise, point.objective.used
    if noise.differentiated:
        # The sums differ from the process by an unknown value, another one after each lost sample.
        rows = np.cumsum(np.where(used, rows, 0.0), axis=1)
        starts = np.flatnonzero(np.diff(used, prepend=not used[0]))
        lengths = np.diff(starts, append=used.size)
        means = np.add.reduceat(rows, starts, axis=1) / lengths
        rows = rows - np.repeat(means, lengths, axis=1)
    return np.array([innovations(row, noise.coefficients) for row in rows])


def _known_innovations(point: PointEstimate) -> FloatArray:
    """1 where a sample and the ``order`` before it are all present, else 0, (n − order,)."""
    missing = np.convolve(~point.objective.used, np.ones(point.noise.order + 1), "valid")
    return np.asarray(missing < 0.5, dtype=np.float64)


def innovation_sd(noise: Noise) -> float:
    """Standard deviation of the innovation of each sample, rpm."""
    variance = noise.sd_rpm**2 * innovation_share(noise.coefficients)
    if noise.differentiated:
        variance /= _variance_of_change(noise)
    return math.sqrt(variance)


def _variance_of_change(noise: Noise) -> float:
    """Variance of the change of an autoregressive process over the variance of the process."""
    return 2.0 * (1.0 - float(autocorrelation(noise.coefficients, 2)[1]))


def predicted(
    point: PointEstimate,
    draws: Mapping[str, FloatArray],
    baseline_rpm: FloatArray,
    generator: np.random.Generator,
) -> FloatArray:
    """Simulated recordings of the speed, one per draw, each with new noise, shape (m, n), rpm.

    Parameters
    ----------
    draws
        Free symbols by name, each of shape (m,).
    baseline_rpm
        Shape (m, 2k).
    """
    speeds = [speed_at(point, draws, baseline_rpm, k) for k in range(len(baseline_rpm))]
    return np.array([s + _drawn(point.noise, s.size, generator) for s in speeds])


def _drawn(noise: Noise, size: int, generator: np.random.Generator) -> FloatArray:
    model = NoiseModel(noise.sd_rpm, tuple(noise.coefficients), noise.degrees_of_freedom)
    if not noise.differentiated:
        return model.draw(size, generator)
    change = np.diff(model.draw(size + 1, generator))
    return np.asarray(change / math.sqrt(_variance_of_change(noise)))
