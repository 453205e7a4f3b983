"""The loop of position over torque by play, compliance and friction.

With e the torque behind the friction, the joint is at f(e): across the play by a compliance of its
own, beyond it by that of the flank, which is another one. It moves only where the torque exceeds
the friction T, so on the way up it follows f(τ − T), on the way down f(τ + T), and rests in
between (the generalised play operator; Krasnosel'skiĭ and Pokrovskiĭ 1989):

    θ_k = min(max(θ_{k−1}, f(τ_k − T)), f(τ_k + T))
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesbl.ramps.cycles import Cycle
from bayesbl.recording.types import FloatArray


@dataclass(frozen=True, slots=True)
class LoopModel:
    """A loop with the width, range and height that cycles were measured to have.

    Attributes
    ----------
    middle_rad, half_width_rad
        Of the positions left at zero torque.
    knee_nm
        Torque behind the friction at these positions.
    flank_rad_per_nm
        Compliance beyond them.
    """

    middle_rad: float
    half_width_rad: float
    knee_nm: float
    friction_nm: float
    flank_rad_per_nm: float

    @classmethod
    def of(cls, cycles: Sequence[Cycle]) -> LoopModel:
        """With the means of cycles of one file and amplitude."""
        left = {
            side: np.mean([e.left_rad for c in cycles for e in (c.first, c.last) if e.side == side])
            for side in (-1, 1)
        }
        width, reach = (
            float(np.mean([getattr(c, name) for c in cycles])) for name in ("width_rad", "range_rad")
        )
        knee = 0.5 * float(np.mean([c.elastic_nm for c in cycles]))
        friction = float(np.mean([c.friction_nm for c in cycles]))
        amplitude = float(np.mean([c.amplitude_nm for c in cycles]))
        beyond = max(amplitude - friction - knee, 1e-3 * amplitude)
        flank = max(reach - width, 0.0) / (2.0 * beyond)
        return cls(
            0.5 * float(left[1] + left[-1]), 0.5 * width, max(knee, 1e-9), friction, flank
        )

    def left_rad(self, side: int) -> float:
        """The position that torque on this side leaves."""
        return self.middle_rad + side * self.half_width_rad

    def balanced(self, elastic_nm: FloatArray) -> FloatArray:
        """f: position by the torque behind the friction, same shape."""
        inside = np.clip(elastic_nm / self.knee_nm, -1.0, 1.0) * self.half_width_rad
        over = np.maximum(np.abs(elastic_nm) - self.knee_nm, 0.0) * np.sign(elastic_nm)
        return np.asarray(self.middle_rad + inside + self.flank_rad_per_nm * over)

    def follow(self, torque_nm: FloatArray, start_rad: float) -> FloatArray:
        """Position along a path of torque, from a position at its start, shape (n,)."""
        lower = self.balanced(torque_nm - self.friction_nm)
        upper = self.balanced(torque_nm + self.friction_nm)
        found, at = np.empty_like(torque_nm), start_rad
        for k in range(torque_nm.size):
            at = min(max(at, lower[k]), upper[k])
            found[k] = at
        return found
