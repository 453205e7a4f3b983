"""One emcee ensemble that goes on in stretches."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from bayesbl.recording.types import FloatArray

FEWEST_WALKERS = 32
START_SPREAD = 1.5
"""Scatter of the walkers at the start, in standard deviations of the local covariance."""


def walkers_needed(dimensions: int) -> int:
    """How many an ensemble has."""
    return max(FEWEST_WALKERS, 4 * dimensions)


class Ensemble:
    """An emcee ensemble with a random state of its own.

    Parameters
    ----------
    target
        Log density of points (m, d), shape (m,).
    start
        Of each walker, shape (:func:`walkers_needed`, d).
    """

    def __init__(
        self,
        target: Callable[[FloatArray], FloatArray],
        start: FloatArray,
        seed: np.random.SeedSequence,
    ) -> None:
        import emcee

        walkers, d = start.shape
        self._sampler = emcee.EnsembleSampler(
            walkers,
            d,
            target,
            moves=emcee.moves.DEMove(),  # DESnookerMove of 3.1.6 is biased
            vectorize=True,
        )
        bits = np.random.MT19937(seed)
        self._state: Any = emcee.State(start, random_state=np.random.RandomState(bits).get_state())

    @classmethod
    def around(
        cls,
        target: Callable[[FloatArray], FloatArray],
        centre: FloatArray,
        local_covariance: FloatArray,
        box: tuple[FloatArray, FloatArray],
        seed: np.random.SeedSequence,
    ) -> Ensemble:
        """One that begins about a point, at the ends of ranges where it would begin outside.

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
            (walkers_needed(centre.size), centre.size)
        )
        start = centre + START_SPREAD * scatter @ np.linalg.cholesky(local_covariance).T
        return cls(target, np.clip(start, low + margin, high - margin), walk_seed)

    def run(self, steps: int) -> None:
        """Go on for a number of steps."""
        self._state = self._sampler.run_mcmc(self._state, steps, skip_initial_state_check=True)

    @property
    def chain(self) -> FloatArray:
        """All steps so far, shape (step, walker, d)."""
        return np.asarray(self._sampler.get_chain())

    @property
    def acceptance(self) -> float:
        """Share of proposals that were accepted."""
        backend = self._sampler.backend
        return float(np.sum(backend.accepted)) / float(backend.iteration * self._sampler.nwalkers)
