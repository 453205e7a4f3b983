"""Viscous friction at the load, behind the gap.

    J_l dω_l/dt = … − b ω_l

At one speed it moves the pulses as Coulomb friction at the load does.
"""

from __future__ import annotations

from bayesbl.bench.effect_declaration import ARMSTRONG, Amplitude, Effect

EFFECT = Effect(
    place=80,
    name="load_viscous_friction",
    sentence="Friction at the load in proportion to its speed.",
    equation="J_l dω_l/dt: − b ω_l",
    parameters=(
        Amplitude(
            "coefficient_nm_s_per_rad",
            "N m s/rad",
            "coefficient b",
            high=100.0,
            typical=10.0,
            not_negative=True,
        ),
    ),
    enters="load",
    depends_on=("speed",),
    data="as load Coulomb friction, in proportion to the reference speed",
    reference=ARMSTRONG,
    load_torque=lambda motion, bench, given: (
        given["coefficient_nm_s_per_rad"] * motion.speed / bench.value("gear_ratio")
    ),
)
