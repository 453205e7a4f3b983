"""A constant torque at the load: a weight on a cable, a spring, wind.

    J_l dω_l/dt = … − T

It moves the two pulses of a rotation towards each other or apart, whichever way the load turns.
"""

from __future__ import annotations

import numpy as np

from bayesbl.bench.effect_declaration import Amplitude, Effect

EFFECT = Effect(
    place=90,
    name="load_torque_offset",
    sentence="A constant torque at the load that does not know the direction.",
    equation="J_l dω_l/dt: − T",
    parameters=(
        Amplitude(
            "torque_nm",
            "N m",
            "torque against forward rotation T",
            low=-200.0,
            high=200.0,
            typical=15.0,
        ),
    ),
    enters="load",
    data="pulses shift alike in both directions",
    load_torque=lambda motion, bench, given: given["torque_nm"] * np.ones_like(motion.speed),
)
