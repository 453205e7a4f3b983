"""Friction between the teeth: a loss in proportion to the torque that the gear passes on.

J_m dω_m/dt = … − μ |τ_s|/N sign ω_m
"""

from __future__ import annotations

import numpy as np

from bayesbl.bench.effect_declaration import (
    Effect,
    FloatArray,
    Parameters,
    RigidBench,
    RigidLaw,
    RigidMotion,
    amplitude,
    direction,
)


def torque_nm(motion: RigidMotion, bench: RigidBench, given: Parameters) -> FloatArray:
    """μ |τ_s|/N sign ω_m."""
    passed_on = np.abs(bench.transmitted_torque(motion))
    return np.asarray(given["coefficient"] * passed_on * direction(motion))


EFFECT = Effect(
    place=110,
    name="gear_mesh_friction",
    sentence="Loss in the gear in proportion to the torque it passes on.",
    equation="J_m dω_m/dt: − μ |τ_s|/N sign ω_m",
    parameters=(
        amplitude(
            "coefficient",
            "",
            "share of the torque lost μ",
            low=0.0,
            high=0.5,
            typical=0.05,
            repeats="always",
            not_negative=True,
        ),
    ),
    enters="motor",
    depends_on=("transmitted_torque", "direction"),
    data="current at twice the load rotation: more where gravity is lifted or held back",
    reference="Hamon, Gautier & Garrec 2010, IROS, 6187",
    torque=RigidLaw(signal=torque_nm, amplitude="coefficient"),
    free_motion=True,
)
