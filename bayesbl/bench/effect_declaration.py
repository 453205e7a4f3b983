"""The form in which every module of :mod:`bayesbl.bench.effects` declares an effect.

Signs: friction opposes motion. Torques called losses act on the load side of the equation of
motion, so a positive offset brakes forward rotation. Motor angles in the periodic effects are zero
where a relaxed shaft would hold the load at the start angle, or absolute if the recording's
``motor_start_angle_rad`` is given.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import partial
from typing import Literal, Protocol

import numpy as np

from bayesbl.bench.kernel import Slot
from bayesbl.errors import BenchError
from bayesbl.recording.channels import did_you_mean
from bayesbl.recording.types import ComplexArray, FloatArray
from bayesbl.units import unit_of

Enters = Literal["motor", "load", "shaft", "loop", "measurement"]
Dependence = Literal[
    "motor_angle", "load_angle", "speed", "direction", "time", "twist", "transmitted_torque"
]
Repeats = Literal["always", "whole_orders", "never"]
Role = Literal["amplitude", "shape", "order", "phase"]

ORDER = "order"
PHASE = "phase_rad"

ARMSTRONG = "Armstrong-Hélouvry, Dupont & Canudas de Wit 1994, Automatica 30, 1083"


@dataclass(frozen=True, slots=True)
class EffectParameter:
    """One parameter of an effect.

    Attributes
    ----------
    role
        ``amplitude``: at zero the effect, or this part of it, is off. ``shape``, ``order`` and
        ``phase`` matter only while an amplitude is not zero. An order is found from the data. A
        phase belongs to each recording, because the motor starts at another angle.
    low, high
        Search range on the reference bench; ``search_scale`` scales it for others.
    typical
        A middling strength on the reference bench: visible but harmless.
    neutral
        Value if it is not given: off for an amplitude, a default for the others.
    repeats
        For an amplitude, whether the bench in steady rotation repeats every load rotation with it:
        ``always``, only with a whole number of cycles per load rotation (``whole_orders``), or
        ``never``. A repeating bench is simulated for one rotation and continued.
    smaller_than
        For an amplitude, the smallest magnitude that the simulator refuses.
    bounded
        For the others, whether the simulator refuses values outside ``low`` to ``high`` while an
        amplitude is not zero.
    sought_from
        Lower end of a search in the loop, if it is not ``low``.
    rate_of
        The parameter whose change per second this is.
    starts
        Starts of a search of a shape besides ``neutral``; empty for a grid over the range.
    """

    name: str
    meaning: str
    _: KW_ONLY
    role: Role
    low: float = 0.0
    high: float
    typical: float
    neutral: float = 0.0
    repeats: Repeats = "always"
    smaller_than: float | None = None
    bounded: bool = False
    sought_from: float | None = None
    rate_of: str | None = None
    starts: tuple[float, ...] = ()

    @property
    def unit(self) -> str:
        """Unit, from the ending of the name; empty for a pure number."""
        return unit_of(self.name)

    @property
    def is_amplitude(self) -> bool:
        """Whether it switches the effect on."""
        return self.role == "amplitude"

    @property
    def not_negative(self) -> bool:
        """Whether the simulator refuses an amplitude below zero: if the search range has none."""
        return self.is_amplitude and self.low >= 0.0

    @property
    def positive_scale(self) -> bool:
        """Whether the simulator refuses values ≤ 0 while an amplitude is not zero: a shape with a
        search range above zero."""
        return self.role == "shape" and self.low > 0.0

    def scaled(self, factor: float) -> EffectParameter:
        """The parameter with all its values multiplied by a factor, for a joint of another size."""
        return replace(
            self,
            low=factor * self.low,
            high=factor * self.high,
            typical=factor * self.typical,
            neutral=factor * self.neutral,
            starts=tuple(factor * start for start in self.starts),
        )


amplitude, shape = (partial(EffectParameter, role=role) for role in ("amplitude", "shape"))

HIGHEST_ORDER = 64.0


def order(typical: float) -> EffectParameter:
    """Cycles per motor turn n."""
    meaning = "cycles per motor turn n, found from the data"
    return EffectParameter(
        ORDER, meaning, role="order", low=0.5, high=HIGHEST_ORDER, typical=typical, neutral=1.0
    )


def phase(typical: float) -> EffectParameter:
    """Phase φ of a signal that turns with the motor."""
    return EffectParameter(
        PHASE, "phase φ", role="phase", low=-3.1416, high=3.1416, typical=typical
    )


@dataclass(frozen=True, slots=True)
class RigidMotion:
    """Motion of the motor along which a law is evaluated, each of shape (n,), SI.

    Attributes
    ----------
    angle
        Motor angle θ_m, rad; the load's is θ_m/N.
    sway
        d²/dt² exp(i θ_m), differentiated as the motion was, 1/s²: the signal of an eccentric
        encoder.
    friction_width
        Motor speed over which dry friction changes its sign, rad/s; 0 for a sign that jumps.
    """

    time_s: FloatArray
    angle: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    sway: ComplexArray
    friction_width: float = 0.0


Parameters = Mapping[str, float]


class BenchValues(Protocol):
    """The properties of a bench that its effects use."""

    @property
    def drive(self) -> str:
        """``"two_mass"`` or ``"rigid"``."""

    def value(self, name: str) -> float:
        """Value of a bench parameter, in its unit."""

    def transmitted_torque(self, motion: RigidMotion) -> FloatArray:
        """Torque that the gear transmits, at the motor, N m, shape (n,)."""


Law = Callable[[RigidMotion, BenchValues, Parameters], FloatArray]
"""A signal of shape (n,) from the motion, the bench and the effect's parameters."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RigidLaw:
    """The term of an effect in a comparison with a rigid bench.

    Attributes
    ----------
    signal
        Shape (n,), linear in the amplitude.
    amplitude
        The parameter that is zero if the effect is absent.
    linear
        Other parameters in which the signal is linear.
    scanned, grid
        A speed to scan, and the values to try, in RMS motor speeds of the recordings. An order gets
        its own grid.
    same_as
        Effects with the same law in this comparison, but at another place.
    contains
        A simpler effect that is a special case of this one, which replaces it.
    usual
        Usual share in the root mean square of the compared signal: the prior scale of its size.
    requires
        An effect without which this one, a departure from it, makes no sense.
    """

    signal: Law
    amplitude: str
    linear: tuple[str, ...] = ()
    scanned: str | None = None
    grid: tuple[float, ...] = ()
    same_as: tuple[str, ...] = ()
    contains: str | None = None
    usual: float = 0.3
    requires: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Resonance:
    """Resonance of an elastic part of a joint, which no derivative at a rigid part shows.

    Attributes
    ----------
    inertia
        Bench parameter of the whole inertia on its side of the gear.
    part
        Shape parameter of the inertia behind the spring.
    is_share
        Whether ``part`` is a share s, so that s (1 − s) of the inertia swings; else it is an
        inertia.
    parts
        Values of ``part``, relative to the inertia, from which a search starts.
    multiples
        Range of its frequency in a search, in √(k/J_l).
    """

    inertia: str
    part: str
    is_share: bool
    parts: tuple[float, ...]
    multiples: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """Everything known of one effect except its term in the compiled kernel.

    Attributes
    ----------
    place
        Position in the catalogue: simpler effects before those that contain them.
    name, sentence, equation, data, reference
        For people; ``data`` is how it appears in a recording.
    enters
        Where it enters the equations.
    depends_on
        What its size depends on. An effect of the load angle is a candidate only if that angle is
        known absolutely; one of the transmitted torque only if gravity's torque is known.
    torque
        Its term in a rigid comparison of the torque at the motor (N m).
    load_torque
        Its torque against a rigid bench's load, N m there.
    free_motion
        Whether a rigid bench that swings freely shows it; its parameters are then those of the
        simulator.
    replaces
        An unknown of every comparison that is equivalent: the effect is then no candidate.
    sought_alone
        Among parameters that recordings cannot distinguish, the one that a search frees.
    sought_in_loop
        Whether recordings at a few constant speeds could identify it.
    in_bench_file
        A sentence: how a bench file states it more briefly than under ``[[effects]]``.
    resonance
        For an elastic part with an inertia behind it.
    always_in
        Every fit of a gap allows for it, because every joint has it, or because it moves δ by more
        than a standard deviation before it becomes visible, and its usual size may be invisible
        (``configs/bias_against_visibility.toml``).
    may_change
        A setting, a cable or a weight brings it into some recordings of a joint and not others.
    """

    place: int
    name: str
    sentence: str
    equation: str
    parameters: tuple[EffectParameter, ...]
    enters: Enters
    data: str
    depends_on: tuple[Dependence, ...] = ()
    reference: str = ""
    torque: RigidLaw | None = None
    load_torque: Law | None = None
    free_motion: bool = False
    replaces: str | None = None
    sought_alone: str | None = None
    sought_in_loop: bool = True
    in_bench_file: str = ""
    resonance: Resonance | None = None
    always_in: bool = False
    may_change: bool = False
    slots: Mapping[str, Slot] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        slots = {item.name: Slot[f"{self.name}__{item.name}"] for item in self.parameters}
        object.__setattr__(self, "slots", slots)

    def parameter(self, name: str) -> EffectParameter:
        """The parameter of that name.

        Raises
        ------
        BenchError
            If the effect has none.
        """
        for item in self.parameters:
            if item.name == name:
                return item
        raise BenchError(
            f"The effect {self.name} has no such parameter." + did_you_mean(name, self.slots),
            found=name,
            expected="one of " + ", ".join(self.slots),
        )

    @property
    def amplitudes(self) -> tuple[EffectParameter, ...]:
        """Parameters that switch it on."""
        return tuple(item for item in self.parameters if item.is_amplitude)

    @property
    def main_amplitude(self) -> EffectParameter:
        """The amplitude that a search frees if recordings cannot show several, or the first."""
        alone = (item for item in self.amplitudes if item.name == self.sought_alone)
        return next(alone, self.amplitudes[0])

    @property
    def shapes(self) -> tuple[EffectParameter, ...]:
        """Parameters that matter only while it is on."""
        return tuple(item for item in self.parameters if not item.is_amplitude)

    @property
    def is_periodic(self) -> bool:
        """Whether it is proportional to sin(n θ_m + φ), with a phase for each recording."""
        return PHASE in self.slots

    @property
    def has_order(self) -> bool:
        """Whether its cycles per motor turn are a parameter; otherwise there is one cycle."""
        return ORDER in self.slots

    def complete(self, given: Mapping[str, float]) -> dict[str, float]:
        """All parameters by name; missing ones at their neutral value.

        Raises
        ------
        BenchError
            If a parameter is not one of this effect's.
        """
        for name in given:
            self.parameter(name)
        return {item.name: float(given.get(item.name, item.neutral)) for item in self.parameters}


def direction(motion: RigidMotion) -> FloatArray:
    """sign ω_m smoothed as tanh(ω_m / width), as in the simulator's friction."""
    if motion.friction_width == 0.0:
        return np.sign(motion.speed)
    return np.tanh(motion.speed / motion.friction_width)
