"""Viscous friction at the motor: lubricant that is sheared.

    J_m dω_m/dt = … − b ω_m

Recordings at two speeds tell it from Coulomb friction. On a rigid bench load friction b_l is the
same law, b = b_l/N².
"""

from __future__ import annotations

from bayesbl.bench.effect_declaration import ARMSTRONG, Amplitude, Effect, RigidLaw

EFFECT = Effect(
    place=30,
    name="motor_viscous_friction",
    sentence="Friction at the motor in proportion to speed.",
    equation="J_m dω_m/dt: − b ω_m",
    parameters=(
        Amplitude(
            "coefficient_nm_s_per_rad",
            "N m s/rad",
            "coefficient b",
            high=0.02,
            typical=1e-3,
            not_negative=True,
        ),
    ),
    enters="motor",
    depends_on=("speed",),
    data="current offset that grows with the reference speed; a little more damping of the ringing",
    reference=ARMSTRONG,
    torque=RigidLaw(
        signal=lambda motion, bench, given: given["coefficient_nm_s_per_rad"] * motion.speed,
        amplitude="coefficient_nm_s_per_rad",
        same_as=("load_viscous_friction",),
    ),
    free_motion=True,
    always_in=True,
)
