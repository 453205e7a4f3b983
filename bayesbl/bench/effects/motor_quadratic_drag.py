"""Drag at the motor that grows with the square of its speed: churned grease, a fan, an open rotor.

    J_m dω_m/dt = … − c |ω_m| ω_m

Over a few constant speeds it is a viscous friction of another size, so it is not sought there.
"""

from __future__ import annotations

import numpy as np

from bayesbl.bench.effect_declaration import Amplitude, Effect, RigidLaw

EFFECT = Effect(
    place=45,
    name="motor_quadratic_drag",
    sentence="Drag that grows with the square of the speed, as of churned grease or a fan.",
    equation="J_m dω_m/dt: − c |ω_m| ω_m",
    parameters=(
        Amplitude(
            "coefficient_nm_s2_per_rad2",
            "N m s²/rad²",
            "drag coefficient c",
            high=1e-4,
            typical=5e-6,
            not_negative=True,
        ),
    ),
    enters="motor",
    depends_on=("speed",),
    data="more current at high speed than viscous friction of the low speeds explains",
    torque=RigidLaw(
        signal=lambda motion, bench, given: (
            given["coefficient_nm_s2_per_rad2"] * np.abs(motion.speed) * motion.speed
        ),
        amplitude="coefficient_nm_s2_per_rad2",
        usual=0.2,
    ),
    sought_in_loop=False,
)
