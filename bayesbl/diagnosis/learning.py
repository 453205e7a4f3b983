"""Which torque, or error of the encoder, explains what repeats: one after the other, by prediction.

A hypothesis is a Fourier series of one variable. Around a fit everything is linear,

    r = C z + J u + noise,

with r the whitened residual, C the derivatives by the coefficients z, J those by all that is fitted
anyway. For every group of samples (a recording, or a half of the only one) z and what all groups
share are fitted on the others, and the group is predicted; only what belongs to it alone (where it
starts, where its motor angle or its time is zero) is fitted on it. The variable, the side and the
number of orders are those that predict best.

A prediction is made before its group is seen, so exp(gain/2), a likelihood ratio, exceeds 1/α with
a probability of at most α if there is nothing (Markov), and so does the mean over the groups.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bayesbl.bench.kernel import LEARNED_HARMONICS
from bayesbl.bench.learned import EncoderError, LearnedTerm, LearnedTorque, Side, Variable
from bayesbl.recording.types import FloatArray

ORDERS = (1, 2, 3, 4, 6, 8, LEARNED_HARMONICS)
"""Numbers of orders that are tried."""

LEAST_OF_ITS_OWN = 1e-3
"""Share of a column's power that nothing else fitted makes, below which it is not fitted: its
coefficient would be thirty times as uncertain as alone."""

CHANCE_LOSS = 6.6
"""χ² that one recording may lose by chance: once in a hundred, with one degree of freedom."""

_ROUNDS = 4
_FINER = 16


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Where something could act, and what it could depend on.

    ``own_zero``: the variable's zero is another one in every recording. ``most``: orders that the
    sampling shows.
    """

    side: Side | Literal["encoder"]
    variable: Variable
    period: float
    reverses: bool = False
    own_zero: bool = False
    most: int = LEARNED_HARMONICS

    def term(self, coefficients: FloatArray) -> LearnedTerm:
        """With these coefficients: the constant, which no encoder has, cosines, sines."""
        orders = coefficients.size // 2
        constant, *waves = map(float, coefficients)
        cosine, sine = tuple(waves[:orders]), tuple(waves[orders:])
        if self.side == "encoder":
            return EncoderError(self.period, cosine, sine)
        return LearnedTorque(
            self.side, self.variable, self.period, constant, cosine, sine, self.reverses
        )


@dataclass(frozen=True, slots=True)
class Group:
    """Products of the columns [C, J, r] of some samples with one another, shape (p, p).

    C holds the constant, :data:`LEARNED_HARMONICS` cosines and as many sines; ``own``: places among
    the columns of J of what belongs to this group alone.
    """

    products: FloatArray
    own: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Trial:
    """A hypothesis with some orders.

    Attributes
    ----------
    free
        Coefficients that are fitted, by their place among constant, cosines and sines; all others
        say nothing that is not fitted anyway.
    coefficients
        Shape (2 orders + 1,), fitted on all groups; 0 where not free.
    shifts
        Of the variable in every group, relative to the first.
    gains
        χ² by which every group is predicted better than without, from the others.
    trials
        How many were tried.
    """

    hypothesis: Hypothesis
    free: tuple[int, ...]
    coefficients: FloatArray
    shifts: FloatArray
    gains: FloatArray
    trials: float

    @property
    def gain(self) -> float:
        """Over all groups."""
        return float(self.gains.sum())

    @property
    def orders(self) -> int:
        """How many."""
        return self.coefficients.size // 2

    def is_sure(self, false_alarm: float) -> bool:
        """Whether it predicts: no group is predicted clearly worse, and the mean beyond chance."""
        most = float(self.gains.max())
        log_mean = 0.5 * most + math.log(float(np.mean(np.exp(0.5 * (self.gains - most)))))
        return self.gains.min() > -CHANCE_LOSS and log_mean > math.log(self.trials / false_alarm)


def learn(
    found: Sequence[tuple[Hypothesis, Sequence[Group]]], precision: FloatArray, false_alarm: float
) -> list[Trial]:
    """Hypotheses that predict, the best first, each with the fewest orders that predict as well.

    Parameters
    ----------
    precision
        Of the prior of what is fitted anyway, shape (d, d).
    false_alarm
        Of learning anything where there is nothing.
    """
    tried = len(found) * len(ORDERS)
    every = []
    for hypothesis, groups in found:
        trials = sorted(_trials(hypothesis, groups, precision, tried), key=lambda t: -t.gain)
        every += [min(alike(trials, false_alarm), key=lambda t: t.orders)] if trials else []
    sure = [trial for trial in every if trial.is_sure(false_alarm)]
    return sorted(sure, key=lambda trial: -trial.gain)


def alike(trials: Sequence[Trial], false_alarm: float) -> list[Trial]:
    """Those that the groups do not tell from the best, it included."""
    enough = 2.0 * math.log(1.0 / false_alarm)
    return [trial for trial in trials if trials[0].gain - trial.gain < enough]


def _trials(
    hypothesis: Hypothesis, groups: Sequence[Group], precision: FloatArray, tried: int
) -> Iterator[Trial]:
    """A hypothesis with each number of orders; ``tried``: how many with all hypotheses."""
    for orders in sorted({min(orders, hypothesis.most) for orders in ORDERS}):
        free = _free(groups, hypothesis, orders)
        if not free:
            continue
        size = len(groups[0].products)
        kept = np.array([*free, *range(1 + 2 * LEARNED_HARMONICS, size)])
        chosen = [replace(g, products=g.products[np.ix_(kept, kept)]) for g in groups]
        problem = _Problem(chosen, precision, hypothesis, orders, len(free))
        everyone = range(len(chosen))
        z, _, shifts = problem.fitted(everyone)
        gains = np.array([problem.gain(k) for k in everyone])
        # Where a shift is sought on the group itself, as many places are tried as there are waves.
        trials = tried * (2.0 * orders if hypothesis.own_zero else 1.0)
        places = tuple(p if p <= orders else p - LEARNED_HARMONICS + orders for p in free)
        complete = np.zeros(2 * orders + 1)
        complete[list(places)] = z
        yield Trial(hypothesis, places, complete, shifts, gains, trials)


def _free(groups: Sequence[Group], hypothesis: Hypothesis, orders: int) -> list[int]:
    """Columns of C up to these orders that are no combination of what is fitted anyway.

    The first cosine of the load angle is a start angle, a constant may be an offset.
    """
    most = LEARNED_HARMONICS
    waves = [*range(1, 1 + orders), *range(1 + most, 1 + most + orders)]
    if hypothesis.own_zero:
        return waves
    total = np.sum([group.products for group in groups], axis=0)[:-1, :-1]
    anyway = np.s_[1 + 2 * most :]
    through = total[:, anyway] @ np.linalg.pinv(total[anyway, anyway], 1e-10, True)
    left = np.diag(total) - np.einsum("ij,ij->i", through, total[:, anyway])
    return [i for i in [0, *waves] if left[i] > LEAST_OF_ITS_OWN * total[i, i]]


class _Problem:
    """One hypothesis with so many orders."""

    def __init__(
        self,
        groups: Sequence[Group],
        precision: FloatArray,
        hypothesis: Hypothesis,
        orders: int,
        waves: int,
    ) -> None:
        self._groups, self._hypothesis, self._orders = groups, hypothesis, orders
        self._waves = waves
        self._prior = precision

    def fitted(self, members: Sequence[int]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """z, u and the shifts of all groups, fitted on these."""
        shifts = np.zeros(len(self._groups))
        if not self._hypothesis.own_zero:
            return *self._solved(members, shifts), shifts
        own = {k: self._solved([k], shifts)[0] for k in members}
        # The others are laid over the group that shows most.
        first = max(members, key=lambda k: -self._loss(k, own[k], None, 0.0))
        z = own[first]
        u: FloatArray | None = None
        for _ in range(_ROUNDS):
            for k in members:
                if k != first:
                    shifts[k] = self._best_shift(k, z, u)
            z, u = self._solved(members, shifts)
        assert u is not None
        shifts[list(members)] -= shifts[members[0]]
        return self._solved(members, shifts)[0], u, shifts

    def gain(self, left_out: int) -> float:
        """χ² by which a group is predicted better with z of the others than without it."""
        others = [k for k in range(len(self._groups)) if k != left_out]
        z, u, _ = self.fitted(others)
        nothing = np.zeros_like(z)
        without = self._solved(others, np.zeros(len(self._groups)), waves=False)[1]
        shift = self._best_shift(left_out, z, u) if self._hypothesis.own_zero else 0.0
        before = self._loss(left_out, nothing, without, 0.0)
        return before - self._loss(left_out, z, u, shift)

    def _solved(
        self, members: Sequence[int], shifts: FloatArray, waves: bool = True
    ) -> tuple[FloatArray, FloatArray]:
        parts = [self._shifted(self._groups[k].products, float(shifts[k])) for k in members]
        total = np.sum(parts, axis=0)
        w = self._waves
        matrix = np.array(total[:-1, :-1])
        matrix[w:, w:] += self._prior
        # Prior of a coefficient: that it alone makes all that is left, one standard deviation.
        matrix[np.diag_indices(w)] *= 1.0 + 1.0 / max(float(total[-1, -1]), 1.0)
        first = 0 if waves else w
        scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        normal = matrix / np.outer(scale, scale)
        right = total[:-1, -1] / scale
        solved = np.zeros(len(right))
        solved[first:] = np.linalg.lstsq(normal[first:, first:], right[first:], rcond=1e-10)[0]
        solved /= scale
        return solved[:w], solved[w:]

    def _loss(self, k: int, z: FloatArray, u: FloatArray | None, shift: float) -> float:
        """χ² of a group with z, what it alone has fitted on it; all of J where u is not given."""
        group = self._groups[k]
        products = self._shifted(group.products, shift)
        w, size = self._waves, len(products)
        own = list(range(w, size - 1)) if u is None else [w + i for i in group.own]
        given = np.zeros(size)
        given[:w], given[-1] = -z, 1.0
        if u is not None:
            given[w:-1] = -u
            given[own] = 0.0
        left = products @ given
        value = float(given @ left)
        if own:
            value -= float(left[own] @ np.linalg.lstsq(products[np.ix_(own, own)], left[own])[0])
        return value

    def _best_shift(self, k: int, z: FloatArray, u: FloatArray | None) -> float:
        """Where the group's variable begins, by a scan of the period."""
        step = self._hypothesis.period / (4 * self._orders)
        found = min(
            (step * j for j in range(4 * self._orders)), key=lambda s: self._loss(k, z, u, s)
        )
        near = (found + step * (j / _FINER) for j in range(-_FINER, _FINER + 1))
        return min(near, key=lambda s: self._loss(k, z, u, s))

    def _shifted(self, products: FloatArray, shift: float) -> FloatArray:
        """Products with the columns of C as they are with the variable shifted."""
        if shift == 0.0:
            return products
        n = self._orders
        turn = 2.0 * math.pi * shift / self._hypothesis.period * np.arange(1, n + 1)
        cosines, sines = np.arange(n), np.arange(n, 2 * n)
        change = np.eye(len(products))
        change[cosines, cosines] = change[sines, sines] = np.cos(turn)
        change[cosines, sines], change[sines, cosines] = np.sin(turn), -np.sin(turn)
        return np.asarray(change.T @ products @ change)
