"""The virtual bench: parameters with tolerances, measurement, effects; simulates recordings.

The bench determines whether the load changes tooth flanks while a joint turns at constant speed.
The gear then transmits only the torque that the load requires,

    τ_s(θ) = m g l sin θ + torques at the load (offset, friction, learned torque).

If that keeps its sign over a rotation (a vertical axis, a balanced arm, an arm that is loaded to
one side), there is no impact, and no recording at that speed depends on the gap.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bayesbl.bench.effect_declaration import RigidMotion
from bayesbl.bench.effects import effect_named
from bayesbl.bench.kernel import CURRENT, POSITION, SLOTS, SPEED, Slot
from bayesbl.bench.learned import ENCODER_ERROR, LearnedTerm
from bayesbl.bench.motion import Motion
from bayesbl.bench.parameters import (
    PARAMETER_INFO,
    JointNormal,
    check_parameters,
    rotation_period_s,
    slot_of,
)
from bayesbl.bench.simulation import PERFECT, Measurement, simulate_channels, simulate_motions
from bayesbl.errors import BenchError, NoFlankChange
from bayesbl.recording.types import (
    MOTOR_CURRENT,
    MOTOR_POSITION,
    MOTOR_TORQUE,
    REFERENCE_POSITION,
    REFERENCE_SPEED,
    FloatArray,
    Recording,
)
from bayesbl.units import RPM_PER_RAD_PER_S

GapForm = Literal["arctan", "dead_zone"]
Drive = Literal["two_mass", "rigid"]

LATE_PARAMETERS = ("gravity_angle_rad",)

# Increased when the same bench gives other signals, so that cached results are not mixed.
_SIGNALS_VERSION = 2
# As hashed. Version 0.2 simulated the encoder's speed as a sensor's, so its curves differ.
_SPEED_SOURCES = {"sensor": "sensor", "encoder": "averaged"}


@dataclass(frozen=True, slots=True)
class BenchParameter:
    """Value of one bench parameter and the half-width of its uniform prior, in its own unit."""

    value: float
    tolerance: float = 0.0


@dataclass(frozen=True, slots=True)
class EffectParameterValue:
    """Value of one effect's parameter, and its standard deviation if it was estimated."""

    value: float
    sd: float | None = None


@dataclass(frozen=True, slots=True)
class BenchEffect:
    """An effect that this bench has, by its catalogue name, with its parameters."""

    name: str
    parameters: Mapping[str, EffectParameterValue]

    def complete(self) -> dict[str, float]:
        """All of its parameters by name; missing ones at their neutral value."""
        given = {name: item.value for name, item in self.parameters.items()}
        return effect_named(self.name).complete(given)


@dataclass(frozen=True, slots=True, repr=False)
class Bench:
    """Two masses, a gap between them, gravity and a speed loop.

    Equations in docs/design.md, "The virtual bench".

    ``parameters``: every name of ``parameters.BENCH_PARAMETERS`` to its value and tolerance.
    ``assumed``: parameters that a rigid bench leaves out because nothing drives it; it can be
    compared with recordings but not simulated in steady rotation. ``identified``: joint
    distribution of some parameters from recordings, instead of their tolerances.
    ``learned_torque``, ``encoder_error``: repeating signals in recordings that no effect explains.
    """

    parameters: Mapping[str, BenchParameter]
    gap_form: GapForm = "arctan"
    drive: Drive = "two_mass"
    measurement: Measurement = PERFECT
    effects: tuple[BenchEffect, ...] = ()
    assumed: frozenset[str] = frozenset()
    identified: JointNormal | None = None
    learned_torque: LearnedTerm | None = None
    encoder_error: LearnedTerm | None = None
    _vector: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        unknown = [name for name in self.parameters if name not in PARAMETER_INFO]
        if unknown:
            raise BenchError(
                "There is no such bench parameter.",
                found=unknown[0],
                expected="one of " + ", ".join(PARAMETER_INFO),
            )
        if self.encoder_error is not None and self.drive == "rigid":
            raise BenchError(
                "Only a bench of two masses can have an encoder error over its angle.",
                where=ENCODER_ERROR,
                found='drive = "rigid"',
                expected='drive = "two_mass", or the effect encoder_eccentricity',
            )
        complete: dict[str, BenchParameter] = {}
        for name, info in PARAMETER_INFO.items():
            if name in self.parameters:
                complete[name] = self.parameters[name]
            elif info.default is not None:
                complete[name] = BenchParameter(info.default)
            else:
                raise BenchError("A bench needs this parameter.", where=name, expected=info.meaning)
        object.__setattr__(self, "parameters", complete)
        vector = self._flat()
        check_parameters(vector[None, :])
        object.__setattr__(self, "_vector", vector)

    def _flat(self) -> FloatArray:
        vector = np.zeros(SLOTS)
        for name, parameter in self.parameters.items():
            vector[Slot[name]] = parameter.value
        vector[Slot.hard_dead_zone] = float(self.gap_form == "dead_zone")
        vector[Slot.rigid] = float(self.drive == "rigid")
        for effect in self.effects:
            slots = effect_named(effect.name).slots
            for name, value in effect.complete().items():
                vector[slots[name]] = value
        for term in self.learned_terms:
            term.put_into(vector)
        vector.setflags(write=False)
        return vector

    def __repr__(self) -> str:
        effects = "".join(f", {effect.name}" for effect in self.effects)
        toleranced = f"{len(self.tolerances)} of {len(self.parameters)} parameters with tolerance"
        return f"<Bench {self.drive}: {toleranced}{effects}>"

    def value(self, name: str) -> float:
        """Value of a bench parameter, run setting or ``effect.parameter``."""
        return float(self._vector[slot_of(name)])

    @property
    def learned_terms(self) -> tuple[LearnedTerm, ...]:
        """The learned terms that the bench has."""
        return tuple(t for t in (self.learned_torque, self.encoder_error) if t is not None)

    def with_learned(self, *terms: LearnedTerm) -> Bench:
        """The same bench with these learned terms, which replace those of the same kind."""
        kinds: dict[str, Any] = {term.block: term for term in terms}
        return dataclasses.replace(self, **kinds)

    @property
    def tolerances(self) -> dict[str, float]:
        """Half-width of every parameter that is not known exactly, in its own unit."""
        return {name: item.tolerance for name, item in self.parameters.items() if item.tolerance}

    def with_parameters(self, **values: float) -> Bench:
        """The same bench with other values; tolerances stay the same relative to the value."""
        changed = dict(self.parameters)
        for name, value in values.items():
            if name not in changed:
                slot_of(name)
                raise BenchError("This is not a parameter of the bench itself.", found=name)
            old = changed[name]
            share = abs(value / old.value) if old.value else 1.0
            changed[name] = BenchParameter(float(value), old.tolerance * share)
        return dataclasses.replace(self, parameters=changed)

    def with_effects(self, *effects: BenchEffect) -> Bench:
        """The same bench with these effects instead of its own."""
        return dataclasses.replace(self, effects=tuple(effects))

    def draw(self, rng: np.random.Generator) -> Bench:
        """Draw an exactly known bench, uniformly within the tolerances or as identified.

        One number is drawn for each parameter, with tolerance or not. Adding a tolerance to one
        parameter thus does not change the draws of the others.
        """
        # Late parameters are drawn last, and only if they have a tolerance, so that draws of
        # benches without them stay the same.
        late = [name for name in LATE_PARAMETERS if self.parameters[name].tolerance]
        names = [name for name in self.parameters if name not in LATE_PARAMETERS] + late
        shifts = dict(zip(names, rng.uniform(-1.0, 1.0, len(names)), strict=True))
        drawn = {
            name: BenchParameter(item.value + item.tolerance * float(shifts.get(name, 0.0)))
            for name, item in self.parameters.items()
        }
        if self.identified is not None:
            factors = self.identified.draw(rng, 1)[0]
            for name, factor in zip(self.identified.names, factors, strict=True):
                drawn[name] = BenchParameter(self.parameters[name].value * float(factor))
        return dataclasses.replace(self, parameters=drawn, identified=None)

    def rotation_period_s(self, reference_speed_rpm: float | None = None) -> float:
        """Time of one load rotation T_w = 2πN/``|ω_ref|``, s."""
        return float(rotation_period_s(self.vector(reference_speed_rpm=reference_speed_rpm))[0])

    def transmitted_torque(self, motion: RigidMotion) -> FloatArray:
        """Torque that the gear transmits in this motion of a rigid bench, at the motor, N m.

        It comprises load inertia, gravity and the effects at the load; shape (n,).
        """
        ratio = self.value("gear_ratio")
        torque = self.value("load_inertia_kg_m2") / ratio * motion.acceleration
        gravity_angle = motion.angle / ratio + self.value("gravity_angle_rad")
        torque = torque + self.value("gravity_torque_nm") * np.sin(gravity_angle)
        for effect in self.effects:
            law = effect_named(effect.name).load_torque
            if law is not None:
                torque = torque + law(motion, self, effect.complete())
        return np.asarray(torque / ratio)

    def vector(self, **settings: Any) -> FloatArray:
        """Parameter matrix for simulations that differ in these settings.

        Parameters
        ----------
        settings
            Names of ``kernel.Slot`` (``effect__parameter`` for effects), each a number or an array
            of shape (m,); ``None`` leaves the bench's value.

        Returns
        -------
        Array of shape (m, SLOTS); m is 1 if all are numbers.
        """
        arrays = {
            slot_of(name): np.asarray(v, float) for name, v in settings.items() if v is not None
        }
        shape = np.broadcast_shapes((1,), *(values.shape for values in arrays.values()))
        matrix = np.tile(self._vector, (shape[0], 1))
        for slot, values in arrays.items():
            matrix[:, slot] = values
        return matrix

    def simulate_many(
        self,
        gap_rad: float | FloatArray,
        *,
        rotations: float = 5.0,
        sampling_hz: float = 1000.0,
        channels: Literal["speed", "all"] = "speed",
        accuracy_rpm: float | None = None,
        workers: int = 1,
        **settings: Any,
    ) -> FloatArray:
        """Noise-free signals for arrays of gaps and of other ``settings`` of :meth:`vector`, (m,).

        The number of samples is that of the nominal reference speed.

        Returns
        -------
        Shape (m, n) in rpm for ``channels="speed"``; (m, 3, n) with position, speed and current
        (rad, rpm, A) for ``"all"``.

        Raises
        ------
        BenchError
            As :func:`simulate_channels`.
        """
        matrix = self.vector(gap_rad=gap_rad, **settings)
        matrix = self.measurement.seen_by(matrix, sampling_hz)
        samples = self.samples(rotations, sampling_hz, settings.get("reference_speed_rpm"))
        signals = simulate_channels(
            matrix,
            samples,
            sampling_hz,
            accuracy_rpm=accuracy_rpm,
            workers=workers,
            speed_alone=channels == "speed",
        )
        return signals[:, 0] if channels == "speed" else signals

    def samples(
        self, rotations: float, sampling_hz: float, reference_speed_rpm: float | None = None
    ) -> int:
        """Number of samples in ``rotations`` load rotations, both ends included.

        Raises
        ------
        BenchError
            If the bench leaves out what a steady rotation needs.
        """
        missing = [name for name in sorted(self.assumed) if not name.startswith("shaft_")]
        if missing:
            raise BenchError(
                "This bench has no drive, so it cannot be simulated in steady "
                "rotation; it can be compared with recordings.",
                where="[parameters]",
                found="no " + ", ".join(missing),
            )
        period = self.rotation_period_s(reference_speed_rpm)
        count = round(rotations * period * sampling_hz, 6)
        if not count >= 1:
            raise BenchError(
                "A recording needs at least two samples.", where="rotations", found=rotations
            )
        return math.floor(count) + 1

    def simulate(
        self,
        gap_rad: float,
        motion: Motion | None = None,
        *,
        rotations: float = 5.0,
        sampling_hz: float = 1000.0,
        start_angle_rad: float = 0.0,
        reference_speed_rpm: float | None = None,
        motor_start_angle_rad: float | None = None,
        seed: np.random.Generator | None = None,
        name: str = "simulated",
        accuracy_rpm: float | None = None,
    ) -> Recording:
        """Simulate one recording in steady rotation, or of a motion with its references as
        channels.

        With a held output, the channels are the position and torque of the motor, as a test stand
        records them.

        Parameters
        ----------
        gap_rad
            Half the clearance δ, an angle at the load.
        motion
            Has its own length and start, which replace rotations, start angle and speed.
        rotations, sampling_hz
            Length in load rotations, and rate.
        start_angle_rad
            Load angle at the first sample; 0 hangs straight down.
        reference_speed_rpm
            Of the motor, negative for reverse; the bench's own if ``None``.
        motor_start_angle_rad
            Makes the recorded position absolute; ``None``: it begins at zero.
        seed
            Generator of the noise; ``None`` for none.
        name, accuracy_rpm
            Name of the recording; largest error of the simulated speed, as in
            :func:`simulate_channels`.

        Raises
        ------
        BenchError
            If a parameter makes no sense, the motor cannot follow or the simulation fails.
        """
        parameters = self.vector(
            gap_rad=gap_rad,
            start_angle_rad=start_angle_rad if motion is None else motion.start_angle_rad,
            reference_speed_rpm=reference_speed_rpm,
            motor_start_angle_rad=motor_start_angle_rad,
        )
        if len(parameters) != 1:
            raise BenchError(
                "One recording has one value of each setting.",
                where="simulate()",
                found=f"{len(parameters)} values",
                expected="one number each; call simulate() once for each gap",
            )
        row, loop = parameters[0], parameters[0]
        reference = None if motion is not None else float(row[Slot.reference_speed_rpm])
        if motion is None:
            samples = self.samples(rotations, sampling_hz, reference)
            simulated = simulate_channels(
                parameters, samples, sampling_hz, accuracy_rpm=accuracy_rpm
            )
        else:
            samples = math.floor(round(motion.duration_s * sampling_hz, 6)) + 1
            simulated = simulate_motions(
                parameters, motion, samples, sampling_hz, accuracy_rpm=accuracy_rpm
            )
            loop = None if motion.output_held else row
        time_s = np.arange(samples) / sampling_hz
        position, speed, current = simulated[0, [POSITION, SPEED, CURRENT]]
        zero = position[0]
        if motor_start_angle_rad is not None:  # defined for a relaxed shaft
            zero = row[Slot.gear_ratio] * row[Slot.start_angle_rad] - motor_start_angle_rad
        channels = self.measurement.channels(
            position - zero, speed, current, loop, sampling_hz, seed
        )
        if motion is not None and motion.output_held:
            torque = self.value("torque_constant_nm_per_a") * channels[MOTOR_CURRENT]
            channels = {MOTOR_POSITION: channels[MOTOR_POSITION], MOTOR_TORQUE: torque}
        elif motion is not None:
            channels[REFERENCE_SPEED] = motion.speed_rpm(time_s)
            channels[REFERENCE_POSITION] = position[0] - zero + motion.position_rad(time_s)
        return Recording(
            name=name,
            time_s=time_s,
            channels=channels,
            metadata={
                "simulated": True,
                "bench": self.fingerprint(),
                "gap_rad": float(row[Slot.gap_rad]),
                "start_angle_rad": float(row[Slot.start_angle_rad]),
                "reference_speed_rpm": reference,
            },
        )

    def fingerprint(self) -> str:
        """Short hash of all that determines the noise-free signals; tolerances and noise do not."""
        content = {
            "version": _SIGNALS_VERSION,
            "values": {
                s.name: repr(float(v)) for s, v in zip(Slot, self._vector, strict=True) if v
            },
            "speed_source": _SPEED_SOURCES[self.measurement.speed_source],
        }
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]


_ANGLES = 720


def steady_torque_nm(bench: Bench, reference_speed_rpm: float) -> tuple[float, float]:
    """Smallest and largest torque that the gear transmits in a rotation, N m at the load."""
    ratio, speed = bench.value("gear_ratio"), reference_speed_rpm / RPM_PER_RAD_PER_S
    angle = math.copysign(ratio, speed) * np.linspace(0.0, 2.0 * math.pi, _ANGLES)
    speeds = np.full(_ANGLES, speed)
    sway = -(speeds**2) * np.exp(1j * angle)
    motion = RigidMotion(angle / speed, angle, speeds, np.zeros(_ANGLES), sway)
    torque = ratio * bench.transmitted_torque(motion)
    for term in bench.learned_terms:
        if term.side == "load":
            torque = torque + ratio * term.along(motion, ratio)
    return float(torque.min()), float(torque.max())


def heaviest(bench: Bench) -> Bench:
    """The bench with the largest gravity torque within its tolerance."""
    gravity = bench.parameters["gravity_torque_nm"]
    return bench.with_parameters(gravity_torque_nm=gravity.value + gravity.tolerance)


def require_flank_change(
    bench: Bench, speeds_rpm: Sequence[float] = (), file: str | Path | None = None
) -> None:
    """Refuse a bench that leaves the load on one flank at all of these speeds.

    Parameters
    ----------
    speeds_rpm
        Of the motor; the bench's own by default.
    file
        File of the bench or the recording, for the message.

    Raises
    ------
    NoFlankChange
        With the torque, and the motion that would show the gap.
    """
    speeds = speeds_rpm or [bench.value("reference_speed_rpm")]
    torques = [steady_torque_nm(bench, speed) for speed in speeds]
    if bench.drive == "rigid" or any(low < 0.0 < high for low, high in torques):
        return
    acting = [e.name for e in bench.effects if effect_named(e.name).load_torque is not None]
    low, high = torques[0]
    raise NoFlankChange(
        "At this speed the load never changes from one tooth flank to the other, so nothing that "
        "is recorded depends on the gap.",
        file=file,
        where="gravity_torque_nm" + "".join(f", {name}" for name in acting),
        found=f"a torque of {low:.4g} to {high:.4g} N m at the load over a rotation at "
        f"{speeds[0]:.4g} rpm",
        expected=f"{NoFlankChange.MOTION}, or a bench whose load torque changes its sign",
    )
