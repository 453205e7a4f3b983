"""The gap: its size if the bench is assumed to have none, and its variation with the load angle."""

from __future__ import annotations

from bayesbl.bench.effect_declaration import Effect, EffectParameter, amplitude

BACKLASH = Effect(
    place=10,
    name="backlash",
    sentence="The gap itself, where the nominal bench has none.",
    equation="δ → δ + gap",
    parameters=(
        amplitude("gap_rad", "half the clearance, at the load", low=1e-4, high=4e-3, typical=4e-4),
    ),
    enters="shaft",
    depends_on=("twist",),
    data="two ringing pulses of opposite sign in each load rotation",
    reference="Nordin & Gutman 2002, Automatica 38, 1633",
    replaces="gap_rad",
)


def _share(name: str, meaning: str, typical: float) -> EffectParameter:
    return amplitude(name, meaning, low=-0.5, high=0.5, typical=typical, smaller_than=1.0)


# From tooth wear where the teeth work, or from run-out. δ is the mean over a load rotation; the
# shares are zero if the gap is the same all round.
GAP_VARIATION = Effect(
    place=15,
    name="gap_variation",
    sentence="The gap is wider at some angles of the load than at others.",
    equation="δ (1 + a_1 cos θ_l + b_1 sin θ_l + a_2 cos 2θ_l + b_2 sin 2θ_l)",
    parameters=(
        _share("cosine_1", "share a_1 of the mean gap", 0.08),
        _share("sine_1", "share b_1 of the mean gap", -0.05),
        _share("cosine_2", "share a_2 of the mean gap", 0.03),
        _share("sine_2", "share b_2 of the mean gap", 0.02),
    ),
    enters="shaft",
    depends_on=("twist",),
    data="the two impacts of a load rotation differ, by the same in every rotation",
    reference="Merzouki & Cadiou 2005, Control Engineering Practice 13, 337",
    in_bench_file="[gap] with harmonics says the same.",
)
