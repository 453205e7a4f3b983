"""Lag of the current loop: the torque comes later than the controller asks for it.

    T dτ_m/dt = τ_demand − τ_m

Nearly the same as a lag of the speed sensor together with a skew of the current. A rigid inverse
comparison does not see it: the recorded current is the one that flows.
"""

from __future__ import annotations

from bayesbl.bench.effect_declaration import Amplitude, Effect

EFFECT = Effect(
    place=170,
    name="current_loop_lag",
    sentence="The motor torque follows the controller with a first-order lag.",
    equation="T dτ_m/dt = τ_demand − τ_m",
    parameters=(
        Amplitude(
            "time_s",
            "s",
            "time constant T",
            high=0.01,
            typical=1e-3,
            not_negative=True,
            sought_from=2e-4,  # shorter ones hardly show and cost the simulator tiny steps
        ),
    ),
    enters="loop",
    data="ringing less damped; current behind speed",
    always_in=True,
    in_nominal=True,  # as late as the drive compensates
)
