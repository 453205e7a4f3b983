"""Catalogue of the effects that a real joint may have and the nominal bench lacks.

Each module of this package declares a family of effects with all their properties. Every effect
declared here is in the catalogue. The functions here answer all questions about effects, so that no
other file needs a list of them. To add one: ``docs/extending.md``.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping

import numpy as np

from bayesbl.bench.effect_declaration import ORDER, BenchValues, Effect, EffectParameter
from bayesbl.bench.kernel import OVER_LOAD_ANGLE, OVER_MOTOR_ANGLE, OVER_SPEED, OVER_TIME, Slot
from bayesbl.declared import declared
from bayesbl.errors import BenchError
from bayesbl.recording.channels import did_you_mean
from bayesbl.recording.types import FloatArray

EFFECTS: tuple[Effect, ...] = tuple(
    sorted(declared(sys.modules[__name__], Effect), key=lambda effect: effect.place)
)

EFFECT_BY_NAME: Mapping[str, Effect] = {effect.name: effect for effect in EFFECTS}


def effect_named(name: str) -> Effect:
    """Catalogue entry of that name.

    Raises
    ------
    BenchError
        If there is none.
    """
    if name not in EFFECT_BY_NAME:
        raise BenchError(
            "There is no such effect." + did_you_mean(name, EFFECT_BY_NAME),
            found=name,
            expected="one of " + ", ".join(EFFECT_BY_NAME),
        )
    return EFFECT_BY_NAME[name]


def with_bench_file_hint(message: str, names: Iterable[str]) -> str:
    """Append how a bench file states those effects that have a form of their own there."""
    known = [EFFECT_BY_NAME[name] for name in dict.fromkeys(names) if name in EFFECT_BY_NAME]
    return " ".join([message, *(effect.in_bench_file for effect in known if effect.in_bench_file)])


_AMPLITUDES = tuple(
    (effect, effect.slots[item.name], item.repeats)
    for effect in EFFECTS
    for item in effect.amplitudes
)
_NEVER_REPEATING = [slot for _, slot, repeats in _AMPLITUDES if repeats == "never"]
_REPEATING_AT_WHOLE_ORDERS = [
    (slot, effect.slots[ORDER] if effect.has_order else None)
    for effect, slot, repeats in _AMPLITUDES
    if repeats == "whole_orders"
]
_WITH_MOTOR_ANGLE = [slot for effect, slot, _ in _AMPLITUDES if "motor_angle" in effect.depends_on]

_RATES = [
    (effect.slots[item.rate_of], effect.slots[item.name])
    for effect in EFFECTS
    for item in effect.amplitudes
    if item.rate_of is not None
]


def after(matrix: FloatArray, time_s: float) -> FloatArray:
    """Benches, shape (m, SLOTS), with their parameters as changed after ``time_s`` seconds."""
    matrix = matrix.copy()
    for value, rate in _RATES:
        matrix[:, value] += time_s * matrix[:, rate]
    depends_on_time = matrix[:, Slot.learned_torque__variable] == OVER_TIME
    matrix[depends_on_time, Slot.learned_torque__shift] += time_s
    return matrix


def repeat_each_rotation(matrix: FloatArray) -> bool:
    """Whether the active effects in these benches, shape (m, SLOTS), repeat every load rotation."""
    if np.any(matrix[:, _NEVER_REPEATING] != 0.0):
        return False
    for amplitude, order in _REPEATING_AT_WHOLE_ORDERS:
        cycles = matrix[:, Slot.gear_ratio] * (1.0 if order is None else matrix[:, order])
        if np.any((matrix[:, amplitude] != 0.0) & (np.abs(cycles - np.round(cycles)) > 1e-9)):
            return False
    sampled = matrix[matrix[:, Slot.sampled_control__period_s] > 0.0]
    turn_s = 60.0 * sampled[:, Slot.gear_ratio] / sampled[:, Slot.reference_speed_rpm]
    ticks = turn_s / sampled[:, Slot.sampled_control__period_s]
    if np.any(np.abs(ticks - np.round(ticks)) > 1e-6):
        return False
    erring = matrix[matrix[:, Slot.encoder_error__orders] != 0.0]
    cycles = 2.0 * np.pi * erring[:, Slot.gear_ratio] / erring[:, Slot.encoder_error__period_rad]
    if np.any(np.abs(cycles - np.round(cycles)) > 1e-9):
        return False
    learned = matrix[matrix[:, Slot.learned_torque__side] != 0.0]
    variable = learned[:, Slot.learned_torque__variable]
    cycles = 2.0 * np.pi / np.maximum(learned[:, Slot.learned_torque__period], 1e-300)
    cycles[variable == OVER_MOTOR_ANGLE] *= learned[variable == OVER_MOTOR_ANGLE, Slot.gear_ratio]
    angular = (variable == OVER_MOTOR_ANGLE) | (variable == OVER_LOAD_ANGLE)
    repeats = angular & (np.abs(cycles - np.round(cycles)) <= 1e-9)
    return bool(np.all(repeats | (variable == OVER_SPEED)))


def sampled_lateness_s(matrix: FloatArray) -> FloatArray:
    """Delay of a sampled loop: differentiation, computation and hold, (m, SLOTS) to (m,)."""
    periods = 1.0 + matrix[:, Slot.sampled_control__delay_periods]
    periods -= 0.5 * matrix[:, Slot.sampled_control__instant_share]
    return np.asarray(periods * matrix[:, Slot.sampled_control__period_s])


def turn_with_the_motor(matrix: FloatArray) -> bool:
    """Whether any active effect in these benches, shape (m, SLOTS), needs the motor's angle."""
    learned = matrix[:, Slot.learned_torque__side] != 0.0
    learned &= matrix[:, Slot.learned_torque__variable] == OVER_MOTOR_ANGLE
    learned |= matrix[:, Slot.encoder_error__orders] != 0.0
    return bool(np.any(matrix[:, _WITH_MOTOR_ANGLE] != 0.0) or np.any(learned))


# Size of a joint relative to the reference bench, for which the ranges are made: a motor of 20 N m
# has ten times the friction of one of 2 N m. Ranges in N m or rad/s scale with torques and speed;
# angles, times and pure numbers do not.
GRAVITY_TORQUE_NM = 425.0
SHAFT_STIFFNESS_NM_PER_RAD = 1.2e5
GEAR_RATIO = 120.0
REFERENCE_SPEED_RPM = 2000.0
"""Values of the reference bench."""

_POWERS = {
    "": (0, 0),
    "rad": (0, 0),
    "rad²": (0, 0),
    "s": (0, 0),
    "N m": (1, 0),
    "N m/s": (1, 0),
    "N m/rad³": (1, 0),
    "N m s/rad": (1, -1),
    "N m s²/rad²": (1, -2),
    "rad/(N m)": (-1, 0),
    "kg m²": (1, -2),
    "rad/s": (0, 1),
    "s/rad": (0, -1),
}
"""Powers of torque and speed in each unit."""


def parameters_on(bench: BenchValues, effect: Effect) -> tuple[EffectParameter, ...]:
    """An effect's parameters, with search ranges and usual sizes scaled to a joint."""
    return tuple(p.scaled(search_scale(bench, effect, p)) for p in effect.parameters)


def search_scale(bench: BenchValues, effect: Effect, parameter: EffectParameter) -> float:
    """Factor on search range and grid of a catalogue parameter; 1 on the reference bench.

    The torque of a joint is that of gravity, or the torque that winds its shaft as far as on the
    reference bench, whichever is larger: an upright axis has no gravity.
    """
    torque = abs(bench.value("gravity_torque_nm")) / GRAVITY_TORQUE_NM
    if bench.drive == "two_mass":
        stiffness = bench.value("shaft_stiffness_nm_per_rad") / SHAFT_STIFFNESS_NM_PER_RAD
        torque = max(torque, stiffness)
    torque = torque or 1.0
    speed = abs(bench.value("reference_speed_rpm")) / REFERENCE_SPEED_RPM or 1.0
    gear = bench.value("gear_ratio") / GEAR_RATIO
    torque_power, speed_power = _POWERS[parameter.unit]
    if effect.enters == "motor":
        torque /= gear
    else:
        speed /= gear
    return math.pow(torque, torque_power) * math.pow(speed, speed_power)
