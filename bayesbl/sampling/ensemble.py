"""emcee's ensembles, walked side by side.

The walk is that of emcee 3.1.6 with the same moves, to the last bit: the same random numbers are
drawn in the same order (``tests/sampling/test_ensemble.py``). Its own loop takes longer than the
densities of a small model, and asks for those of one ensemble at a time; here those of all
ensembles are asked for in one call.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from bayesbl.recording.types import FloatArray

Target = Callable[[FloatArray], FloatArray]
Walkers = NDArray[np.int_]
Proposal = Callable[[FloatArray, np.random.RandomState], tuple[FloatArray, FloatArray]]

FEWEST_WALKERS = 32
START_SPREAD = 1.5
"""Scatter of the walkers at the start, in standard deviations of the local covariance."""

FREEDOM = 5.0
"""Degrees of freedom of proposals that forget: heavier in the tails than what is sampled. They and
moves by differences take turns: where the posterior is nearly normal the chains forget four times
as fast, where it is cut off by its ranges a third more slowly."""

STEP_JITTER = 1e-5
"""Relative standard deviation of the length of a step by differences."""

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
        self._target = target
        self._points = np.clip(start, low, high)
        self._log_density = _number(target(self._points))
        self._random = np.random.RandomState(np.random.MT19937(walk_seed))
        self._anew = anew(centre, root)
        rows, columns = np.tril_indices(walkers // 2, -1)
        self._pairs = np.concatenate([rows, columns]), np.concatenate([columns, rows])
        self._step = 2.38 / np.sqrt(2 * d)  # ter Braak 2006
        self._accepted = 0
        self.chain: FloatArray = np.empty((0, walkers, d))

    @property
    def acceptance(self) -> float:
        """Share of proposals that were accepted."""
        return self._accepted / (len(self.chain) * len(self._points))

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
            turns = [one._turns() for one in ensembles]
            for turn in (0, 1):
                moving = [
                    (one, of[turn], *one._proposed(*of[turn]))
                    for one, of in zip(ensembles, turns, strict=True)
                    if turn < len(of)
                ]
                if not moving:
                    continue
                proposed = np.concatenate([points for _, _, points, _ in moving])
                density, start = _number(target(proposed)), 0
                for one, (mine, _), points, log_ratio in moving:
                    end = start + len(mine)
                    one._decide(mine, points, density[start:end], log_ratio)
                    start = end
            for one, made in zip(ensembles, new, strict=True):
                made[step] = one._points
        for one, made in zip(ensembles, new, strict=True):
            one.chain = np.concatenate([one.chain, made])

    def _turns(self) -> list[tuple[Walkers, Walkers]]:
        """Who moves, and by whom, in the turns of a step: either half by the other, or all anew.

        Differences alone, for emcee 3.1.6's ``DESnookerMove`` is biased.
        """
        walkers = np.arange(len(self._points))
        if self._random.random_sample() >= 0.5:
            return [(walkers, walkers[:0])]
        half = walkers % 2
        self._random.shuffle(half)
        first, second = np.flatnonzero(half == 0), np.flatnonzero(half == 1)
        return [(first, second), (second, first)]

    def _proposed(self, mine: Walkers, others: Walkers) -> tuple[FloatArray, FloatArray]:
        """Walkers anew, or each moved along the line between two of the others."""
        if not others.size:
            return self._anew(self._points, self._random)
        other = self._points[others]
        first, second = self._pairs
        drawn = self._random.randint(0, first.size, size=mine.size)
        along = other[second[drawn]] - other[first[drawn]]
        length = self._step * (1 + STEP_JITTER * self._random.randn(mine.size, 1))
        return self._points[mine] + length * along, np.zeros(mine.size)

    def _decide(
        self, mine: Walkers, proposed: FloatArray, log_density: FloatArray, log_ratio: FloatArray
    ) -> None:
        """Metropolis and Hastings, walker by walker."""
        with np.errstate(invalid="ignore"):  # a walker that starts where nothing is
            gain = log_density - self._log_density[mine] + log_ratio
        taken = gain > np.log(self._random.rand(mine.size))
        self._points[mine[taken]] = proposed[taken]
        self._log_density[mine[taken]] = log_density[taken]
        self._accepted += int(taken.sum())


def _number(log_density: FloatArray) -> FloatArray:
    """The densities, which may be −∞."""
    if np.isnan(log_density).any():
        raise ValueError("The log density is not a number.")
    return log_density
