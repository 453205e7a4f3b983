"""Viscous friction at the motor: lubricant that is sheared.

J_m dω_m/dt = … − b ω_m
"""

from __future__ import annotations

import numpy as np

from bayesbl.bench.effect_declaration import (
    ARMSTRONG,
    Effect,
    FloatArray,
    Parameters,
    RigidBench,
    RigidLaw,
    RigidMotion,
    amplitude,
)


def torque_nm(motion: RigidMotion, bench: RigidBench, given: Parameters) -> FloatArray:
    """b ω_m."""
    return np.asarray(given["coefficient_nm_s_per_rad"] * motion.speed)


EFFECT = Effect(
    place=30,
    name="motor_viscous_friction",
    sentence="Friction at the motor in proportion to speed.",
    equation="J_m dω_m/dt: − b ω_m",
    parameters=(
        amplitude(
            "coefficient_nm_s_per_rad",
            "N m s/rad",
            "coefficient b",
            low=0.0,
            high=0.02,
            typical=1e-3,
            repeats="always",
            not_negative=True,
        ),
    ),
    enters="motor",
    depends_on=("speed",),
    data="current offset that grows with the reference speed; a little more damping of the ringing",
    reference=ARMSTRONG,
    torque=RigidLaw(
        signal=torque_nm,
        amplitude="coefficient_nm_s_per_rad",
        same_as=("load_viscous_friction",),
    ),
    free_motion=True,
)
