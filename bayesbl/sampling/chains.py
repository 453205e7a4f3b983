"""How ensembles are run until their chains are long enough, and what is kept of them.

Independent emcee ensembles go on side by side, in stretches. Of draws that press against the edge
of a tolerance it is asked how probable that is for a true value within it.
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
    Contender,
    Diagnostics,
    integrated_time,
    judge,
    rank_r_hat_and_ess,
)

FURTHEST = 30.0
"""Standard deviations of a peak beyond an edge; from there on the draws look exponential."""


def chance_at_edge(distances: FloatArray, width: float) -> float:
    """Probability of a likelihood whose peak lies so far beyond an edge, or further.

    With the peak t standard deviations s beyond the edge, draws have their mean at s (λ − t) and
    the variance s² (1 + tλ − λ²), λ = φ(t)/Q(t) and Q the upper tail of the normal distribution.
    The true value lies anywhere within the tolerance with equal probability, so a peak t or
    further beyond has the probability s/width (φ(t) − t Q(t)).

    Parameters
    ----------
    distances
        Of the draws from the edge, none negative, any shape.
    width
        Of the tolerance, in the same unit.

    Returns
    -------
    At most one; one where the peak does not lie beyond the edge.
    """
    mean, sd = float(distances.mean()), float(distances.std())
    if mean >= sd * _shape(0.0)[0]:
        return 1.0
    beyond = FURTHEST
    if mean > sd * _shape(FURTHEST)[0]:
        from scipy.optimize import brentq

        beyond = float(brentq(lambda t: _shape(t)[0] - mean / sd, 0.0, FURTHEST))
    own = sd / _shape(beyond)[1]
    tail = _density(beyond) - beyond * normal_sf(beyond)
    return min(1.0, own / width * tail)


def _density(z: float) -> float:
    """Of the standard normal distribution."""
    return math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)


def _shape(beyond: float) -> tuple[float, float]:
    """Mean over standard deviation of the draws, and the latter over that of the likelihood."""
    hazard = _density(beyond) * math.exp(-log_ndtr(-beyond))
    sd = float(np.sqrt(1.0 + beyond * hazard - hazard**2))
    return (hazard - beyond) / sd, sd


FEWEST_WALKERS = 32
START_SPREAD = 1.5
"""Scatter of the walkers at the start, in standard deviations of the local covariance."""

INDEPENDENT_SHARE = 0.5
"""Of the steps, that propose from the local distribution whatever the walker is; the others jump
along differences of walkers, which needs no guess of the posterior's shape."""
FREEDOM = 5.0
"""Of Student's t that is proposed from: its tails are heavier than a posterior's, so no walker that
is far out stays there."""

GAMMA_SCATTER = 1e-5
"""Of the length of a jump, relative: so that any point can be reached."""


def walkers_needed(dimensions: int) -> int:
    """How many an ensemble has."""
    return max(FEWEST_WALKERS, 4 * dimensions)


class Ensembles:
    """emcee ensembles, each of which knows nothing of the others.

    One sampler holds the walkers of all, so that a step asks for the density of all at once.

    Parameters
    ----------
    target
        Log density of points (m, d), shape (m,).
    starts
        Of each walker, shape (ensembles, :func:`walkers_needed`, d).
    centre, local_covariance
        Roughly where the density is, shapes (d,) and (d, d): decides how fast it is sampled, never
        what is.
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
        """So many that begin about a point, at the ends of ranges where they would begin outside.

        Parameters
        ----------
        centre, local_covariance
            Where the walkers start and how far they scatter there, shapes (d,) and (d, d).
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
        """Go on for a number of steps."""
        with np.errstate(invalid="ignore"):  # from a point of no density to another
            self._state = self._sampler.run_mcmc(self._state, steps, skip_initial_state_check=True)

    @property
    def chains(self) -> FloatArray:
        """All steps so far, shape (ensemble, step, walker, d)."""
        chain = np.asarray(self._sampler.get_chain())
        return chain.reshape(len(chain), *self._shape).swapaxes(0, 1)

    @property
    def acceptance(self) -> FloatArray:
        """Share of proposals that were accepted, by ensemble."""
        backend = self._sampler.backend
        accepted = np.asarray(backend.accepted).reshape(self._shape[:2])
        return np.asarray(accepted.mean(axis=1) / backend.iteration)


def _independent_of(
    centre: FloatArray, covariance: FloatArray
) -> Callable[[FloatArray, Any], tuple[FloatArray, FloatArray]]:
    """Proposals from Student's t around a point, the same for every walker, as emcee asks for them.

    x' = c + L z √(ν/χ²_ν); the chance of a move is p(x') t(x) / (p(x) t(x')), 1 at most (Tierney
    1994, Annals of Statistics 22, 1701). Where the posterior is nearly normal most are taken, and a
    chain forgets in a few steps.
    """
    root = np.linalg.cholesky(covariance)

    def log_density(points: FloatArray) -> FloatArray:
        square = np.sum(np.linalg.solve(root, (points - centre).T) ** 2, axis=0)
        return np.asarray(-0.5 * (FREEDOM + centre.size) * np.log1p(square / FREEDOM))

    def propose(points: FloatArray, random: Any) -> tuple[FloatArray, FloatArray]:
        shrunk = np.sqrt(random.chisquare(FREEDOM, (len(points), 1)) / FREEDOM)
        tried = centre + (random.randn(*points.shape) / shrunk) @ root.T
        return tried, log_density(points) - log_density(tried)

    return propose


class _DifferentialEvolution:
    """emcee's DEMove within each of several ensembles, all of them at once: twice as fast.

    Half of an ensemble's walkers jump along the difference of two of its other half, then the
    other half does: x + γ (x₁ − x₂), γ = 2.38/√(2d). Ter Braak 2006, Statistics and Computing 16,
    239; Nelson, Ford & Payne 2014, Astrophysical Journal Supplement 210, 11.
    """

    def __init__(self, ensembles: int) -> None:
        self._ensembles = ensembles

    def propose(self, model: Any, state: Any) -> tuple[Any, BoolArray]:
        """The next state and which walkers moved, as emcee asks for them."""
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
            places = moving.ravel()
            length = gamma * (1.0 + GAMMA_SCATTER * random.randn(places.size, 1))
            tried = state.coords[places] + length * (state.coords[pair[0]] - state.coords[pair[1]])
            log_prob = model.log_prob_fn(tried)
            moves = np.log(random.rand(places.size)) < log_prob - state.log_prob[places]
            state.coords[places[moves]] = tried[moves]
            state.log_prob[places[moves]] = log_prob[moves]
            accepted[places[moves]] = True
        return state, accepted


STEPS_BETWEEN_CHECKS = 100
GROWTH_BETWEEN_CHECKS = 0.2
"""Of the steps so far, before the next check: it costs in proportion to the steps it looks at."""
BURN_IN_AUTOCORRELATIONS = 5.0
DRAWS_KEPT = 1000
BOUND_TOLERANCE_SD = 0.05
"""Interval bounds count as stable when they move less than this many standard deviations."""


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
class Walk:
    """Ensembles that have run until they were long enough, or as long as they may.

    Attributes
    ----------
    chains
        After the burn-in, one for each ensemble, shape (step, walker, d).
    autocorrelation_steps
        The longest of all ensembles and dimensions.
    steps
        Of each chain.
    acceptance
        Of each ensemble.
    stable
        Whether interval bounds had stopped to move at the last check.
    """

    chains: tuple[FloatArray, ...]
    autocorrelation_steps: float
    steps: int
    acceptance: FloatArray
    stable: bool

    def judged(
        self,
        draws: Mapping[str, FloatArray],
        signal_to_noise: float = math.inf,
        at_bound: Mapping[str, float] | None = None,
        other_answer: Contender | None = None,
    ) -> Diagnostics:
        """Whether draws by name, (chain, draw), that were made of it can be trusted."""
        return judge(
            *rank_r_hat_and_ess(draws),
            self.autocorrelation_steps,
            self.steps,
            self.acceptance,
            self.stable,
            signal_to_noise,
            at_bound or {},
            other_answer,
        )


def walk(
    ensembles: Ensembles,
    settings: SamplerSettings,
    bounds: Callable[[FloatArray], FloatArray],
    sd: FloatArray | float,
    progress: Progress | None = None,
) -> Walk:
    """Run until chains hold enough autocorrelation times and interval bounds stand still.

    Parameters
    ----------
    bounds
        Of the intervals, from the last three quarters of all chains, shape (ensemble, step,
        walker, d); checked against ``sd``, the
        standard deviations of what they bound.
    """
    steps, tau, stable = 0, math.inf, False
    last: FloatArray | None = None
    while steps < settings.max_steps:
        # Short chains tell their autocorrelation time too short: what they lack is not too much.
        lacking = needed(tau) - steps if math.isfinite(tau) else 0.0
        stretch = max(STEPS_BETWEEN_CHECKS, GROWTH_BETWEEN_CHECKS * steps, lacking)
        count = min(math.ceil(stretch), settings.max_steps - steps)
        ensembles.run(count)
        steps += count
        chains = ensembles.chains[:, steps // 4 :]
        tau = max(integrated_time(chain) for chain in chains)
        edges = bounds(chains)
        stable = last is not None and bool(np.all(np.abs(edges - last) < BOUND_TOLERANCE_SD * sd))
        last = edges
        if progress is not None:
            progress(steps, settings.max_steps)
        if stable and steps - burn_in(tau, steps) > STEPS_PER_AUTOCORRELATION * tau:
            break
    burn = burn_in(tau, steps)
    kept = tuple(ensembles.chains[:, burn:])
    return Walk(kept, tau, steps - burn, ensembles.acceptance, stable)


def needed(tau: float) -> float:
    """Steps with the burn-in, for chains of this autocorrelation time."""
    return (BURN_IN_AUTOCORRELATIONS + STEPS_PER_AUTOCORRELATION) * tau


def burn_in(tau: float, steps: int) -> int:
    """Steps left out at the start: five autocorrelation times, at most half of all."""
    half = steps // 2
    return half if not math.isfinite(tau) else min(half, math.ceil(BURN_IN_AUTOCORRELATIONS * tau))


def thinned(chain: FloatArray, count: int = DRAWS_KEPT) -> FloatArray:
    """``count`` draws of a chain (step, walker, d), shape (draw, d): all walkers, few steps.

    Steps as far apart as they can be. Evenly spaced over steps and walkers alike, draws would be of
    one walker alone wherever the spacing comes to a multiple of their number.
    """
    steps, walkers, d = chain.shape
    kept = _evenly(min(steps, math.ceil(count / walkers)), steps)
    flat = chain[kept].reshape(-1, d)
    return np.asarray(flat[_evenly(count, len(flat))])


def _evenly(count: int, size: int) -> NDArray[np.int_]:
    return np.linspace(0, size - 1, count).round().astype(int)
