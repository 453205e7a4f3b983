"""One emcee ensemble that goes on in stretches."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from bayesbl.recording.types import FloatArray

Proposal = Callable[[FloatArray, np.random.RandomState], tuple[FloatArray, FloatArray]]

FEWEST_WALKERS = 32
START_SPREAD = 1.5
"""Scatter of the walkers at the start, in standard deviations of the local covariance."""

FREEDOM = 5.0
"""Degrees of freedom of proposals that forget: heavier in the tails than what is sampled. They and
moves by differences take turns: where the posterior is nearly normal the chains forget four times
as fast, where it is cut off by its ranges a third more slowly."""

START_ROUNDS = 200
"""Walkers outside the ranges are drawn again so often, and only then moved to their ends: one that
is moved along one coordinate leaves the valley of several, and may not find back."""


def anew(centre: FloatArray, root: FloatArray) -> Proposal:
    """Proposals that forget where a walker is: Student's t around a point.

    ``root``: Cholesky root of its scale. The proposals take points (m, d) and NumPy's old random
    state, and return new points and ln of q(old)/q(new), shape (m,).
    """

    def proposal(
        points: FloatArray, random: np.random.RandomState
    ) -> tuple[FloatArray, FloatArray]:
        steps = random.standard_normal(points.shape)
        steps /= np.sqrt(random.chisquare(FREEDOM, len(points)) / FREEDOM)[:, None]
        away = np.asarray(np.linalg.solve(root, (points - centre).T).T, dtype=float)
        return centre + steps @ root.T, _log_t(away) - _log_t(steps)

    return proposal


def _log_t(away: FloatArray) -> FloatArray:
    """Up to a constant, of standardised points (m, d)."""
    square = (away**2).sum(axis=1)
    return np.asarray(-0.5 * (FREEDOM + away.shape[1]) * np.log1p(square / FREEDOM))


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
        root = np.asarray(np.linalg.cholesky(local_covariance), dtype=float)
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
            moves=[
                (emcee.moves.DEMove(), 0.5),  # DESnookerMove of 3.1.6 is biased
                (emcee.moves.MHMove(anew(centre, root)), 0.5),
            ],
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
