"""A constant torque at the motor: a spring, a counterweight's cable, an offset current sensor.

J_m dω_m/dt = … − T
"""

from __future__ import annotations

import numpy as np

from bayesbl.bench.effect_declaration import (
    Effect,
    FloatArray,
    Parameters,
    RigidBench,
    RigidLaw,
    RigidMotion,
    amplitude,
)


def torque_nm(motion: RigidMotion, bench: RigidBench, given: Parameters) -> FloatArray:
    """T."""
    return np.asarray(given["torque_nm"] * np.ones_like(motion.speed))


EFFECT = Effect(
    place=60,
    name="motor_torque_offset",
    sentence="A constant torque at the motor that does not know the direction.",
    equation="J_m dω_m/dt: − T",
    parameters=(
        amplitude(
            "torque_nm",
            "N m",
            "torque against forward rotation T",
            low=-2.0,
            high=2.0,
            typical=0.2,
            repeats="always",
        ),
    ),
    enters="motor",
    depends_on=(),
    data="constant current offset of the same sign in both directions",
    torque=RigidLaw(signal=torque_nm, amplitude="torque_nm", same_as=("load_torque_offset",)),
    free_motion=True,
)
