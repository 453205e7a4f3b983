"""Stribeck friction at the motor: more friction before the lubricant film has built up.

    J_m dω_m/dt = … − T_s exp(−(ω_m/ω_s)²) sign ω_m

Beside another motor friction it takes recordings at three speeds to be seen.
"""

from __future__ import annotations

import numpy as np

from bayesbl.bench.effect_declaration import (
    ARMSTRONG,
    Amplitude,
    Effect,
    RigidLaw,
    Shape,
    direction,
)

EFFECT = Effect(
    place=40,
    name="motor_stribeck_friction",
    sentence="Extra friction at low speed that fades as the lubricant film builds up.",
    equation="J_m dω_m/dt: − T_s exp(−(ω_m/ω_s)²) sign ω_m",
    parameters=(
        Amplitude(
            "torque_nm",
            "N m",
            "extra torque at standstill T_s",
            high=2.0,
            typical=0.3,
            not_negative=True,
        ),
        Shape(
            "speed_rad_per_s",
            "rad/s",
            "fading speed ω_s",
            low=1.0,
            high=500.0,
            neutral=50.0,
            typical=200.0,
            positive_scale=True,
        ),
    ),
    enters="motor",
    depends_on=("speed", "direction"),
    data="more current at low reference speeds than at high ones",
    reference=ARMSTRONG,
    torque=RigidLaw(
        signal=lambda motion, bench, given: (
            given["torque_nm"]
            * np.exp(-((motion.speed / given["speed_rad_per_s"]) ** 2))
            * direction(motion)
        ),
        amplitude="torque_nm",
        usual=0.2,
        requires="motor_coulomb_friction",
        scanned="speed_rad_per_s",
        grid=tuple(np.geomspace(0.01, 2.0, 21)),
        grid_unit="speed",
    ),
    free_motion=True,
)
