"""An elastic arm or payload: part of the load hangs on a spring of its own.

    a = θ_l − θ_a,   τ_a = (a + t_a ȧ)/c_a
    (1 − s) J_l dω_l/dt = τ_s − τ_a − (1 − g) m g l sin θ_l,   s J_l dω_a/dt = τ_a − g m g l sin θ_a

J_l and m g l are those of the whole load, of which the shares s and g are behind the spring.
"""

from __future__ import annotations

from bayesbl.bench.effect_declaration import Amplitude, Effect, Resonance, Shape

EFFECT = Effect(
    place=102,
    name="arm",
    sentence="The arm, or a payload on it, bends: it has a resonance of its own.",
    equation="τ_a = (a + t_a ȧ)/c_a of a = θ_l − θ_a, the share s of J_l and g of m g l behind it",
    parameters=(
        Amplitude(
            "compliance_rad_per_nm",
            "rad/(N m)",
            "bending over torque c_a, one over its stiffness",
            high=2e-4,
            typical=8e-6,
            not_negative=True,
        ),
        Shape(
            "damping_time_s",
            "s",
            "damping over stiffness t_a",
            high=1e-2,
            typical=1e-3,
            neutral=1e-3,
            bounded=True,
        ),
        Shape(
            "inertia_share",
            "",
            "share s of the load's inertia that is behind the spring",
            low=0.05,
            high=0.95,
            typical=0.4,
            neutral=0.4,
            positive_scale=True,
            bounded=True,
        ),
        Shape(
            "gravity_share",
            "",
            "share g of gravity's torque that is behind the spring",
            high=1.0,
            typical=0.5,
            neutral=0.5,
            bounded=True,
        ),
    ),
    enters="shaft",
    depends_on=("transmitted_torque",),
    resonance=Resonance(
        inertia="load_inertia_kg_m2",
        part="inertia_share",
        is_share=True,
        parts=(0.15, 0.4),
        multiples=(0.4, 3.0),
    ),
    data="a second ringing that dies slowly, at the arm's own frequency",
    reference="Spong 1987, J. Dyn. Syst. Meas. Control 109, 310",
    in_bench_file="[arm] with stiffness_nm_per_rad and inertia_kg_m2 says the same.",
)
