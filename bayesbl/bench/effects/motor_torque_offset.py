"""A constant torque at the motor: a spring, a cable, a current sensor that does not read zero.

    J_m dω_m/dt = … − T

Forward and reverse recordings together tell it from friction.
"""

from __future__ import annotations

import numpy as np

from bayesbl.bench.effect_declaration import Amplitude, Effect, RigidLaw

EFFECT = Effect(
    place=60,
    name="motor_torque_offset",
    sentence="A constant torque at the motor that does not know the direction.",
    equation="J_m dω_m/dt: − T",
    parameters=(
        Amplitude(
            "torque_nm", "N m", "torque against forward rotation T", low=-2.0, high=2.0, typical=0.2
        ),
    ),
    enters="motor",
    data="constant current offset of the same sign in both directions",
    torque=RigidLaw(
        signal=lambda motion, bench, given: given["torque_nm"] * np.ones_like(motion.speed),
        amplitude="torque_nm",
        same_as=("load_torque_offset",),
    ),
    free_motion=True,
)
