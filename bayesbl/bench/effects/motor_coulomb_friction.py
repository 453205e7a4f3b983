"""Coulomb friction at the motor: a torque of constant size against the motion.

    J_m dω_m/dt = … − T_c sign ω_m

At constant speed the current carries T_c/K_t more, with the sign of the direction, and the speed
shows nothing: forward and reverse recordings together tell it from an offset, several speeds from
viscous friction. On a rigid bench load friction T_l is the same law, T_c = T_l/N.
"""

from __future__ import annotations

from bayesbl.bench.effect_declaration import ARMSTRONG, Amplitude, Effect, RigidLaw, direction

EFFECT = Effect(
    place=20,
    name="motor_coulomb_friction",
    sentence="Dry friction at the motor that does not depend on speed.",
    equation="J_m dω_m/dt: − T_c sign ω_m",
    parameters=(
        Amplitude(
            "torque_nm", "N m", "friction torque T_c", high=2.0, typical=0.2, not_negative=True
        ),
    ),
    enters="motor",
    depends_on=("direction",),
    data="constant current offset that changes sign with the direction",
    reference=ARMSTRONG,
    torque=RigidLaw(
        signal=lambda motion, bench, given: given["torque_nm"] * direction(motion),
        amplitude="torque_nm",
        same_as=("load_coulomb_friction",),
    ),
    free_motion=True,
)
