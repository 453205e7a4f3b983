"""Two tooth flanks of different stiffness, as asymmetric or unevenly worn teeth have them.

    τ_s → τ_s + a K_s |e|,   e the compression beyond the gap

The shaft is stiffer by the share a where it drives the load forward, and softer by as much where it
drives backward. A rigid bench has no shaft, so no law there.
"""

from __future__ import annotations

from bayesbl.bench.effect_declaration import Amplitude, Effect

EFFECT = Effect(
    place=155,
    name="flank_asymmetry",
    sentence="The two tooth flanks differ in stiffness.",
    equation="τ_s + a K_s |e|, e the compression beyond the gap",
    parameters=(
        Amplitude(
            "share",
            "",
            "half the difference of the two stiffnesses over their mean a",
            low=-0.6,
            high=0.6,
            typical=0.05,
            smaller_than=1.0,
        ),
    ),
    enters="shaft",
    depends_on=("twist",),
    data="ringing on one flank faster than on the other",
    reference="Kapelevich 2000, Mechanism and Machine Theory 35, 117",
)
