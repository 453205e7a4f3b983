"""Transmission error: the gear passes motion on unevenly.

    Δθ → Δθ + a sin(n θ_m + φ),   Δω → Δω + a n ω_m cos(n θ_m + φ)

Felt only while the teeth touch. It repeats with the load only if the gear ratio times n is whole.
"""

from __future__ import annotations

import numpy as np

from bayesbl.bench.effect_declaration import ORDER, PHASE, Amplitude, Effect, RigidLaw, order, phase

EFFECT = Effect(
    place=130,
    name="gear_transmission_error",
    sentence="The gear passes motion on unevenly, once or more per motor turn.",
    equation="Δθ → Δθ + a sin(n θ_m + φ), Δω → Δω + a n ω_m cos(n θ_m + φ)",
    parameters=(
        Amplitude(
            "angle_rad",
            "rad",
            "amplitude a at the load",
            low=-1e-3,
            high=1e-3,
            typical=3e-5,
            repeats="whole_orders",
        ),
        order(typical=2.0),
        phase(typical=-0.4),
    ),
    enters="shaft",
    depends_on=("motor_angle",),
    data="a line at order n while the teeth touch, gone while they do not",
    reference="Tuttle & Seering 1996, IEEE Trans. Robot. Autom. 12, 368",
    position=RigidLaw(
        signal=lambda motion, bench, given: (
            given["angle_rad"] * np.sin(given[ORDER] * motion.angle + given[PHASE])
        ),
        amplitude="angle_rad",
        scanned=ORDER,
    ),
)
