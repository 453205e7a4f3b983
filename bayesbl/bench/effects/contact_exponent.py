"""A contact that stiffens with its load, as curved surfaces of steel do: Hertz's law.

    τ_s → τ_s + K_s e [(|e|/e₀)^m − 1],   e the compression beyond the gap, e₀ = m g l/K_s

The flank's torque goes with e^(1+m): m is 0.11 for a line contact (roller bearings, teeth) and 0.5
for a point contact (ball bearings); in series with shafts it is less. K_s is the stiffness at
gravity's largest torque, or at e₀ = 1 mrad on an axis without gravity. A rigid bench has no shaft,
so no law there.
"""

from __future__ import annotations

from bayesbl.bench.effect_declaration import Amplitude, Effect

EFFECT = Effect(
    place=152,
    name="contact_exponent",
    sentence="The contact stiffens with its load (Hertz).",
    equation="τ_s + K_s e [(|e|/e₀)^m − 1], e the compression beyond the gap, e₀ = m g l/K_s",
    parameters=(
        Amplitude(
            "excess",
            "",
            "exponent of the flanks' torque over compression, less 1, m",
            low=-0.3,
            high=0.6,
            typical=0.05,
            smaller_than=1.0,
        ),
    ),
    enters="shaft",
    depends_on=("twist",),
    data="ringing faster under high load torque than under low, most where the teeth barely touch",
    reference="Palmgren 1959, Ball and Roller Bearing Engineering; Hertz 1882",
)
