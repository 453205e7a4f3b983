"""How large a bench is beside the one that the catalogue's ranges are made for.

A motor of 20 N m has ten times the friction of one of 2 N m. So what is sought in N m or rad/s goes
with the joint's torques and speed; angles, times and pure numbers stay as they are.
"""

from __future__ import annotations

import math

from bayesbl.bench.bench import Bench
from bayesbl.bench.effect_declaration import Effect, EffectParameter

GRAVITY_TORQUE_NM = 425.0
SHAFT_STIFFNESS_NM_PER_RAD = 1.2e5
GEAR_RATIO = 120.0
REFERENCE_SPEED_RPM = 2000.0
"""Of the reference bench."""

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
"""Of torque and speed in each unit."""


def search_scale(bench: Bench, effect: Effect, parameter: EffectParameter) -> float:
    """By what the range and the grid of a catalogue's parameter are multiplied on a bench, a pure
    number: 1 on the reference bench.

    The torque of a joint is that of gravity, or what winds its shaft by as much as on the
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
