"""The posterior of the disturbance model around its RMSE optimum, by emcee.

The likelihood is exp(−SSE(θ) / 2κ): centred on the least-squares optimum, which is what the gap
curve means by A, and as wide as the recording's own noise and impacts make it (docs/design.md,
"Statistics"). What impacts lose that come early and late is given back to A.
Priors are flat in every symbol within its range. emcee walks over the symbols that enter
nonlinearly; A, v_t and the baseline are linear, integrated out exactly and drawn afterwards.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesbl.progress import Progress
from bayesbl.recording.types import FloatArray
from bayesbl.ringing.covariance import Covariance, signal_to_noise
from bayesbl.ringing.objective import Objective
from bayesbl.ringing.optimum import Optimum, bounds
from bayesbl.ringing.symbols import AMPLITUDE, MEAN
from bayesbl.sampling.chains import SamplerSettings, thinned, walk
from bayesbl.sampling.convergence import (
    Contender,
    Diagnostics,
)
from bayesbl.sampling.ensemble import Ensembles

DRAWS_FOR_EDGES = 2000
"""Of each ensemble: with four the edge of a 90 % interval scatters by 0.023 standard deviations."""


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
    *,
    contenders: Sequence[Contender] | None = None,
) -> Posterior:
    """Sample until converged or ``settings.max_steps`` is reached.

    Parameters
    ----------
    seed
        One child is spawned for the ensembles and one for the linear symbols.
    progress
        Called with (steps made, steps allowed) at every check.
    contenders
        Other optima to weigh against this one; if ``None``, the optimum's rivals by their
        likelihood.
    """
    walk_seed, linear_seed = seed.spawn(2)
    target = LogPosterior(objective, optimum, spread.scale)
    searched = np.array([spread.names.index(n) for n in objective.searched])
    local = spread.scale * spread.inverse_curvature[np.ix_(searched, searched)]
    box = (target.low, target.high)
    ensembles = Ensembles.around(
        target, optimum.searched, local, box, settings.ensembles, walk_seed
    )
    walked = walk(
        ensembles,
        settings,
        lambda chains: _interval_edges(objective, chains, settings.level),
        math.sqrt(spread.sandwich[0, 0]),
        progress,
    )
    generator = np.random.default_rng(linear_seed)
    points = np.stack([thinned(chain) for chain in walked.chains])
    draws, baseline, log_likelihood = complete(objective, optimum, spread, points, generator)
    if contenders is None:
        contenders = weighed_by_likelihood(target, optimum)
    diagnostics = walked.judged(
        draws,
        signal_to_noise(optimum, spread),
        _at_bound(objective, points),
        _other_answer(contenders, optimum, spread),
    )
    return Posterior(draws, baseline, log_likelihood, diagnostics)


def weighed_by_likelihood(target: LogPosterior, optimum: Optimum) -> tuple[Contender, ...]:
    """The optimum's rivals, weighed by the height of the posterior there.

    The peaks are assumed to be equally wide; a rival outside the ranges has no weight.
    """
    if not optimum.rivals:
        return ()
    names = optimum.model.searched
    points = np.array([[r.symbols[name] for name in names] for r in optimum.rivals])
    odds = target(points) - target(optimum.searched[None])[0]
    return tuple(
        Contender(r.symbols[AMPLITUDE], float(o)) for r, o in zip(optimum.rivals, odds, strict=True)
    )


def _other_answer(
    contenders: Sequence[Contender], optimum: Optimum, spread: Covariance
) -> Contender | None:
    """The likeliest contender whose amplitude differs from the optimum's."""
    sd = math.sqrt(spread.sandwich[0, 0])
    others = [c for c in contenders if abs(c.amplitude_rpm - optimum.symbols[AMPLITUDE]) > sd]
    return max(others, key=lambda c: c.log_odds, default=None)


def _interval_edges(objective: Objective, chains: FloatArray, level: float) -> FloatArray:
    """Bounds of the interval of A's conditional mean over all ensembles, rpm."""
    points = np.concatenate([thinned(chain, DRAWS_FOR_EDGES) for chain in chains])
    amplitude = objective.solve(points).coefficients[:, -1]
    return np.asarray(np.quantile(amplitude, [0.5 - 0.5 * level, 0.5 + 0.5 * level]))


def complete(
    objective: Objective,
    optimum: Optimum,
    spread: Covariance,
    points: FloatArray,
    generator: np.random.Generator,
) -> tuple[dict[str, FloatArray], FloatArray, FloatArray]:
    """Draw the linear symbols given the searched ones, then calibrate every width to the noise.

    Draws that calibration carries beyond a symbol's range, where the prior is zero, are put at the
    bound: for a symbol that the recording hardly determines, the map leads to decays that grow.

    Parameters
    ----------
    points
        Of the searched symbols, shape (chain, draw, d).

    Returns
    -------
    Draws by name, baseline and log likelihood, as :class:`Posterior` holds them.
    """
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
    case = generator.integers(spread.factors.size, size=len(flat))
    wider = np.sqrt(spread.factors[case])
    stacked = centre + wider[:, None] * ((stacked - centre) @ spread.calibration.T)
    stacked[:, 0] *= 1.0 + spread.losses[case]
    ranged = [symbols.index(n) for n in objective.searched]
    stacked[:, ranged] = np.clip(stacked[:, ranged], *bounds(objective))

    shape = (chains, count)
    draws = {n: stacked[:, i].reshape(shape) for i, n in enumerate(symbols)}
    baseline = stacked[:, len(symbols) :].reshape(*shape, -1)
    log_likelihood = -0.5 * (solution.sum_of_squares - optimum.sum_of_squares) / spread.scale
    return draws, baseline, log_likelihood.reshape(shape)


def _at_bound(objective: Objective, points: FloatArray) -> dict[str, float]:
    """By symbol, the share of draws within half a standard deviation of a bound of its range.

    A posterior that ends before its bound has hardly any, one cut off at its peak a quarter.
    """
    low, high = bounds(objective)
    near = 0.5 * points.std(axis=(0, 1))
    close = (points < low + near) | (points > high - near)
    return dict(zip(objective.searched, close.mean(axis=(0, 1)).tolist(), strict=True))
