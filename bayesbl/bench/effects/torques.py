"""Torques that are not friction: constant ones, a shifted gravity, cogging."""

from __future__ import annotations

import numpy as np

from bayesbl.bench.effect_declaration import (
    ORDER,
    PHASE,
    Effect,
    Law,
    RigidLaw,
    amplitude,
    order,
    phase,
)

# From a spring, a cable, or a current sensor with an offset. Forward and reverse recordings
# together distinguish it from friction.
MOTOR_TORQUE_OFFSET = Effect(
    place=60,
    name="motor_torque_offset",
    sentence="A constant torque at the motor that does not depend on the direction.",
    equation="J_m dω_m/dt: − T",
    parameters=(
        amplitude(
            "torque_nm", "torque against forward rotation T", low=-2.0, high=2.0, typical=0.2
        ),
    ),
    enters="motor",
    data="constant current offset of the same sign in both directions",
    torque=RigidLaw(
        signal=lambda motion, bench, given: given["torque_nm"] * np.ones_like(motion.speed),
        amplitude="torque_nm",
        same_as=("load_torque_offset",),
    ),
    free_motion=True,
)

# From a weight on a cable, a spring, or wind. It moves the two pulses of a rotation towards each
# other or apart, whichever way the load turns.
LOAD_TORQUE_OFFSET = Effect(
    place=90,
    name="load_torque_offset",
    sentence="A constant torque at the load that does not depend on the direction.",
    equation="J_l dω_l/dt: − T",
    parameters=(
        amplitude(
            "torque_nm", "torque against forward rotation T", low=-200.0, high=200.0, typical=15.0
        ),
    ),
    enters="load",
    data="pulses shift alike in both directions",
    may_change=True,
    load_torque=lambda motion, bench, given: given["torque_nm"] * np.ones_like(motion.speed),
)

_AT_LOAD: Law = lambda motion, bench, given: (  # noqa: E731
    given["torque_nm"] * np.cos(motion.angle / bench.value("gear_ratio"))
)

# The link does not hang straight down where the load angle is zero. Added to m g l sin θ_l it gives
# one shifted sine: equivalent to a start angle unless the load angle is known.
GRAVITY_PHASE = Effect(
    place=100,
    name="gravity_phase",
    sentence="Gravity's torque is zero at a different load angle than the bench states.",
    equation="J_l dω_l/dt: − m_c cos θ_l",
    parameters=(
        amplitude("torque_nm", "torque at θ_l = 0, m_c", low=-200.0, high=200.0, typical=30.0),
    ),
    enters="load",
    depends_on=("load_angle",),
    data="the whole rotation shifts in phase: a start angle in disguise unless θ_l is absolute",
    torque=RigidLaw(
        signal=lambda motion, bench, given: (
            _AT_LOAD(motion, bench, given) / bench.value("gear_ratio")
        ),
        amplitude="torque_nm",
    ),
    load_torque=_AT_LOAD,
    free_motion=True,
)

# Cogging of the magnets, errors of the current sensors. Repeats with the load only if the gear
# ratio times n is whole.
MOTOR_TORQUE_RIPPLE = Effect(
    place=120,
    name="motor_torque_ripple",
    sentence="Torque that repeats with the motor angle: cogging, current sensor errors.",
    equation="J_m dω_m/dt: − a sin(n θ_m + φ)",
    parameters=(
        amplitude(
            "torque_nm", "amplitude a", low=-1.0, high=1.0, typical=0.05, repeats="whole_orders"
        ),
        order(typical=6.0),
        phase(typical=0.7),
    ),
    enters="motor",
    depends_on=("motor_angle",),
    data="a line at order n of the motor speed in speed and current",
    reference="Holtz & Springob 1996, IEEE Trans. Ind. Electron. 43, 309",
    torque=RigidLaw(
        signal=lambda motion, bench, given: (
            given["torque_nm"] * np.sin(given[ORDER] * motion.angle + given[PHASE])
        ),
        amplitude="torque_nm",
        scanned=ORDER,
    ),
)
