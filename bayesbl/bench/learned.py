"""What recordings showed and no effect of the catalogue explains, as a Fourier series.

    a_0 + Σ_k a_k cos(2π k x/X) + b_k sin(2π k x/X),    X the period of x

A :class:`LearnedTorque` acts against the motor or the load, over the motor's angle, the load's
angle, the motor's speed or the time. An :class:`EncoderError` is how far the angle that the motor's
encoder shows is from the true one, over that angle. Neither has a name but what it depends on. The
zero of a motor angle or a time belongs to a recording, not to the bench: there the slot ``shift``
is an unknown of each recording.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from bayesbl.bench.effect_declaration import RigidMotion
from bayesbl.bench.kernel import (
    FIRST_COSINE,
    FIRST_ENCODER_COSINE,
    FIRST_ENCODER_SINE,
    FIRST_SINE,
    LEARNED_HARMONICS,
    Slot,
)
from bayesbl.errors import BenchError
from bayesbl.recording.types import FloatArray

Side = Literal["motor", "load"]
Variable = Literal["motor_angle", "load_angle", "motor_speed", "time"]
SIDES: tuple[Side, ...] = ("motor", "load")
VARIABLES: tuple[Variable, ...] = ("motor_angle", "load_angle", "motor_speed", "time")
"""In the order of the kernel's numbers."""


@dataclass(frozen=True, slots=True)
class LearnedTorque:
    """The coefficients, N m at the side that the torque acts at.

    Where it ``reverses``, it is multiplied by the sign of the motor's speed, as friction is.

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

    block: ClassVar[str] = "learned_torque"
    unit: ClassVar[str] = "N m"
    shift_slot: ClassVar[str] = "learned_torque__shift"
    period_slot: ClassVar[str] = "learned_torque__period"

    def __post_init__(self) -> None:
        _check_series(self, self.cosine_nm, self.sine_nm)
        if self.side == "load" and self.variable == "motor_angle":
            raise BenchError(
                "A torque over the motor's angle acts at the motor.",
                where=f"{self.block} side",
                found='"load"',
                expected='"motor"',
            )

    @property
    def belongs_to_recordings(self) -> bool:
        """Whether the variable's zero is another one in every recording."""
        return self.variable in ("motor_angle", "time")

    @property
    def orders(self) -> int:
        """How many."""
        return len(self.cosine_nm)

    @property
    def names(self) -> tuple[str, ...]:
        """Slots of the coefficients: the constant's, the cosines', the sines'."""
        return (f"{self.block}__constant_nm", *_wave_names(self.block, self.orders, "nm"))

    @property
    def coefficients(self) -> tuple[float, ...]:
        """In the order of ``names``."""
        return (self.constant_nm, *self.cosine_nm, *self.sine_nm)

    @property
    def deviations(self) -> tuple[float, ...]:
        """Standard deviations in the order of ``names``; empty where all is known."""
        return self.sd_nm

    def fitted(self, values: Mapping[str, float], sds: Mapping[str, float]) -> LearnedTorque:
        """With these values and standard deviations, by slot; what is not there stays."""
        constant, *waves = _by_name(self.names, self.coefficients, values)
        return replace(
            self,
            period=values.get(self.period_slot, self.period),
            constant_nm=constant,
            cosine_nm=tuple(waves[: self.orders]),
            sine_nm=tuple(waves[self.orders :]),
            sd_nm=_by_name(self.names, self.sd_nm or (0.0,) * len(self.names), sds),
        )

    def put_into(self, vector: FloatArray) -> None:
        """Fill its places of a parameter vector, shape (SLOTS,)."""
        vector[Slot.learned_torque__side] = 1.0 + SIDES.index(self.side)
        vector[Slot.learned_torque__variable] = VARIABLES.index(self.variable)
        vector[Slot.learned_torque__reverses] = float(self.reverses)
        vector[Slot.learned_torque__period] = self.period
        vector[Slot.learned_torque__constant_nm] = self.constant_nm
        vector[FIRST_COSINE : FIRST_COSINE + self.orders] = self.cosine_nm
        vector[FIRST_SINE : FIRST_SINE + self.orders] = self.sine_nm

    def over(self, x: FloatArray) -> FloatArray:
        """The torque at these values of its variable, shape as ``x``, N m; forwards."""
        return self.constant_nm + _series(x, self.period, self.cosine_nm, self.sine_nm)

    def along(self, motion: RigidMotion, gear_ratio: float) -> FloatArray:
        """The torque against a rigid bench, at the motor, N m, shape (n,)."""
        torque = self.over(variable_of(self.variable, motion, gear_ratio))
        if self.reverses:
            torque = torque * np.sign(motion.speed)
        return np.asarray(torque / (gear_ratio if self.side == "load" else 1.0))


@dataclass(frozen=True, slots=True)
class EncoderError:
    """The angle that the motor's encoder shows less the true one, inside the loop.

        θ_meas = θ_m + ε(θ_m),    ω_meas = ω_m (1 + dε/dθ_m)

    A constant of it is where the angle's zero is, so it has none.

    Attributes
    ----------
    period_rad
        X of the motor's angle: a turn, or a whole part of it.
    cosine_rad, sine_rad
        Of the orders 1, 2, …, one as long as the other, at most :data:`LEARNED_HARMONICS`.
    sd_rad
        Standard deviation of each coefficient: the cosines', the sines'; empty where they are taken
        as known.
    """

    period_rad: float
    cosine_rad: tuple[float, ...]
    sine_rad: tuple[float, ...]
    sd_rad: tuple[float, ...] = ()

    block: ClassVar[str] = "encoder_error"
    unit: ClassVar[str] = "rad"
    shift_slot: ClassVar[str] = "encoder_error__shift_rad"
    period_slot: ClassVar[str] = "encoder_error__period_rad"
    side: ClassVar[Literal["encoder"]] = "encoder"
    variable: ClassVar[Variable] = "motor_angle"
    reverses: ClassVar[bool] = False
    belongs_to_recordings: ClassVar[bool] = True

    def __post_init__(self) -> None:
        _check_series(self, self.cosine_rad, self.sine_rad)
        steepest = float(np.sum(self.slopes))
        if steepest >= 1.0:
            raise BenchError(
                "With this error the encoder would run backwards.",
                where=self.block,
                found=f"a slope of up to {steepest:.3g} rad for each rad of the motor",
                expected="less than 1",
            )

    @property
    def period(self) -> float:
        """X, rad."""
        return self.period_rad

    @property
    def orders(self) -> int:
        """How many."""
        return len(self.cosine_rad)

    @property
    def slopes(self) -> FloatArray:
        """Amplitude of each order in dε/dθ: the speed's error over the speed, shape (orders,)."""
        sizes = np.hypot(self.cosine_rad, self.sine_rad)
        return np.asarray(2.0 * math.pi / self.period_rad * np.arange(1, 1 + self.orders) * sizes)

    @property
    def names(self) -> tuple[str, ...]:
        """Slots of the coefficients: the cosines', the sines'."""
        return _wave_names(self.block, self.orders, "rad")

    @property
    def coefficients(self) -> tuple[float, ...]:
        """In the order of ``names``."""
        return (*self.cosine_rad, *self.sine_rad)

    @property
    def deviations(self) -> tuple[float, ...]:
        """Standard deviations in the order of ``names``; empty where all is known."""
        return self.sd_rad

    def fitted(self, values: Mapping[str, float], sds: Mapping[str, float]) -> EncoderError:
        """With these values and standard deviations, by slot; what is not there stays."""
        waves = _by_name(self.names, self.coefficients, values)
        return replace(
            self,
            cosine_rad=waves[: self.orders],
            sine_rad=waves[self.orders :],
            sd_rad=_by_name(self.names, self.sd_rad or (0.0,) * len(self.names), sds),
        )

    def put_into(self, vector: FloatArray) -> None:
        """Fill its places of a parameter vector, shape (SLOTS,)."""
        vector[Slot.encoder_error__orders] = self.orders
        vector[Slot.encoder_error__period_rad] = self.period_rad
        vector[FIRST_ENCODER_COSINE : FIRST_ENCODER_COSINE + self.orders] = self.cosine_rad
        vector[FIRST_ENCODER_SINE : FIRST_ENCODER_SINE + self.orders] = self.sine_rad

    def over(self, x: FloatArray) -> FloatArray:
        """The error at these angles of the motor, shape as ``x``, rad."""
        return _series(x, self.period_rad, self.cosine_rad, self.sine_rad)


LearnedTerm = LearnedTorque | EncoderError
LEARNED_TERMS: tuple[type[LearnedTerm], ...] = (LearnedTorque, EncoderError)


def variable_of(variable: Variable, motion: RigidMotion, gear_ratio: float) -> FloatArray:
    """What a torque of a rigid bench depends on, shape (n,)."""
    return {
        "motor_angle": motion.angle,
        "load_angle": motion.angle / gear_ratio,
        "motor_speed": motion.speed,
        "time": motion.time_s,
    }[variable]


def _wave_names(block: str, orders: int, unit: str) -> tuple[str, ...]:
    numbers = range(1, orders + 1)
    return tuple(f"{block}__{wave}_{k}_{unit}" for wave in ("cosine", "sine") for k in numbers)


def _by_name(
    names: Sequence[str], known: Sequence[float], given: Mapping[str, float]
) -> tuple[float, ...]:
    return tuple(given.get(name, value) for name, value in zip(names, known, strict=True))


def waves_over(x: FloatArray, period: float, orders: int) -> tuple[FloatArray, FloatArray]:
    """Cosines and sines of the orders 1, 2, … at these values, each shape (…, orders)."""
    phase = 2.0 * math.pi * np.multiply.outer(x, np.arange(1, 1 + orders)) / period
    return np.cos(phase), np.sin(phase)


def _series(
    x: FloatArray, period: float, cosine: Sequence[float], sine: Sequence[float]
) -> FloatArray:
    cosines, sines = waves_over(x, period, len(cosine))
    return np.asarray(cosines @ np.array(cosine) + sines @ np.array(sine))


def _check_series(learned: LearnedTerm, cosine: Sequence[float], sine: Sequence[float]) -> None:
    block, orders = learned.block, len(cosine)
    a = "A learned torque" if block == LearnedTorque.block else "An error of the encoder"
    if not (len(sine) == orders and 0 < orders <= LEARNED_HARMONICS):
        raise BenchError(
            f"{a} has as many sines as cosines, one of each for every order.",
            where=block,
            found=f"{orders} cosines, {len(sine)} sines",
            expected=f"from 1 to {LEARNED_HARMONICS} of each",
        )
    if len(learned.deviations) not in (0, len(learned.names)):
        raise BenchError(
            f"{a} has a standard deviation for each coefficient, or none.",
            where=f"{block} sd",
            found=f"{len(learned.deviations)} numbers",
            expected=f"{len(learned.names)}, cosines before sines, a constant before both",
        )
    if not (learned.period > 0.0 and math.isfinite(learned.period)):
        raise BenchError(
            f"{a} repeats over its variable.",
            where=f"{block} period",
            found=f"{learned.period:g}",
            expected="a number above zero",
        )
