"""The posterior of the disturbance model around its RMSE optimum, by emcee.

The likelihood is exp(−SSE(θ) / 2κ): centred on the least-squares optimum, which is what the gap
curve means by A, and as wide as the recording's own noise makes it (design.md section 5). Priors
are flat in every symbol within its range. emcee walks over the symbols that enter nonlinearly;
A, v_t and the baseline, linear, are integrated out exactly and drawn afterwards.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from bayesbl.inference.covariance import Covariance, signal_to_noise
from bayesbl.inference.diagnostics import (
    STEPS_PER_AUTOCORRELATION,
    Diagnostics,
    integrated_time,
    judge,
    rank_r_hat_and_ess,
)
from bayesbl.inference.optimum import Optimum, bounds
from bayesbl.recording.types import FloatArray
from bayesbl.signal.objective import Objective
from bayesbl.signal.parameters import AMPLITUDE, MEAN

STEPS_BETWEEN_CHECKS = 250
BURN_IN_AUTOCORRELATIONS = 5.0
DRAWS_KEPT = 1000
BOUND_TOLERANCE_SD = 0.05
"""Interval bounds count as stable when they move less than this many standard deviations."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class SamplerSettings:
    """How the posterior is sampled; never part of what A means.

    Attributes
    ----------
    ensembles
        Independent emcee ensembles; these are the chains.
    max_steps
        Upper limit of steps per ensemble; the sampler stops by itself when converged.
    level
        Interval level whose bounds must be stable.
    """

    ensembles: int = 4
    max_steps: int = 20000
    level: float = 0.9


@dataclass(frozen=True, slots=True)
class Posterior:
    """Draws of every free symbol.

    Attributes
    ----------
    draws
        Free symbols by name, each of shape (chain, draw); chain = ensemble.
    baseline_rpm
        cos and sin of each load-angle harmonic, shape (chain, draw, 2k).
    log_likelihood
        −SSE/2κ with the linear symbols at their best, shape (chain, draw).
    """

    draws: dict[str, FloatArray]
    baseline_rpm: FloatArray
    log_likelihood: FloatArray
    diagnostics: Diagnostics


class LogDensity(Protocol):
    """What an ensemble walks on: a log density with the ranges of its coordinates, shape (d,)."""

    low: FloatArray
    high: FloatArray

    def __call__(self, points: FloatArray) -> FloatArray:
        """Shape (m, d) to (m,), up to a constant; −inf outside the ranges."""


class LogPosterior:
    """log p(searched symbols | recording), A, v_t and the baseline integrated out."""

    def __init__(self, objective: Objective, optimum: Optimum, scale: float) -> None:
        self._objective = objective
        self._scale = scale
        low, high = bounds(objective)
        self.low, self.high = low, high
        self._least = optimum.sum_of_squares

    def __call__(self, points: FloatArray) -> FloatArray:
        """Shape (m, d) to (m,), up to a constant; −inf outside the ranges."""
        sse, volume = self._objective.sum_of_squares_and_volume(points)
        value = -0.5 * ((sse - self._least) / self._scale + volume)
        inside = np.all((points >= self.low) & (points <= self.high), axis=1)
        return np.where(inside & np.isfinite(sse), value, -np.inf)


def sample_posterior(
    objective: Objective,
    optimum: Optimum,
    spread: Covariance,
    settings: SamplerSettings,
    seed: np.random.SeedSequence,
    progress: Progress | None = None,
) -> Posterior:
    """Sample until converged or ``settings.max_steps`` is reached.

    Parameters
    ----------
    seed
        One child is spawned per ensemble and one for the linear symbols, so the draws do not
        depend on how the work is spread.
    progress
        Called with (steps made, steps allowed) at every check.
    """
    *ensemble_seeds, linear_seed = seed.spawn(settings.ensembles + 1)
    target = LogPosterior(objective, optimum, spread.scale)
    searched = np.array([spread.names.index(n) for n in objective.searched])
    local = spread.scale * spread.inverse_curvature[np.ix_(searched, searched)]
    ensembles = [Ensemble(target, optimum.searched, local, s) for s in ensemble_seeds]

    steps, tau, stable = 0, math.inf, False
    last: FloatArray | None = None
    while steps < settings.max_steps:
        count = min(STEPS_BETWEEN_CHECKS, settings.max_steps - steps)
        for ensemble in ensembles:
            ensemble.run(count)
        steps += count
        tau = max(integrated_time(e.chain[steps // 4 :]) for e in ensembles)
        edges = _interval_edges(objective, ensembles, steps // 4, settings.level)
        sd = math.sqrt(spread.sandwich[0, 0])
        stable = last is not None and bool(np.all(np.abs(edges - last) < BOUND_TOLERANCE_SD * sd))
        last = edges
        if progress is not None:
            progress(steps, settings.max_steps)
        kept = steps - burn_in(tau, steps)
        if stable and kept > STEPS_PER_AUTOCORRELATION * tau:
            break

    burn = burn_in(tau, steps)
    generator = np.random.default_rng(linear_seed)
    points = np.stack([thinned(e.chain[burn:]) for e in ensembles])
    draws, baseline, log_likelihood = _complete(objective, optimum, spread, points, generator)
    r_hat, ess = rank_r_hat_and_ess(draws)
    diagnostics = judge(
        r_hat,
        ess,
        tau,
        steps - burn,
        np.array([e.acceptance for e in ensembles]),
        stable,
        signal_to_noise(optimum, spread),
        _at_bound(objective, points),
    )
    return Posterior(draws, baseline, log_likelihood, diagnostics)


class Ensemble:
    """One emcee ensemble with a random state of its own."""

    def __init__(
        self,
        target: LogDensity,
        centre: FloatArray,
        local_covariance: FloatArray,
        seed: np.random.SeedSequence,
    ) -> None:
        import emcee

        start_seed, walk_seed = seed.spawn(2)
        d = centre.size
        walkers = max(32, 4 * d)
        generator = np.random.default_rng(start_seed)
        root = np.linalg.cholesky(local_covariance)
        start = centre + 1.5 * generator.standard_normal((walkers, d)) @ root.T
        width = target.high - target.low
        margin = 1e-6 * np.where(np.isfinite(width), width, 0.0)
        start = np.clip(start, target.low + margin, target.high - margin)
        self._sampler = emcee.EnsembleSampler(
            walkers,
            d,
            target,
            moves=emcee.moves.DEMove(),  # DESnookerMove of 3.1.6 is biased
            vectorize=True,
        )
        bits = np.random.MT19937(walk_seed)
        state = np.random.RandomState(bits).get_state()
        self._state = emcee.State(start, random_state=state)

    def run(self, steps: int) -> None:
        """Go on for a number of steps."""
        self._state = self._sampler.run_mcmc(self._state, steps, skip_initial_state_check=True)

    @property
    def chain(self) -> FloatArray:
        """All steps so far, shape (step, walker, d)."""
        return np.asarray(self._sampler.get_chain())

    @property
    def acceptance(self) -> float:
        return float(np.mean(self._sampler.acceptance_fraction))


def burn_in(tau: float, steps: int) -> int:
    """Steps left out at the begin: five autocorrelation times, at most half of all."""
    half = steps // 2
    return half if not math.isfinite(tau) else min(half, math.ceil(BURN_IN_AUTOCORRELATIONS * tau))


def thinned(chain: FloatArray, count: int = DRAWS_KEPT) -> FloatArray:
    """``count`` evenly spaced draws of a chain (step, walker, d), shape (draw, d)."""
    flat = chain.reshape(-1, chain.shape[-1])
    return np.asarray(flat[np.linspace(0, len(flat) - 1, count).round().astype(int)])


def _interval_edges(
    objective: Objective, ensembles: list[Ensemble], burn: int, level: float
) -> FloatArray:
    """Bounds of the interval of A's conditional mean over all ensembles, rpm."""
    points = np.concatenate([thinned(e.chain[burn:]) for e in ensembles])
    amplitude = objective.solve(points).coefficients[:, -1]
    return np.asarray(np.quantile(amplitude, [0.5 - 0.5 * level, 0.5 + 0.5 * level]))


def _complete(
    objective: Objective,
    optimum: Optimum,
    spread: Covariance,
    points: FloatArray,
    generator: np.random.Generator,
) -> tuple[dict[str, FloatArray], FloatArray, FloatArray]:
    """Linear symbols drawn given the searched ones, then every width made the noise's own."""
    chains, count, d = points.shape
    flat = points.reshape(-1, d)
    solution = objective.solve(flat)
    linear = solution.coefficients.copy()
    free_linear = np.flatnonzero(solution.factor[0].diagonal() > 0.0)
    factor = solution.factor[:, free_linear[:, None], free_linear]
    white = math.sqrt(spread.scale) * generator.standard_normal((len(flat), free_linear.size, 1))
    linear[:, free_linear] += np.linalg.solve(np.swapaxes(factor, 1, 2), white)[:, :, 0]

    values = {name: flat[:, i] for i, name in enumerate(objective.searched)}
    values[AMPLITUDE], values[MEAN] = linear[:, -1], linear[:, 0]
    names = spread.names
    symbols = [n for n in names if n in values]
    stacked = np.column_stack([*(values[n] for n in symbols), linear[:, 1:-1]])
    centre = np.r_[[optimum.symbols[n] for n in symbols], optimum.baseline_rpm]
    stacked = centre + (stacked - centre) @ spread.calibration.T

    shape = (chains, count)
    draws = {n: stacked[:, i].reshape(shape) for i, n in enumerate(symbols)}
    baseline = stacked[:, len(symbols) :].reshape(*shape, -1)
    log_likelihood = -0.5 * (solution.sum_of_squares - optimum.sum_of_squares) / spread.scale
    return draws, baseline, log_likelihood.reshape(shape)


def _at_bound(objective: Objective, points: FloatArray) -> dict[str, float]:
    """By symbol, the share of draws at a bound of its range.

    That is within one percent of the range, and within half a standard deviation: a narrow
    posterior beside a bound is not cut by it.
    """
    low, high = bounds(objective)
    near = np.minimum(0.01 * (high - low), 0.5 * points.std(axis=(0, 1)))
    close = (points < low + near) | (points > high - near)
    return dict(zip(objective.searched, close.mean(axis=(0, 1)).tolist(), strict=True))
