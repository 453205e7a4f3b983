"""Viscous friction at the load, behind the gap.

J_l dω_l/dt = … − b ω_l
"""

from __future__ import annotations

import numpy as np

from bayesbl.bench.effect_declaration import (
    ARMSTRONG,
    Effect,
    FloatArray,
    Parameters,
    RigidBench,
    RigidMotion,
    amplitude,
)


def load_torque_nm(motion: RigidMotion, bench: RigidBench, given: Parameters) -> FloatArray:
    """b ω_l, at the load."""
    coefficient = given["coefficient_nm_s_per_rad"]
    return np.asarray(coefficient * motion.speed / bench.value("gear_ratio"))


EFFECT = Effect(
    place=80,
    name="load_viscous_friction",
    sentence="Friction at the load in proportion to its speed.",
    equation="J_l dω_l/dt: − b ω_l",
    parameters=(
        amplitude(
            "coefficient_nm_s_per_rad",
            "N m s/rad",
            "coefficient b",
            low=0.0,
            high=100.0,
            typical=10.0,
            repeats="always",
            not_negative=True,
        ),
    ),
    enters="load",
    depends_on=("speed",),
    data="as load Coulomb friction, in proportion to the reference speed",
    reference=ARMSTRONG,
    load_torque=load_torque_nm,
)
