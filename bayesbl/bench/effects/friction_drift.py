"""Drift: motor friction that changes during the recording as the joint warms up.

    J_m dω_m/dt = … − (T₀ + r t) sign ω_m

T₀ repeats every load rotation, the change r does not: such a bench is simulated in full length.
"""

from __future__ import annotations

from bayesbl.bench.effect_declaration import Amplitude, Effect, RigidLaw, direction

EFFECT = Effect(
    place=190,
    name="friction_drift",
    sentence="Motor friction that changes during the recording as the joint warms up.",
    equation="J_m dω_m/dt: − (T₀ + r t) sign ω_m",
    parameters=(
        Amplitude("torque_nm", "N m", "friction at the start T₀", low=-2.0, high=2.0, typical=0.1),
        Amplitude(
            "rate_nm_per_s",
            "N m/s",
            "change r",
            low=-0.05,
            high=0.05,
            typical=0.01,
            repeats="never",
            rate_of="torque_nm",
        ),
    ),
    enters="motor",
    depends_on=("time", "direction"),
    data="current that drifts from rotation to rotation",
    torque=RigidLaw(
        signal=lambda motion, bench, given: (
            (given["torque_nm"] + given["rate_nm_per_s"] * (motion.time_s - motion.time_s[0]))
            * direction(motion)
        ),
        amplitude="rate_nm_per_s",
        linear=("torque_nm",),
        contains="motor_coulomb_friction",
    ),
    free_motion=True,
)
