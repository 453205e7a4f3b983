"""What is known of several bench parameters together: their logarithms are normal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesbl.recording.types import FloatArray

FURTHEST = 5.0
"""Standard deviations that a parameter may be from its value: further by chance once in two
million; one that is there contradicts what it was identified from."""


@dataclass(frozen=True, slots=True, eq=False)
class JointNormal:
    """ln p ~ N(ln of the bench's values, covariance).

    Attributes
    ----------
    names
        Of k bench parameters, all above zero.
    covariance
        Of their logarithms, shape (k, k), positive definite.
    sources
        SHA-256 of the files that it was learned from.
    """

    names: tuple[str, ...]
    covariance: FloatArray
    sources: tuple[str, ...] = ()

    def sd(self, name: str) -> float:
        """Standard deviation of the logarithm of one parameter: about its relative one."""
        i = self.names.index(name)
        return float(np.sqrt(self.covariance[i, i]))

    def range(self, name: str, value: float) -> tuple[float, float, float]:
        """Lowest, middle and highest logarithm that a parameter of this value may have."""
        middle, reach = math.log(value), FURTHEST * self.sd(name)
        return middle - reach, middle, middle + reach

    def whitening(self, names: Sequence[str]) -> FloatArray:
        """W with Wᵀ W the inverse covariance of these parameters' logarithms, shape (n, n)."""
        index = [self.names.index(name) for name in names]
        root = np.linalg.cholesky(self.covariance[np.ix_(index, index)])
        return np.asarray(np.linalg.inv(root))

    def draw(self, rng: np.random.Generator, count: int) -> FloatArray:
        """Factors of the values, shape (count, k)."""
        root = np.linalg.cholesky(self.covariance)
        return np.exp(rng.standard_normal((count, len(self.names))) @ root.T)
