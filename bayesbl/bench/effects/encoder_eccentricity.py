"""Eccentricity of the encoder: its disc sits off the shaft's centre.

    θ_meas = θ_m + e sin(θ_m + φ),   ω_meas = ω_m (1 + e cos(θ_m + φ))

Inside the loop: the controller answers what the encoder shows.
"""

from __future__ import annotations

import numpy as np

from bayesbl.bench.effect_declaration import (
    PHASE,
    Amplitude,
    Effect,
    Parameters,
    RigidBench,
    RigidLaw,
    RigidMotion,
    phase,
)
from bayesbl.recording.types import FloatArray


def torque_nm(motion: RigidMotion, bench: RigidBench, given: Parameters) -> FloatArray:
    """What is taken for acceleration and is not: the encoder's sway, differentiated as the rest."""
    ratio = bench.value("gear_ratio")
    inertia = bench.value("motor_inertia_kg_m2") + bench.value("load_inertia_kg_m2") / ratio**2
    sway = (motion.sway * np.exp(1j * given[PHASE])).imag
    return np.asarray(-inertia * given["angle_rad"] * sway)


EFFECT = Effect(
    place=140,
    name="encoder_eccentricity",
    sentence="The encoder disc sits off centre: the measured angle sways once per motor turn.",
    equation="θ_meas = θ_m + e sin(θ_m + φ), ω_meas = ω_m (1 + e cos(θ_m + φ)), inside the loop",
    parameters=(
        Amplitude(
            "angle_rad",
            "rad",
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
    position=RigidLaw(
        signal=lambda motion, bench, given: (
            -given["angle_rad"] / bench.value("gear_ratio") * np.sin(motion.angle + given[PHASE])
        ),
        amplitude="angle_rad",
    ),
)
