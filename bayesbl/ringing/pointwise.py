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

from bayesbl.compiled import compiled
from bayesbl.noise.process import NoiseModel
from bayesbl.noise.rotation_noise import Noise, autocorrelation, innovation_share, innovations
from bayesbl.recording.types import BoolArray, FloatArray
from bayesbl.ringing.estimator import PointEstimate
from bayesbl.ringing.objective import kernel_parameters
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
    parameters = kernel_parameters({**point.optimum.symbols, **draws})
    shape, rows = parameters.shape[:-1], parameters.reshape(-1, parameters.shape[-1])
    objective, noise = point.objective, point.noise
    coefficients = np.asarray(noise.coefficients, dtype=np.float64)
    rotation_s, baseline = point.optimum.symbols[ROTATION], baseline_rpm.reshape(len(rows), -1)
    centred_time_s = objective.time_s - 0.5 * (objective.time_s[0] + objective.time_s[-1])
    orders = np.arange(1, baseline.shape[1] // 2 + 1)
    rotation = rotations_of(point)
    count = int(rotation[-1]) + 1
    densities = np.zeros((len(rows), count))
    _log_densities(
        rows,
        np.ascontiguousarray(baseline),
        objective.time_s,
        objective.period_s,
        rotation_s,
        centred_time_s,
        np.exp(2j * math.pi / rotation_s * np.outer(orders, centred_time_s)),
        objective.speed_rpm,
        _known_innovations(objective.used, coefficients.size),
        np.searchsorted(rotation, np.arange(count + 1)),
        coefficients,
        noise.differentiated,
        objective.used,
        innovation_sd(noise),
        noise.degrees_of_freedom or 0.0,
        densities,
    )
    return densities.reshape(*shape, -1)


def likelihood_draws(
    point: PointEstimate,
    log_prior: Callable[[FloatArray], FloatArray],
    count: int,
    generator: np.random.Generator,
) -> tuple[dict[str, FloatArray], FloatArray] | None:
    """Draws of prior times likelihood: free symbols by name, (count,), and baseline, (count, 2k).

    The first proposal is a normal distribution around one Gauss-Newton step from the optimum.

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
    whitened = _whitened(point, np.column_stack([columns, np.nan_to_num(point.residual_rpm)]))
    curvature = whitened[:, :-1].T @ whitened[:, :-1]
    covariance = np.asarray(np.linalg.inv(curvature), dtype=np.float64)
    symbols = [name for name in names if name in SYMBOLS]
    centre = np.r_[[optimum.symbols[name] for name in symbols], optimum.baseline_rpm]
    low, high = np.full(centre.size, -np.inf), np.full(centre.size, np.inf)
    searched_columns = [symbols.index(name) for name in objective.searched]
    low[searched_columns], high[searched_columns] = bounds(objective)

    def named(points: FloatArray) -> tuple[dict[str, FloatArray], FloatArray]:
        return dict(zip(symbols, points.T, strict=False)), points[:, len(symbols) :]

    def density(points: FloatArray) -> FloatArray:
        prior = log_prior(points[:, symbols.index(AMPLITUDE)])
        return np.asarray(log_likelihood(point, *named(points)).sum(axis=1) + prior)

    peak = centre + covariance @ (whitened[:, :-1].T @ whitened[:, -1])
    peak = np.clip(peak, low, high)
    sample = independent_draws(density, peak, covariance, (low, high), count, generator, PROPOSED)
    return None if sample is None else named(sample[0])


def _whitened(point: PointEstimate, columns: FloatArray) -> FloatArray:
    """Whitened columns (n, p): innovations over their standard deviation; 0 at missing samples."""
    noise, used = point.noise, point.objective.used
    if noise.differentiated:
        columns = np.cumsum(np.where(used[:, None], columns - columns[used].mean(axis=0), 0.0), 0)
    order = noise.order
    e = np.column_stack([innovations(column, noise.coefficients) for column in columns.T])
    return e / innovation_sd(noise) * _known_innovations(used, order)[order:, None]


def _known_innovations(used: BoolArray, order: int) -> FloatArray:
    """1 where a sample and the ``order`` before it are all present, else 0, shape (n,)."""
    missing = np.convolve(~used, np.ones(order + 1), "full")[: used.size]
    missing[:order] = 1.0
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
    objective = point.objective
    rows = []
    for k, baseline in enumerate(baseline_rpm):
        symbols = {**point.optimum.symbols, **{n: float(v[k]) for n, v in draws.items()}}
        model = model_speed(objective.time_s, symbols, baseline)
        rows.append(model + _drawn(point.noise, model.size, generator))
    return np.array(rows)


def _drawn(noise: Noise, size: int, generator: np.random.Generator) -> FloatArray:
    model = NoiseModel(noise.sd_rpm, tuple(noise.coefficients), noise.degrees_of_freedom)
    if not noise.differentiated:
        return model.draw(size, generator)
    change = np.diff(model.draw(size + 1, generator))
    return np.asarray(change / math.sqrt(_variance_of_change(noise)))


@compiled(fastmath={"reassoc", "contract"})
def _log_densities(  # type: ignore[no-untyped-def]
    rows, baselines, time, period, nominal_turn, centred_time, waves, speed, counts, rotation,
    coefficients, differentiated, used, sd, freedom, densities,
):  # fmt: skip
    """Add to ``densities`` (m, rotation) the log densities of innovations, draw by draw.

    ``waves`` of the load angle, (harmonic, n), are those at ``nominal_turn``. They are corrected by
    a series of three terms in the change of their rate, because draws of T_w differ by some 1e-5 of
    it. ``counts`` is 1 where an innovation is known.
    """
    n, order, harmonics = time.size, coefficients.size, baselines.shape[1] // 2
    residual, e = np.empty(n), np.empty(n)
    if freedom > 0.0:
        scale = sd * math.sqrt((freedom - 2.0) / freedom)
        constant = (
            math.lgamma(0.5 * (freedom + 1.0))
            - math.lgamma(0.5 * freedom)
            - 0.5 * math.log(freedom * math.pi)
            - math.log(scale)
        )
    else:
        scale = sd
        constant = -0.5 * math.log(2.0 * math.pi) - math.log(sd)
    for m in range(rows.shape[0]):
        amplitude, first, decay, frequency = rows[m, 0], rows[m, 1], rows[m, 2], rows[m, 3]
        mean, window, separation, turn = rows[m, 4], rows[m, 5], rows[m, 6], rows[m, 7]
        for i in range(n):
            residual[i] = speed[i] - mean
        for k in range(harmonics):
            c, s = baselines[m, 2 * k], baselines[m, 2 * k + 1]
            rate_change = 2.0 * math.pi * (k + 1) * (1.0 / turn - 1.0 / nominal_turn)
            for i in range(n):
                x = rate_change * centred_time[i]
                cos_shift, sin_shift = 1.0 - 0.5 * x * x, x * (1.0 - x * x / 6.0)
                cosine, sine = waves[k, i].real, waves[k, i].imag
                residual[i] -= c * (cosine * cos_shift - sine * sin_shift) + s * (
                    sine * cos_shift + cosine * sin_shift
                )
        for side in range(2):
            sign = 1.0 if side == 0 else -1.0
            origin = first if side == 0 else first - separation
            lowest = math.ceil((time[0] - window - period - origin) / turn)
            highest = math.floor((time[n - 1] + period - origin) / turn)
            for pulse in range(lowest, highest + 1):
                start = origin + turn * pulse
                begin = np.searchsorted(time, start - period)
                end = np.searchsorted(time, start + window + period)
                for i in range(begin, end):
                    since = time[i] - start
                    u = max(since, 0.0)
                    ramp = min(max((window - since) / period + 0.5, 0.0), 1.0)
                    corner = max(1.0 - abs(since) / period, 0.0)
                    wave = ramp * math.exp(-decay * u) * math.sin(frequency * u)
                    wave += frequency * period * corner * corner * corner / 6.0
                    residual[i] -= sign * amplitude * wave
        if differentiated:
            centre, number = 0.0, 0
            for i in range(n):
                if used[i]:
                    centre += residual[i]
                    number += 1
            centre /= max(number, 1)
            total = 0.0
            for i in range(n):
                total += residual[i] - centre if used[i] else 0.0
                residual[i] = total
        for i in range(n):
            e[i] = residual[i]
        for k in range(order):
            phi = coefficients[k]
            for i in range(order, n):
                e[i] -= phi * residual[i - 1 - k]
        for r in range(densities.shape[1]):
            total, known, product = 0.0, 0.0, 1.0
            for i in range(rotation[r], rotation[r + 1]):
                square = counts[i] * e[i] * e[i] / (scale * scale)
                known += counts[i]
                if freedom > 0.0:
                    product *= 1.0 + square / freedom
                    if product > 1e200:  # one logarithm of many factors
                        total += math.log(product)
                        product = 1.0
                else:
                    total += square
            share = freedom + 1.0 if freedom > 0.0 else 1.0
            densities[m, r] += known * constant - 0.5 * share * (total + math.log(product))
