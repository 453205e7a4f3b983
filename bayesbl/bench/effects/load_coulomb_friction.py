"""Coulomb friction at the load, behind the gap.

    J_l dω_l/dt = … − T_c sign ω_l

The teeth part where gravity balances it: the pulses move away from half a rotation apart. A rigid
bench shows it as friction at the motor, T_c/N.
"""

from __future__ import annotations

from bayesbl.bench.effect_declaration import ARMSTRONG, Amplitude, Effect, direction

EFFECT = Effect(
    place=70,
    name="load_coulomb_friction",
    sentence="Dry friction at the load, beyond the gap.",
    equation="J_l dω_l/dt: − T_c sign ω_l",
    parameters=(
        Amplitude(
            "torque_nm", "N m", "friction torque T_c", high=200.0, typical=15.0, not_negative=True
        ),
    ),
    enters="load",
    depends_on=("direction",),
    data="pulses move away from half a rotation apart and change in size; current offset",
    reference=ARMSTRONG,
    load_torque=lambda motion, bench, given: given["torque_nm"] * direction(motion),
)
