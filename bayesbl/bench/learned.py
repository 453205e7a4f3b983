"""Torques and encoder errors that no effect of the catalogue explains, as Fourier series.

    a_0 + Σ_k a_k cos(2π k x/X) + b_k sin(2π k x/X),    X the period of x

A torque acts against the motor or the load, as a function of the motor angle, the load angle, the
motor speed or time. An error of the encoder is the difference between the shown and the true motor
angle, as a function of that angle, and inside the loop:

    θ_meas = θ_m + ε(θ_m),    ω_meas = ω_m (1 + dε/dθ_m)

Both are known only by what they depend on. The zero of a motor angle or a time belongs to a
recording, not to the bench. The slot ``shift`` is therefore an unknown of each recording.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bayesbl.bench.effect_declaration import RigidMotion
from bayesbl.bench.kernel import LEARNED_HARMONICS, Slot
from bayesbl.errors import BenchError
from bayesbl.recording.types import FloatArray

Side = Literal["motor", "load"]
Variable = Literal["motor_angle", "load_angle", "motor_speed", "time"]
VARIABLES: tuple[Variable, ...] = ("motor_angle", "load_angle", "motor_speed", "time")
"""In the order of the kernel's numbers."""

ENCODER: Literal["encoder"] = "encoder"
LEARNED_TORQUE, ENCODER_ERROR = "learned_torque", "encoder_error"
"""Kinds of term: names of blocks of slots, in bench files and in results."""


@dataclass(frozen=True, slots=True)
class LearnedTerm:
    """A learned torque, N m at the side where it acts; or a learned encoder error, rad.

    If it ``reverses``, it is multiplied by the sign of the motor's speed, like friction.

    Attributes
    ----------
    period
        X, in rad, rad/s or s; for an encoder error a turn of the motor, or a whole fraction of it.
    constant
        a_0. An encoder error has none: it is part of the angle's zero.
    cosine, sine
        Coefficients of the orders 1, 2, …, of equal length, at most :data:`LEARNED_HARMONICS`.
    sd
        Standard deviation of each coefficient in the order of ``names``; empty if they are taken as
        known.
    """

    side: Side | Literal["encoder"]
    variable: Variable
    period: float
    constant: float
    cosine: tuple[float, ...]
    sine: tuple[float, ...]
    reverses: bool = False
    sd: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        self._check_series()
        if self.side == "load" and self.variable == "motor_angle":
            raise BenchError(
                "A torque over the motor's angle acts at the motor.",
                where=f"{self.block} side",
                found='"load"',
                expected='"motor"',
            )
        if self.is_of_encoder and (steepest := float(np.sum(self.slopes))) >= 1.0:
            raise BenchError(
                "With this error the encoder would run backwards.",
                where=self.block,
                found=f"a slope of up to {steepest:.3g} rad for each rad of the motor",
                expected="less than 1",
            )

    def _check_series(self) -> None:
        subject = "An error of the encoder" if self.is_of_encoder else "A learned torque"
        orders = self.orders
        if not (len(self.sine) == orders and 0 < orders <= LEARNED_HARMONICS):
            raise BenchError(
                f"{subject} has as many sines as cosines, one of each for every order.",
                where=self.block,
                found=f"{orders} cosines, {len(self.sine)} sines",
                expected=f"from 1 to {LEARNED_HARMONICS} of each",
            )
        if len(self.sd) not in (0, len(self.names)):
            raise BenchError(
                f"{subject} has a standard deviation for each coefficient, or none.",
                where=f"{self.block} sd",
                found=f"{len(self.sd)} numbers",
                expected=f"{len(self.names)}, cosines before sines, a constant before both",
            )
        if not (self.period > 0.0 and math.isfinite(self.period)):
            raise BenchError(
                f"{subject} repeats over its variable.",
                where=f"{self.block} period",
                found=f"{self.period:g}",
                expected="a number above zero",
            )

    @property
    def is_of_encoder(self) -> bool:
        """Whether it is an error of the encoder, not a torque."""
        return self.side == ENCODER

    @property
    def block(self) -> str:
        """Its name in bench files, and the prefix of its slots."""
        return ENCODER_ERROR if self.is_of_encoder else LEARNED_TORQUE

    @property
    def period_slot(self) -> str:
        """Slot of X."""
        return f"{self.block}__period" + ("_rad" if self.is_of_encoder else "")

    @property
    def shift_slot(self) -> str:
        """Slot of the shift that is added to the variable."""
        return f"{self.block}__shift" + ("_rad" if self.is_of_encoder else "")

    @property
    def belongs_to_recordings(self) -> bool:
        """Whether the zero of the variable differs between recordings."""
        return self.variable in ("motor_angle", "time")

    @property
    def orders(self) -> int:
        """Number of orders."""
        return len(self.cosine)

    @property
    def names(self) -> tuple[str, ...]:
        """Slots of the coefficients: the constant (of a torque), the cosines, the sines."""
        numbers = range(1, 1 + self.orders)
        names = [f"{wave}_{k}" for wave in ("cosine", "sine") for k in numbers]
        if self.is_of_encoder:
            return tuple(f"{self.block}__{name}_rad" for name in names)
        return tuple(f"{self.block}__{name}_nm" for name in ("constant", *names))

    @property
    def coefficients(self) -> tuple[float, ...]:
        """Coefficients in the order of ``names``."""
        return (*(() if self.is_of_encoder else (self.constant,)), *self.cosine, *self.sine)

    @property
    def slopes(self) -> FloatArray:
        """Amplitude of each order in dε/dθ: the speed's error over the speed, shape (orders,)."""
        sizes = np.hypot(self.cosine, self.sine)
        return np.asarray(2.0 * math.pi / self.period * np.arange(1, 1 + self.orders) * sizes)

    def fitted(self, values: Mapping[str, float], sds: Mapping[str, float]) -> LearnedTerm:
        """The term with these values and standard deviations, by slot; missing ones stay."""
        n, names = self.orders, self.names
        coefficients = [
            values.get(name, c) for name, c in zip(names, self.coefficients, strict=True)
        ]
        old_sd = self.sd or (0.0,) * len(names)
        return replace(
            self,
            period=values.get(self.period_slot, self.period),
            constant=self.constant if self.is_of_encoder else coefficients[0],
            cosine=tuple(coefficients[-2 * n : -n]),
            sine=tuple(coefficients[-n:]),
            sd=tuple(sds.get(name, sd) for name, sd in zip(names, old_sd, strict=True)),
        )

    def put_into(self, vector: FloatArray) -> None:
        """Fill its slots of a parameter vector, shape (SLOTS,)."""
        if self.is_of_encoder:
            vector[Slot.encoder_error__orders] = self.orders
        else:
            vector[Slot.learned_torque__side] = 1.0 + (self.side == "load")
            vector[Slot.learned_torque__variable] = VARIABLES.index(self.variable)
            vector[Slot.learned_torque__reverses] = float(self.reverses)
        vector[Slot[self.period_slot]] = self.period
        for name, value in zip(self.names, self.coefficients, strict=True):
            vector[Slot[name]] = value

    def over(self, x: FloatArray) -> FloatArray:
        """Its value at values of its variable, shape as ``x``; of a torque in forward motion."""
        cosines, sines = waves_over(x, self.period, self.orders)
        waves = cosines @ np.array(self.cosine) + sines @ np.array(self.sine)
        return np.asarray(self.constant + waves)

    def along(self, motion: RigidMotion, gear_ratio: float) -> FloatArray:
        """The torque against a rigid bench, at the motor, N m, shape (n,)."""
        torque = self.over(variable_of(self.variable, motion, gear_ratio))
        if self.reverses:
            torque = torque * np.sign(motion.speed)
        return np.asarray(torque / (gear_ratio if self.side == "load" else 1.0))


def variable_of(variable: Variable, motion: RigidMotion, gear_ratio: float) -> FloatArray:
    """Values of the variable that a torque of a rigid bench depends on, shape (n,)."""
    return {
        "motor_angle": motion.angle,
        "load_angle": motion.angle / gear_ratio,
        "motor_speed": motion.speed,
        "time": motion.time_s,
    }[variable]


def waves_over(x: FloatArray, period: float, orders: int) -> tuple[FloatArray, FloatArray]:
    """Cosines and sines of the orders 1, 2, … at these values, each shape (…, orders)."""
    phase = 2.0 * math.pi * np.multiply.outer(x, np.arange(1, 1 + orders)) / period
    return np.cos(phase), np.sin(phase)
