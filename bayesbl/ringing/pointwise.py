"""Waveform and noise alone as a model of a recording: likelihood by rotation, draws, predictions.

The noise is that of :mod:`bayesbl.noise.rotation_noise`. What repeats every rotation and the
waveform lacks is not in this model, so comparisons of models see it. The answer's posterior is
another one: it is centred on the least-squares optimum and as wide as that scatters
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
"""Points of which draws are resampled: of nine symbols half of them count."""


def rotations_of(point: PointEstimate) -> NDArray[np.int64]:
    """Number of the rotation that each sample lies in, shape (n,).

    A rest shorter than half a rotation belongs to the rotation before it.
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
    turn, baseline = point.optimum.symbols[ROTATION], baseline_rpm.reshape(len(rows), -1)
    away = objective.time_s - 0.5 * (objective.time_s[0] + objective.time_s[-1])
    orders = np.arange(1, baseline.shape[1] // 2 + 1)
    rotation = rotations_of(point)
    count = int(rotation[-1]) + 1
    densities = np.zeros((len(rows), count))
    _log_densities(
        rows,
        np.ascontiguousarray(baseline),
        objective.time_s,
        objective.period_s,
        turn,
        away,
        np.exp(2j * math.pi / turn * np.outer(orders, away)),
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

    The first proposal is the normal distribution about one Gauss-Newton step from the optimum.

    Parameters
    ----------
    log_prior
        Of the amplitude in rpm, shape (m,) to (m,); flat in all else within its range.

    Returns
    -------
    ``None`` where the posterior is too far from a normal distribution.
    """
    objective, optimum, names = point.objective, point.optimum, point.spread.names
    columns = jacobian(optimum.model, objective.time_s, optimum.symbols, optimum.baseline_rpm)
    white = _whitened(point, np.column_stack([columns, np.nan_to_num(point.residual_rpm)]))
    curvature = white[:, :-1].T @ white[:, :-1]
    covariance = np.asarray(np.linalg.inv(curvature), dtype=np.float64)
    symbols = [name for name in names if name in SYMBOLS]
    centre = np.r_[[optimum.symbols[name] for name in symbols], optimum.baseline_rpm]
    low, high = np.full(centre.size, -np.inf), np.full(centre.size, np.inf)
    places = [symbols.index(name) for name in objective.searched]
    low[places], high[places] = bounds(objective)

    def named(points: FloatArray) -> tuple[dict[str, FloatArray], FloatArray]:
        return dict(zip(symbols, points.T, strict=False)), points[:, len(symbols) :]

    def density(points: FloatArray) -> FloatArray:
        prior = log_prior(points[:, symbols.index(AMPLITUDE)])
        return np.asarray(log_likelihood(point, *named(points)).sum(axis=1) + prior)

    peak = centre + covariance @ (white[:, :-1].T @ white[:, -1])
    peak = np.clip(peak, low, high)
    sample = independent_draws(density, peak, covariance, (low, high), count, generator, PROPOSED)
    return None if sample is None else named(sample[0])


def _whitened(point: PointEstimate, columns: FloatArray) -> FloatArray:
    """Innovations of columns (n, p) over their standard deviation; 0 where a sample is missing."""
    noise, used = point.noise, point.objective.used
    if noise.differentiated:
        columns = np.cumsum(np.where(used[:, None], columns - columns[used].mean(axis=0), 0.0), 0)
    order = noise.order
    new = np.column_stack([innovations(column, noise.coefficients) for column in columns.T])
    return new / innovation_sd(noise) * _known_innovations(used, order)[order:, None]


def _known_innovations(used: BoolArray, order: int) -> FloatArray:
    """1 where a sample and the ``order`` before it are all there, else 0, shape (n,)."""
    missing = np.convolve(~used, np.ones(order + 1), "full")[: used.size]
    missing[:order] = 1.0
    return np.asarray(missing < 0.5, dtype=np.float64)


def innovation_sd(noise: Noise) -> float:
    """Standard deviation of what is new in each sample, rpm."""
    variance = noise.sd_rpm**2 * innovation_share(noise.coefficients)
    if noise.differentiated:
        variance /= _variance_of_change(noise)
    return math.sqrt(variance)


def _variance_of_change(noise: Noise) -> float:
    """Of an autoregressive process from sample to sample, over its own."""
    return 2.0 * (1.0 - float(autocorrelation(noise.coefficients, 2)[1]))


def predicted(
    point: PointEstimate,
    draws: Mapping[str, FloatArray],
    baseline_rpm: FloatArray,
    generator: np.random.Generator,
) -> FloatArray:
    """New recordings of the speed, one a draw, with noise of their own, shape (m, n), rpm.

    Parameters
    ----------
    draws
        Free symbols by name, each of shape (m,).
    baseline_rpm
        Shape (m, 2k).
    """
    objective = point.objective
    rows = []
    for number, baseline in enumerate(baseline_rpm):
        symbols = {**point.optimum.symbols, **{n: float(v[number]) for n, v in draws.items()}}
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
    rows, baselines, time, period, nominal_turn, away, waves, speed, counts, rotation,
    coefficients, differentiated, used, sd, freedom, densities,
):  # fmt: skip
    """Adds to ``densities`` (m, rotation) the log densities of innovations, draw by draw.

    ``waves`` of the load angle, (harmonic, n), are those of ``nominal_turn``, with three terms in
    the change of their rate: draws of T_w differ by some 1e-5 of it. ``counts`` is 1 where an
    innovation is known.
    """
    n, order, harmonics = time.size, coefficients.size, baselines.shape[1] // 2
    rest, e = np.empty(n), np.empty(n)
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
            rest[i] = speed[i] - mean
        for k in range(harmonics):
            c, s = baselines[m, 2 * k], baselines[m, 2 * k + 1]
            more = 2.0 * math.pi * (k + 1) * (1.0 / turn - 1.0 / nominal_turn)
            for i in range(n):
                x = more * away[i]
                even, odd = 1.0 - 0.5 * x * x, x * (1.0 - x * x / 6.0)
                co, si = waves[k, i].real, waves[k, i].imag
                rest[i] -= c * (co * even - si * odd) + s * (si * even + co * odd)
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
                    near = max(1.0 - abs(since) / period, 0.0)
                    wave = ramp * math.exp(-decay * u) * math.sin(frequency * u)
                    wave += frequency * period * near * near * near / 6.0
                    rest[i] -= sign * amplitude * wave
        if differentiated:
            centre, number = 0.0, 0
            for i in range(n):
                if used[i]:
                    centre += rest[i]
                    number += 1
            centre /= max(number, 1)
            total = 0.0
            for i in range(n):
                total += rest[i] - centre if used[i] else 0.0
                rest[i] = total
        for i in range(n):
            e[i] = rest[i]
        for k in range(order):
            phi = coefficients[k]
            for i in range(order, n):
                e[i] -= phi * rest[i - 1 - k]
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
