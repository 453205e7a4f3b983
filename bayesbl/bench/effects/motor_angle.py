"""Errors of gear and encoder over the angle of the motor."""

from __future__ import annotations

import numpy as np

from bayesbl.bench.effect_declaration import (
    PHASE,
    BenchValues,
    Effect,
    Parameters,
    RigidLaw,
    RigidMotion,
    amplitude,
    order,
    phase,
)
from bayesbl.recording.types import FloatArray

# Acts only while the teeth touch. Repeats with the load only if the gear ratio times n is whole.
GEAR_TRANSMISSION_ERROR = Effect(
    place=130,
    name="gear_transmission_error",
    sentence="The gear transmits motion unevenly, once or more per motor turn.",
    equation="Δθ → Δθ + a sin(n θ_m + φ), Δω → Δω + a n ω_m cos(n θ_m + φ)",
    parameters=(
        amplitude(
            "angle_rad",
            "amplitude a at the load",
            low=-1e-3,
            high=1e-3,
            typical=3e-5,
            repeats="whole_orders",
        ),
        order(typical=2.0),
        phase(typical=-0.4),
    ),
    enters="shaft",
    depends_on=("motor_angle",),
    data="a line at order n while the teeth touch, gone while they do not",
    reference="Tuttle & Seering 1996, IEEE Trans. Robot. Autom. 12, 368",
)


def torque_nm(motion: RigidMotion, bench: BenchValues, given: Parameters) -> FloatArray:
    """Apparent torque: the encoder's sway, which differentiation mistakes for acceleration."""
    ratio = bench.value("gear_ratio")
    inertia = bench.value("motor_inertia_kg_m2") + bench.value("load_inertia_kg_m2") / ratio**2
    sway = (motion.sway * np.exp(1j * given[PHASE])).imag
    return np.asarray(-inertia * given["angle_rad"] * sway)


# The disc is off the shaft's centre. The error is inside the loop: the controller responds to it.
ENCODER_ECCENTRICITY = Effect(
    place=140,
    name="encoder_eccentricity",
    sentence="The encoder disc is off centre: the measured angle has an error once per motor turn.",
    equation="θ_meas = θ_m + e sin(θ_m + φ), ω_meas = ω_m (1 + e cos(θ_m + φ)), inside the loop",
    parameters=(
        amplitude(
            "angle_rad",
            "amplitude e",
            low=-0.02,
            high=0.02,
            typical=2e-3,
            repeats="whole_orders",
            smaller_than=1.0,  # beyond it the measured angle would run backwards
        ),
        phase(typical=1.1),
    ),
    enters="loop",
    depends_on=("motor_angle",),
    data="a line at the motor's rotation in speed, answered by the current",
    torque=RigidLaw(signal=torque_nm, amplitude="angle_rad"),
)
