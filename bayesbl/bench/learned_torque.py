"""A torque that recordings showed and that no effect of the catalogue explains.

    τ = a_0 + Σ_k a_k cos(2π k x/X) + b_k sin(2π k x/X),    against the motor or the load

x is the motor's angle, the load's angle, the motor's speed or the time, X its period. Where the
torque ``reverses``, it is multiplied by the sign of the motor's speed, as friction is. It has no
name but what it depends on. The zero of a motor angle or a time belongs to a recording, not to the
bench: there ``learned_torque__shift`` is an unknown of each recording.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayesbl.bench.effect_declaration import RigidMotion
from bayesbl.bench.kernel import FIRST_COSINE, FIRST_SINE, LEARNED_HARMONICS, Slot
from bayesbl.errors import BenchError
from bayesbl.recording.types import FloatArray

LEARNED_TORQUE = "learned_torque"
SHIFT = "learned_torque__shift"

Side = Literal["motor", "load"]
Variable = Literal["motor_angle", "load_angle", "motor_speed", "time"]
SIDES: tuple[Side, ...] = ("motor", "load")
VARIABLES: tuple[Variable, ...] = ("motor_angle", "load_angle", "motor_speed", "time")
"""In the order of the kernel's numbers."""

UNIT_OF_VARIABLE = {
    "motor_angle": "rad",
    "load_angle": "rad",
    "motor_speed": "rad/s",
    "time": "s",
}


@dataclass(frozen=True, slots=True)
class LearnedTorque:
    """The coefficients, N m at the side that the torque acts at.

    Attributes
    ----------
    period
        X, in rad, rad/s or s.
    cosine_nm, sine_nm
        Of the orders 1, 2, …, one as long as the other, at most :data:`LEARNED_HARMONICS`.
    sd_nm
        Standard deviation of each coefficient: the constant's, the cosines', the sines'; empty
        where they are taken as known.
    """

    side: Side
    variable: Variable
    period: float
    constant_nm: float
    cosine_nm: tuple[float, ...]
    sine_nm: tuple[float, ...]
    reverses: bool = False
    sd_nm: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        orders = len(self.cosine_nm)
        if not (len(self.sine_nm) == orders and 0 < orders <= LEARNED_HARMONICS):
            raise BenchError(
                "A learned torque has as many sines as cosines, one of each for every order.",
                where=LEARNED_TORQUE,
                found=f"{orders} cosines, {len(self.sine_nm)} sines",
                expected=f"from 1 to {LEARNED_HARMONICS} of each",
            )
        if len(self.sd_nm) not in (0, 2 * orders + 1):
            raise BenchError(
                "A learned torque has a standard deviation for each coefficient, or none.",
                where=f"{LEARNED_TORQUE} sd_nm",
                found=f"{len(self.sd_nm)} numbers",
                expected=f"{2 * orders + 1}: constant, cosines, sines",
            )
        if not (self.period > 0.0 and math.isfinite(self.period)):
            raise BenchError(
                "A learned torque repeats over its variable.",
                where=f"{LEARNED_TORQUE} period",
                found=f"{self.period:g}",
                expected="a number above zero",
            )
        if self.side == "load" and self.variable == "motor_angle":
            raise BenchError(
                "A torque over the motor's angle acts at the motor.",
                where=f"{LEARNED_TORQUE} side",
                found='"load"',
                expected='"motor"',
            )

    @property
    def belongs_to_recordings(self) -> bool:
        """Whether the variable's zero is another one in every recording."""
        return self.variable in ("motor_angle", "time")

    @property
    def names(self) -> tuple[str, ...]:
        """Slots of the coefficients, in the order of ``sd_nm``."""
        return coefficient_names(len(self.cosine_nm))

    @property
    def coefficients(self) -> tuple[float, ...]:
        """In the order of ``names``."""
        return (self.constant_nm, *self.cosine_nm, *self.sine_nm)

    def put_into(self, vector: FloatArray) -> None:
        """Fill its places of a parameter vector, shape (SLOTS,)."""
        vector[Slot.learned_torque__side] = 1.0 + SIDES.index(self.side)
        vector[Slot.learned_torque__variable] = VARIABLES.index(self.variable)
        vector[Slot.learned_torque__reverses] = float(self.reverses)
        vector[Slot.learned_torque__period] = self.period
        vector[Slot.learned_torque__constant_nm] = self.constant_nm
        orders = len(self.cosine_nm)
        vector[FIRST_COSINE : FIRST_COSINE + orders] = self.cosine_nm
        vector[FIRST_SINE : FIRST_SINE + orders] = self.sine_nm

    def over(self, x: FloatArray) -> FloatArray:
        """The torque at these values of its variable, shape as ``x``, N m; forwards."""
        found = np.full(np.shape(x), self.constant_nm)
        for k, (a, b) in enumerate(zip(self.cosine_nm, self.sine_nm, strict=True), start=1):
            phase = 2.0 * math.pi * k * np.asarray(x) / self.period
            found += a * np.cos(phase) + b * np.sin(phase)
        return np.asarray(found)

    def along(self, motion: RigidMotion, gear_ratio: float) -> FloatArray:
        """The torque against a rigid bench, at the motor, N m, shape (n,)."""
        torque = self.over(variable_of(self.variable, motion, gear_ratio))
        if self.reverses:
            torque = torque * np.sign(motion.speed)
        return np.asarray(torque / (gear_ratio if self.side == "load" else 1.0))


def variable_of(variable: Variable, motion: RigidMotion, gear_ratio: float) -> FloatArray:
    """What a torque of a rigid bench depends on, shape (n,)."""
    return {
        "motor_angle": motion.angle,
        "load_angle": motion.angle / gear_ratio,
        "motor_speed": motion.speed,
        "time": motion.time_s,
    }[variable]


def coefficient_names(orders: int) -> tuple[str, ...]:
    """Slots of the constant, the cosines and the sines of so many orders."""
    numbers = range(1, orders + 1)
    cosines = (f"{LEARNED_TORQUE}__cosine_{k}_nm" for k in numbers)
    sines = (f"{LEARNED_TORQUE}__sine_{k}_nm" for k in numbers)
    return (f"{LEARNED_TORQUE}__constant_nm", *cosines, *sines)
