"""A base that gives way: what motor and gear push off from moves.

    J_f d²θ_f/dt² = −(θ_f + t_f dθ_f/dt)/c_f − K_t i + τ_s/N − τ_s

All angles of the joint are those against its housing, which is turned by θ_f; gravity acts at the
load's absolute angle, and both inertias are turned with the housing.
"""

from __future__ import annotations

from bayesbl.bench.effect_declaration import Amplitude, Effect, Resonance, Shape

EFFECT = Effect(
    place=103,
    name="base",
    sentence="What the joint is mounted on gives way: a base with a resonance of its own.",
    equation="J_f d²θ_f/dt² = −(θ_f + t_f dθ_f/dt)/c_f − K_t i + τ_s/N − τ_s",
    parameters=(
        Amplitude(
            "compliance_rad_per_nm",
            "rad/(N m)",
            "turn over torque c_f, one over its stiffness",
            high=2e-5,
            typical=5e-7,
            not_negative=True,
        ),
        Shape(
            "damping_time_s",
            "s",
            "damping over stiffness t_f",
            high=1e-2,
            typical=1e-3,
            neutral=1e-3,
            bounded=True,
        ),
        Shape(
            "inertia_kg_m2",
            "kg m²",
            "inertia of the base J_f about the joint's axis",
            low=0.05,
            high=1e4,
            typical=60.0,
            neutral=60.0,
            positive_scale=True,
        ),
    ),
    enters="shaft",
    depends_on=("transmitted_torque",),
    resonance=Resonance(
        inertia="load_inertia_kg_m2",
        part="inertia_kg_m2",
        is_share=False,
        parts=(1.5, 5.0),
        multiples=(0.4, 3.0),
    ),
    data="a second ringing at the base's own frequency",
    reference="Book & Lee 1989, American Control Conference, 1377",
    in_bench_file="[base] with stiffness_nm_per_rad and inertia_kg_m2 says the same.",
)
