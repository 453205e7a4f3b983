"""A belt between motor and gear: a spring on the fast side, with the reducer's inertia behind it.

    b = θ_m − θ_r,   τ_b = (b + t_b ḃ)/c_b
    (1 − s) J_m dω_m/dt = K_t i − τ_b,   s J_m dω_r/dt = τ_b − τ_s/N

The gear is turned by θ_r, the encoder shows θ_m. J_m is the whole inertia on the fast side, pulleys
and the reducer's input included, of which the share s is behind the belt: a belt that does not
stretch leaves the bench as it was.
"""

from __future__ import annotations

from bayesbl.bench.effect_declaration import Amplitude, Effect, Resonance, Shape

EFFECT = Effect(
    place=101,
    name="belt",
    sentence="A belt or an elastic coupling between motor and gear stretches.",
    equation="τ_b = (b + t_b ḃ)/c_b of b = θ_m − θ_r, the share s of J_m behind it",
    parameters=(
        Amplitude(
            "compliance_rad_per_nm",
            "rad/(N m)",
            "stretch over torque at the motor c_b, one over its stiffness",
            high=0.1,
            typical=0.006,
            not_negative=True,
        ),
        Shape(
            "damping_time_s",
            "s",
            "damping over stiffness t_b",
            high=2e-3,
            typical=2e-4,
            neutral=2e-4,
            bounded=True,
        ),
        Shape(
            "reducer_share",
            "",
            "share s of the motor's inertia that is behind the belt",
            low=0.05,
            high=0.95,
            typical=0.3,
            neutral=0.3,
            positive_scale=True,
            bounded=True,
        ),
    ),
    enters="motor",
    depends_on=("transmitted_torque",),
    resonance=Resonance(
        inertia="motor_inertia_kg_m2",
        part="reducer_share",
        is_share=True,
        parts=(0.2, 0.5),
        multiples=(3.0, 25.0),
    ),
    data="ringing at two frequencies; the motor answers a current before the gear does",
    reference="Hace, Jezernik & Sabanovic 2005, Mechatronics 15, 717",
    in_bench_file="[belt] with stiffness_nm_per_rad and reducer_inertia_kg_m2 says the same.",
)
