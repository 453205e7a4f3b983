"""Viscous friction that differs between the two directions, as worn or preloaded gears have it.

    J_m dω_m/dt = … − c |ω_m|

c is half the difference of the two coefficients; their mean is viscous friction.
"""

from __future__ import annotations

from bayesbl.bench.effect_declaration import ARMSTRONG, Amplitude, Effect, RigidLaw, direction

EFFECT = Effect(
    place=50,
    name="friction_asymmetry",
    sentence="Viscous friction that differs between the two directions.",
    equation="J_m dω_m/dt: − c |ω_m|",
    parameters=(
        Amplitude(
            "coefficient_nm_s_per_rad",
            "N m s/rad",
            "half the difference of the coefficients, forward less reverse",
            low=-0.01,
            high=0.01,
            typical=5e-4,
        ),
    ),
    enters="motor",
    depends_on=("speed",),
    data="current offsets of forward and reverse recordings that differ in size, more at speed",
    reference=ARMSTRONG,
    torque=RigidLaw(
        signal=lambda motion, bench, given: (
            given["coefficient_nm_s_per_rad"] * motion.speed * direction(motion)
        ),
        amplitude="coefficient_nm_s_per_rad",
        usual=0.1,
        requires="motor_viscous_friction",
    ),
    free_motion=True,
)
