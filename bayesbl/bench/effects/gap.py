"""The gap: its size where a bench is believed to have none, and over the angle of the load."""

from __future__ import annotations

import numpy as np

from bayesbl.bench.effect_declaration import Effect, EffectParameter, RigidLaw, amplitude
from bayesbl.recording.types import FloatArray


def play(angle: FloatArray, half_width: float) -> FloatArray:
    """Departure of the play operator from its input, shape (n,), within ±half_width."""
    out = np.empty_like(angle)
    held = angle[0]
    for i, value in enumerate(angle):
        held = min(max(held, value - half_width), value + half_width)
        out[i] = held - value
    return out


# In a rigid comparison a load that friction holds lies half the clearance behind the motor and
# waits at reversals: the play operator.
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
    position=RigidLaw(
        signal=lambda motion, bench, given: play(
            motion.angle / bench.value("gear_ratio"), given["gap_rad"]
        ),
        amplitude="gap_rad",
        scanned="gap_rad",  # the signal is not linear in the gap
        grid=tuple(np.geomspace(1e-6, 0.1, 41)),
    ),
    replaces="gap_rad",
)


def _share(name: str, meaning: str, typical: float) -> EffectParameter:
    return amplitude(name, meaning, low=-0.5, high=0.5, typical=typical, smaller_than=1.0)


# Teeth that wear where they work, or run-out. δ is the mean over a load rotation; the shares are
# zero of a gap that is the same all round.
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
    data="the two impacts of a load rotation are not alike, by the same in every rotation",
    reference="Merzouki & Cadiou 2005, Control Engineering Practice 13, 337",
    in_bench_file="[gap] with harmonics says the same.",
)
