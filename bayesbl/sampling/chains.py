"""Run independent emcee ensembles in parallel until their chains are long enough.

Also judge draws that pile up at the edge of a tolerance: how probable is that for a true value
within the tolerance?
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from bayesbl.probabilities import normal_sf
from bayesbl.progress import Progress
from bayesbl.recording.types import BoolArray, FloatArray
from bayesbl.sampling.convergence import (
    STEPS_PER_AUTOCORRELATION,
    Diagnostics,
    integrated_time,
    judge,
    rank_r_hat_and_ess,
)
from bayesbl.sampling.trajectories import Trajectories

FURTHEST = 30.0
"""Largest distance of a peak from an edge, in sd; the draws then look exponential."""


def chance_at_edge(distances: FloatArray, width: float) -> float:
    """Probability that the peak of a likelihood lies this far beyond an edge, or farther.

    If the peak is t standard deviations s beyond the edge, the draws have mean s (λ − t) and
    variance s² (1 + tλ − λ²), with λ = φ(t)/Q(t) and Q the upper tail of the normal distribution.
    The true value is uniform within the tolerance, so a peak t or farther beyond has the
    probability s/width (φ(t) − t Q(t)).

    Parameters
    ----------
    distances
        Distances of the draws from the edge, none negative, any shape.
    width
        Width of the tolerance, in the same unit.

    Returns
    -------
    At most 1; 1 if the peak does not lie beyond the edge.
    """
    mean, sd = float(distances.mean()), float(distances.std())
    if mean >= sd * _shape(0.0)[0]:
        return 1.0
    peak_distance = FURTHEST
    if mean > sd * _shape(FURTHEST)[0]:
        from scipy.optimize import brentq

        peak_distance = float(brentq(lambda t: _shape(t)[0] - mean / sd, 0.0, FURTHEST))
    likelihood_sd = sd / _shape(peak_distance)[1]
    tail = _density(peak_distance) - peak_distance * normal_sf(peak_distance)
    return min(1.0, likelihood_sd / width * tail)


def _density(z: float) -> float:
    """Density of the standard normal distribution."""
    return math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)


def _shape(peak_distance: float) -> tuple[float, float]:
    """Mean over sd of the draws, and their sd over that of the likelihood."""
    hazard = _density(peak_distance) * math.exp(-log_ndtr(-peak_distance))
    sd = float(np.sqrt(1.0 + peak_distance * hazard - hazard**2))
    return (hazard - peak_distance) / sd, sd


START_SPREAD = 1.5
"""Scatter of the walkers at the start, in standard deviations of the local covariance."""

INDEPENDENT_SHARE = 0.5
"""Share of steps with independent proposals from the local distribution. The others jump along
differences of walkers, which needs no guess of the posterior's shape."""
FREEDOM = 5.0
"""Degrees of freedom of the Student-t proposal. Its tails are heavier than a posterior's, so no
walker stays far out."""

GAMMA_SCATTER = 1e-5
"""Relative scatter of the length of a jump, so that any point can be reached."""


def walkers_needed(dimensions: int) -> int:
    """Number of walkers of an ensemble."""
    return max(32, 4 * dimensions)


class Ensembles:
    """Independent emcee ensembles.

    One sampler holds the walkers of all ensembles, so that a step evaluates all densities at once.

    Parameters
    ----------
    target
        Log density of points (m, d), shape (m,).
    starts
        Start of each walker, shape (ensembles, :func:`walkers_needed`, d).
    centre, local_covariance
        Approximate location and covariance of the density, shapes (d,) and (d, d). They affect the
        speed of sampling, not its result.
    """

    def __init__(
        self,
        target: Callable[[FloatArray], FloatArray],
        starts: FloatArray,
        centre: FloatArray,
        local_covariance: FloatArray,
        seed: np.random.SeedSequence,
    ) -> None:
        import emcee

        self._shape = starts.shape
        points = starts.reshape(-1, starts.shape[-1])
        moves = [
            (emcee.moves.MHMove(_independent_of(centre, local_covariance)), INDEPENDENT_SHARE),
            (_DifferentialEvolution(starts.shape[0]), 1.0 - INDEPENDENT_SHARE),
        ]
        self._sampler = emcee.EnsembleSampler(*points.shape, target, moves=moves, vectorize=True)
        bits = np.random.RandomState(np.random.MT19937(seed)).get_state()
        self._state: Any = emcee.State(points, random_state=bits)

    @classmethod
    def around(
        cls,
        target: Callable[[FloatArray], FloatArray],
        centre: FloatArray,
        local_covariance: FloatArray,
        box: tuple[FloatArray, FloatArray],
        count: int,
        seed: np.random.SeedSequence,
    ) -> Ensembles:
        """Start ``count`` ensembles around a point, clipped to the ranges.

        Parameters
        ----------
        centre, local_covariance
            Mean and covariance of the starts, shapes (d,) and (d, d).
        box
            Low and high end of every range, shapes (d,); infinite where there is none.
        """
        start_seed, walk_seed = seed.spawn(2)
        low, high = box
        margin = 1e-6 * np.where(np.isfinite(high - low), high - low, 0.0)
        scatter = np.random.default_rng(start_seed).standard_normal(
            (count, walkers_needed(centre.size), centre.size)
        )
        starts = centre + START_SPREAD * scatter @ np.linalg.cholesky(local_covariance).T
        inside = np.clip(starts, low + margin, high - margin)
        return cls(target, inside, centre, local_covariance, walk_seed)

    def run(self, steps: int) -> None:
        """Continue for a number of steps."""
        with np.errstate(invalid="ignore"):  # −inf − (−inf) between points without density
            self._state = self._sampler.run_mcmc(self._state, steps, skip_initial_state_check=True)

    @property
    def chains(self) -> FloatArray:
        """All steps so far, shape (ensemble, step, walker, d)."""
        chain = np.asarray(self._sampler.get_chain())
        return chain.reshape(len(chain), *self._shape).swapaxes(0, 1)

    @property
    def acceptance(self) -> FloatArray:
        """Accepted share of proposals, by ensemble."""
        backend = self._sampler.backend
        accepted = np.asarray(backend.accepted).reshape(self._shape[:2])
        return np.asarray(accepted.mean(axis=1) / backend.iteration)


def _independent_of(
    centre: FloatArray, covariance: FloatArray
) -> Callable[[FloatArray, Any], tuple[FloatArray, FloatArray]]:
    """Independent Student-t proposals around a point, the same for every walker, in emcee's form.

    x' = c + L z √(ν/χ²_ν). A move is accepted with probability p(x') t(x) / (p(x) t(x')), at most 1
    (Tierney 1994, Annals of Statistics 22, 1701). If the posterior is nearly normal, most proposals
    are accepted and the autocorrelation time is a few steps.
    """
    root = np.linalg.cholesky(covariance)

    def log_density(points: FloatArray) -> FloatArray:
        square = np.sum(np.linalg.solve(root, (points - centre).T) ** 2, axis=0)
        return np.asarray(-0.5 * (FREEDOM + centre.size) * np.log1p(square / FREEDOM))

    def propose(points: FloatArray, random: Any) -> tuple[FloatArray, FloatArray]:
        t_scale = np.sqrt(random.chisquare(FREEDOM, (len(points), 1)) / FREEDOM)
        proposals = centre + (random.randn(*points.shape) / t_scale) @ root.T
        return proposals, log_density(points) - log_density(proposals)

    return propose


class _DifferentialEvolution:
    """emcee's DEMove within each of several ensembles, vectorised over them: twice as fast.

    Half of an ensemble's walkers jump along the difference of two walkers of the other half, then
    the other half does: x + γ (x₁ − x₂), γ = 2.38/√(2d). Ter Braak 2006, Statistics and Computing
    16, 239; Nelson, Ford & Payne 2014, Astrophysical Journal Supplement 210, 11.
    """

    def __init__(self, ensembles: int) -> None:
        self._ensembles = ensembles

    def propose(self, model: Any, state: Any) -> tuple[Any, BoolArray]:
        """The next state and the accepted walkers, as emcee asks for them."""
        random, d = model.random, state.coords.shape[1]
        walkers = len(state.coords) // self._ensembles
        gamma = 2.38 / math.sqrt(2.0 * d)
        order = np.argsort(random.rand(self._ensembles, walkers), axis=1)
        order += walkers * np.arange(self._ensembles)[:, None]
        accepted = np.zeros(len(state.coords), dtype=bool)
        halves = order[:, : walkers // 2], order[:, walkers // 2 :]
        for moving, others in (halves, halves[::-1]):
            size = others.shape[1]
            first = random.randint(size, size=moving.shape)
            second = (first + random.randint(1, size, size=moving.shape)) % size
            pair = [np.take_along_axis(others, place, axis=1).ravel() for place in (first, second)]
            index = moving.ravel()
            length = gamma * (1.0 + GAMMA_SCATTER * random.randn(index.size, 1))
            trial = state.coords[index] + length * (state.coords[pair[0]] - state.coords[pair[1]])
            log_prob = model.log_prob_fn(trial)
            is_accepted = np.log(random.rand(index.size)) < log_prob - state.log_prob[index]
            state.coords[index[is_accepted]] = trial[is_accepted]
            state.log_prob[index[is_accepted]] = log_prob[is_accepted]
            accepted[index[is_accepted]] = True
        return state, accepted


STEPS_BETWEEN_CHECKS = 100
GROWTH_BETWEEN_CHECKS = 0.2
"""Share of the steps so far before the next check, whose cost is proportional to them."""
BURN_IN_AUTOCORRELATIONS = 5.0
DRAWS_KEPT = 1000
BOUND_TOLERANCE_SD = 0.05
"""Interval bounds count as stable when they move less than this many standard deviations."""


@dataclass(frozen=True, slots=True)
class SamplerSettings:
    """How the posterior is sampled; has no influence on the meaning of A.

    Attributes
    ----------
    ensembles
        Number of independent emcee ensembles; these are the chains.
    max_steps
        Upper limit of steps per ensemble; the sampler stops by itself when converged.
    level
        Interval level whose bounds must be stable.
    """

    ensembles: int = 4
    max_steps: int = 20000
    level: float = 0.9


@dataclass(frozen=True, slots=True)
class Walk:
    """The chains of all ensembles after a run.

    Attributes
    ----------
    chains
        Chain of each ensemble after burn-in, shape (step, walker, d).
    autocorrelation_steps
        Longest autocorrelation time of all ensembles and dimensions.
    steps
        Number of steps of each chain.
    acceptance
        Accepted share of proposals of each ensemble.
    stable
        Whether the interval bounds were stable at the last check.
    """

    chains: tuple[FloatArray, ...]
    autocorrelation_steps: float
    steps: int
    acceptance: FloatArray
    stable: bool

    def judged(self, draws: Mapping[str, FloatArray], **numbers: Any) -> Diagnostics:
        """Judge whether draws made from the chains, (chain, draw) by name, can be trusted.

        ``numbers``: those that :func:`judge` takes besides.
        """
        r_hat, ess = rank_r_hat_and_ess(draws)
        ended = Diagnostics(r_hat, ess, self.autocorrelation_steps, self.steps, self.acceptance)
        return judge(ended, self.stable, **numbers)


def walk(
    ensembles: Ensembles | Trajectories,
    settings: SamplerSettings,
    bounds: Callable[[FloatArray], FloatArray],
    sd: FloatArray | float,
    progress: Progress | None = None,
) -> Walk:
    """Run until the chains hold enough autocorrelation times and the interval bounds are stable.

    Parameters
    ----------
    bounds
        Function from the last three quarters of all chains, shape (ensemble, step, walker, d), to
        interval bounds. Their changes are compared with ``sd``, the standard deviations of the
        bounded quantities.
    """
    steps, tau, stable = 0, math.inf, False
    previous: FloatArray | None = None
    while steps < settings.max_steps:
        # Short chains underestimate their autocorrelation time: never too many missing steps.
        missing = needed(tau) - steps if math.isfinite(tau) else 0.0
        stretch = max(STEPS_BETWEEN_CHECKS, GROWTH_BETWEEN_CHECKS * steps, missing)
        count = min(math.ceil(stretch), settings.max_steps - steps)
        ensembles.run(count)
        steps += count
        chains = ensembles.chains[:, steps // 4 :]
        tau = max(integrated_time(chain) for chain in chains)
        edges = bounds(chains)
        stable = previous is not None and bool(
            np.all(np.abs(edges - previous) < BOUND_TOLERANCE_SD * sd)
        )
        previous = edges
        if progress is not None:
            progress(steps, settings.max_steps)
        if stable and steps - burn_in(tau, steps) > STEPS_PER_AUTOCORRELATION * tau:
            break
    burn = burn_in(tau, steps)
    kept = tuple(ensembles.chains[:, burn:])
    return Walk(kept, tau, steps - burn, ensembles.acceptance, stable)


def needed(tau: float) -> float:
    """Steps, including burn-in, that chains of this autocorrelation time need."""
    return (BURN_IN_AUTOCORRELATIONS + STEPS_PER_AUTOCORRELATION) * tau


def burn_in(tau: float, steps: int) -> int:
    """Steps dropped at the start: five autocorrelation times, at most half of all."""
    half = steps // 2
    return half if not math.isfinite(tau) else min(half, math.ceil(BURN_IN_AUTOCORRELATIONS * tau))


def thinned(chain: FloatArray, count: int = DRAWS_KEPT) -> FloatArray:
    """``count`` draws of a chain (step, walker, d), shape (draw, d): all walkers of a few steps.

    The steps are as far apart as possible. With even spacing over steps and walkers alike, all
    draws would come from one walker if the spacing were a multiple of the number of walkers.
    """
    steps, walkers, d = chain.shape
    kept = _evenly(min(steps, math.ceil(count / walkers)), steps)
    flat = chain[kept].reshape(-1, d)
    return np.asarray(flat[_evenly(count, len(flat))])


def _evenly(count: int, size: int) -> NDArray[np.int_]:
    return np.linspace(0, size - 1, count).round().astype(int)
