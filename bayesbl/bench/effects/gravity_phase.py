"""Gravity's direction is off: the link does not hang straight down where the load angle is zero.

    J_l dω_l/dt = … − m g l sin θ_l − m_c cos θ_l

Together they are one sine, shifted: a start angle in disguise unless the load angle is known.
"""

from __future__ import annotations

import numpy as np

from bayesbl.bench.effect_declaration import (
    Amplitude,
    Effect,
    Parameters,
    RigidBench,
    RigidLaw,
    RigidMotion,
)
from bayesbl.recording.types import FloatArray


def load_torque_nm(motion: RigidMotion, bench: RigidBench, given: Parameters) -> FloatArray:
    """m_c cos θ_l, at the load."""
    return np.asarray(given["torque_nm"] * np.cos(motion.angle / bench.value("gear_ratio")))


def torque_nm(motion: RigidMotion, bench: RigidBench, given: Parameters) -> FloatArray:
    """(m_c/N) cos θ_l, at the motor."""
    return np.asarray(load_torque_nm(motion, bench, given) / bench.value("gear_ratio"))


EFFECT = Effect(
    place=100,
    name="gravity_phase",
    sentence="Gravity's direction is not where the load angle's zero says.",
    equation="J_l dω_l/dt: − m_c cos θ_l",
    parameters=(
        Amplitude(
            "torque_nm", "N m", "torque at θ_l = 0, m_c", low=-200.0, high=200.0, typical=30.0
        ),
    ),
    enters="load",
    depends_on=("load_angle",),
    data="the whole rotation shifts in phase: a start angle in disguise unless θ_l is absolute",
    torque=RigidLaw(signal=torque_nm, amplitude="torque_nm"),
    load_torque=load_torque_nm,
    free_motion=True,
)
