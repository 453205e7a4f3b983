"""Hysteresis of the shaft, Dahl's law: friction whose size depends on where the twist came from.

    τ_s → τ_s + T z,   dz/dt = (Δω/θ_p)(1 − z sign Δω)

It acts inside the gap too. On a rigid bench it shows as twist between motor and load position.
"""

from __future__ import annotations

import numpy as np

from bayesbl.bench.effect_declaration import Amplitude, Effect, RigidLaw, Shape
from bayesbl.recording.types import FloatArray


def dahl(angle: FloatArray, reach: float) -> FloatArray:
    """z of dz/dx = (1 − z sign dx)/θ_p along the angle, exactly for each step; shape (n,)."""
    out = np.empty_like(angle)
    z = 0.0
    out[0] = z
    steps = np.diff(angle)
    fading = np.exp(-np.abs(steps) / reach)
    signs = np.sign(steps)
    for i, (keep, sign) in enumerate(zip(fading, signs, strict=True), start=1):
        z = sign + (z - sign) * keep if sign else z
        out[i] = z
    return out


EFFECT = Effect(
    place=160,
    name="shaft_hysteresis",
    sentence=(
        "Dry friction inside the shaft (Dahl): torque that depends on where the twist came from."
    ),
    equation="τ_s + T z, dz/dt = (Δω/θ_p)(1 − z sign Δω), also inside the gap",
    parameters=(
        Amplitude("torque_nm", "N m", "friction torque T", high=200.0, typical=20.0),
        Shape(
            "angle_rad",
            "rad",
            "twist that builds it up θ_p",
            low=1e-5,
            high=1e-2,
            neutral=1e-3,
            typical=1e-3,
            positive_scale=True,
        ),
    ),
    enters="shaft",
    depends_on=("twist", "direction"),
    data="ringing that dies sooner; the gap is crossed more slowly",
    reference=(
        "Dahl 1976, AIAA Journal 14, 1675; Ruderman, Bertram & Iwasaki 2014, Mechatronics 24, 407"
    ),
    position=RigidLaw(
        signal=lambda motion, bench, given: (  # the twist −(T/K_s) z
            -given["torque_nm"]
            / bench.value("shaft_stiffness_nm_per_rad")
            * dahl(motion.angle / bench.value("gear_ratio"), given["angle_rad"])
        ),
        amplitude="torque_nm",
        usual=0.2,
        scanned="angle_rad",
        grid=tuple(np.geomspace(1e-5, 1e-2, 13)),
        not_negative=True,
        bench_parameters=("shaft_stiffness_nm_per_rad",),
    ),
)
