"""A constant torque at the load: a weight on a cable, a spring, wind.

J_l dω_l/dt = … − T
"""

from __future__ import annotations

import numpy as np

from bayesbl.bench.effect_declaration import (
    Effect,
    FloatArray,
    Parameters,
    RigidBench,
    RigidMotion,
    amplitude,
)


def load_torque_nm(motion: RigidMotion, bench: RigidBench, given: Parameters) -> FloatArray:
    """T, at the load."""
    return np.asarray(given["torque_nm"] * np.ones_like(motion.speed))


EFFECT = Effect(
    place=90,
    name="load_torque_offset",
    sentence="A constant torque at the load that does not know the direction.",
    equation="J_l dω_l/dt: − T",
    parameters=(
        amplitude(
            "torque_nm",
            "N m",
            "torque against forward rotation T",
            low=-200.0,
            high=200.0,
            typical=15.0,
            repeats="always",
        ),
    ),
    enters="load",
    depends_on=(),
    data="pulses shift alike in both directions",
    load_torque=load_torque_nm,
)
