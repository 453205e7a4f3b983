"""One emcee ensemble that goes on in stretches, each of which can be stored and put back."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from bayesbl.recording.types import FloatArray
from bayesbl.ringing.memory import Arrays

FEWEST_WALKERS = 32
START_SPREAD = 1.5
"""Scatter of the walkers at the start, in standard deviations of the local covariance."""


class Ensemble:
    """An emcee ensemble with a random state of its own.

    Parameters
    ----------
    target
        Log density of points (m, d), shape (m,).
    centre, local_covariance
        Where the walkers start and how far they scatter there, shapes (d,) and (d, d).
    box
        Low and high end of every range, shapes (d,); infinite where there is none.
    """

    def __init__(
        self,
        target: Callable[[FloatArray], FloatArray],
        centre: FloatArray,
        local_covariance: FloatArray,
        box: tuple[FloatArray, FloatArray],
        seed: np.random.SeedSequence,
    ) -> None:
        import emcee

        start_seed, walk_seed = seed.spawn(2)
        d = centre.size
        walkers = max(FEWEST_WALKERS, 4 * d)
        generator = np.random.default_rng(start_seed)
        root = np.linalg.cholesky(local_covariance)
        start = centre + START_SPREAD * generator.standard_normal((walkers, d)) @ root.T
        low, high = box
        margin = 1e-6 * np.where(np.isfinite(high - low), high - low, 0.0)
        start = np.clip(start, low + margin, high - margin)
        self._sampler = emcee.EnsembleSampler(
            walkers,
            d,
            target,
            moves=emcee.moves.DEMove(),  # DESnookerMove of 3.1.6 is biased
            vectorize=True,
        )
        bits = np.random.MT19937(walk_seed)
        self._state: Any = emcee.State(start, random_state=np.random.RandomState(bits).get_state())
        self._stretches: list[FloatArray] = []
        self._accepted = 0.0

    def run(self, steps: int) -> Arrays:
        """Go on for a number of steps; the stretch and the state after it, for :meth:`put_back`."""
        self._sampler.reset()
        self._state = self._sampler.run_mcmc(self._state, steps, skip_initial_state_check=True)
        stretch = np.array(self._sampler.get_chain())
        accepted = float(np.sum(self._sampler.backend.accepted))
        self._stretches.append(stretch)
        self._accepted += accepted
        _, key, position, has_gauss, cached = self._state.random_state
        return {
            "stretch": stretch,
            "accepted": np.array(accepted),
            "coords": self._state.coords,
            "log_prob": self._state.log_prob,
            "random_key": key,
            "random_place": np.array([position, has_gauss]),
            "random_cached": np.array(cached),
        }

    def put_back(self, stored: Arrays) -> None:
        """Go on from the end of a stored stretch, as if it had just been run."""
        import emcee

        position, has_gauss = (int(x) for x in stored["random_place"])
        cached = float(stored["random_cached"])
        self._state = emcee.State(
            stored["coords"],
            log_prob=stored["log_prob"],
            random_state=("MT19937", stored["random_key"], position, has_gauss, cached),
        )
        self._stretches.append(stored["stretch"])
        self._accepted += float(stored["accepted"])

    @property
    def chain(self) -> FloatArray:
        """All steps so far, shape (step, walker, d)."""
        return np.concatenate(self._stretches)

    @property
    def acceptance(self) -> float:
        """Share of proposals that were accepted."""
        steps = sum(len(stretch) for stretch in self._stretches)
        return self._accepted / float(steps * self._sampler.nwalkers)
