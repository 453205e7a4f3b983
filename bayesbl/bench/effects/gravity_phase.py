"""Gravity's direction is off: the link does not hang straight down where the load angle is zero.

    J_l dω_l/dt = … − m g l sin θ_l − m_c cos θ_l

Together they are one sine, shifted: a start angle in disguise unless the load angle is known.
"""

from __future__ import annotations

import numpy as np

from bayesbl.bench.effect_declaration import Amplitude, Effect, Law, RigidLaw

_AT_LOAD: Law = lambda motion, bench, given: (  # noqa: E731
    given["torque_nm"] * np.cos(motion.angle / bench.value("gear_ratio"))
)

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
    torque=RigidLaw(
        signal=lambda motion, bench, given: (
            _AT_LOAD(motion, bench, given) / bench.value("gear_ratio")
        ),
        amplitude="torque_nm",
    ),
    load_torque=_AT_LOAD,
    free_motion=True,
)
