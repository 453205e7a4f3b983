"""Elastic parts of the joint with an inertia behind them: belt, arm and base."""

from __future__ import annotations

from bayesbl.bench.effect_declaration import Effect, EffectParameter, Resonance, amplitude, shape


def _compliance(meaning: str, high: float, typical: float) -> EffectParameter:
    return amplitude(
        "compliance_rad_per_nm", f"{meaning}, one over its stiffness", high=high, typical=typical
    )


def _damping(symbol: str) -> EffectParameter:
    return shape(
        "damping_ratio",
        f"damping ratio {symbol} of its resonance",
        high=0.5,
        typical=0.05,
        neutral=0.05,
        bounded=True,
    )


# b = θ_m − θ_r,   τ_b = (b + t_b ḃ)/c_b,   t_b = 2 ζ_b/ω_b,   1/ω_b² = c_b s (1 − s) J_m
# (1 − s) J_m dω_m/dt = K_t i − τ_b,   s J_m dω_r/dt = τ_b − τ_s/N
#
# θ_r drives the gear, the encoder shows θ_m. J_m is the whole inertia on the fast side, including
# pulleys and the reducer's input, of which the share s is behind the belt. A belt that does not
# stretch leaves the bench unchanged.
BELT = Effect(
    place=101,
    name="belt",
    sentence="A belt or an elastic coupling between motor and gear stretches.",
    equation="τ_b = (b + t_b ḃ)/c_b of b = θ_m − θ_r, the share s of J_m behind it",
    parameters=(
        _compliance("stretch over torque at the motor c_b", high=0.1, typical=0.006),
        _damping("ζ_b"),
        shape(
            "reducer_share",
            "share s of the motor's inertia that is behind the belt",
            low=0.05,
            high=0.95,
            typical=0.3,
            neutral=0.3,
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

# a = θ_l − θ_a,   τ_a = (a + t_a ȧ)/c_a,   t_a = 2 ζ_a/ω_a,   1/ω_a² = c_a s (1 − s) J_l
# (1 − s) J_l dω_l/dt = τ_s − τ_a − (1 − g) m g l sin θ_l,   s J_l dω_a/dt = τ_a − g m g l sin θ_a
#
# J_l and m g l are those of the whole load, of which the shares s and g are behind the spring.
ARM = Effect(
    place=102,
    name="arm",
    sentence="The arm, or a payload on it, bends: it has a resonance of its own.",
    equation="τ_a = (a + t_a ȧ)/c_a of a = θ_l − θ_a, the share s of J_l and g of m g l behind it",
    parameters=(
        _compliance("bending over torque c_a", high=2e-4, typical=8e-6),
        _damping("ζ_a"),
        shape(
            "inertia_share",
            "share s of the load's inertia that is behind the spring",
            low=0.05,
            high=0.95,
            typical=0.4,
            neutral=0.4,
            bounded=True,
        ),
        shape(
            "gravity_share",
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

# The base, against which motor and gear react, moves. All angles of the joint are relative to its
# housing, which turns by θ_f. Gravity acts at the load's absolute angle, and both inertias are
# accelerated with the housing. t_f = 2 ζ_f/ω_f,  1/ω_f² = c_f J_f.
BASE = Effect(
    place=103,
    name="base",
    sentence="The base under the joint yields: it has a resonance of its own.",
    equation="J_f d²θ_f/dt² = −(θ_f + t_f dθ_f/dt)/c_f − K_t i + τ_s/N − τ_s",
    parameters=(
        _compliance("turn over torque c_f", high=2e-5, typical=5e-7),
        _damping("ζ_f"),
        shape(
            "inertia_kg_m2",
            "inertia of the base J_f about the joint's axis",
            low=0.05,
            high=1e4,
            typical=60.0,
            neutral=60.0,
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
