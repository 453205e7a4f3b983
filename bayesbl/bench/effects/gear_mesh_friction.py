"""Friction between the teeth: a loss in proportion to the torque that the gear passes on.

    J_m dω_m/dt = … − μ |τ_s|/N sign ω_m

The loss is largest where gravity is lifted or held back, so twice in a load rotation.
"""

from __future__ import annotations

import numpy as np

from bayesbl.bench.effect_declaration import Amplitude, Effect, RigidLaw, direction

EFFECT = Effect(
    place=110,
    name="gear_mesh_friction",
    sentence="Loss in the gear in proportion to the torque it passes on.",
    equation="J_m dω_m/dt: − μ |τ_s|/N sign ω_m",
    parameters=(
        Amplitude(
            "coefficient",
            "",
            "share of the torque lost μ",
            high=0.5,
            typical=0.05,
            not_negative=True,
        ),
    ),
    enters="motor",
    depends_on=("transmitted_torque", "direction"),
    data="current at twice the load rotation: more where gravity is lifted or held back",
    reference="Hamon, Gautier & Garrec 2010, IROS, 6187",
    torque=RigidLaw(
        signal=lambda motion, bench, given: (
            given["coefficient"] * np.abs(bench.transmitted_torque(motion)) * direction(motion)
        ),
        amplitude="coefficient",
        usual=0.2,
    ),
    free_motion=True,
)
