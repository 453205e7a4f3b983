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
import scipy.sparse as sp

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
    def hats(self) -> sp.csr_array:
        """H, shape (n, b); without columns where the samples are too few."""
        count = min(int(MOST_SHARE * self.kept.sum()), MOST_HATS)
        if count < FEWEST_HATS:
            return sp.csr_array((self.turns.size, 0))
        place = self.turns % 1.0 * count
        before = np.floor(place).astype(int)
        share = place - before
        rows = np.arange(self.turns.size)
        return sp.csr_array(
            (
                np.concatenate([1.0 - share, share]) * np.tile(self.kept, 2),
                (np.tile(rows, 2), np.concatenate([before, before + 1]) % count),
            ),
            shape=(self.turns.size, count),
        )

    @cached_property
    def inverse(self) -> FloatArray:
        """(HᵀH)⁺, shape (b, b)."""
        gram = (self.hats.T @ self.hats).toarray()
        return np.asarray(np.linalg.pinv(gram, rcond=SMALLEST, hermitian=True))

    def taken_from(self, rows: FloatArray) -> FloatArray:
        """Rows of the recording's last samples without what turns with the motor, shape (…, m)."""
        if not self.hats.shape[1]:
            return rows
        first = self.kept.size - rows.shape[-1]
        left = np.zeros((*rows.shape[:-1], self.kept.size))
        left[..., first:] = rows
        # The hats add up to one, so this takes the constant too.
        weights, across = self.inverse - 1.0 / self.kept[first:].sum(), self.hats.T
        for row in left.reshape(-1, self.kept.size):
            row -= self.hats @ (weights @ (across @ row))
        return left[..., first:]
