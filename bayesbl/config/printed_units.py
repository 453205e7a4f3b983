"""Units as data sheets and drives print them, converted to the bench's own.

Some numbers are printed as something else: a reset time stands for the integral gain, a bandwidth
for the proportional gain, a damping ratio for the damping. They are converted with the other
parameters of the same bench.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from bayesbl.bench.parameters import PARAMETER_INFO
from bayesbl.units import RPM_PER_RAD_PER_S

ARCMIN_PER_RAD = 60.0 * 180.0 / math.pi
STANDARD_GRAVITY = 9.80665

Values = Mapping[str, float]
Conversion = Callable[[float, Values], float]
"""From the printed number, and the bench's parameters converted so far, to the bench's unit."""


def _times(factor: float) -> Conversion:
    return lambda value, bench: factor * value


def _over(factor: float) -> Conversion:
    return lambda value, bench: factor / value


_INERTIA = {
    "kg m2": _times(1.0),
    "kg cm2": _times(1e-4),
    "kg mm2": _times(1e-6),
    "g cm2": _times(1e-7),
}
_SPEED_GAIN = {
    "N m s/rad": _times(1.0),
    "N m/rpm": _times(RPM_PER_RAD_PER_S),
    "A s/rad": lambda value, bench: value * bench["torque_constant_nm_per_a"],
    "A/rpm": lambda value, bench: value * RPM_PER_RAD_PER_S * bench["torque_constant_nm_per_a"],
    "1/s": lambda value, bench: value * _total_inertia(bench),
}
CONVERSIONS: Mapping[str, Mapping[str, Conversion]] = {
    "motor_inertia_kg_m2": _INERTIA,
    "load_inertia_kg_m2": _INERTIA,
    "shaft_stiffness_nm_per_rad": {
        "N m/rad": _times(1.0),
        "kN m/rad": _times(1e3),
        "N m/deg": _times(180.0 / math.pi),
        "N m/arcmin": _times(ARCMIN_PER_RAD),
        "arcmin/N m": _over(ARCMIN_PER_RAD),
        "rad/N m": _over(1.0),
    },
    "gravity_torque_nm": {"N m": _times(1.0), "kg m": _times(STANDARD_GRAVITY)},
    "torque_constant_nm_per_a": {"N m/A": _times(1.0), "mN m/A": _times(1e-3)},
    "shaft_damping_nm_s_per_rad": {
        "N m s/rad": _times(1.0),
        "damping ratio": lambda value, bench: (
            2.0
            * value
            * math.sqrt(bench["shaft_stiffness_nm_per_rad"] * reduced_inertia_kg_m2(bench))
        ),
    },
    "speed_gain_nm_s_per_rad": _SPEED_GAIN,
    "integral_gain_nm_per_rad": {
        "N m/rad": _times(1.0),
        "s": lambda value, bench: bench["speed_gain_nm_s_per_rad"] / value,
        "ms": lambda value, bench: 1e3 * bench["speed_gain_nm_s_per_rad"] / value,
    },
    "position_gain_per_s": {"1/s": _times(1.0), "m/min/mm": _times(1000.0 / 60.0)},
    "reference_speed_rpm": {"rpm": _times(1.0), "rad/s": _times(RPM_PER_RAD_PER_S)},
    "current_limit_a": {"A": _times(1.0), "mA": _times(1e-3)},
}
"""Parameter to the units it may be printed in, its own first; later ones may need earlier ones."""


def accepted(name: str) -> tuple[str, ...]:
    """Units that a parameter may be given in."""
    return tuple(CONVERSIONS.get(name, {PARAMETER_INFO[name].unit: None}))


def spelled(unit: str) -> str:
    """``kg cm²`` as ``kg cm2``, ``arcmin/(Nm)`` as ``arcmin/N m``."""
    text = unit.strip().replace("²", "2").replace("^2", "2").replace("·", " ").replace("*", " ")
    text = text.replace("(", "").replace(")", "").replace("s⁻¹", "1/s").replace("′", "arcmin")
    return text.replace("Nm", "N m")


def converted(printed: Mapping[str, float], units: Mapping[str, str]) -> dict[str, float]:
    """Values in the bench's own units.

    Parameters
    ----------
    printed
        Every parameter's number as given.
    units
        Of those given in another unit than the bench's own; each one of :func:`accepted`.

    Raises
    ------
    KeyError
        Naming the parameter that a conversion needs and that is not given.
    ZeroDivisionError
        If a number that is divided by is zero.
    """
    found = {name: value for name, value in printed.items() if name not in units}
    for name, conversions in CONVERSIONS.items():
        if name in units:
            found[name] = conversions[units[name]](printed[name], found)
    return found


def reduced_inertia_kg_m2(bench: Values) -> float:
    """Of motor and load on the shaft, seen at the load: 1/(1/J_l + 1/(N² J_m))."""
    motor = bench["gear_ratio"] ** 2 * bench["motor_inertia_kg_m2"]
    return 1.0 / (1.0 / bench["load_inertia_kg_m2"] + 1.0 / motor)


def _total_inertia(bench: Values) -> float:
    """Of motor and load, seen at the motor."""
    return bench["motor_inertia_kg_m2"] + bench["load_inertia_kg_m2"] / bench["gear_ratio"] ** 2
