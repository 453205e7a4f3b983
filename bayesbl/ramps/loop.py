"""The loop of position over torque by play, compliance and friction.

With e the torque behind the friction, the joint is at

    f(e) = θ_0 + b tanh(e/s) + c e

where 2b is what it crosses within a torque of some s (play, for a small s; soft contact, for a
larger one) and c the compliance of the flanks. It moves only where the torque exceeds the friction
T, so on the way up it follows f(τ − T), on the way down f(τ + T), and rests in between (the
generalised play operator; Krasnosel'skiĭ and Pokrovskiĭ 1989):

    θ_k = min(max(θ_{k−1}, f(τ_k − T)), f(τ_k + T))

A real loop has steps where the friction changes with the position, and is not this one. So it does
not decide the play: it is drawn, and how far it is off is stored.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
from scipy.optimize import least_squares

from bayesbl.ramps.torque_cycles import Cycle, left_rad
from bayesbl.recording.types import FloatArray

POINTS_FITTED = 400


@dataclass(frozen=True, slots=True)
class LoopModel:
    """θ_0, b, s, c and T above, in rad, N m and rad/(N m)."""

    middle_rad: float
    half_crossing_rad: float
    spread_nm: float
    flank_rad_per_nm: float
    friction_nm: float

    @classmethod
    def fitted(
        cls, cycles: Sequence[Cycle], torque_nm: FloatArray, position_rad: FloatArray
    ) -> LoopModel:
        """By least squares in position along a path of torque, from what its cycles left."""
        step = max(1, torque_nm.size // POINTS_FITTED)
        torque, position = torque_nm[::step], position_rad[::step]
        begin = cls._of(cycles)
        scale = np.maximum(np.abs(astuple(begin)), 1e-9)
        scale[0] = max(begin.half_crossing_rad, 1e-9)
        low = np.array([-np.inf, 0.0, 1e-3 * begin.spread_nm, 0.0, 0.0])
        found = least_squares(
            lambda point: (cls(*point).follow(torque, position[0]) - position) / scale[0],
            np.maximum(astuple(begin), low),
            bounds=(low, np.inf),
            x_scale=scale,
            diff_step=1e-3,
            max_nfev=30,
        )
        return cls(*(float(value) for value in found.x))

    @classmethod
    def _of(cls, cycles: Sequence[Cycle]) -> LoopModel:
        width, reach, elastic, friction, amplitude = (
            float(np.mean([getattr(c, name) for c in cycles]))
            for name in ("width_rad", "range_rad", "elastic_nm", "friction_nm", "amplitude_nm")
        )
        compliance = max(reach - width, 0.0) / (2.0 * amplitude)
        return cls(
            float(np.mean(left_rad(cycles))),
            max(0.5 * width, 1e-9),
            max(0.25 * elastic, 1e-3 * amplitude),
            compliance,
            friction,
        )

    def balanced(self, elastic_nm: FloatArray) -> FloatArray:
        """f: position by the torque behind the friction, same shape."""
        crossing = self.half_crossing_rad * np.tanh(elastic_nm / self.spread_nm)
        return np.asarray(self.middle_rad + crossing + self.flank_rad_per_nm * elastic_nm)

    def follow(self, torque_nm: FloatArray, start_rad: float) -> FloatArray:
        """Position along a path of torque, from a position at its start, shape (n,)."""
        lower = self.balanced(torque_nm - self.friction_nm).tolist()
        upper = self.balanced(torque_nm + self.friction_nm).tolist()
        found, at = [], float(start_rad)
        for least, most in zip(lower, upper, strict=True):
            at = min(max(at, least), most)
            found.append(at)
        return np.array(found)
