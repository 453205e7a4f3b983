"""What of a joint moves between two snapshots though nobody touched it, and by how much.

"Nothing but the gap changed" is never assumed: grease warms up, magnets weaken, bearings settle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

BITTENCOURT = "Bittencourt & Gunnarsson 2012, J. Dyn. Syst. Meas. Control 134, 051013"
NEODYMIUM = "IEC 60404-8-1: remanence of Nd-Fe-B falls by 0.08 to 0.12 % per kelvin"
STEEL = "Young's modulus of steel falls by 0.03 % per kelvin; preload of bearings does the rest"


@dataclass(frozen=True, slots=True)
class Budget:
    """Relative standard deviation between two snapshots, and where it is taken from."""

    relative_sd: float
    source: str


def _lubricant(relative_sd: float) -> Budget:
    return Budget(relative_sd, f"lubricant warmer or colder by some 20 K: {BITTENCOURT}")


DEFAULT_DRIFT: Mapping[str, Budget] = MappingProxyType(
    {
        "shaft_damping_nm_s_per_rad": _lubricant(0.2),
        "shaft_stiffness_nm_per_rad": Budget(0.01, STEEL),
        "torque_constant_nm_per_a": Budget(0.02, f"a motor warmer by some 20 K: {NEODYMIUM}"),
        "contact_damping": _lubricant(0.2),
        "stiffness_hardening": Budget(0.02, STEEL),
        "shaft_hysteresis": _lubricant(0.2),
        "motor_coulomb_friction": _lubricant(0.2),
        "motor_viscous_friction": _lubricant(0.3),
        "motor_quadratic_drag": _lubricant(0.3),
        "motor_stribeck_friction": _lubricant(0.3),
        "friction_asymmetry": _lubricant(0.3),
        "load_coulomb_friction": _lubricant(0.2),
        "load_viscous_friction": _lubricant(0.3),
        "gear_mesh_friction": _lubricant(0.2),
    }
)
"""By name of a bench parameter or effect; what is not here does not drift unless told.

Gains and payload are set by people: they stay or are changed, and a change shows.
"""


def drift_of(name: str, stated: Mapping[str, float]) -> float:
    """Relative standard deviation of a parameter, an effect or ``effect.parameter``."""
    for key in (name, name.partition(".")[0]):
        if key in stated:
            return stated[key]
    budget = DEFAULT_DRIFT.get(name) or DEFAULT_DRIFT.get(name.partition(".")[0])
    return budget.relative_sd if budget is not None else 0.0
