"""The gap as an effect: for a bench that is believed to have none.

In a rigid comparison a load that friction holds lies half the clearance behind the motor and
waits at reversals: the play operator.
"""

from __future__ import annotations

import numpy as np

from bayesbl.bench.effect_declaration import Amplitude, Effect, RigidLaw
from bayesbl.recording.types import FloatArray


def play(angle: FloatArray, half_width: float) -> FloatArray:
    """Departure of the play operator from its input, shape (n,), within ±half_width."""
    out = np.empty_like(angle)
    held = angle[0]
    for i, value in enumerate(angle):
        held = min(max(held, value - half_width), value + half_width)
        out[i] = held - value
    return out


EFFECT = Effect(
    place=10,
    name="backlash",
    sentence="The gap itself, where the nominal bench has none.",
    equation="δ → δ + gap",
    parameters=(
        Amplitude(
            "gap_rad",
            "rad",
            "half the clearance, at the load",
            low=1e-4,
            high=4e-3,
            typical=4e-4,
            not_negative=True,
        ),
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
