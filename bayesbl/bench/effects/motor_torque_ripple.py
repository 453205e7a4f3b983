"""Torque ripple: cogging of the magnets, errors of the current sensors.

    J_m dω_m/dt = … − a sin(n θ_m + φ)

It repeats with the load only if the gear ratio times n is whole.
"""

from __future__ import annotations

import numpy as np

from bayesbl.bench.effect_declaration import ORDER, PHASE, Amplitude, Effect, RigidLaw, order, phase

EFFECT = Effect(
    place=120,
    name="motor_torque_ripple",
    sentence="Torque that repeats with the motor angle: cogging, current sensor errors.",
    equation="J_m dω_m/dt: − a sin(n θ_m + φ)",
    parameters=(
        Amplitude(
            "torque_nm",
            "N m",
            "amplitude a",
            low=-1.0,
            high=1.0,
            typical=0.05,
            repeats="whole_orders",
        ),
        order(typical=6.0),
        phase(typical=0.7),
    ),
    enters="motor",
    depends_on=("motor_angle",),
    data="a line at order n of the motor speed in speed and current",
    reference="Holtz & Springob 1996, IEEE Trans. Ind. Electron. 43, 309",
    torque=RigidLaw(
        signal=lambda motion, bench, given: (
            given["torque_nm"] * np.sin(given[ORDER] * motion.angle + given[PHASE])
        ),
        amplitude="torque_nm",
        scanned=ORDER,
    ),
)
