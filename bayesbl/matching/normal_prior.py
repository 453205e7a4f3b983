"""Normal priors of unknowns: of each alone, and of several bench parameters together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesbl.bench.parameters import JointNormal
from bayesbl.recording.types import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class NormalPrior:
    """The density exp(−½ Σ ((x − c)/s)² − ½|W (x − c)|²).

    Attributes
    ----------
    centre
        c, shape (d,).
    sd
        s of each unknown alone, shape (d,); infinite where it has none, or one with others.
    together
        W, shape (k, d), of those that have one together.
    """

    centre: FloatArray
    sd: FloatArray
    together: FloatArray

    @classmethod
    def of(
        cls,
        centre: FloatArray,
        sd: FloatArray,
        shared: Sequence[str | None],
        joint: JointNormal | None,
    ) -> NormalPrior:
        """Made of what each unknown states of itself, and of the bench's joint prior.

        ``shared``: names of those that all recordings share, ``None`` for others.
        """
        joined = [] if joint is None else [i for i, n in enumerate(shared) if n in joint.names]
        together = np.zeros((len(joined), centre.size))
        if joint is not None and joined:
            together[:, joined] = joint.whitening([str(shared[i]) for i in joined])
        alone = sd.copy()
        alone[joined] = np.inf
        return cls(centre, alone, together)

    @property
    def precision(self) -> FloatArray:
        """Inverse covariance, 0 for what has no normal prior, shape (d, d)."""
        return np.asarray(np.diag(self.sd**-2.0) + self.together.T @ self.together)

    def deviations(self, point: FloatArray) -> FloatArray:
        """Centre minus coordinate, whitened, shape (k,)."""
        alone = (self.centre - point) / self.sd
        return np.concatenate([alone[np.isfinite(self.sd)], self.together @ (self.centre - point)])

    def log_density(self, points: FloatArray) -> FloatArray:
        """Up to a constant, shape (m, d) to (m,)."""
        away = points - self.centre
        density = -0.5 * ((away / self.sd) ** 2).sum(axis=1)
        return np.asarray(density - 0.5 * ((away @ self.together.T) ** 2).sum(axis=1))

    def log_densities(self, points: FloatArray) -> FloatArray:
        """Of each coordinate given those before it, up to constants, shape (m, d) to (m, d)."""
        away = points - self.centre
        densities = -0.5 * (away / self.sd) ** 2
        # W is the inverse of a lower triangular root: a row for each coordinate, given the former.
        joined = np.flatnonzero(np.any(self.together != 0.0, axis=0))
        densities[:, joined] -= 0.5 * (away @ self.together.T) ** 2
        return np.asarray(densities)
