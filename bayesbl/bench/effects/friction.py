"""Friction at the motor, in the gear, and at the load behind the gap.

On a rigid bench, a friction torque T at the load is equivalent to T/N at the motor, and a viscous
coefficient b to b/N².
"""

from __future__ import annotations

import numpy as np

from bayesbl.bench.effect_declaration import (
    ARMSTRONG,
    Effect,
    RigidLaw,
    amplitude,
    direction,
    shape,
)

# At constant speed, the current increases by T_c/K_t, with the sign of the direction, and the speed
# shows nothing. Forward and reverse recordings together distinguish it from an offset, several
# speeds from viscous friction.
#
# Near rest, the sign z is no jump. Contacts bend before they slide, so z follows the motor over an
# angle; lubricants creep, and so do simulated contacts, so its final value grows over a width of
# speed. With no angle, z = tanh(ω/w); with little width, z is Dahl's. Bristles of machines bend by
# 1 to 100 µm before they slide, which is 1 to 100 mrad at the radius of a motor's bearings and
# seals (Armstrong-Hélouvry et al., section 2); simulators use widths of 0.1 to some per cent of the
# speed. Only reversals show either.
MOTOR_COULOMB_FRICTION = Effect(
    place=20,
    name="motor_coulomb_friction",
    sentence="Dry friction at the motor that does not depend on speed.",
    equation="J_m dω_m/dt: − T_c z, z = sign ω_m; near rest ż = (|ω_m| + w)(tanh(ω_m/w) − z)/θ_p",
    parameters=(
        amplitude("torque_nm", "friction torque T_c", high=2.0, typical=0.2),
        shape("width_rad_per_s", "width of the sign w", high=100.0, typical=2.0, bounded=True),
        shape("presliding_rad", "angle before sliding θ_p", high=1.0, typical=0.02, bounded=True),
    ),
    sought_alone="torque_nm",
    enters="motor",
    depends_on=("direction",),
    data="constant current offset that changes sign with the direction",
    reference=ARMSTRONG,
    torque=RigidLaw(
        signal=lambda motion, bench, given: given["torque_nm"] * direction(motion),
        amplitude="torque_nm",
        same_as=("load_coulomb_friction",),
    ),
    free_motion=True,
)

# Sheared lubricant. Recordings at two speeds distinguish it from Coulomb friction.
MOTOR_VISCOUS_FRICTION = Effect(
    place=30,
    name="motor_viscous_friction",
    sentence="Friction at the motor in proportion to speed.",
    equation="J_m dω_m/dt: − b ω_m",
    parameters=(amplitude("coefficient_nm_s_per_rad", "coefficient b", high=0.02, typical=1e-3),),
    enters="motor",
    depends_on=("speed",),
    data="current offset that grows with the reference speed; a little more damping of the ringing",
    reference=ARMSTRONG,
    torque=RigidLaw(
        signal=lambda motion, bench, given: given["coefficient_nm_s_per_rad"] * motion.speed,
        amplitude="coefficient_nm_s_per_rad",
        same_as=("load_viscous_friction",),
    ),
    free_motion=True,
    always_in=True,
)

# Besides another motor friction, it takes recordings at three speeds to show.
MOTOR_STRIBECK_FRICTION = Effect(
    place=40,
    name="motor_stribeck_friction",
    sentence="Extra friction at low speed that fades as the lubricant film builds up.",
    equation="J_m dω_m/dt: − T_s exp(−(ω_m/ω_s)²) sign ω_m",
    parameters=(
        amplitude("torque_nm", "extra torque at standstill T_s", high=2.0, typical=0.3),
        shape(
            "speed_rad_per_s", "fading speed ω_s", low=1.0, high=500.0, neutral=50.0, typical=200.0
        ),
    ),
    enters="motor",
    depends_on=("speed", "direction"),
    data="more current at low reference speeds than at high ones",
    reference=ARMSTRONG,
    torque=RigidLaw(
        signal=lambda motion, bench, given: (
            given["torque_nm"]
            * np.exp(-((motion.speed / given["speed_rad_per_s"]) ** 2))
            * direction(motion)
        ),
        amplitude="torque_nm",
        usual=0.2,
        requires="motor_coulomb_friction",
        scanned="speed_rad_per_s",
        grid=tuple(np.geomspace(0.01, 0.5, 21)),
    ),
    free_motion=True,
)

# Resembles viscous friction of another size over a few constant speeds, so is not sought there.
MOTOR_QUADRATIC_DRAG = Effect(
    place=45,
    name="motor_quadratic_drag",
    sentence="Drag that grows with the square of the speed, as from churned grease or a fan.",
    equation="J_m dω_m/dt: − c |ω_m| ω_m",
    parameters=(
        amplitude("coefficient_nm_s2_per_rad2", "drag coefficient c", high=1e-4, typical=5e-6),
    ),
    enters="motor",
    depends_on=("speed",),
    data="more current at high speed than viscous friction at low speed explains",
    torque=RigidLaw(
        signal=lambda motion, bench, given: (
            given["coefficient_nm_s2_per_rad2"] * np.abs(motion.speed) * motion.speed
        ),
        amplitude="coefficient_nm_s2_per_rad2",
        usual=0.2,
    ),
    sought_in_loop=False,
)

# Found in worn or preloaded gears; the mean of the two coefficients is viscous friction.
FRICTION_ASYMMETRY = Effect(
    place=50,
    name="friction_asymmetry",
    sentence="Viscous friction that differs between the two directions.",
    equation="J_m dω_m/dt: − c |ω_m|",
    parameters=(
        amplitude(
            "coefficient_nm_s_per_rad",
            "half the difference of the coefficients, forward minus reverse",
            low=-0.01,
            high=0.01,
            typical=5e-4,
        ),
    ),
    enters="motor",
    depends_on=("speed",),
    data="current offsets of forward and reverse recordings that differ in size, more at speed",
    reference=ARMSTRONG,
    torque=RigidLaw(
        signal=lambda motion, bench, given: (
            given["coefficient_nm_s_per_rad"] * motion.speed * direction(motion)
        ),
        amplitude="coefficient_nm_s_per_rad",
        usual=0.1,
        requires="motor_viscous_friction",
    ),
    free_motion=True,
)

# T₀ repeats every load rotation, the change r does not: such a bench is simulated in full length.
FRICTION_DRIFT = Effect(
    place=190,
    name="friction_drift",
    sentence="Motor friction that changes during the recording as the joint warms up.",
    equation="J_m dω_m/dt: − (T₀ + r t) sign ω_m",
    parameters=(
        amplitude("torque_nm", "friction at the start T₀", low=-2.0, high=2.0, typical=0.1),
        amplitude(
            "rate_nm_per_s",
            "change r",
            low=-0.05,
            high=0.05,
            typical=0.01,
            repeats="never",
            rate_of="torque_nm",
        ),
    ),
    enters="motor",
    depends_on=("time", "direction"),
    data="current that drifts from rotation to rotation",
    torque=RigidLaw(
        signal=lambda motion, bench, given: (
            (given["torque_nm"] + given["rate_nm_per_s"] * (motion.time_s - motion.time_s[0]))
            * direction(motion)
        ),
        amplitude="rate_nm_per_s",
        linear=("torque_nm",),
        contains="motor_coulomb_friction",
    ),
    free_motion=True,
)

# The loss is largest where gravity is lifted or held back, so twice in a load rotation.
GEAR_MESH_FRICTION = Effect(
    place=110,
    name="gear_mesh_friction",
    sentence="Loss in the gear in proportion to the torque that it transmits.",
    equation="J_m dω_m/dt: − μ |τ_s|/N sign ω_m",
    parameters=(amplitude("coefficient", "share of the torque lost μ", high=0.5, typical=0.05),),
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
    always_in=True,
)

# The teeth part where gravity balances it: the pulses move away from half a rotation apart.
LOAD_COULOMB_FRICTION = Effect(
    place=70,
    name="load_coulomb_friction",
    sentence="Dry friction at the load, beyond the gap.",
    equation="J_l dω_l/dt: − T_c sign ω_l",
    parameters=(amplitude("torque_nm", "friction torque T_c", high=200.0, typical=15.0),),
    enters="load",
    depends_on=("direction",),
    data="pulses move away from half a rotation apart and change in size; current offset",
    reference=ARMSTRONG,
    load_torque=lambda motion, bench, given: given["torque_nm"] * direction(motion),
)

# At one speed it moves the pulses as Coulomb friction at the load does.
LOAD_VISCOUS_FRICTION = Effect(
    place=80,
    name="load_viscous_friction",
    sentence="Friction at the load in proportion to its speed.",
    equation="J_l dω_l/dt: − b ω_l",
    parameters=(amplitude("coefficient_nm_s_per_rad", "coefficient b", high=100.0, typical=10.0),),
    enters="load",
    depends_on=("speed",),
    data="as load Coulomb friction, in proportion to the reference speed",
    reference=ARMSTRONG,
    load_torque=lambda motion, bench, given: (
        given["coefficient_nm_s_per_rad"] * motion.speed / bench.value("gear_ratio")
    ),
)
