"""Hardening: the shaft, or the gear's teeth, stiffen as they are wound up.

    τ_s → τ_s + k₃ e³,   e the compression beyond the gap

A rigid bench has no shaft, so no law there.
"""

from __future__ import annotations

from bayesbl.bench.effect_declaration import Amplitude, Effect

EFFECT = Effect(
    place=150,
    name="stiffness_hardening",
    sentence="The shaft stiffens as it is wound up.",
    equation="τ_s + k₃ e³, e the compression beyond the gap",
    parameters=(
        Amplitude("stiffness_nm_per_rad3", "N m/rad³", "k₃", low=-1e9, high=1e10, typical=1e9),
    ),
    enters="shaft",
    depends_on=("twist",),
    data="ringing faster under high load torque than under low",
    reference="Tuttle & Seering 1996, IEEE Trans. Robot. Autom. 12, 368",
    always_in=True,
)
