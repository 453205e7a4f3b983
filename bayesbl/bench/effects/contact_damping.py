"""Damping of the contact that grows with its compression, Hunt and Crossley's law.

    τ_s → τ_s + λ K_s |e| ė,   e the compression beyond the gap

Teeth that have just met damp nothing yet, as the shaft's own D_s does at once. A rigid bench has no
shaft, so no law there.
"""

from __future__ import annotations

from bayesbl.bench.effect_declaration import Amplitude, Effect

EFFECT = Effect(
    place=157,
    name="contact_damping",
    sentence="The contact damps more, the more it is compressed (Hunt and Crossley).",
    equation="τ_s + λ K_s |e| ė, e the compression beyond the gap",
    parameters=(
        Amplitude(
            "factor_s_per_rad",
            "s/rad",
            "damping over stiffness and compression λ",
            high=5.0,
            typical=0.5,
            not_negative=True,
        ),
    ),
    enters="shaft",
    depends_on=("twist",),
    data="ringing that dies sooner under high load torque than under low",
    reference="Hunt & Crossley 1975, J. Appl. Mech. 42, 440",
    always_in=True,
)
