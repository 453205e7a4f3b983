"""One emcee ensemble that goes on in stretches."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from bayesbl.recording.types import FloatArray

FEWEST_WALKERS = 32
START_SPREAD = 1.5
"""Scatter of the walkers at the start, in standard deviations of the local covariance."""

START_ROUNDS = 200
"""Walkers outside the ranges are drawn again so often, and only then moved to their ends: one that
is moved along one coordinate leaves the valley of several, and may not find back."""


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
    redrawn
        Walkers that would start outside are drawn again; otherwise they start at the ends.
    """

    def __init__(
        self,
        target: Callable[[FloatArray], FloatArray],
        centre: FloatArray,
        local_covariance: FloatArray,
        box: tuple[FloatArray, FloatArray],
        seed: np.random.SeedSequence,
        *,
        redrawn: bool = False,
    ) -> None:
        import emcee

        start_seed, walk_seed = seed.spawn(2)
        d = centre.size
        walkers = max(FEWEST_WALKERS, 4 * d)
        generator = np.random.default_rng(start_seed)
        root = np.linalg.cholesky(local_covariance)
        low, high = box
        margin = 1e-6 * np.where(np.isfinite(high - low), high - low, 0.0)
        low, high = low + margin, high - margin
        start = np.empty((walkers, d))
        outside = np.ones(walkers, dtype=bool)
        for _ in range(START_ROUNDS if redrawn else 1):
            steps = START_SPREAD * generator.standard_normal((int(outside.sum()), d))
            start[outside] = centre + steps @ root.T
            outside = np.any((start < low) | (start > high), axis=1)
            if not outside.any():
                break
        start = np.clip(start, low, high)
        self._sampler = emcee.EnsembleSampler(
            walkers,
            d,
            target,
            moves=emcee.moves.DEMove(),  # DESnookerMove of 3.1.6 is biased
            vectorize=True,
        )
        bits = np.random.MT19937(walk_seed)
        self._state: Any = emcee.State(start, random_state=np.random.RandomState(bits).get_state())

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
