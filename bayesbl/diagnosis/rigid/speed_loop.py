"""What a rigid drive's speed loop makes of a torque, and of an encoder's error, at a frequency.

    (J s + b) ω = −τ + L C (ω_ref − ω_meas),   ω_meas = F (ω + s ε),
    C = (K_p + K_i/s)(1 + k_pos/s),   L = 1/(1 + T_i s),   F = 1/(1 + T_ω s)

with a torque τ that brakes and an error ε of the measured angle:

    ω_meas = F (−τ + (J s + b) s ε) / (J s + b + L C F)

An error of the angle is thus what a torque of (J s + b) s ε would be: one amplitude of either gives
lines that differ by the square of the speed, whatever the controller is.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.recording.types import ComplexArray, FloatArray
from bayesbl.units import RPM_PER_RAD_PER_S

LOOP_PARAMETERS = (
    "motor_inertia_kg_m2",
    "load_inertia_kg_m2",
    "speed_gain_nm_s_per_rad",
    "integral_gain_nm_per_rad",
    "position_gain_per_s",
)

FRICTION, CURRENT_LAG, SENSOR_LAG = "motor_viscous_friction", "current_loop_lag", "speed_sensor_lag"
LOOP_EFFECTS = {
    FRICTION: "coefficient_nm_s_per_rad",
    CURRENT_LAG: "time_s",
    SENSOR_LAG: "time_s",
}
"""Effects that change the loop, and the parameter that is zero without each."""

Values = Mapping[str, float]
"""Loop parameters and the sizes of :data:`LOOP_EFFECTS`, by name; ``gear_ratio`` among them."""


def loop_values(bench: Bench) -> dict[str, float]:
    """Of a bench, with what its effects do to the loop."""
    values = {name: bench.value(name) for name in ("gear_ratio", *LOOP_PARAMETERS)}
    values |= dict.fromkeys(LOOP_EFFECTS, 0.0)
    for effect in bench.effects:
        given = effect.complete()
        if effect.name in LOOP_EFFECTS:
            values[effect.name] += given[LOOP_EFFECTS[effect.name]]
        if effect.name == "load_viscous_friction":
            at_motor = given["coefficient_nm_s_per_rad"] / values["gear_ratio"] ** 2
            values[FRICTION] += at_motor
    return values


def speed_of_torque(values: Values, frequency: FloatArray) -> ComplexArray:
    """Measured speed over a braking torque, rpm per N m; ``frequency`` in rad/s, not zero."""
    s = 1j * frequency
    gains = values["speed_gain_nm_s_per_rad"] + values["integral_gain_nm_per_rad"] / s
    controller = gains * (1.0 + values["position_gain_per_s"] / s)
    seen = 1.0 / (1.0 + values[SENSOR_LAG] * s)
    answer = controller * seen / (1.0 + values[CURRENT_LAG] * s)
    return np.asarray(-RPM_PER_RAD_PER_S * seen / (mechanics(values, frequency) + answer))


def torque_of_angle(values: Values, frequency: FloatArray) -> ComplexArray:
    """The torque that would look like an error of the measured angle, N m per rad."""
    return np.asarray(-mechanics(values, frequency) * 1j * frequency)


def mechanics(values: Values, frequency: FloatArray) -> ComplexArray:
    """J s + b at the motor, N m s/rad."""
    inertia = values["motor_inertia_kg_m2"]
    inertia += values["load_inertia_kg_m2"] / values["gear_ratio"] ** 2
    return np.asarray(inertia * 1j * frequency + values[FRICTION])
