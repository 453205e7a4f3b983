"""emcee's ensembles, walked side by side.

The walk is that of emcee 3.1.6 with its move by differential evolution (Nelson et al. 2013), to the
last bit: the same random numbers are drawn in the same order. Its own loop takes longer than
the densities of a small model, and asks for those of one half ensemble at a time; here those of all
ensembles are asked for in one call.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from bayesbl.recording.types import FloatArray

FEWEST_WALKERS = 32
START_SPREAD = 1.5
"""Scatter of the walkers at the start, in standard deviations of the local covariance."""

STEP_JITTER = 1e-5
"""Relative standard deviation of a step's length, so that no step is exactly undone."""

START_ROUNDS = 200
"""Walkers outside the ranges are drawn again so often, and only then moved to their ends: one that
is moved along one coordinate leaves the valley of several, and may not find back."""


Target = Callable[[FloatArray], FloatArray]


class Ensemble:
    """An ensemble of walkers with a random state of its own.

    Parameters
    ----------
    target
        Log density of points (m, d), shape (m,): that of a point does not depend on the others.
    centre, local_covariance
        Where the walkers start and how far they scatter there, shapes (d,) and (d, d).
    box
        Low and high end of every range, shapes (d,); infinite where there is none.
    redrawn
        Walkers that would start outside are drawn again; otherwise they start at the ends.

    Attributes
    ----------
    chain
        All steps so far, shape (step, walker, d).
    """

    def __init__(
        self,
        target: Target,
        centre: FloatArray,
        local_covariance: FloatArray,
        box: tuple[FloatArray, FloatArray],
        seed: np.random.SeedSequence,
        *,
        redrawn: bool = False,
    ) -> None:
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
        self._target = target
        self._points = np.clip(start, low, high)
        self._log_density = _finite(target(self._points))
        self._random = np.random.RandomState(np.random.MT19937(walk_seed))
        self._halves = np.arange(walkers) % 2
        rows, columns = np.tril_indices(walkers // 2, -1)
        self._pairs = np.concatenate([rows, columns]), np.concatenate([columns, rows])
        self._step = 2.38 / np.sqrt(2 * d)
        self._accepted = 0
        self.chain: FloatArray = np.empty((0, walkers, d))

    @property
    def acceptance(self) -> float:
        """Share of proposals that were accepted."""
        return self._accepted / (len(self.chain) * len(self._points))

    def _split(self) -> list[np.ndarray]:
        """Numbers of the walkers in either half, which are drawn anew for every step."""
        self._random.random_sample()  # emcee's choice among one move
        halves = self._halves.copy()
        self._random.shuffle(halves)
        return [np.flatnonzero(halves == 0), np.flatnonzero(halves == 1)]

    def _proposed(self, mine: np.ndarray, others: np.ndarray) -> FloatArray:
        """Each walker of a half moved along the line between two of the other half."""
        points, other = self._points[mine], self._points[others]
        first, second = self._pairs
        drawn = self._random.randint(0, first.size, size=mine.size)
        along = other[second[drawn]] - other[first[drawn]]
        length = self._step * (1 + STEP_JITTER * self._random.randn(mine.size, 1))
        return np.asarray(points + length * along)

    def _decide(self, mine: np.ndarray, proposed: FloatArray, log_density: FloatArray) -> None:
        """Metropolis, walker by walker."""
        with np.errstate(invalid="ignore"):  # a walker that starts where nothing is
            gain = log_density - self._log_density[mine]
        taken = gain > np.log(self._random.rand(mine.size))
        self._points[mine[taken]] = proposed[taken]
        self._log_density[mine[taken]] = log_density[taken]
        self._accepted += int(taken.sum())

    @staticmethod
    def walk(ensembles: Sequence[Ensemble], steps: int) -> None:
        """All ensembles, which have one target, go on for a number of steps.

        Raises
        ------
        ValueError
            If the target is not a number somewhere.
        """
        target = ensembles[0]._target
        new = [np.empty((steps, *one._points.shape)) for one in ensembles]
        for step in range(steps):
            halves = [one._split() for one in ensembles]
            for half in (0, 1):
                proposed = [
                    one._proposed(both[half], both[1 - half])
                    for one, both in zip(ensembles, halves, strict=True)
                ]
                ends = np.cumsum([len(points) for points in proposed])[:-1]
                density = np.split(_finite(target(np.concatenate(proposed))), ends)
                for one, both, points, own in zip(
                    ensembles, halves, proposed, density, strict=True
                ):
                    one._decide(both[half], points, own)
            for one, made in zip(ensembles, new, strict=True):
                made[step] = one._points
        for one, made in zip(ensembles, new, strict=True):
            one.chain = np.concatenate([one.chain, made])


def _finite(log_density: FloatArray) -> FloatArray:
    """The densities, which may be −∞ but no less than a number."""
    if np.isnan(log_density).any():
        raise ValueError("The log density is not a number.")
    return log_density
