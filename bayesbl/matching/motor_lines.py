"""Marginalise what repeats with the motor: cogging, ripple and errors of the motor's encoder.

Every real motor has them, and no joint's data sheet states them, while a gap acts once per flank
change of the load. So any function of the motor angle in a channel is integrated out under a flat
prior. Residuals r become

    r − H (HᵀH)⁺ Hᵀ r + mean of r,

where the columns of H are hat functions over a turn of the motor. Their sum is constant, and the
mean stays because friction determines it. Recording, simulation and derivatives are projected
alike, so there is no bias. Of the load's signal, one part in the gear ratio is lost.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayesbl.compiled import compiled
from bayesbl.recording.types import BoolArray, FloatArray

MOST_SHARE = 0.01
"""Largest number of columns of H per sample."""
FEWEST_HATS, MOST_HATS = 8, 256
"""A sine of order k is represented with an error of (2π k/hats)²/12: 5 % at order 30."""
SMALLEST = 1e-9
"""Relative eigenvalue of HᵀH below which a column is a combination of the others."""


@dataclass(frozen=True, eq=False)
class MotorLines:
    """Functions of the motor's angle over the samples of a recording.

    Attributes
    ----------
    turns
        Motor turns at each sample, shape (n,).
    kept
        Compared samples, shape (n,).
    """

    turns: FloatArray
    kept: BoolArray

    @cached_property
    def count(self) -> int:
        """Number of hats b; zero if there are too few samples."""
        count = min(int(MOST_SHARE * self.kept.sum()), MOST_HATS)
        return count if count >= FEWEST_HATS else 0

    @cached_property
    def interpolation(self) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
        """Index of the hat before each sample, and the weights of it and of the next, (n,) each."""
        place = self.turns % 1.0 * self.count
        before = np.floor(place).astype(np.int64)
        share = place - before
        return before % self.count, (1.0 - share) * self.kept, share * self.kept

    @cached_property
    def inverse(self) -> FloatArray:
        """(HᵀH)⁺, shape (b, b)."""
        before, weight, next_weight = self.interpolation
        gram = np.zeros((self.count, self.count))
        hat = np.arange(self.count)
        after = (hat + 1) % self.count
        gram[hat, hat] = np.bincount(before, weight**2, self.count)
        gram[after, after] += np.bincount(before, next_weight**2, self.count)
        gram[hat, after] = gram[after, hat] = np.bincount(before, weight * next_weight, self.count)
        return np.asarray(np.linalg.pinv(gram, rcond=SMALLEST, hermitian=True))

    def project_out(self, rows: FloatArray) -> None:
        """Remove what repeats with the motor from rows of the last samples, (…, m)."""
        if not self.count:
            return
        first = self.kept.size - rows.shape[-1]
        # The hats add up to one, so subtracting 1/n from the weights keeps the mean.
        weights = self.inverse - 1.0 / self.kept[first:].sum()
        before, weight, next_weight = (values[first:] for values in self.interpolation)
        for index in np.ndindex(rows.shape[:-1]):
            _project_out(rows[index], before, weight, next_weight, weights)


@compiled(nogil=True, fastmath={"reassoc", "contract"})
def _project_out(row, before, weight, next_weight, weights):  # type: ignore[no-untyped-def]
    """row − H W Hᵀ row, in place, (m,)."""
    count = len(weights)
    projection = np.zeros(count + 1)
    for i in range(row.size):
        projection[before[i]] += weight[i] * row[i]
        projection[before[i] + 1] += next_weight[i] * row[i]
    projection[0] += projection[count]
    coefficients = np.zeros(count + 1)
    for j in range(count):
        for k in range(count):
            coefficients[j] += weights[j, k] * projection[k]
    coefficients[count] = coefficients[0]
    for i in range(row.size):
        row[i] -= weight[i] * coefficients[before[i]] + next_weight[i] * coefficients[before[i] + 1]
