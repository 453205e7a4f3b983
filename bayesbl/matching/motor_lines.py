"""What turns with the motor, marginalised: cogging, ripple and errors of the motor's encoder.

Every real motor has them and no data sheet of a joint says how much, while a gap acts once in a
flank change of the load. So whatever function of the motor's angle a channel holds is integrated
out under a flat prior: residuals r become

    r − H (HᵀH)⁺ Hᵀ r + mean of r,

the columns of H hats over a turn of the motor; their sum, a constant, is friction's. Recording,
simulation and derivatives all lose it alike, so nothing is biased; of what the load does, one part
in the gear ratio goes with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayesbl.compiled import compiled
from bayesbl.recording.types import BoolArray, FloatArray

MOST_SHARE = 0.01
"""Of the samples that is spent on lines of the motor: columns of H over samples."""
FEWEST_HATS, MOST_HATS = 8, 256
"""A sine of order k is represented to (2π k/hats)²/12: 5 % of order 30."""
SMALLEST = 1e-9
"""Eigenvalue of HᵀH over the largest below which a column is a combination of the others."""


@dataclass(frozen=True, eq=False)
class MotorLines:
    """Functions of the motor's angle over the samples of a recording.

    Attributes
    ----------
    turns
        Of the motor at each sample, shape (n,).
    kept
        Samples that are compared, shape (n,).
    """

    turns: FloatArray
    kept: BoolArray

    @cached_property
    def count(self) -> int:
        """Number of hats b; none where the samples are too few."""
        count = min(int(MOST_SHARE * self.kept.sum()), MOST_HATS)
        return count if count >= FEWEST_HATS else 0

    @cached_property
    def place(self) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
        """The hat before each sample, and what the sample has of it and of the next, (n,) each."""
        place = self.turns % 1.0 * self.count
        before = np.floor(place).astype(np.int64)
        share = place - before
        return before % self.count, (1.0 - share) * self.kept, share * self.kept

    @cached_property
    def inverse(self) -> FloatArray:
        """(HᵀH)⁺, shape (b, b)."""
        before, own, next_ = self.place
        gram = np.zeros((self.count, self.count))
        hat = np.arange(self.count)
        after = (hat + 1) % self.count
        gram[hat, hat] = np.bincount(before, own**2, self.count)
        gram[after, after] += np.bincount(before, next_**2, self.count)
        gram[hat, after] = gram[after, hat] = np.bincount(before, own * next_, self.count)
        return np.asarray(np.linalg.pinv(gram, rcond=SMALLEST, hermitian=True))

    def project_out(self, rows: FloatArray) -> None:
        """Remove from rows of the recording's last samples, (…, m), what turns with the motor."""
        if not self.count:
            return
        first = self.kept.size - rows.shape[-1]
        # The hats add up to one, so this takes the constant too.
        weights = self.inverse - 1.0 / self.kept[first:].sum()
        before, own, next_ = (values[first:] for values in self.place)
        for index in np.ndindex(rows.shape[:-1]):
            _project_out(rows[index], before, own, next_, weights)


@compiled(nogil=True, fastmath={"reassoc", "contract"})
def _project_out(row, before, own, after, weights):  # type: ignore[no-untyped-def]
    """row − H W Hᵀ row, in place, (m,)."""
    count = len(weights)
    across = np.zeros(count + 1)
    for i in range(row.size):
        across[before[i]] += own[i] * row[i]
        across[before[i] + 1] += after[i] * row[i]
    across[0] += across[count]
    size = np.zeros(count + 1)
    for j in range(count):
        for k in range(count):
            size[j] += weights[j, k] * across[k]
    size[count] = size[0]
    for i in range(row.size):
        row[i] -= own[i] * size[before[i]] + after[i] * size[before[i] + 1]
