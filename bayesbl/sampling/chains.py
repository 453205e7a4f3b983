"""How ensembles are run until their chains are long enough, and what is kept of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from bayesbl.progress import Progress
from bayesbl.recording.types import FloatArray
from bayesbl.sampling.convergence import (
    STEPS_PER_AUTOCORRELATION,
    Contender,
    Diagnostics,
    integrated_time,
    judge,
    rank_r_hat_and_ess,
)
from bayesbl.sampling.ensemble import Ensembles

STEPS_BETWEEN_CHECKS = 100
GROWTH_BETWEEN_CHECKS = 0.2
"""Of the steps so far, before the next check: it costs in proportion to the steps it looks at."""
BURN_IN_AUTOCORRELATIONS = 5.0
DRAWS_KEPT = 1000
BOUND_TOLERANCE_SD = 0.05
"""Interval bounds count as stable when they move less than this many standard deviations."""


NOTHING_AT_BOUND: Mapping[str, float] = MappingProxyType({})


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
        at_bound: Mapping[str, float] = NOTHING_AT_BOUND,
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
            at_bound,
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
