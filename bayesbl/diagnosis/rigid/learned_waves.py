"""Waves of a torque that is being learned on a rigid bench, fitted together with what is named.

    τ = a_0 + Σ_k a_k (cos(2π k x/X) − c_k) + b_k (sin(2π k x/X) − s_k)   (· sign ω if it reverses)

c_k and s_k are the means of the waves over the places recorded: what is learned is then the
departure from a mean that belongs to a name, as friction that depends on the position is Coulomb's
and its departure. Without them a mean over the period X would be told, most of it not recorded.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from bayesbl.bench.learned import LearnedTorque
from bayesbl.diagnosis.learning import Hypothesis
from bayesbl.diagnosis.rigid.motion import Motion
from bayesbl.recording.types import FloatArray


@dataclass(frozen=True, slots=True)
class LearnedWaves:
    """What is free of a torque: combinations of its coefficients, as many as are seen.

    Attributes
    ----------
    orders
        How many; the coefficients are the constant, so many cosines, so many sines.
    changes
        Of the coefficients by one of each that is free, N m, shape (2 orders + 1, free).
    """

    hypothesis: Hypothesis
    orders: int
    changes: FloatArray

    @property
    def names(self) -> tuple[str, ...]:
        """Of what is free, in a fit."""
        return tuple(f"learned wave {k}" for k in range(self.changes.shape[1]))

    def by_name(self, gear_ratio: float) -> dict[str, Callable[[Motion], FloatArray]]:
        """What one of each that is free adds along a motion, N m, shape (n,)."""

        def of(k: int) -> Callable[[Motion], FloatArray]:
            torque = self._term(self.changes[:, k])
            return lambda motion: torque.along(motion, gear_ratio)

        return {name: of(k) for k, name in enumerate(self.names)}

    def torque(
        self, values: Mapping[str, float], covariance: FloatArray | None = None
    ) -> LearnedTorque:
        """With these values by name, and their covariance, shape (free, free)."""
        torque = self._term(self.changes @ np.array([values[name] for name in self.names]))
        if covariance is None:
            return torque
        variances = np.einsum("ik,kl,il->i", self.changes, covariance, self.changes)
        return replace(torque, sd_nm=tuple(map(float, np.sqrt(np.maximum(variances, 0.0)))))

    def _term(self, coefficients: FloatArray) -> LearnedTorque:
        term = self.hypothesis.term(coefficients)
        assert isinstance(term, LearnedTorque)
        return term


def wave_of(hypothesis: Hypothesis, orders: int, place: int, x: FloatArray) -> FloatArray:
    """Cosine or sine of a coefficient, by its place, over these values, shape as ``x``."""
    cosine = place <= orders
    order = place if cosine else place - orders
    phase = 2.0 * math.pi * order * x / hypothesis.period
    return np.asarray(np.cos(phase) if cosine else np.sin(phase))
