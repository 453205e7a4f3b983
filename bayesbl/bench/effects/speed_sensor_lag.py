"""Lag of the speed sensor: a filter between the motor and the controller.

    T dω_meas/dt = ω_m − ω_meas

The recorded speed is the filtered one. Nearly the same as a lag of the current loop with a skew.
"""

from __future__ import annotations

from bayesbl.bench.effect_declaration import Amplitude, Effect

EFFECT = Effect(
    place=180,
    name="speed_sensor_lag",
    sentence="The speed that the controller sees and records is filtered.",
    equation="T dω_meas/dt = ω_m − ω_meas",
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
    data="ringing less damped; pulse fronts rounded",
    always_in=True,
    in_nominal=True,  # as late as the drive compensates
)
