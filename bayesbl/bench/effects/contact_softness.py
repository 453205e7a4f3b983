"""Edges of the gap that are not sharp: teeth meet one after another, and flanks are not smooth.

    K_s max(0, |Δθ| − δ) → its mean over a δ that is logistic with variance v

Contact begins earlier and is softer at first; far from the edge nothing changes, so δ stays where
the straight flank meets zero torque. The damper acts as the mean does. A rigid bench has no gap, so
no law there.
"""

from __future__ import annotations

from bayesbl.bench.effect_declaration import Amplitude, Effect

EFFECT = Effect(
    place=153,
    name="contact_softness",
    sentence="The edges of the gap are soft.",
    equation="K_s max(0, |Δθ| − δ) → its mean over a logistic δ of variance v",
    parameters=(
        Amplitude(
            "variance_rad2",
            "rad²",
            "variance of the edge v",
            high=1e-7,
            typical=1e-9,
            not_negative=True,
        ),
    ),
    enters="shaft",
    depends_on=("twist",),
    data="impacts that begin softly, most beside a small gap",
    reference="Kahraman & Singh 1991, J. Sound Vib. 146, 135",
    always_in=True,
    in_nominal=True,  # the arctan form is soft itself
)
