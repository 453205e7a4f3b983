"""Equations of motion and their integrator, compiled.

Everything that numba compiles together is in this one file. Its cache checks only the file of the
outermost function, so a right-hand side kept elsewhere could go stale unnoticed.

State, shape (19,), SI: angle and speed of the gear's input (the motor, unless a belt drives it),
twist Δθ, twist speed Δω, and the integral of the speed error. Then, used only while an effect is
on: lagged drive torque, lagged speed, Dahl z. Then, used only if the bench has the part: z of
friction that builds up over an angle, lead of the motor over the gear's input and its rate, lead of
the load over the arm behind it and its rate, angle and speed of the base. Then, used only with a
sampled controller: the torque it holds, the one it has computed since, and the angle and speed at
its last tick. If more than one torque is pending, the older ones follow, the newest first. Angles
are relative to the base. The load angle is θ/N − Δθ, with θ the angle of the gear's input. Twist
and twist speed are states of their own, because the contact depends on them alone and the step
control must see their error.

Integrator: Dormand-Prince 5(4) with its fourth-order dense output. Steps end where the contact
changes (at Δθ = ±δ, and for the arctan form also at Δθ = 0, where eq. 2's smoothed torque jumps)
and at the ticks of a sampled controller. The region is fixed within a step, so the right-hand side
is smooth there. Between two ticks, far from edges and reversals, a bench with friction alone is
nearly linear: its linear part is solved exactly, gravity along its tangent.

A held output is a load of infinite inertia; the drive's reference is then its torque.
"""

from __future__ import annotations

import math
from enum import IntEnum, auto
from typing import Any, NamedTuple

import numpy as np

from bayesbl.compiled import compiled

LEARNED_HARMONICS = 12


class Slot(IntEnum):
    """Places in the flat parameter vector, numbered in this order.

    Bench and run come first, then effects as ``effect__parameter``, learned terms, and last the
    parameters that change no motion: skews and averaging.
    A vector of zeros in the effects' places is a bench without effects.
    """

    _ignore_ = "number wave order part"

    @staticmethod
    def _generate_next_value_(name: str, start: int, count: int, last_values: list[Any]) -> int:
        return count

    gear_ratio = auto()
    motor_inertia_kg_m2 = auto()
    load_inertia_kg_m2 = auto()
    shaft_stiffness_nm_per_rad = auto()
    shaft_damping_nm_s_per_rad = auto()
    gravity_torque_nm = auto()
    gravity_angle_rad = auto()
    speed_gain_nm_s_per_rad = auto()
    integral_gain_nm_per_rad = auto()
    position_gain_per_s = auto()
    torque_constant_nm_per_a = auto()
    current_limit_a = auto()
    stiffness_sharpness_per_rad = auto()
    hard_dead_zone = auto()  # 1: hard dead zone, 0: arctan
    rigid = auto()  # 1: one inertia, 0: two masses
    reference_speed_rpm = auto()
    gap_rad = auto()
    start_angle_rad = auto()
    motor_start_angle_rad = auto()
    reference_delay_s = auto()  # of a motion: the loop is given its reference that much later
    backlash__gap_rad = auto()
    sampled_control__period_s = auto()
    sampled_control__delay_periods = auto()
    sampled_control__instant_share = auto()
    motor_coulomb_friction__width_rad_per_s = auto()
    motor_coulomb_friction__presliding_rad = auto()
    motor_coulomb_friction__torque_nm = auto()
    motor_viscous_friction__coefficient_nm_s_per_rad = auto()
    motor_stribeck_friction__torque_nm = auto()
    motor_stribeck_friction__speed_rad_per_s = auto()
    motor_quadratic_drag__coefficient_nm_s2_per_rad2 = auto()
    friction_asymmetry__coefficient_nm_s_per_rad = auto()
    motor_torque_offset__torque_nm = auto()
    load_coulomb_friction__torque_nm = auto()
    load_viscous_friction__coefficient_nm_s_per_rad = auto()
    load_torque_offset__torque_nm = auto()
    gravity_phase__torque_nm = auto()
    gear_mesh_friction__coefficient = auto()
    motor_torque_ripple__torque_nm = auto()
    motor_torque_ripple__order = auto()
    motor_torque_ripple__phase_rad = auto()
    gear_transmission_error__angle_rad = auto()
    gear_transmission_error__order = auto()
    gear_transmission_error__phase_rad = auto()
    encoder_eccentricity__angle_rad = auto()
    encoder_eccentricity__phase_rad = auto()
    stiffness_hardening__stiffness_nm_per_rad3 = auto()
    contact_exponent__excess = auto()
    contact_softness__variance_rad2 = auto()
    flank_asymmetry__share = auto()
    contact_damping__factor_s_per_rad = auto()
    contact_release__share = auto()
    gap_damping__coefficient_nm_s_per_rad = auto()
    shaft_hysteresis__torque_nm = auto()
    shaft_hysteresis__angle_rad = auto()
    current_loop_lag__time_s = auto()
    speed_sensor_lag__time_s = auto()
    friction_drift__torque_nm = auto()
    friction_drift__rate_nm_per_s = auto()
    belt__compliance_rad_per_nm = auto()
    belt__damping_ratio = auto()
    belt__reducer_share = auto()
    arm__compliance_rad_per_nm = auto()
    arm__damping_ratio = auto()
    arm__inertia_share = auto()
    arm__gravity_share = auto()
    base__compliance_rad_per_nm = auto()
    base__damping_ratio = auto()
    base__inertia_kg_m2 = auto()
    gap_variation__cosine_1 = auto()
    gap_variation__sine_1 = auto()
    gap_variation__cosine_2 = auto()
    gap_variation__sine_2 = auto()
    learned_torque__side = auto()  # 0: there is none, 1: at the motor, 2: at the load
    learned_torque__variable = auto()  # 0: motor angle, 1: load angle, 2: motor speed, 3: time
    learned_torque__reverses = auto()  # 1: its sign is that of the speed
    learned_torque__period = auto()  # of the variable: rad, rad/s or s
    learned_torque__shift = auto()  # added to the variable
    learned_torque__constant_nm = auto()
    for wave in ("cosine", "sine"):
        for number in range(1, LEARNED_HARMONICS + 1):
            vars()[f"learned_torque__{wave}_{number}_nm"] = auto()
    encoder_error__orders = auto()  # how many; 0: there is none
    encoder_error__period_rad = auto()  # of the motor's angle
    encoder_error__shift_rad = auto()  # added to the motor's angle
    for part in ("cosine", "sine"):
        for order in range(1, LEARNED_HARMONICS + 1):
            vars()[f"encoder_error__{part}_{order}_rad"] = auto()
    channel_time_skew__position_s = auto()
    channel_time_skew__speed_s = auto()
    channel_time_skew__current_s = auto()
    speed_averaging__time_s = auto()


SLOTS = len(Slot)
FIRST_EFFECT = int(Slot.motor_coulomb_friction__torque_nm)
FRICTION = (
    int(Slot.motor_viscous_friction__coefficient_nm_s_per_rad),
    int(Slot.load_viscous_friction__coefficient_nm_s_per_rad),
    int(Slot.motor_coulomb_friction__torque_nm),
    int(Slot.load_coulomb_friction__torque_nm),
)
FIRST_COSINE = int(Slot["learned_torque__cosine_1_nm"])
FIRST_SINE = int(Slot["learned_torque__sine_1_nm"])
FIRST_ENCODER_COSINE = int(Slot["encoder_error__cosine_1_rad"])
FIRST_ENCODER_SINE = int(Slot["encoder_error__sine_1_rad"])
FIRST_SKEW = int(Slot.channel_time_skew__position_s)
AT_MOTOR, AT_LOAD = 1.0, 2.0
OVER_MOTOR_ANGLE, OVER_LOAD_ANGLE, OVER_SPEED, OVER_TIME = range(4)
STATES = 19
NEWTON_STEPS = 8  # to rounding, for any hardening within its range
MOTOR_ANGLE, MOTOR_SPEED, TWIST, TWIST_SPEED, INTEGRAL, DRIVE_TORQUE, SENSED_SPEED, DAHL = range(8)
BRISTLE, BELT_TWIST, BELT_SPEED, ARM_TWIST, ARM_SPEED, BASE_ANGLE, BASE_SPEED = range(8, 15)
HELD_TORQUE, NEXT_TORQUE, TICK_ANGLE, TICK_SPEED = range(15, 19)

POSITION, SPEED, CURRENT, EVERY = range(4)
RPM = 60.0 / (2.0 * math.pi)
PER_PI = 1.0 / math.pi

# sign(ω) of friction is tanh(ω/width), where the width is at least a share of the joint's reference
# speed: 1 rpm of 2000. With the output held there is no speed, so the least width is fixed.
SIGN_WIDTH_SHARE = 5e-4
HELD_SIGN_WIDTH = 0.1  # rad/s
# Shortest time, s, in which friction follows the motor's angle. At speed it has long followed: so
# this bounds the rate of a state that does not move.
SHORTEST_FOLLOWING_S = 1e-4
# Angle, rad, far below which friction does not follow the motor's angle but its speed alone: so the
# limit of no angle is smooth. A hundredth of the smallest that is published.
LEAST_PRESLIDING_RAD = 1e-5
# The integral fades out while the demand exceeds the current limit by up to this share of it.
ANTI_WINDUP_BAND = 0.01

# Error allowed in one step, as a share of the requested accuracy. On 300 random benches, the worst
# error over a rotation was half the accuracy, the median a fortieth.
LOCAL_SHARE = 0.004
# Longest step in radians of the fastest oscillation that the dense output still resolves.
LONGEST_PHASE = 1.0
# Longest time between two ticks, in radians of the fastest oscillation, for one step of the
# classical method: its phase error, (ωh)⁵/120 per step, is 5e-6 rad in a period.
SHORT_PHASE = 0.1
# Terms of the series over such a time.
TERMS = 12
# Distance from a smoothed edge or sign, in its widths, beyond which its curvature is negligible.
CLEAR = 20.0
# Distance from a smoothed edge, in its widths, within which a step is at most two widths. Beyond,
# the torque of the flank is that with a sharp edge, to e⁻¹⁰ of that of one width.
LAYERS = 10.0
# Least share of a gap that varies with the load angle: below it the teeth would jam.
LEAST_GAP_SHARE = 0.01
# rad/s: rate scale of a rigid bench that nothing drives.
SLOWEST_RATE = 0.1

# Share of a sampling period within which a time counts as the tick itself.
AT_TICK = 1e-6

DONE, DIVERGED, TOO_MANY_STEPS, SATURATED = range(4)
MAX_STEPS_PER_SECOND = 200_000


# e₀ of the contact exponent on an axis without gravity.
COMPRESSION_RAD = 1e-3

# Share of gravity's largest torque below which a load at rest may stand inside the gap.
LOOSE_SHARE = 0.01

# Columns of a piece of a motion: start, ω_ref as a cubic, θ_ref as a quartic of the time since.
# With a held output, the drive's torque takes the place of ω_ref.
PIECE_COLUMNS = 10


class Constants(NamedTuple):
    """Constants of the right-hand side, derived from the parameter vector."""

    ratio: float
    per_ratio: float
    per_motor_inertia: float
    motor_inertia: float
    per_load_inertia: float
    load_inertia: float
    motor_viscous: float
    load_viscous: float
    motor_coulomb: float
    load_coulomb: float
    stiffness: float
    damping: float
    gravity: float
    gravity_angle: float
    speed_gain: float
    integral_gain: float
    position_gain: float
    torque_limit: float
    sharpness: float
    hard: bool
    rigid: bool
    friction_width: float
    load_friction_width: float
    bends: bool
    gap: float
    reference_angle: float
    phase_offset: float
    drift_start: float
    effects: bool
    structured: bool
    varies: bool
    held: bool
    plain: bool
    sampled: bool
    waiting: int
    fastest_reference: float
    # From here on set by each piece of a motion.
    reference: float
    direction: float
    follows: bool
    piece_start: float
    speed_1: float
    speed_2: float
    speed_3: float
    angle_0: float
    angle_1: float
    angle_2: float
    angle_3: float
    angle_4: float


_OF_PIECE = Constants._fields.index("reference")

_OPTIONS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    # fused multiply-add only: nan and inf keep their meaning
    "fastmath": {"contract"},
}
_jit = compiled(**_OPTIONS)
# In the innermost loop, a call with its two dozen constants costs as much as the work.
_inlined = compiled(**_OPTIONS, forceinline=True)


@_jit
def waiting_torques(p):  # type: ignore[no-untyped-def]
    """Number of pending torques of a sampled controller besides the one it computed last.

    The torque of tick j acts from (j + d) T on. Just after a tick, the next one to act is this many
    ticks older than the last.
    """
    if not p[Slot.sampled_control__period_s] > 0.0:
        return 0
    return max(0, math.ceil(p[Slot.sampled_control__delay_periods]) - 1)


@_jit
def constants(p, reference_angle, drift_start):  # type: ignore[no-untyped-def]
    """Constants of one run at constant speed.

    ``reference_angle`` is where the ramp of the position loop starts.
    """
    effects = False
    for i in range(FIRST_EFFECT, FIRST_SKEW):
        if p[i] != 0.0 and i not in FRICTION:
            effects = True
    ratio = p[Slot.gear_ratio]
    rigid = p[Slot.rigid] != 0.0
    structured = not rigid and (
        p[Slot.belt__compliance_rad_per_nm] != 0.0
        or p[Slot.arm__compliance_rad_per_nm] != 0.0
        or p[Slot.base__compliance_rad_per_nm] != 0.0
    )
    varies = (
        p[Slot.gap_variation__cosine_1] != 0.0
        or p[Slot.gap_variation__sine_1] != 0.0
        or p[Slot.gap_variation__cosine_2] != 0.0
        or p[Slot.gap_variation__sine_2] != 0.0
    )
    held = math.isinf(p[Slot.load_inertia_kg_m2])
    sampled = p[Slot.sampled_control__period_s] > 0.0
    bends = p[Slot.motor_coulomb_friction__presliding_rad] > 0.0
    plain = not (effects or bends or rigid or held)
    fastest_reference = abs(p[Slot.reference_speed_rpm] / RPM)
    friction_width = HELD_SIGN_WIDTH
    if fastest_reference > 0.0:
        friction_width = SIGN_WIDTH_SHARE * fastest_reference
    friction_width += p[Slot.motor_coulomb_friction__width_rad_per_s]
    return Constants(
        ratio,
        1.0 / ratio,
        1.0 / p[Slot.motor_inertia_kg_m2],
        p[Slot.motor_inertia_kg_m2],
        1.0 / p[Slot.load_inertia_kg_m2],
        p[Slot.load_inertia_kg_m2],
        p[Slot.motor_viscous_friction__coefficient_nm_s_per_rad],
        p[Slot.load_viscous_friction__coefficient_nm_s_per_rad],
        p[Slot.motor_coulomb_friction__torque_nm],
        p[Slot.load_coulomb_friction__torque_nm],
        p[Slot.shaft_stiffness_nm_per_rad],
        p[Slot.shaft_damping_nm_s_per_rad],
        p[Slot.gravity_torque_nm],
        p[Slot.gravity_angle_rad],
        p[Slot.speed_gain_nm_s_per_rad],
        p[Slot.integral_gain_nm_per_rad],
        p[Slot.position_gain_per_s],
        p[Slot.torque_constant_nm_per_a] * p[Slot.current_limit_a],
        p[Slot.stiffness_sharpness_per_rad],
        p[Slot.hard_dead_zone] != 0.0,
        rigid,
        friction_width,
        friction_width / ratio,
        bends,
        p[Slot.gap_rad] + p[Slot.backlash__gap_rad],
        reference_angle,
        p[Slot.motor_start_angle_rad] - ratio * p[Slot.start_angle_rad],
        drift_start,
        effects,
        structured,
        varies,
        held,
        plain,
        sampled,
        waiting_torques(p),
        fastest_reference,
        p[Slot.reference_speed_rpm] / RPM,
        math.copysign(1.0, p[Slot.reference_speed_rpm]),
        False,
        0.0,
        *(0.0, 0.0, 0.0),
        *(0.0, 0.0, 0.0, 0.0, 0.0),
    )


@_jit
def on_piece(c, pieces, number):  # type: ignore[no-untyped-def]
    """The same constants on one piece of a motion (see ``bench/motion.py``)."""
    r = pieces[number]
    piece = (r[1], 1.0, True, r[0], r[2], r[3], r[4], r[5], r[6], r[7], r[8], r[9])
    return Constants(*(c[:_OF_PIECE] + piece))


@_inlined
def reference_speed(t, c):  # type: ignore[no-untyped-def]
    """ω_ref of the motor, rad/s; with a held output, its torque, N m."""
    if not c.follows:
        return c.reference
    s = t - c.piece_start
    return c.reference + s * (c.speed_1 + s * (c.speed_2 + s * c.speed_3))


@_inlined
def reference_position(t, c):  # type: ignore[no-untyped-def]
    """θ_ref of the motor, rad."""
    if not c.follows:
        return c.reference_angle + c.reference * t
    s = t - c.piece_start
    turned = c.angle_0 + s * (c.angle_1 + s * (c.angle_2 + s * (c.angle_3 + s * c.angle_4)))
    return c.reference_angle + turned


@_inlined
def shaft_torque(twist, twist_speed, region, sharpness, c):  # type: ignore[no-untyped-def]
    """Shaft torque τ_s on the load side, N m (eqs. 1, 2 and the variable stiffness).

    ``region`` is the number of edges below the twist: −δ, δ for the dead zone, −δ, 0, δ for the
    arctan.
    """
    if c.hard:
        if region == 1 and c.gap > 0.0:
            return 0.0
        flank = -c.gap if region == 0 else c.gap
        return c.stiffness * (twist - flank) + c.damping * twist_speed
    flank = -c.gap if region < 2 else c.gap
    # π + arctan(α(x − δ)) − arctan(α(x + δ)) as one angle: no cancellation inside the gap.
    opposite = 2.0 * sharpness * c.gap
    adjacent = sharpness * sharpness * (c.gap - twist) * (c.gap + twist) - 1.0
    if opposite < 0.01 * abs(adjacent):
        # Away from the edges a series, exact to rounding, in a third of the time.
        r = opposite / adjacent
        r2 = r * r
        angle = r * (1.0 - r2 * (1.0 / 3.0 - r2 * (0.2 - r2 / 7.0)))
        if adjacent < 0.0:
            angle += math.pi
    else:
        angle = math.atan2(opposite, adjacent)
    return (c.stiffness * (twist - flank) + c.damping * twist_speed) * (angle * PER_PI)


@_jit
def exponent_torque(compression, p, c):  # type: ignore[no-untyped-def]
    """Torque of a contact with exponent 1 + m beyond K_s e, N m."""
    excess = p[Slot.contact_exponent__excess]
    if excess == 0.0 or compression == 0.0:
        return 0.0
    reference = abs(c.gravity) / c.stiffness if c.gravity != 0.0 else COMPRESSION_RAD
    size = abs(compression) / reference
    return c.stiffness * compression * math.expm1(excess * math.log(size))


@_jit
def softness_torque(twist, twist_speed, share_of_gap, p, c):  # type: ignore[no-untyped-def]
    """Torque of flanks with soft edges beyond that with sharp edges, N m."""
    scale = softness_scale(p)
    gap = c.gap * share_of_gap
    near = abs(twist) - gap
    this = math.exp(-abs(near) / scale)
    other = math.exp(-(abs(twist) + gap) / scale)
    torque = c.stiffness * scale * (math.log1p(this) - math.log1p(other))
    touching = this / (1.0 + this)
    touching = other / (1.0 + other) - math.copysign(touching, near)
    return math.copysign(torque, twist) + c.damping * touching * twist_speed


@_jit
def softness_scale(p):  # type: ignore[no-untyped-def]
    """Scale of the logistic distribution of the gap's edges, rad."""
    return math.sqrt(3.0 * p[Slot.contact_softness__variance_rad2]) / math.pi


@_jit
def limited(demand, error, c):  # type: ignore[no-untyped-def]
    """Drive torque within the current limit, and the share of the error that is integrated.

    Conditional integration: beyond the limit the integral stops unless the error reduces the
    demand. It fades out over a narrow band, because a switch would chatter at the limit.
    """
    if abs(demand) <= c.torque_limit:
        return demand, 1.0
    torque = math.copysign(c.torque_limit, demand)
    if error * demand < 0.0:
        return torque, 1.0
    excess = (abs(demand) - c.torque_limit) / (ANTI_WINDUP_BAND * c.torque_limit)
    return torque, max(0.0, 1.0 - excess)


@_jit
def gap_share(angle, twist, p, c):  # type: ignore[no-untyped-def]
    """The gap at this load angle over its mean, a pure number."""
    if not c.varies:
        return 1.0
    load_angle = angle * c.per_ratio - twist
    cosine = math.cos(load_angle)
    sine = math.sin(load_angle)
    share = 1.0 + p[Slot.gap_variation__cosine_1] * cosine + p[Slot.gap_variation__sine_1] * sine
    share += p[Slot.gap_variation__cosine_2] * (cosine * cosine - sine * sine)
    share += p[Slot.gap_variation__sine_2] * 2.0 * sine * cosine
    return max(share, LEAST_GAP_SHARE)


@_jit
def contact_twist(angle, twist, p, c):  # type: ignore[no-untyped-def]
    """Twist at the teeth: Δθ plus the transmission error, on the scale of the mean gap."""
    if not c.effects:
        return twist
    return eccentric_twist(angle, twist, p, c) / gap_share(angle, twist, p, c)


@_jit
def eccentric_twist(angle, twist, p, c):  # type: ignore[no-untyped-def]
    """Δθ plus the transmission error."""
    order = p[Slot.gear_transmission_error__order]
    amplitude = p[Slot.gear_transmission_error__angle_rad]
    if amplitude == 0.0:
        return twist
    phase = p[Slot.gear_transmission_error__phase_rad]
    return twist + amplitude * math.sin(order * (angle + c.phase_offset) + phase)


@_jit
def fourier(phase, orders, first_cosine, first_sine, p):  # type: ignore[no-untyped-def]
    """Σ_k a_k cos kφ + b_k sin kφ of coefficients from these slots on, and its slope over φ."""
    turn_cosine = math.cos(phase)
    turn_sine = math.sin(phase)
    cosine = 1.0
    sine = 0.0
    value = 0.0
    slope = 0.0
    for k in range(orders):
        turned = cosine * turn_cosine - sine * turn_sine
        sine = sine * turn_cosine + cosine * turn_sine
        cosine = turned
        a = p[first_cosine + k]
        b = p[first_sine + k]
        value += a * cosine + b * sine
        slope += (k + 1) * (b * cosine - a * sine)
    return value, slope


@_jit
def encoder_error(angle, p, c):  # type: ignore[no-untyped-def]
    """Learned error of the encoder's angle, rad, and its derivative with respect to the angle."""
    base = 2.0 * math.pi / p[Slot.encoder_error__period_rad]
    phase = base * (angle + c.phase_offset + p[Slot.encoder_error__shift_rad])
    orders = int(p[Slot.encoder_error__orders])
    error, slope = fourier(phase, orders, FIRST_ENCODER_COSINE, FIRST_ENCODER_SINE, p)
    return error, base * slope


@_inlined
def sensed(y, p, c):  # type: ignore[no-untyped-def]
    """Motor angle and speed as the encoder shows them, before any lag."""
    angle = y[MOTOR_ANGLE]
    motor_speed = y[MOTOR_SPEED]
    if c.structured:
        angle += y[BELT_TWIST]
        motor_speed += y[BELT_SPEED]
    true_angle = angle
    rate = 1.0
    if c.effects:
        eccentricity = p[Slot.encoder_eccentricity__angle_rad]
        if eccentricity != 0.0:
            phase = angle + c.phase_offset + p[Slot.encoder_eccentricity__phase_rad]
            angle += eccentricity * math.sin(phase)
            rate += eccentricity * math.cos(phase)
        if p[Slot.encoder_error__orders] != 0.0:
            error, slope = encoder_error(true_angle, p, c)
            angle += error
            rate += slope
    return angle, motor_speed * rate


@_inlined
def controller(t, y, p, c):  # type: ignore[no-untyped-def]
    """Recorded speed, speed error, torque after the limit, integrated share of the error."""
    angle, speed = sensed(y, p, c)
    if c.effects and p[Slot.speed_sensor_lag__time_s] > 0.0:
        speed = y[SENSED_SPEED]
    if c.held:
        torque, _ = limited(reference_speed(t, c), 0.0, c)
        return speed, 0.0, torque, 0.0
    error = reference_speed(t, c) - speed
    if c.position_gain != 0.0:
        error += c.position_gain * (reference_position(t, c) - angle)
    torque, share = limited(c.speed_gain * error + c.integral_gain * y[INTEGRAL], error, c)
    return speed, error, torque, share


@_jit
def states_of(c):  # type: ignore[no-untyped-def]
    """Number of states of the bench."""
    return STATES + c.waiting if c.sampled else moving_states(c)


@_jit
def moving_states(c):  # type: ignore[no-untyped-def]
    """Number of states that change between the ticks of a sampled controller."""
    if c.structured:
        return HELD_TORQUE
    if c.bends:
        return BELT_TWIST
    return BRISTLE if c.effects else DRIVE_TORQUE


@_jit
def rest_the_loop(y, speed, torque, p, c):  # type: ignore[no-untyped-def]
    """Set lags and a sampled controller to their steady state at this speed and torque."""
    if c.effects:
        y[DRIVE_TORQUE] = torque
        y[SENSED_SPEED] = speed
    if c.bends:
        y[BRISTLE] = direction_of(speed / c.friction_width)
    if c.sampled:
        y[HELD_TORQUE] = torque
        y[NEXT_TORQUE] = torque
        y[TICK_ANGLE] = filtered_angle(y, p, c)
        y[TICK_SPEED] = speed
        y[STATES:] = torque


@_jit
def next_to_act(y, c):  # type: ignore[no-untyped-def]
    """The oldest torque that a sampled controller has computed and that does not act yet, N m."""
    return y[STATES + c.waiting - 1] if c.waiting > 0 else y[NEXT_TORQUE]


@_jit
def logged_torque(y, repeated, dt, p, c):  # type: ignore[no-untyped-def]
    """Torque that a sampled drive reports at its tick, N m: the mean torque until the next tick.

    It is therefore d periods old, and smooth in d. A recorder that sees each torque for several
    samples reports the mean until its next sample. With a lag of the current loop, it is the mean
    of the actual torque.
    """
    held = y[HELD_TORQUE]
    if repeated:
        following, share, span = held, 1.0, dt
    else:
        following, share = next_to_act(y, c), p[Slot.sampled_control__delay_periods] - c.waiting
        span = p[Slot.sampled_control__period_s]
    shown = share * held + (1.0 - share) * following
    if p[Slot.current_loop_lag__time_s] > 0.0:
        lag = p[Slot.current_loop_lag__time_s] / span
        decay = math.exp(-share / lag)
        behind = y[DRIVE_TORQUE] - held
        shown += lag * behind * (1.0 - decay)
        behind = behind * decay + held - following
        shown += lag * behind * (1.0 - math.exp((share - 1.0) / lag))
    return shown


@_jit
def filtered_angle(y, p, c):  # type: ignore[no-untyped-def]
    """Integral of the speed that the controller gets: T dω_f/dt = ω − ω_f has θ − T ω_f."""
    angle, _ = sensed(y, p, c)
    return angle - p[Slot.speed_sensor_lag__time_s] * y[SENSED_SPEED]


@_jit
def tick(t, y, p, c):  # type: ignore[no-untyped-def]
    """Tick of a sampled controller: difference the angle, sum the error, compute a later torque."""
    period = p[Slot.sampled_control__period_s]
    instant = p[Slot.sampled_control__instant_share]
    for i in range(STATES + c.waiting - 1, STATES, -1):
        y[i] = y[i - 1]
    if c.waiting > 0:
        y[STATES] = y[NEXT_TORQUE]
    turned = filtered_angle(y, p, c)
    speed = (turned - y[TICK_ANGLE]) / period
    if instant > 0.0:
        fresh = y[SENSED_SPEED]
        if p[Slot.speed_sensor_lag__time_s] == 0.0:
            _, fresh = sensed(y, p, c)
        speed += instant * (fresh - speed)
    y[TICK_ANGLE] = turned
    y[TICK_SPEED] = speed
    if c.held:
        y[NEXT_TORQUE], _ = limited(reference_speed(t, c), 0.0, c)
        return
    error = reference_speed(t, c) - speed
    if c.position_gain != 0.0:
        angle, _ = sensed(y, p, c)
        error += c.position_gain * (reference_position(t, c) - angle)
    summed = y[INTEGRAL] + error * period
    torque, share = limited(c.speed_gain * error + c.integral_gain * summed, error, c)
    y[INTEGRAL] += share * error * period
    y[NEXT_TORQUE] = torque


@_inlined
def direction_of(ratio):  # type: ignore[no-untyped-def]
    """Smoothed sign tanh(ω / width); beyond 20 widths it is ±1 to the last digit."""
    if abs(ratio) > 20.0:
        return math.copysign(1.0, ratio)
    return math.tanh(ratio)


@_jit
def bent_friction(bristle, speed, p, c, dy):  # type: ignore[no-untyped-def]
    """What the sign of dry friction lacks because contacts bend; fills its row of ``dy``."""
    bent = bristle - direction_of(speed / c.friction_width)
    rate = abs(speed) + p[Slot.motor_coulomb_friction__width_rad_per_s]
    rate /= p[Slot.motor_coulomb_friction__presliding_rad]
    dy[BRISTLE] = -min(rate, 1.0 / SHORTEST_FOLLOWING_S) * bent
    return presliding_share(p) * bent


@_jit
def presliding_share(p):  # type: ignore[no-untyped-def]
    """Share of :func:`bent_friction` that acts: none in the limit of no angle."""
    presliding = p[Slot.motor_coulomb_friction__presliding_rad]
    return presliding / (presliding + LEAST_PRESLIDING_RAD)


@_jit
def settle(y, per_allowance, c):  # type: ignore[no-untyped-def]
    """End the bending of dry friction when it is less than a step's allowed error.

    So it ends in a finite time, after which its rate limits no step.
    """
    speed = y[MOTOR_SPEED]
    if c.structured:
        speed += y[BELT_SPEED]
    sign = math.copysign(1.0, speed)
    if abs(speed) > CLEAR * c.friction_width and abs(y[BRISTLE] - sign) * per_allowance < 1.0:
        y[BRISTLE] = sign


@_jit
def motor_losses(t, angle, speed, bent, transmitted, p, c):  # type: ignore[no-untyped-def]
    """Torque against the motor from motor-side effects, N m; ``bent``: added to the sign of dry
    friction."""
    direction = direction_of(speed / c.friction_width) + bent
    if not c.effects:
        return c.motor_viscous * speed + c.motor_coulomb * direction
    drift = p[Slot.friction_drift__torque_nm]
    drift += p[Slot.friction_drift__rate_nm_per_s] * max(0.0, t - c.drift_start)
    dry = c.motor_coulomb + drift
    dry += p[Slot.gear_mesh_friction__coefficient] * abs(transmitted) * c.per_ratio
    dry += p[Slot.friction_asymmetry__coefficient_nm_s_per_rad] * speed
    if p[Slot.motor_stribeck_friction__torque_nm] != 0.0:
        ratio = speed / p[Slot.motor_stribeck_friction__speed_rad_per_s]
        dry += p[Slot.motor_stribeck_friction__torque_nm] * math.exp(-ratio * ratio)
    ripple = 0.0
    if p[Slot.motor_torque_ripple__torque_nm] != 0.0:
        phase = p[Slot.motor_torque_ripple__order] * (angle + c.phase_offset)
        ripple = p[Slot.motor_torque_ripple__torque_nm] * math.sin(
            phase + p[Slot.motor_torque_ripple__phase_rad]
        )
    return (
        dry * direction
        + c.motor_viscous * speed
        + p[Slot.motor_quadratic_drag__coefficient_nm_s2_per_rad2] * abs(speed) * speed
        + p[Slot.motor_torque_offset__torque_nm]
        + ripple
    )


@_jit
def gravity_at(angle, p, c):  # type: ignore[no-untyped-def]
    """Gravity's torque against a load at this angle, N m."""
    torque = c.gravity * math.sin(angle + c.gravity_angle)
    if c.effects and p[Slot.gravity_phase__torque_nm] != 0.0:
        torque += p[Slot.gravity_phase__torque_nm] * math.cos(angle)
    return torque


@_jit
def load_losses(speed, p, c):  # type: ignore[no-untyped-def]
    """Torque against the load from load-side effects, N m."""
    torque = c.load_viscous * speed
    if c.load_coulomb != 0.0:
        torque += c.load_coulomb * direction_of(speed / c.load_friction_width)
    if c.effects:
        torque += p[Slot.load_torque_offset__torque_nm]
    return torque


@_jit
def learned_torque(t, angle, speed, load_angle, p, c):  # type: ignore[no-untyped-def]
    """Learned torque against the side where it acts, N m: of a variable x with the period X."""
    variable = p[Slot.learned_torque__variable]
    if variable == OVER_MOTOR_ANGLE:
        x = angle + c.phase_offset
    elif variable == OVER_LOAD_ANGLE:
        x = load_angle
    elif variable == OVER_SPEED:
        x = speed
    else:
        x = t - c.drift_start
    phase = 2.0 * math.pi * (x + p[Slot.learned_torque__shift]) / p[Slot.learned_torque__period]
    waves, _ = fourier(phase, LEARNED_HARMONICS, FIRST_COSINE, FIRST_SINE, p)
    torque = p[Slot.learned_torque__constant_nm] + waves
    if p[Slot.learned_torque__reverses] != 0.0:
        torque *= direction_of(speed / c.friction_width)
    return torque


@_jit
def rigid_accelerations(torque, losses, load, speed, p, c):  # type: ignore[no-untyped-def]
    """Motor acceleration of a drive without compliance; losses exclude gear-mesh friction."""
    reflected = c.load_inertia * c.per_ratio * c.per_ratio
    acceleration = (torque - losses - load * c.per_ratio) / (c.motor_inertia + reflected)
    mesh = p[Slot.gear_mesh_friction__coefficient] if c.effects else 0.0
    if mesh != 0.0:
        # The transmitted torque contains the acceleration: solve with its sign fixed.
        transmitted = reflected * acceleration + load * c.per_ratio
        factor = 1.0 + mesh * direction_of(speed / c.friction_width) * math.copysign(
            1.0, transmitted
        )
        acceleration = (torque - losses - load * c.per_ratio * factor) / (
            c.motor_inertia + reflected * factor
        )
    return acceleration


@_jit
def belt_rate(p):  # type: ignore[no-untyped-def]
    """Angular frequency of the belt between the inertias on both sides, both free, rad/s."""
    share = p[Slot.belt__reducer_share]
    inertia = p[Slot.motor_inertia_kg_m2] * share * (1.0 - share)
    return 1.0 / math.sqrt(p[Slot.belt__compliance_rad_per_nm] * inertia)


@_jit
def arm_rate(p):  # type: ignore[no-untyped-def]
    """Angular frequency of the arm between the inertias on both sides, both free, rad/s."""
    share = p[Slot.arm__inertia_share]
    inertia = p[Slot.load_inertia_kg_m2] * share * (1.0 - share)
    return 1.0 / math.sqrt(p[Slot.arm__compliance_rad_per_nm] * inertia)


@_jit
def base_rate(p):  # type: ignore[no-untyped-def]
    """Angular frequency of the base against the ground, rad/s."""
    return 1.0 / math.sqrt(p[Slot.base__compliance_rad_per_nm] * p[Slot.base__inertia_kg_m2])


@_jit
def chain_accelerations(y, driven, shaft, losses, load_angle, p, c, dy):  # type: ignore[no-untyped-def]
    """Fill the rows of belt, arm and base in ``dy``; return accelerations of gear input and load,
    rad/s².

        b = θ_m − θ_r,  τ_b = (b + t_b ḃ)/c_b,   J_m − J_r at the motor, J_r at the gear's input
        a = θ_l − θ_a,  τ_a = (a + t_a ȧ)/c_a,   J_l − J_a at the gear, J_a behind the spring
        J_f θ̈_f = −(θ_f + t_f θ̇_f)/c_f + τ_s/N − τ_s − K_t i

    Each damping time t is 2 ζ/ω of the spring's resonance ω. Motor and gear react against the
    housing. ``driven``: the motor's torque minus its losses; ``losses``: those of the load without
    gravity.
    """
    base, base_speed, base_acceleration = 0.0, 0.0, 0.0
    if p[Slot.base__compliance_rad_per_nm] != 0.0:
        base, base_speed = y[BASE_ANGLE], y[BASE_SPEED]
        time = 2.0 * p[Slot.base__damping_ratio] / base_rate(p)
        bent = base + time * base_speed
        reaction = -bent / p[Slot.base__compliance_rad_per_nm] - driven
        reaction += shaft * (c.per_ratio - 1.0) + losses
        base_acceleration = reaction / p[Slot.base__inertia_kg_m2]
    dy[BASE_ANGLE] = base_speed
    dy[BASE_SPEED] = base_acceleration
    dy[BELT_TWIST] = 0.0
    dy[BELT_SPEED] = 0.0
    if p[Slot.belt__compliance_rad_per_nm] != 0.0:
        time = 2.0 * p[Slot.belt__damping_ratio] / belt_rate(p)
        stretch = y[BELT_TWIST] + time * y[BELT_SPEED]
        pull = stretch / p[Slot.belt__compliance_rad_per_nm]
        reducer = p[Slot.belt__reducer_share] * c.motor_inertia
        acceleration = (pull - shaft * c.per_ratio) / reducer - base_acceleration
        dy[BELT_TWIST] = y[BELT_SPEED]
        dy[BELT_SPEED] = (driven - pull) / (c.motor_inertia - reducer)
        dy[BELT_SPEED] -= base_acceleration + acceleration
    else:
        acceleration = (driven - shaft * c.per_ratio) * c.per_motor_inertia - base_acceleration
    dy[ARM_TWIST] = 0.0
    dy[ARM_SPEED] = 0.0
    if p[Slot.arm__compliance_rad_per_nm] != 0.0:
        time = 2.0 * p[Slot.arm__damping_ratio] / arm_rate(p)
        bent = y[ARM_TWIST] + time * y[ARM_SPEED]
        held = bent / p[Slot.arm__compliance_rad_per_nm]
        arm = p[Slot.arm__inertia_share] * c.load_inertia
        share = p[Slot.arm__gravity_share]
        near = (1.0 - share) * gravity_at(load_angle + base, p, c) + losses
        load_acceleration = (shaft - held - near) / (c.load_inertia - arm) - base_acceleration
        far = share * gravity_at(load_angle + base - y[ARM_TWIST], p, c)
        dy[ARM_TWIST] = y[ARM_SPEED]
        dy[ARM_SPEED] = load_acceleration - ((held - far) / arm - base_acceleration)
    else:
        load = gravity_at(load_angle + base, p, c) + losses
        load_acceleration = (shaft - load) * c.per_load_inertia - base_acceleration
    return acceleration, load_acceleration


@_jit
def full_right_hand_side(t, y, region, p, c, dy):  # type: ignore[no-untyped-def]
    """The right-hand side with every effect, for the rigid drive and for a held output."""
    speed = y[MOTOR_SPEED]
    twist = y[TWIST]
    twist_speed = y[TWIST_SPEED]
    if c.sampled:
        error, torque, share = 0.0, y[HELD_TORQUE], 0.0
    else:
        _, error, torque, share = controller(t, y, p, c)
    load_angle = y[MOTOR_ANGLE] * c.per_ratio - twist
    load_speed = speed * c.per_ratio - twist_speed
    shaft = 0.0
    if not c.rigid:
        if not c.effects:
            shaft = shaft_torque(twist, twist_speed, region, c.sharpness, c)
        else:
            share_of_gap = gap_share(y[MOTOR_ANGLE], twist, p, c)
            apparent_twist = eccentric_twist(y[MOTOR_ANGLE], twist, p, c) / share_of_gap
            seen_speed = twist_speed
            if p[Slot.gear_transmission_error__angle_rad] != 0.0:
                order = p[Slot.gear_transmission_error__order]
                phase = order * (y[MOTOR_ANGLE] + c.phase_offset)
                phase += p[Slot.gear_transmission_error__phase_rad]
                slope = p[Slot.gear_transmission_error__angle_rad] * order * math.cos(phase)
                seen_speed += slope * speed
            # Twist divided by the gap's share, torque multiplied by it: the edges stay at ±δ.
            sharpness = c.sharpness * share_of_gap
            shaft = shaft_torque(apparent_twist, seen_speed / share_of_gap, region, sharpness, c)
            shaft *= share_of_gap
            compression = (
                math.copysign(max(0.0, abs(apparent_twist) - c.gap), apparent_twist) * share_of_gap
            )
            shaft += p[Slot.stiffness_hardening__stiffness_nm_per_rad3] * compression**3
            shaft += exponent_torque(compression, p, c)
            if p[Slot.contact_softness__variance_rad2] > 0.0:
                shaft += softness_torque(
                    apparent_twist * share_of_gap, seen_speed, share_of_gap, p, c
                )
            shaft += p[Slot.flank_asymmetry__share] * c.stiffness * abs(compression)
            damping = p[Slot.contact_damping__factor_s_per_rad] * c.stiffness * abs(compression)
            shaft += damping * seen_speed
            if shaft * compression < 0.0:
                shaft *= 1.0 - p[Slot.contact_release__share]
            if compression == 0.0:
                shaft += p[Slot.gap_damping__coefficient_nm_s_per_rad] * seen_speed
            shaft += p[Slot.shaft_hysteresis__torque_nm] * y[DAHL]
    motor_angle, motor_speed = y[MOTOR_ANGLE], speed
    if c.structured:
        motor_angle += y[BELT_TWIST]
        motor_speed += y[BELT_SPEED]
    if c.effects:
        lag = p[Slot.current_loop_lag__time_s]
        dy[DRIVE_TORQUE] = 0.0
        if lag > 0.0:
            dy[DRIVE_TORQUE] = (torque - y[DRIVE_TORQUE]) / lag
            torque = y[DRIVE_TORQUE]
        lag = p[Slot.speed_sensor_lag__time_s]
        dy[SENSED_SPEED] = 0.0
        if lag > 0.0:
            _, fresh = sensed(y, p, c)
            dy[SENSED_SPEED] = (fresh - y[SENSED_SPEED]) / lag
        dy[DAHL] = 0.0
        if p[Slot.shaft_hysteresis__torque_nm] != 0.0:
            dy[DAHL] = (twist_speed - abs(twist_speed) * y[DAHL]) / p[
                Slot.shaft_hysteresis__angle_rad
            ]
    bent = 0.0
    if c.bends:
        bent = bent_friction(y[BRISTLE], motor_speed, p, c, dy)
    elif c.structured:
        dy[BRISTLE] = 0.0
    losses = motor_losses(t, motor_angle, motor_speed, bent, shaft, p, c)
    load = load_losses(load_speed, p, c)
    if not c.structured:
        load += gravity_at(load_angle, p, c)
    if c.effects and p[Slot.learned_torque__side] != 0.0:
        learned = learned_torque(t, motor_angle, motor_speed, load_angle, p, c)
        if p[Slot.learned_torque__side] == AT_MOTOR:
            losses += learned
        else:
            load += learned
    dy[MOTOR_ANGLE] = speed
    dy[INTEGRAL] = share * error
    if c.rigid:
        dy[MOTOR_SPEED] = rigid_accelerations(torque, losses, load, speed, p, c)
        dy[TWIST] = 0.0
        dy[TWIST_SPEED] = 0.0
        return
    if c.structured:
        dy[MOTOR_SPEED], load_acceleration = chain_accelerations(
            y, torque - losses, shaft, load, load_angle, p, c, dy
        )
        dy[TWIST] = twist_speed
        dy[TWIST_SPEED] = dy[MOTOR_SPEED] * c.per_ratio - load_acceleration
        return
    acceleration = (torque - shaft * c.per_ratio - losses) * c.per_motor_inertia
    dy[MOTOR_SPEED] = acceleration
    dy[TWIST] = twist_speed
    dy[TWIST_SPEED] = acceleration * c.per_ratio - (shaft - load) * c.per_load_inertia


@_jit
def tick_each(states, p):  # type: ignore[no-untyped-def]
    """Replace each of some states, (m, n), by that after a tick."""
    c = constants(p, 0.0, math.inf)
    for state in states:
        tick(0.0, state, p, c)


@_jit
def contact_matrix(p, a):  # type: ignore[no-untyped-def]
    """Fill the columns of ``a``, (n, n), with the time derivative of each unit state on one flank.

    For a bench whose equations are linear there, this is the system matrix.
    """
    c = constants(p, 0.0, math.inf)
    y = np.zeros(HELD_TORQUE)
    dy = np.zeros(HELD_TORQUE)
    for column in range(len(a)):
        y[column] = 1.0
        full_right_hand_side(0.0, y, 2, p, c, dy)
        y[column] = 0.0
        for row in range(len(a)):
            a[row, column] = dy[row]


@_inlined
def right_hand_side(t, y, region, p, c, dy):  # type: ignore[no-untyped-def]
    """Time derivative of the state into ``dy`` (docs/design.md, "The virtual bench")."""
    if not c.plain:
        full_right_hand_side(t, y, region, p, c, dy)
        return
    # The bench with no effects but friction, short enough to be inlined into the stages.
    speed = y[MOTOR_SPEED]
    twist = y[TWIST]
    twist_speed = y[TWIST_SPEED]
    if c.sampled:
        error, torque, share = 0.0, y[HELD_TORQUE], 0.0
    else:
        error = reference_speed(t, c) - speed
        if c.position_gain != 0.0:
            error += c.position_gain * (reference_position(t, c) - y[MOTOR_ANGLE])
        torque = c.speed_gain * error + c.integral_gain * y[INTEGRAL]
        share = 1.0
        if abs(torque) > c.torque_limit:
            torque, share = limited(torque, error, c)
    shaft = shaft_torque(twist, twist_speed, region, c.sharpness, c)
    load = c.gravity * math.sin(y[MOTOR_ANGLE] * c.per_ratio - twist + c.gravity_angle)
    load_speed = speed * c.per_ratio - twist_speed
    load += c.load_viscous * load_speed
    if c.load_coulomb != 0.0:
        load += c.load_coulomb * direction_of(load_speed / c.load_friction_width)
    losses = c.motor_viscous * speed
    if c.motor_coulomb != 0.0:
        losses += c.motor_coulomb * direction_of(speed / c.friction_width)
    acceleration = (torque - shaft * c.per_ratio - losses) * c.per_motor_inertia
    dy[MOTOR_ANGLE] = speed
    dy[MOTOR_SPEED] = acceleration
    dy[TWIST] = twist_speed
    dy[TWIST_SPEED] = acceleration * c.per_ratio - (shaft - load) * c.per_load_inertia
    dy[INTEGRAL] = share * error


@_jit
def lower_edge(region, c):  # type: ignore[no-untyped-def]
    """Lower end of this contact region, as a twist."""
    if region == 0:
        return -math.inf
    if region == 1:
        return -c.gap
    return c.gap if c.hard or region == 3 else 0.0


@_jit
def upper_edge(region, c):  # type: ignore[no-untyped-def]
    """Upper end of this contact region, as a twist."""
    if region == (2 if c.hard else 3):
        return math.inf
    return lower_edge(region + 1, c)


# Dormand & Prince 1980; dense output as in Hairer, Nørsett, Wanner, Solving ODEs I, II.6. Written
# out as scalars: the compiler folds them into the loops, which arrays of coefficients prevent.
A21 = 1 / 5
A31, A32 = 3 / 40, 9 / 40
A41, A42, A43 = 44 / 45, -56 / 15, 32 / 9
A51, A52, A53, A54 = 19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729
A61, A62, A63, A64, A65 = 9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656
B1, B3, B4, B5, B6 = 35 / 384, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84
E1, E3, E4, E5, E6, E7 = 71 / 57600, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40
D1, D3, D4 = -12715105075 / 11282082432, 87487479700 / 32700410799, -10690763975 / 1880347072
D5, D6, D7 = 701980252875 / 199316789632, -1453857185 / 822651844, 69997945 / 29380423


@_jit
def step(t, y, h, region, p, c, k, y_new):  # type: ignore[no-untyped-def]
    """One step from ``y`` into ``y_new``; ``k[0]`` is given, ``k[1:]`` filled, shape (7, n)."""
    k1, k2, k3, k4, k5, k6, k7 = k[0], k[1], k[2], k[3], k[4], k[5], k[6]
    n = k.shape[1]
    for i in range(n):
        y_new[i] = y[i] + h * (A21 * k1[i])
    right_hand_side(t + 0.2 * h, y_new, region, p, c, k2)
    for i in range(n):
        y_new[i] = y[i] + h * (A31 * k1[i] + A32 * k2[i])
    right_hand_side(t + 0.3 * h, y_new, region, p, c, k3)
    for i in range(n):
        y_new[i] = y[i] + h * (A41 * k1[i] + A42 * k2[i] + A43 * k3[i])
    right_hand_side(t + 0.8 * h, y_new, region, p, c, k4)
    for i in range(n):
        y_new[i] = y[i] + h * (A51 * k1[i] + A52 * k2[i] + A53 * k3[i] + A54 * k4[i])
    right_hand_side(t + 8 / 9 * h, y_new, region, p, c, k5)
    for i in range(n):
        slope = A61 * k1[i] + A62 * k2[i] + A63 * k3[i] + A64 * k4[i] + A65 * k5[i]
        y_new[i] = y[i] + h * slope
    right_hand_side(t + h, y_new, region, p, c, k6)
    for i in range(n):
        slope = B1 * k1[i] + B3 * k3[i] + B4 * k4[i] + B5 * k5[i] + B6 * k6[i]
        y_new[i] = y[i] + h * slope
    right_hand_side(t + h, y_new, region, p, c, k7)


@_inlined
def short_step(t, y, h, region, p, c, k, y_new, dense):  # type: ignore[no-untyped-def]
    """One classical Runge-Kutta step from ``y`` into ``y_new``, with the motor angle's dense row.

    ``k[0]`` is given, ``k[1:4]`` filled. For the time between two ticks if it is short compared
    with every oscillation.
    """
    k1, k2, k3, k4 = k[0], k[1], k[2], k[3]
    n = k.shape[1]
    for i in range(n):
        y_new[i] = y[i] + 0.5 * h * k1[i]
    right_hand_side(t + 0.5 * h, y_new, region, p, c, k2)
    for i in range(n):
        y_new[i] = y[i] + 0.5 * h * k2[i]
    right_hand_side(t + 0.5 * h, y_new, region, p, c, k3)
    for i in range(n):
        y_new[i] = y[i] + h * k3[i]
    right_hand_side(t + h, y_new, region, p, c, k4)
    for i in range(n):
        y_new[i] = y[i] + h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])
    between_ends(y, y_new, h, dense)


@_inlined
def between_ends(y, y_new, h, dense):  # type: ignore[no-untyped-def]
    """Dense row of the motor's angle: the cubic through angle and speed at both ends."""
    rise = y_new[MOTOR_ANGLE] - y[MOTOR_ANGLE]
    bend = h * y[MOTOR_SPEED] - rise
    dense[0, MOTOR_ANGLE] = y[MOTOR_ANGLE]
    dense[1, MOTOR_ANGLE] = rise
    dense[2, MOTOR_ANGLE] = bend
    dense[3, MOTOR_ANGLE] = rise - h * y_new[MOTOR_SPEED] - bend
    dense[4, MOTOR_ANGLE] = 0.0


@_jit
def of_whole_ticks(acting, p, c):  # type: ignore[no-untyped-def]
    """Exact solution over a period of a sampled controller, in the gap and on a flank, (2, 4, 8).

    For the bench with no effects but friction. Rows: growth of the angle, then speed, twist and
    twist speed after the period. Columns: these three before it, the drive's torque until the share
    ``acting`` of the period and that from then on, the shaft's torque beyond a straight flank's,
    the load in the middle and its rate. By the series of the matrix exponential.
    """
    period = p[Slot.sampled_control__period_s]
    rows = np.zeros((2, 4, 8))
    a = np.zeros((4, 4))
    a[0, 1] = 1.0
    a[2, 3] = 1.0
    a[1, 1] = -c.motor_viscous * c.per_motor_inertia
    w = np.zeros(4)
    following = np.zeros(4)
    for touching in range(2):
        stiffness, damping = touching * c.stiffness, touching * c.damping
        a[1, 2] = -stiffness * c.per_ratio * c.per_motor_inertia
        a[1, 3] = -damping * c.per_ratio * c.per_motor_inertia
        a[3, 1] = (a[1, 1] + c.load_viscous * c.per_load_inertia) * c.per_ratio
        a[3, 2] = a[1, 2] * c.per_ratio - stiffness * c.per_load_inertia
        a[3, 3] = a[1, 3] * c.per_ratio - (damping + c.load_viscous) * c.per_load_inertia
        for column in range(8):
            span = period * (1.0 - acting) if column == 4 else period
            w[:] = 0.0
            if column < 3:
                w[column + 1] = 1.0
            elif column < 6:
                w[1] = c.per_motor_inertia * (1.0 if column < 5 else -c.per_ratio)
                w[3] = w[1] * c.per_ratio - (0.0 if column < 5 else c.per_load_inertia)
            else:
                w[3] = c.per_load_inertia
            for k in range(TERMS):
                weight = 1.0
                if column == 7:
                    weight = span * span * (1.0 / (k + 2) - 0.5) / (k + 1)
                elif column > 2:
                    weight = span / (k + 1)
                for i in range(4):
                    rows[touching, i, column] += weight * w[i]
                    following[i] = 0.0
                    for j in range(4):
                        following[i] += a[i, j] * w[j]
                for i in range(4):
                    w[i] = span / (k + 1) * following[i]
        for i in range(4):
            rows[touching, i, 3] -= rows[touching, i, 4]
    return rows


@_inlined
def whole_tick(y, period, region, later_torque, rows, c, y_new):  # type: ignore[no-untyped-def]
    """Advance ``y`` by a period into ``y_new``, with the rows of :func:`of_whole_ticks`.

    Meanwhile, gravity's torque grows with the load's angle, and the arctan's difference from a
    straight flank is that in the middle.
    """
    half = 0.5 * period
    speed, twist, twist_speed = y[MOTOR_SPEED], y[TWIST], y[TWIST_SPEED]
    load_speed = speed * c.per_ratio - twist_speed
    angle = y[MOTOR_ANGLE] * c.per_ratio - twist + c.gravity_angle + half * load_speed
    load = c.gravity * math.sin(angle)
    rate = c.gravity * math.cos(angle) * load_speed
    first, later = y[HELD_TORQUE], later_torque
    if c.load_coulomb != 0.0:
        load += math.copysign(c.load_coulomb, load_speed)
    if c.motor_coulomb != 0.0:
        losses = math.copysign(c.motor_coulomb, speed)
        first -= losses
        later -= losses
    middle = twist + half * twist_speed
    shaft = shaft_torque(middle, twist_speed, region, c.sharpness, c)
    touching = 0
    if c.gap == 0.0 or region == 0 or region == (2 if c.hard else 3):
        touching = 1
        shaft -= c.stiffness * middle + c.damping * twist_speed
    for i in range(4):
        r = rows[touching, i]
        y_new[i] = r[0] * speed + r[1] * twist + r[2] * twist_speed + r[3] * first + r[4] * later
        y_new[i] += r[5] * shaft + r[6] * load + r[7] * rate
    y_new[MOTOR_ANGLE] += y[MOTOR_ANGLE]


@_inlined
def is_reversed(y, y_new, c):  # type: ignore[no-untyped-def]
    """Whether motor or load, and with them dry friction, reversed between two states."""
    if not (c.effects or c.motor_coulomb != 0.0 or c.load_coulomb != 0.0):
        return False
    before = y[MOTOR_SPEED] - c.ratio * y[TWIST_SPEED]
    after = y_new[MOTOR_SPEED] - c.ratio * y_new[TWIST_SPEED]
    return not (y[MOTOR_SPEED] * y_new[MOTOR_SPEED] > 0.0 and before * after > 0.0)


@_inlined
def is_clear(y, region, margin, p, c):  # type: ignore[no-untyped-def]
    """Whether a state is far from the edges of its contact region and from reversal."""
    if not c.rigid and c.gap > 0.0:
        twist = contact_twist(y[MOTOR_ANGLE], y[TWIST], p, c)
        if not lower_edge(region, c) + margin < twist < upper_edge(region, c) - margin:
            return False
    if not (c.effects or c.motor_coulomb != 0.0 or c.load_coulomb != 0.0):
        return True
    least = CLEAR * c.friction_width
    speed = y[MOTOR_SPEED]
    if c.structured and not abs(speed + y[BELT_SPEED]) > least:
        return False
    if c.bends and abs(y[BRISTLE]) != 1.0:
        return False
    return abs(speed) > least and abs(speed - c.ratio * y[TWIST_SPEED]) > least


@_jit
def through_layer(y, acceleration, region, layer, p, c):  # type: ignore[no-untyped-def]
    """Longest step, s, that does not jump over a smoothed edge.

    It reaches the layer at once, and crosses it in steps of its width. A longer step would have at
    most one stage in the layer, and its error estimate would miss it.
    """
    twist = contact_twist(y[MOTOR_ANGLE], y[TWIST], p, c)
    near = min(twist - lower_edge(region, c), upper_edge(region, c) - twist)
    room = max(near - LAYERS * layer, 0.0) + 2.0 * layer
    speed = abs(y[TWIST_SPEED])
    return 2.0 * room / (speed + math.sqrt(speed * speed + 2.0 * abs(acceleration) * room) + 1e-9)


@_jit
def error_of(h, k, scale):  # type: ignore[no-untyped-def]
    """Largest component of the step's error estimate over its allowance; nan if diverged."""
    worst = 0.0
    for i in range(scale.size):
        slope = E1 * k[0, i] + E3 * k[2, i] + E4 * k[3, i]
        slope += E5 * k[4, i] + E6 * k[5, i] + E7 * k[6, i]
        error = abs(h * slope) * scale[i]
        if not error <= worst:
            worst = error
    return worst


@_jit
def dense_coefficients(y, y_new, h, k, dense):  # type: ignore[no-untyped-def]
    """Coefficients of the interpolant over the step, ``dense`` of shape (5, n)."""
    for i in range(dense.shape[1]):
        rise = y_new[i] - y[i]
        bend = h * k[0, i] - rise
        last = D1 * k[0, i] + D3 * k[2, i] + D4 * k[3, i]
        last += D5 * k[4, i] + D6 * k[5, i] + D7 * k[6, i]
        dense[0, i] = y[i]
        dense[1, i] = rise
        dense[2, i] = bend
        dense[3, i] = rise - h * k[6, i] - bend
        dense[4, i] = h * last


@_inlined
def interpolated(dense, i, s):  # type: ignore[no-untyped-def]
    """State ``i`` at the share ``s`` of the step."""
    r = 1.0 - s
    tail = dense[3, i] + r * dense[4, i]
    return dense[0, i] + s * (dense[1, i] + r * (dense[2, i] + s * tail))


@_jit
def beyond(s, dense, edge, kind, p, c):  # type: ignore[no-untyped-def]
    """How far an event has been passed at the share ``s`` of the step; negative before it.

    ``kind``: −1 for the lower edge of the contact region, 1 for the upper one, 0 for the load angle
    ``edge``.
    """
    angle = interpolated(dense, MOTOR_ANGLE, s)
    twist = interpolated(dense, TWIST, s)
    if kind == 0:
        return c.direction * (angle * c.per_ratio - twist - edge)
    return kind * (contact_twist(angle, twist, p, c) - edge)


@_jit
def event_share(s, dense, edge, kind, p, c):  # type: ignore[no-untyped-def]
    """Share of the step at which an event passed at ``s`` happened, by bisection."""
    early = 0.0
    late = s
    for _ in range(40):
        middle = 0.5 * (early + late)
        if beyond(middle, dense, edge, kind, p, c) > 0.0:
            late = middle
        else:
            early = middle
    return late


@_jit
def emit(t, h, dense, row, first, start, moments, out, y, p, c):  # type: ignore[no-untyped-def]
    """Fill the samples that fall into the step; return the next sample's index.

    ``row``: one of position, speed, current, or ``EVERY`` for all rows in ``out``. ``out`` has the
    row of speed alone, these three, or all states.
    """
    rows = out.shape[0]
    for index in range(first, out.shape[1]):
        time = start + moments[index]
        if time > t + h:
            return index
        s = (time - t) / h if h > 0.0 else 1.0
        if rows == 1 and not c.effects:
            out[0, index] = interpolated(dense, MOTOR_SPEED, s) * RPM
            continue
        # The encoder's angle depends on the motor's angle alone.
        for i in range(1 if row == POSITION and not c.structured else dense.shape[1]):
            y[i] = interpolated(dense, i, s)
        if row == POSITION:
            out[POSITION, index], _ = sensed(y, p, c)
            continue
        if rows == STATES:
            for i in range(min(y.size, STATES)):
                out[i, index] = y[i]
            continue
        speed, _, torque, _ = controller(time, y, p, c)
        if row in (SPEED, EVERY):
            out[min(SPEED, rows - 1), index] = speed * RPM
        if rows == 1:
            continue
        if row == EVERY:
            out[POSITION, index], _ = sensed(y, p, c)
        if row in (CURRENT, EVERY):
            if c.effects and p[Slot.current_loop_lag__time_s] > 0.0:
                torque = y[DRIVE_TORQUE]
            out[CURRENT, index] = torque / p[Slot.torque_constant_nm_per_a]
    return out.shape[1]


@_jit
def emit_average(t, h, dense, first, last, begin, moments, out, y, p, c):  # type: ignore[no-untyped-def]
    """Fill samples of the averaged speed that begin or end in the step; return the next indices.

    Until its average ends, the place of a sample holds minus the angle at its beginning.
    """
    averaging = p[Slot.speed_averaging__time_s]
    row = min(SPEED, out.shape[0] - 1)
    while first < out.shape[1] and begin - averaging + moments[first] <= t + h:
        out[row, first] = -shown_angle(t, h, begin - averaging + moments[first], dense, y, p, c)
        first += 1
    while last < out.shape[1] and begin + moments[last] <= t + h:
        out[row, last] += shown_angle(t, h, begin + moments[last], dense, y, p, c)
        out[row, last] *= RPM / averaging
        last += 1
    return first, last


@_jit
def shown_angle(t, h, time, dense, y, p, c):  # type: ignore[no-untyped-def]
    """Angle that the encoder shows at a time in the step."""
    s = (time - t) / h if h > 0.0 else 1.0
    y[MOTOR_ANGLE] = interpolated(dense, MOTOR_ANGLE, s)
    if c.structured:
        y[BELT_TWIST] = interpolated(dense, BELT_TWIST, s)
    angle, _ = sensed(y, p, c)
    return angle


@_jit
def is_repeated(period, dt):  # type: ignore[no-untyped-def]
    """Whether a recorder with the same clock sees each value of a drive for several samples.

    A slower recorder samples at the drive's ticks. If neither period is a multiple of the other,
    samples are interpolated between the ticks, which keeps them smooth in the period.
    """
    samples = period / dt
    return samples > 1.5 and abs(samples - round(samples)) < AT_TICK * samples


@_jit
def emit_logged(  # type: ignore[no-untyped-def]
    since, until, p, row, first, start, moments, dt, repeated, out, old, new, towards
):
    """Fill samples between two times at which a sampled drive logs; return the next sample's index.

    ``old`` and ``new`` are the values at these times. A recorder that sees a held value for several
    samples shows the mean until its next sample, so that it is smooth in the delay. A lagging
    current meanwhile approaches the torque ``towards``.
    """
    lag = p[Slot.current_loop_lag__time_s] if row == CURRENT else 0.0
    margin = AT_TICK * p[Slot.sampled_control__period_s]
    begin = start - p[FIRST_SKEW + row]
    place = row if out.shape[0] > 1 else 0
    for index in range(first, out.shape[1]):
        time = begin + moments[index]
        if time >= until - margin:
            return index
        share = max(0.0, time - since) / (until - since)
        shown = old + share * (new - old)
        if repeated:
            shown = old
            if lag > 0.0:
                shown = towards + (old - towards) * math.exp(-max(0.0, time - since) / lag)
            shown += max(0.0, 1.0 - (until - time) / dt) * (new - shown)
        out[place, index] = shown
    return out.shape[1]


@_jit
def scale_structure(motor_rate, speed, p, c, scale):  # type: ignore[no-untyped-def]
    """Allowances of belt, arm and base at a motor ``speed``; returns the fastest rate."""
    belt, arm, base = 0.0, 0.0, 0.0
    if p[Slot.belt__compliance_rad_per_nm] > 0.0:
        belt = belt_rate(p)
    if p[Slot.arm__compliance_rad_per_nm] > 0.0:
        arm = arm_rate(p)
    if p[Slot.base__compliance_rad_per_nm] > 0.0:
        base = base_rate(p)
    scale[BELT_TWIST] = max(belt, motor_rate) / speed
    scale[BELT_SPEED] = 1.0 / speed
    scale[ARM_TWIST] = c.ratio * max(arm, motor_rate) / speed
    scale[ARM_SPEED] = c.ratio / speed
    scale[BASE_ANGLE] = c.ratio * max(base, motor_rate) / speed
    scale[BASE_SPEED] = c.ratio / speed
    return max(belt, arm, base)


@_jit
def error_scale(p, c, accuracy_rpm, scale):  # type: ignore[no-untyped-def]
    """Reciprocal of each state's allowance: its effect on the motor speed in one step.

    Returns the longest step.
    """
    speed = accuracy_rpm / RPM * LOCAL_SHARE
    inertia = c.motor_inertia
    if c.rigid:
        inertia += c.load_inertia * c.per_ratio * c.per_ratio
    stiffness = c.stiffness * (1.0 + abs(p[Slot.flank_asymmetry__share]))
    motor_rate = math.sqrt(stiffness * c.per_ratio * c.per_ratio * c.per_motor_inertia)
    load_rate = math.sqrt(stiffness * c.per_load_inertia)
    loop_rate = math.sqrt(c.integral_gain / inertia) + c.speed_gain / inertia
    fastest = math.sqrt(motor_rate**2 + load_rate**2)
    if c.rigid:
        # In free motion, gravity sets the rate.
        swing = math.sqrt(c.gravity * c.per_ratio * c.per_ratio / inertia)
        fastest = max(loop_rate, swing, SLOWEST_RATE)
    torque = speed * inertia * max(fastest, loop_rate)
    scale[MOTOR_SPEED] = 1.0 / speed
    scale[MOTOR_ANGLE] = fastest / speed
    scale[TWIST] = c.ratio * motor_rate / speed
    scale[TWIST_SPEED] = c.ratio / speed
    scale[INTEGRAL] = c.integral_gain / torque
    rate = max(fastest, 0.25 * loop_rate)
    if c.sampled:
        # A difference over a short period amplifies the error of the angle.
        per_period = 1.0 / p[Slot.sampled_control__period_s]
        scale[MOTOR_ANGLE] = max(scale[MOTOR_ANGLE], per_period / speed)
    if c.bends:
        dry = abs(p[Slot.motor_coulomb_friction__torque_nm])
        dry += abs(p[Slot.motor_stribeck_friction__torque_nm])
        # As much as it acts: so the steps for a small angle are those for none.
        scale[BRISTLE] = presliding_share(p) * dry / torque
    if c.effects:
        scale[DRIVE_TORQUE] = 1.0 / torque
        scale[SENSED_SPEED] = 1.0 / speed
        scale[DAHL] = abs(p[Slot.shaft_hysteresis__torque_nm]) * c.per_ratio / torque
        if c.structured:
            rate = max(rate, scale_structure(motor_rate, speed, p, c, scale))
        turning = 0.5 * c.fastest_reference
        order = 0.0
        if p[Slot.motor_torque_ripple__torque_nm] != 0.0:
            order = abs(p[Slot.motor_torque_ripple__order])
        if p[Slot.gear_transmission_error__angle_rad] != 0.0:
            order = max(order, abs(p[Slot.gear_transmission_error__order]))
        if p[Slot.encoder_eccentricity__angle_rad] != 0.0:
            order = max(order, 1.0)
        if p[Slot.encoder_error__orders] != 0.0:
            highest = p[Slot.encoder_error__orders]
            order = max(order, highest * 2.0 * math.pi / p[Slot.encoder_error__period_rad])
        rate = max(rate, turning * order)
        if p[Slot.learned_torque__side] != 0.0:
            variable = p[Slot.learned_torque__variable]
            if variable == OVER_LOAD_ANGLE:
                turning *= c.per_ratio
            elif variable != OVER_MOTOR_ANGLE:
                turning = 1.0 if variable == OVER_TIME else 0.0
            highest = 0
            for k in range(LEARNED_HARMONICS):
                if p[FIRST_COSINE + k] != 0.0 or p[FIRST_SINE + k] != 0.0:
                    highest = k + 1
            base = 2.0 * math.pi / p[Slot.learned_torque__period]
            rate = max(rate, turning * highest * base)
    return min(LONGEST_PHASE / rate, 0.5 / (c.fastest_reference * c.per_ratio + 1e-3))


@_jit
def fastest_decay(p, c):  # type: ignore[no-untyped-def]
    """Rate at which damping and viscous friction alone would end a motion, 1/s."""
    damping = max(c.damping, p[Slot.gap_damping__coefficient_nm_s_per_rad])
    rate = damping * (c.per_ratio * c.per_ratio * c.per_motor_inertia + c.per_load_inertia)
    rate += c.motor_viscous * c.per_motor_inertia + c.load_viscous * c.per_load_inertia
    if c.effects:
        rate += abs(p[Slot.friction_asymmetry__coefficient_nm_s_per_rad]) * c.per_motor_inertia
    return rate


@_jit
def is_stiffer(p, c):  # type: ignore[no-untyped-def]
    """Whether an effect is on that may be faster than the rates of :func:`error_scale`."""
    return (
        c.structured
        or p[Slot.speed_sensor_lag__time_s] > 0.0
        or p[Slot.current_loop_lag__time_s] > 0.0
        or p[Slot.stiffness_hardening__stiffness_nm_per_rad3] != 0.0
        or p[Slot.contact_damping__factor_s_per_rad] != 0.0
    )


@_jit
def integrate(  # type: ignore[no-untyped-def]
    t, y, stop_time, stop_angle, start, dt, moments, out, p, c, accuracy_rpm, pieces
):
    """Integrate ``y`` in place until a time or a load angle, sampling on the way.

    Samples j of ``out`` are at ``start + moments[j]``, minus each channel's skew; the averaging of
    a speed ends there. ``dt``: the recorder's sampling period; ``pieces``: the motion that the
    reference follows. Steps end where a piece does. A sampled controller has a tick at ``start``;
    the given state is that after its last tick. Returns status, time reached, number of right-hand
    sides.
    """
    piece = 0
    if len(pieces) > 0:
        c = on_piece(c, pieces, 0)
    piece_end = pieces[1, 0] if len(pieces) > 1 else math.inf
    n = moving_states(c)
    k = np.zeros((7, n))
    y_new = y.copy()
    scale = np.zeros(n)
    dense = np.empty((5, n))
    next_sample = np.zeros(3, np.int64)
    next_average = 0
    longest = error_scale(p, c, accuracy_rpm, scale)
    skewed = p[FIRST_SKEW] != 0.0 or p[FIRST_SKEW + 1] != 0.0 or p[FIRST_SKEW + 2] != 0.0
    averaged = p[Slot.speed_averaging__time_s] > 0.0 and out.shape[0] != STATES
    skewed = (skewed or averaged) and out.shape[0] != STATES
    logged = c.sampled and out.shape[0] != STATES
    repeated = is_repeated(p[Slot.sampled_control__period_s], dt)
    period = p[Slot.sampled_control__period_s]
    delay = p[Slot.sampled_control__delay_periods]
    number, next_tick, due = 0, math.inf, math.inf
    if c.sampled:
        number = int(math.floor((t - start) / period + AT_TICK)) + 1
        next_tick = start + number * period
        due = start + (number - 1 - c.waiting + delay) * period
        if due <= t:
            due = math.inf
    pause = min(piece_end, next_tick, due)
    current, towards, changed = 0.0, 0.0, t
    if c.sampled:
        current = logged_torque(y, repeated, dt, p, c) / p[Slot.torque_constant_nm_per_a]
        towards = y[HELD_TORQUE] / p[Slot.torque_constant_nm_per_a]
    has_edges = c.gap > 0.0 and not c.rigid
    layer = max(softness_scale(p), 0.0 if c.hard else 1.0 / c.sharpness)
    margin = CLEAR * layer
    shortest = SHORT_PHASE / max(1.0 / longest, fastest_decay(p, c))
    if not logged or is_stiffer(p, c):
        shortest = 0.0
    per_friction_angle = 0.0
    if p[Slot.shaft_hysteresis__torque_nm] != 0.0:
        per_friction_angle = 1.0 / p[Slot.shaft_hysteresis__angle_rad]
    # A torque that the recorder sees several times a period is logged when it begins to act.
    by_period = not (c.effects or c.rigid or c.held or repeated or averaged)
    by_period = by_period and period <= shortest
    rows = of_whole_ticks(delay - c.waiting, p, c) if by_period else np.zeros((0, 4, 8))
    fresh = False
    evaluations = 0
    budget = 1000 + int(MAX_STEPS_PER_SECOND * max(1.0, stop_time - t))
    runaway = 50.0 * c.fastest_reference + 1e3
    twist = contact_twist(y[MOTOR_ANGLE], y[TWIST], p, c)
    region = 0 if c.hard or has_edges else 2
    while has_edges and twist > upper_edge(region, c):
        region += 1
    right_hand_side(t, y, region, p, c, k[0])
    h = 0.1 * longest
    for _ in range(budget):
        if t >= stop_time:
            return DONE, t, evaluations
        h_usual, whole = h, False
        if fresh and next_tick <= min(stop_time, piece_end):
            later = next_to_act(y, c) if due < next_tick else y[HELD_TORQUE]
            whole_tick(y, period, region, later, rows, c, y_new)
            reach = margin + period * abs(y[TWIST_SPEED])
            turned = c.direction * (y_new[MOTOR_ANGLE] * c.per_ratio - y_new[TWIST] - stop_angle)
            whole = turned < 0.0 and abs(y_new[MOTOR_SPEED]) <= runaway
            whole = whole and is_clear(y, region, reach, p, c) and not is_reversed(y, y_new, c)
            whole = whole and is_clear(y_new, region, margin, p, c)
        is_short = whole
        if whole:
            h, pause, ends, last = next_tick - t, next_tick, True, False
            y_new[INTEGRAL] = y[INTEGRAL]
            between_ends(y, y_new, h, dense)
            if due < next_tick:
                y[HELD_TORQUE], due = later, math.inf
        else:
            if fresh:
                right_hand_side(t, y, region, p, c, k[0])
                evaluations += 1
            h = min(h, longest)
            if layer > 0.0 and has_edges:
                h = min(h, through_layer(y, k[0, TWIST_SPEED], region, layer, p, c))
            last = t + h >= stop_time
            if last:
                h = stop_time - t
            h_usual = h
            ends = t + h >= pause
            if ends:
                h = pause - t
                last = False
            is_short = ends and h <= shortest and is_clear(y, region, margin, p, c)
            is_short = is_short and abs(y[TWIST_SPEED]) * h * per_friction_angle <= SHORT_PHASE
            if is_short:
                short_step(t, y, h, region, p, c, k, y_new, dense)
                evaluations += 3
                turned = c.direction * (
                    y_new[MOTOR_ANGLE] * c.per_ratio - y_new[TWIST] - stop_angle
                )
                is_short = turned < 0.0 and abs(y_new[MOTOR_SPEED]) <= runaway
                is_short = is_short and is_clear(y_new, region, margin, p, c)
                is_short = is_short and not is_reversed(y, y_new, c)
        fresh = False
        h_next, crossed, arrived = h, 0, False
        if not is_short:
            step(t, y, h, region, p, c, k, y_new)
            evaluations += 6
            error = error_of(h, k, scale)
            if not error <= 1.0:
                # nan and inf shrink the step too, until it is hopeless
                h *= max(0.2, 0.9 * error**-0.2) if error < 1e30 else 0.1
                if h < 1e-12:
                    return DIVERGED, t, evaluations
                continue
            if abs(y_new[MOTOR_SPEED]) > runaway:
                return DIVERGED, t, evaluations
            dense_coefficients(y, y_new, h, k, dense)
            factor = min(6.0, 0.9 * max(error, 1e-8) ** -0.2)

            share = 1.0
            crossed = 0
            if has_edges:
                lower = lower_edge(region, c)
                upper = upper_edge(region, c)
                probes = 1
                turn = 0.0
                if y[TWIST_SPEED] * y_new[TWIST_SPEED] < 0.0:
                    probes = 2  # the twist turns inside the step: look there first
                    turn = y[TWIST_SPEED] / (y[TWIST_SPEED] - y_new[TWIST_SPEED])
                for probe in range(probes):
                    s = turn if probe + 1 < probes else 1.0
                    if beyond(s, dense, lower, -1, p, c) > 0.0:
                        crossed = -1
                    elif beyond(s, dense, upper, 1, p, c) > 0.0:
                        crossed = 1
                    if crossed != 0:
                        edge = lower if crossed < 0 else upper
                        share = event_share(s, dense, edge, crossed, p, c)
                        break
            arrived = False
            if beyond(share, dense, stop_angle, 0, p, c) >= 0.0:
                share = event_share(share, dense, stop_angle, 0, p, c)
                arrived = True
                crossed = 0
            if share < 1.0:
                # The interpolant only locates the event; the state there is that of a full step.
                h_next = h * factor
                h *= share
                last = False
                ends = False
                step(t, y, h, region, p, c, k, y_new)
                evaluations += 6
                dense_coefficients(y, y_new, h, k, dense)
            else:
                h_next = h * factor
            if c.bends:
                settle(y_new, scale[BRISTLE], c)

        if averaged:
            next_average, next_sample[SPEED] = emit_average(
                t, h, dense, next_average, next_sample[SPEED], start - p[FIRST_SKEW + SPEED],
                moments, out, y, p, c,
            )  # fmt: skip
        if not (logged or skewed):
            next_sample[0] = emit(t, h, dense, EVERY, next_sample[0], start, moments, out, y, p, c)
        else:
            for row in range(3):
                by_ticks = logged and row != POSITION
                if by_ticks or (row == SPEED and averaged):
                    continue
                if out.shape[0] == 3 or row == SPEED:
                    begin = start - p[FIRST_SKEW + row]
                    next_sample[row] = emit(
                        t, h, dense, row, next_sample[row], begin, moments, out, y, p, c
                    )
        t = stop_time if last else pause if ends else t + h
        for i in range(n):
            y[i] = y_new[i]
            k[0, i] = k[6, i]
        if arrived:
            return DONE, t, evaluations
        if ends:
            if t == piece_end:
                piece += 1
                c = on_piece(c, pieces, piece)
                piece_end = pieces[piece + 1, 0] if piece + 1 < len(pieces) else math.inf
            acts, ticks = t == due, t == next_tick
            if acts:
                y[HELD_TORQUE] = next_to_act(y, c)
                due = math.inf
            if ticks:
                due = start + (number - c.waiting + delay) * period
                number += 1
                next_tick = start + number * period
                old = y[TICK_SPEED] * RPM
                tick(t, y, p, c)
                if due <= t:
                    y[HELD_TORQUE] = next_to_act(y, c)
                    due, acts = math.inf, True
                if logged and not averaged:
                    next_sample[SPEED] = emit_logged(
                        t - period, t, p, SPEED, next_sample[SPEED], start, moments, dt,
                        repeated, out, old, y[TICK_SPEED] * RPM, 0.0,
                    )  # fmt: skip
            if logged and out.shape[0] == 3 and (acts if repeated else ticks):
                old = current
                current = logged_torque(y, repeated, dt, p, c) / p[Slot.torque_constant_nm_per_a]
                next_sample[CURRENT] = emit_logged(
                    changed, t, p, CURRENT, next_sample[CURRENT], start, moments, dt, repeated,
                    out, old, current, towards,
                )  # fmt: skip
                towards = y[HELD_TORQUE] / p[Slot.torque_constant_nm_per_a]
                changed = t
            for i in range(n, y.size):
                y_new[i] = y[i]
            pause = min(piece_end, next_tick, due)
            fresh = ticks and by_period
            if not fresh:
                right_hand_side(t, y, region, p, c, k[0])
                evaluations += 1
            # A step cut short by a pause says nothing about the next step.
            h_next = max(h_next, min(h_usual, longest))
        if crossed != 0:
            region += crossed
            right_hand_side(t, y, region, p, c, k[0])
            evaluations += 1
        h = max(h_next, 1e-9)
    return TOO_MANY_STEPS, t, evaluations


@_jit
def hanging(load_angle, p, c):  # type: ignore[no-untyped-def]
    """Gravity's torque on the shaft at rest, N m, and the deflections of arm and base, rad.

    By fixed-point iteration, since the deflections are much smaller than a radian.
    """
    bent, base = 0.0, 0.0
    torque = gravity_at(load_angle, p, c)
    if not c.structured:
        return torque, bent, base
    share = 0.0
    if p[Slot.arm__compliance_rad_per_nm] != 0.0:
        share = p[Slot.arm__gravity_share]
    for _ in range(NEWTON_STEPS):
        far = share * gravity_at(load_angle + base - bent, p, c)
        torque = (1.0 - share) * gravity_at(load_angle + base, p, c) + far
        bent = p[Slot.arm__compliance_rad_per_nm] * far
        base = -p[Slot.base__compliance_rad_per_nm] * torque
    return torque, bent, base


@_jit
def balanced_torques(load_angle, speed, p, c):  # type: ignore[no-untyped-def]
    """Load torque on the shaft at rest, N m, and the learned torque at the motor."""
    torque, _, _ = hanging(load_angle, p, c)
    load = torque + load_losses(speed * c.per_ratio, p, c)
    if not c.effects or p[Slot.learned_torque__side] == 0.0:
        return load, 0.0
    learned = 0.0
    if p[Slot.learned_torque__variable] != OVER_TIME:
        learned = learned_torque(0.0, load_angle * c.ratio, speed, load_angle, p, c)
    if p[Slot.learned_torque__side] == AT_MOTOR:
        return load, learned
    return load + learned, 0.0


@_jit
def static_twist(load, p, c):  # type: ignore[no-untyped-def]
    """Twist beyond the gap, rad, that balances a load torque at rest, N m, by all laws of the
    flanks.

    K_s e [(e/e₀)^m ± a] + k₃ e³ = |load|, by Newton's method from the linear law.
    """
    twist = load / c.stiffness
    if not c.effects:
        return twist
    torque = abs(load)
    side = math.copysign(1.0, load)
    linear = c.stiffness * (1.0 + side * p[Slot.flank_asymmetry__share])
    cubic = p[Slot.stiffness_hardening__stiffness_nm_per_rad3]
    excess = p[Slot.contact_exponent__excess]
    compression = torque / linear
    for _ in range(NEWTON_STEPS):
        if not compression > 0.0:
            return 0.0
        by_exponent = exponent_torque(compression, p, c)
        slope = linear + 3.0 * cubic * compression * compression
        slope += (1.0 + excess) * by_exponent / compression + excess * c.stiffness
        if slope <= 0.0:
            break
        borne = linear * compression + cubic * compression**3 + by_exponent
        compression -= (borne - torque) / slope
    return side * compression


@_jit
def stand(angle, speed, acceleration, load, losses, side, p, c, y):  # type: ignore[no-untyped-def]
    """Set the states to balance these torques at a load angle; return the drive's torque, N m.

    ``side``: flank on which the teeth touch, 1 or −1, or a position within the gap.
    """
    y[:] = 0.0
    if not c.rigid:
        gap = c.gap * gap_share(c.ratio * angle, 0.0, p, c)
        y[TWIST] = static_twist(load, p, c) + side * gap
    y[MOTOR_ANGLE] = c.ratio * (angle + y[TWIST])
    y[MOTOR_SPEED] = speed
    if c.structured:
        carried = load * c.per_ratio
        carried += p[Slot.belt__reducer_share] * c.motor_inertia * acceleration
        y[BELT_TWIST] = p[Slot.belt__compliance_rad_per_nm] * carried
        _, y[ARM_TWIST], y[BASE_ANGLE] = hanging(angle, p, c)
    torque = load * c.per_ratio + c.motor_inertia * acceleration
    return torque + losses + motor_losses(-math.inf, y[MOTOR_ANGLE], speed, 0.0, load, p, c)


@_jit
def quasi_static_state(p, load_angle, y):  # type: ignore[no-untyped-def]
    """Start of the settling: torques balanced at the reference speed, no acceleration.

    Returns whether the current limit allows it.
    """
    c = constants(p, 0.0, math.inf)
    speed = c.reference
    load, losses = balanced_torques(load_angle, speed, p, c)
    side = math.copysign(1.0, load if load != 0.0 else speed)
    torque = stand(load_angle, speed, 0.0, load, losses, side, p, c, y)
    carried = abs(torque) <= c.torque_limit
    torque, _ = limited(torque, 0.0, c)
    if c.integral_gain > 0.0:
        y[INTEGRAL] = torque / c.integral_gain
    rest_the_loop(y, speed, torque, p, c)
    return carried


@_jit
def lag_and_stop(p, moments):  # type: ignore[no-untyped-def]
    """Longest time, s, by which a channel's value is older than its sample, and the end of a run.

    A value logged at a tick is sent at the next.
    """
    speed = p[FIRST_SKEW + SPEED] + p[Slot.speed_averaging__time_s]
    lag = max(p[FIRST_SKEW + POSITION], speed, p[FIRST_SKEW + CURRENT])
    lead = max(0.0, -p[FIRST_SKEW], -p[FIRST_SKEW + 1], -p[FIRST_SKEW + 2])
    stop = moments[-1] + lead + 1e-9 + (1.0 + AT_TICK) * p[Slot.sampled_control__period_s]
    return lag, stop


@_jit
def simulate(p, settle_s, dt, moments, accuracy_rpm, out, state):  # type: ignore[no-untyped-def]
    """Steady rotation from the load angle ``start_angle_rad`` on, into ``out``.

    The run begins at least ``settle_s`` earlier, in the middle of a tooth flank (where gravity's
    torque is largest and nearly constant). It is recorded from the time when the load passes the
    start angle, at ``moments`` (n,) after that. ``state`` receives the state there. Returns status
    and number of right-hand sides.
    """
    c = constants(p, 0.0, math.inf)
    load_speed = c.reference * c.per_ratio
    direction = math.copysign(1.0, load_speed)
    start_angle = p[Slot.start_angle_rad]
    flank = 0.5 * math.pi - math.atan2(p[Slot.gravity_phase__torque_nm], c.gravity)
    flank -= c.gravity_angle
    ahead = (start_angle - flank) * direction - settle_s * abs(load_speed)
    begin = flank + direction * math.pi * math.floor(ahead / math.pi)
    y = np.empty(states_of(c))
    carried = quasi_static_state(p, begin + math.pi, y)
    if not (quasi_static_state(p, begin, y) and carried):
        return SATURATED, 0
    # A drift in time begins about when the load will be there; in the second run exactly there.
    expected = (start_angle - begin) / load_speed
    in_time = p[Slot.learned_torque__side] != 0.0 and p[Slot.learned_torque__variable] == OVER_TIME
    c = constants(p, y[MOTOR_ANGLE], expected if in_time else math.inf)
    none = np.empty((1, 0))
    longest = 4.0 * expected + 1.0
    first = y.copy()
    steady = np.empty((0, PIECE_COLUMNS))
    status, t, cost = integrate(
        0.0, y, longest, start_angle, 0.0, dt, moments, none, p, c, accuracy_rpm, steady
    )
    if status != DONE:
        return status, cost
    if t >= longest:
        return SATURATED, cost
    ramp_start, run_begin = first[MOTOR_ANGLE], 0.0
    if c.sampled:
        # Ticks follow the recorder's clock, not the load's angle. Run once more, starting at a tick
        # and with one at the first sample.
        period = p[Slot.sampled_control__period_s]
        run_begin = t - math.ceil(t / period) * period
        quasi_static_state(p, begin + load_speed * run_begin, first)
        ramp_start = first[MOTOR_ANGLE] - c.reference * run_begin
        for i in range(y.size):  # to compile the assignment of an array takes seconds
            y[i] = first[i]
        status, _, more = integrate(
            run_begin, y, t, math.inf * direction, t, dt, moments, none, p,
            constants(p, ramp_start, t), accuracy_rpm, steady,
        )  # fmt: skip
        cost += more
        if status != DONE:
            return status, cost
    for i in range(state.size):
        state[i] = y[i] if i < y.size else 0.0
    c = constants(p, ramp_start, t)
    lag, stop = lag_and_stop(p, moments)
    begun = t
    if lag > 0.0:
        # A lagging channel shows values from before the start: run once more with the time known.
        begun, y = run_begin, first
    status, _, more = integrate(
        begun, y, t + stop, math.inf * direction, t, dt, moments, out, p, c, accuracy_rpm, steady
    )
    return status, cost + more


@_jit
def standing_state(t, p, c, start_flank, y):  # type: ignore[no-untyped-def]
    """Start of a motion: the load at its start angle, all torques balanced on the loaded flank.

    Speed and acceleration are those of the reference at that time, zero for a motion from rest. A
    held output begins at rest on its lower flank, from which opposite torque moves it. With
    ``start_flank`` 1 or −1 the teeth touch on that flank, whatever the torque.

    Returns the reference angle at which the controller is balanced.
    """
    if c.held:
        y[:] = 0.0
        y[TWIST] = -c.gap
        y[MOTOR_ANGLE] = c.ratio * (p[Slot.start_angle_rad] + y[TWIST])
        return 0.0
    speed = reference_speed(t, c)
    acceleration = c.speed_1
    angle = p[Slot.start_angle_rad]
    load, losses = balanced_torques(angle, speed, p, c)
    load += c.load_inertia * acceleration * c.per_ratio
    # Without much torque, the load may stand anywhere in the gap: so the start is continuous.
    side = max(-1.0, min(1.0, load / (LOOSE_SHARE * c.gravity + 1e-9)))
    if start_flank != 0.0:
        side = start_flank
    torque = stand(angle, speed, acceleration, load, losses, side, p, c, y)
    torque, _ = limited(torque, 0.0, c)
    shown, _ = sensed(y, p, c)
    reference_angle = shown - reference_position(t, c) + c.reference_angle
    if c.integral_gain > 0.0:
        y[INTEGRAL] = torque / c.integral_gain
    elif c.position_gain > 0.0:
        reference_angle += torque / (c.speed_gain * c.position_gain)
    else:
        y[MOTOR_SPEED] -= torque / c.speed_gain
    rest_the_loop(y, y[MOTOR_SPEED], torque, p, c)
    return reference_angle


@_jit
def simulate_motion(p, pieces, dt, moments, accuracy_rpm, start_flank, out):  # type: ignore[no-untyped-def]
    """Simulate a motion from its initial state into ``out``; return status and right-hand sides."""
    lag, stop = lag_and_stop(p, moments)
    lag = max(0.0, lag)
    pieces = pieces.copy()
    for k in range(len(pieces)):
        pieces[k, 0] += p[Slot.reference_delay_s]
    q = p.copy()
    held = math.isinf(p[Slot.load_inertia_kg_m2])
    # The friction width is that of the joint's full speed, also in a slow motion.
    fastest = max(np.max(np.abs(pieces[:, 1])) * RPM, abs(p[Slot.reference_speed_rpm]))
    q[Slot.reference_speed_rpm] = 0.0 if held else fastest
    begun = on_piece(constants(q, 0.0, 0.0), pieces, 0)
    y = np.empty(states_of(begun))
    c = constants(q, standing_state(-lag, p, begun, start_flank, y), 0.0)
    status, _, cost = integrate(
        -lag, y, stop, math.inf, 0.0, dt, moments, out, p, c, accuracy_rpm, pieces
    )
    return status, cost
