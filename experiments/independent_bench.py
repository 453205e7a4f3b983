"""The two-mass bench once more, to make data that the package's own simulator has no part in.

Studies hide an effect here and diagnose it with ``bayesbl``. Only the equations are
shared (docs/design.md, "The virtual bench"). This file integrates with the classical fourth-order
Runge-Kutta method at a fixed small step, does not look for the edges of the gap, smooths dry
friction differently (ω/√(ω² + w²) at the motor, erf at the load), integrates the two angles instead
of the twist, and reaches steady rotation by running through whole rotations from a rough start.

It can also simulate what the catalogue lacks: a torque periodic in time, a belt defect, errors of
the encoder's disc of two orders, lost speed samples, an
encoder whose counts a digital controller works with, a second gap behind a third mass, and laws
that differ from the catalogue's: load friction with another smoothing or over the load's angle,
LuGre, a Stribeck exponent of 1, a ripple with harmonics, contact damping by Hunt and Crossley,
hysteresis by Bouc and Wen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
from scipy import signal, special

from bayesbl.bench.bench import Bench
from bayesbl.bench.effects import EFFECTS
from bayesbl.bench.parameters import BENCH_PARAMETERS
from bayesbl.recording.types import (
    MOTOR_CURRENT,
    MOTOR_POSITION,
    MOTOR_SPEED,
    REFERENCE_POSITION,
    REFERENCE_SPEED,
    Recording,
)

RPM = 60.0 / (2.0 * math.pi)
LONGEST_STEP_S = 2.5e-5
"""Keeps the speed to 0.005 rpm at δ of 3 mrad, to 0.001 rpm below 1 mrad."""
CHECKPOINT_S = 0.03
"""The run goes back this far or more from where the recording begins, for channels that lag."""
SETTLING_ROTATIONS = 1.5
STATES = 22
SUM, HELD, COMING, LAST_ANGLE, LAST_SPEED = 4, 12, 13, 14, 15
"""The memory of a digital controller, among the states; the sum stands where the integral would."""
REDUCER, ARM, BASE = 16, 18, 20
"""Absolute angles behind a belt, of an elastic arm, of the base; their speeds follow."""

MOTOR_WIDTH = 0.05  # rad/s
LOAD_WIDTH = 2e-3  # rad/s
LUGRE_ANGLE = 0.05
"""Way of the motor over which the bristles bend, rad: slow enough for the step."""
LUGRE_DAMPING_S = 1e-4
CHANNELS = (MOTOR_POSITION, MOTOR_SPEED, MOTOR_CURRENT)
SPEEDS_RPM = (2000.0, -2000.0, 1200.0)


class Plant(NamedTuple):
    """All that decides the noise-free signals, SI but for the reference speed in rpm.

    Effects of the catalogue as ``effect__parameter``; ``outside__…`` is in no catalogue. A belt's
    defect acts as a smooth pulse of torque without a mean, once per ``turns`` of the motor, of the
    given angular width at the motor; a second gap stands behind a third mass, a share of the load,
    between two shafts that together are as stiff as the one (with a mass of 0.02 of the load it is
    nothing but a larger gap: the bench with one gap then fits to the noise).
    """

    gear_ratio: float
    motor_inertia_kg_m2: float
    load_inertia_kg_m2: float
    shaft_stiffness_nm_per_rad: float
    shaft_damping_nm_s_per_rad: float
    gravity_torque_nm: float
    speed_gain_nm_s_per_rad: float
    integral_gain_nm_per_rad: float
    torque_constant_nm_per_a: float
    current_limit_a: float
    reference_speed_rpm: float
    gap_rad: float
    start_angle_rad: float
    stiffness_sharpness_per_rad: float = 1e6
    position_gain_per_s: float = 0.0
    gravity_angle_rad: float = 0.0
    hard_dead_zone: float = 0.0
    motor_start_angle_rad: float = 0.0
    backlash__gap_rad: float = 0.0
    motor_coulomb_friction__torque_nm: float = 0.0
    motor_viscous_friction__coefficient_nm_s_per_rad: float = 0.0
    motor_stribeck_friction__torque_nm: float = 0.0
    motor_stribeck_friction__speed_rad_per_s: float = 50.0
    friction_asymmetry__coefficient_nm_s_per_rad: float = 0.0
    motor_torque_offset__torque_nm: float = 0.0
    load_coulomb_friction__torque_nm: float = 0.0
    load_viscous_friction__coefficient_nm_s_per_rad: float = 0.0
    load_torque_offset__torque_nm: float = 0.0
    gravity_phase__torque_nm: float = 0.0
    gear_mesh_friction__coefficient: float = 0.0
    motor_torque_ripple__torque_nm: float = 0.0
    motor_torque_ripple__order: float = 1.0
    motor_torque_ripple__phase_rad: float = 0.0
    gear_transmission_error__angle_rad: float = 0.0
    gear_transmission_error__order: float = 1.0
    gear_transmission_error__phase_rad: float = 0.0
    encoder_eccentricity__angle_rad: float = 0.0
    encoder_eccentricity__phase_rad: float = 0.0
    stiffness_hardening__stiffness_nm_per_rad3: float = 0.0
    contact_exponent__excess: float = 0.0
    contact_softness__variance_rad2: float = 0.0
    flank_asymmetry__share: float = 0.0
    contact_damping__factor_s_per_rad: float = 0.0
    contact_release__share: float = 0.0
    gap_damping__coefficient_nm_s_per_rad: float = 0.0
    shaft_hysteresis__torque_nm: float = 0.0
    shaft_hysteresis__angle_rad: float = 1e-3
    current_loop_lag__time_s: float = 0.0
    speed_sensor_lag__time_s: float = 0.0
    friction_drift__torque_nm: float = 0.0
    friction_drift__rate_nm_per_s: float = 0.0
    sampled_control__period_s: float = 0.0
    sampled_control__delay_periods: float = 1.0
    channel_time_skew__position_s: float = 0.0
    channel_time_skew__speed_s: float = 0.0
    channel_time_skew__current_s: float = 0.0
    speed_averaging__time_s: float = 0.0
    belt__compliance_rad_per_nm: float = 0.0
    belt__damping_ratio: float = 0.05
    belt__reducer_share: float = 0.3
    arm__compliance_rad_per_nm: float = 0.0
    arm__damping_ratio: float = 0.05
    arm__inertia_share: float = 0.4
    arm__gravity_share: float = 0.5
    base__compliance_rad_per_nm: float = 0.0
    base__damping_ratio: float = 0.05
    base__inertia_kg_m2: float = 60.0
    gap_variation__cosine_1: float = 0.0
    gap_variation__sine_1: float = 0.0
    gap_variation__cosine_2: float = 0.0
    gap_variation__sine_2: float = 0.0
    outside__shaking_nm: float = 0.0  # at the load, in time
    outside__shaking_hz: float = 9.7
    outside__shaking_phase_rad: float = 0.0
    outside__time_torque_nm: float = 0.0
    outside__time_frequency_hz: float = 7.3
    outside__time_phase_rad: float = 0.0
    outside__belt_torque_nm: float = 0.0
    outside__belt_turns: float = 1.37
    outside__belt_width_rad: float = 0.8
    outside__belt_mean: float = 0.0  # filled in: mean of the belt's pulse
    outside__second_gap_rad: float = 0.0
    outside__second_mass_share: float = 0.3
    outside__load_coulomb_nm: float = 0.0  # smoothed as ω/(|ω| + w)
    outside__lugre_nm: float = 0.0
    outside__stribeck_1_nm: float = 0.0  # fades as exp(−|ω|/ω_s)
    outside__stribeck_1_rad_per_s: float = 80.0
    outside__ripple_nm: float = 0.0  # with a second and a third harmonic
    outside__ripple_order: float = 4.0
    outside__position_friction_nm: float = 0.0  # of the load, over its angle
    outside__position_friction_phase_rad: float = 0.0
    outside__contact_damping_nm_s_per_rad: float = 0.0  # times √compression, of 1 rad
    outside__edge_rad: float = 0.0  # to each side of the gap's edge, stiffness rises as a ramp
    outside__bouc_wen_nm: float = 0.0
    outside__bouc_wen_rad: float = 5e-4
    outside__encoder_1_rad: float = 0.0  # errors of the disc: orders 1 and 2 of the motor
    outside__encoder_2_rad: float = 0.0
    outside__encoder_2_phase_rad: float = 0.0
    outside__dropouts_per_s: float = 0.0
    outside__dropout_length_s: float = 0.004
    outside__dropout_share: float = 0.5
    outside__loop_counts: float = 0.0  # in a turn, of the encoder that a digital controller has
    outside__speed_of_instant: float = 0.0  # 1: a digital controller has it, and no difference
    outside__loop_filter: float = 1.0  # share of a new speed that its filter passes at each tick


TYPICAL: Mapping[str, Mapping[str, float]] = {
    effect.name: {item.name: item.typical for item in effect.parameters}
    for effect in EFFECTS
    if all(slot.name in Plant._fields for slot in effect.slots.values())
}
"""A middling strength of every effect of the catalogue that this simulator has too."""


_jit = numba.njit(cache=True, nogil=True, error_model="numpy")


@_jit
def _shaft(twist, slip, gap, stiffness, damping, p):
    """Torque of one shaft with its gap, load side."""
    if p.hard_dead_zone != 0.0:
        if abs(twist) < gap:
            return 0.0
        return stiffness * (twist - math.copysign(gap, twist)) + damping * slip
    alpha = p.stiffness_sharpness_per_rad
    share = 1.0 + (math.atan(alpha * (twist - gap)) - math.atan(alpha * (twist + gap))) / math.pi
    return (stiffness * (twist - math.copysign(gap, twist)) + damping * slip) * share


@_jit
def _soft(twist, slip, gap, stiffness, damping, p):
    """Torque of a shaft whose gap has edges of logistic distribution, load side."""
    scale = math.sqrt(3.0 * p.contact_softness__variance_rad2) / math.pi
    torque = 0.0
    for side in (1.0, -1.0):
        z = (side * twist - gap) / scale
        torque += side * stiffness * scale * (max(z, 0.0) + math.log1p(math.exp(-abs(z))))
        torque += damping * slip * 0.5 * (1.0 + math.tanh(0.5 * z))
    return torque


@_jit
def _ramped(twist, slip, gap, stiffness, damping, edge):
    """Torque of a shaft whose stiffness rises as a ramp across the edge of its gap, load side."""
    beyond = abs(twist) - gap
    if beyond <= -edge:
        return 0.0
    share = min(1.0, 0.5 * (beyond + edge) / edge)
    compression = beyond if beyond > edge else share * 0.5 * (beyond + edge)
    return math.copysign(stiffness * compression, twist) + damping * share * slip


@_jit
def _hertzian(compression, stiffness, p):
    """Torque of a contact of exponent 1 + m, with the stiffness at gravity's largest torque."""
    at = abs(p.gravity_torque_nm) / stiffness
    size = math.pow(abs(compression) / at, 1.0 + p.contact_exponent__excess)
    return math.copysign(stiffness * at * size, compression)


@_jit
def _measured(y, p, phase):
    """Angle and speed that the encoder shows, speed that the controller is given."""
    angle, speed = y[0] - y[BASE], y[1] - y[BASE + 1]
    if p.encoder_eccentricity__angle_rad != 0.0:
        turn = angle + phase + p.encoder_eccentricity__phase_rad
        angle += p.encoder_eccentricity__angle_rad * math.sin(turn)
        speed *= 1.0 + p.encoder_eccentricity__angle_rad * math.cos(turn)
    shaft = y[0] - y[BASE] + phase
    second = 2.0 * shaft + p.outside__encoder_2_phase_rad
    angle += p.outside__encoder_1_rad * math.sin(shaft)
    angle += p.outside__encoder_2_rad * math.sin(second)
    slope = p.outside__encoder_1_rad * math.cos(shaft)
    slope += 2.0 * p.outside__encoder_2_rad * math.cos(second)
    speed += y[1] * slope
    return angle, speed, y[6] if p.speed_sensor_lag__time_s > 0.0 else speed


@_jit
def _demand(y, p, phase, asked):
    """Speed error and torque that the controller asks for, unlimited; asked: ω_ref, θ_ref."""
    if p.sampled_control__period_s > 0.0:
        return 0.0, y[HELD]
    angle, _, speed = _measured(y, p, phase)
    error = asked[0] - speed
    if p.position_gain_per_s != 0.0:
        error += p.position_gain_per_s * (asked[1] - angle)
    return error, p.speed_gain_nm_s_per_rad * error + p.integral_gain_nm_per_rad * y[4]


@_jit
def _work(step, each, y, p, phase, asked):
    """What a digital controller does at the begin of a step; a tick is every ``each`` steps.

    It logs the torque that acts at the tick, of a delay up to a period one period old. The package
    takes what is logged to be as old as the delay.
    """
    if each == 0:
        return
    since = step % each
    late = round(p.sampled_control__delay_periods * each)
    if since == late % each and late > 0:
        y[HELD] = y[COMING]
    if since != 0:
        return
    period = p.sampled_control__period_s
    angle, _, speed = _measured(y, p, phase)
    if p.outside__loop_counts > 0.0:
        count = 2.0 * math.pi / p.outside__loop_counts
        angle = count * math.floor(angle / count)
    if p.outside__speed_of_instant == 0.0:
        speed = (angle - y[LAST_ANGLE]) / period
    y[LAST_SPEED] += p.outside__loop_filter * (speed - y[LAST_SPEED])
    y[LAST_ANGLE] = angle
    error = asked[0] - y[LAST_SPEED] + p.position_gain_per_s * (asked[1] - angle)
    limit = p.torque_constant_nm_per_a * p.current_limit_a
    proportional = p.speed_gain_nm_s_per_rad * error
    demand = proportional + p.integral_gain_nm_per_rad * (y[SUM] + period * error)
    y[COMING] = min(max(demand, -limit), limit)
    if y[COMING] == demand or error * demand < 0.0:
        y[SUM] += period * error
    if late == 0:
        y[HELD] = y[COMING]


@_jit
def _decay(ratio, compliance, inertia):
    """Damping over stiffness of a spring, 2 ζ/ω, s."""
    return 2.0 * ratio * math.sqrt(compliance * inertia)


@_jit
def _weight(angle, p):
    """Gravity's torque against a load at an absolute angle."""
    torque = p.gravity_torque_nm * math.sin(angle + p.gravity_angle_rad)
    return torque + p.gravity_phase__torque_nm * math.cos(angle)


@_jit
def _slopes(t, y, p, phase, asked, drift_start, dy):
    """θ_m, ω_m, θ_l, ω_l, ∫error, lagged torque, lagged speed, Dahl z, θ_k, ω_k, two more z."""
    n = p.gear_ratio
    dy[HELD:] = 0.0
    error, demand = _demand(y, p, phase, asked)
    limit = p.torque_constant_nm_per_a * p.current_limit_a
    torque = min(max(demand, -limit), limit)
    dy[4] = error if torque == demand or error * demand < 0.0 else 0.0
    dy[5] = 0.0
    if p.current_loop_lag__time_s > 0.0:
        dy[5] = (torque - y[5]) / p.current_loop_lag__time_s
        torque = y[5]
    dy[6] = 0.0
    if p.speed_sensor_lag__time_s > 0.0:
        _, fresh, _ = _measured(y, p, phase)
        dy[6] = (fresh - y[6]) / p.speed_sensor_lag__time_s

    three = p.outside__second_gap_rad > 0.0
    belt = p.belt__compliance_rad_per_nm > 0.0
    base, base_speed = y[BASE], y[BASE + 1]
    far_angle, far_speed = (y[8], y[9]) if three else (y[2], y[3])
    near_angle, near_speed = (y[REDUCER], y[REDUCER + 1]) if belt else (y[0], y[1])
    twist = (near_angle - base) / n - (far_angle - base)
    slip = (near_speed - base_speed) / n - (far_speed - base_speed)
    dy[7] = 0.0
    if p.shaft_hysteresis__torque_nm != 0.0:
        dy[7] = (slip - abs(slip) * y[7]) / p.shaft_hysteresis__angle_rad
    if p.gear_transmission_error__angle_rad != 0.0:
        order = p.gear_transmission_error__order
        turn = order * (y[0] + phase) + p.gear_transmission_error__phase_rad
        twist += p.gear_transmission_error__angle_rad * math.sin(turn)
        slip += p.gear_transmission_error__angle_rad * order * y[1] * math.cos(turn)
    gap = p.gap_rad + p.backlash__gap_rad
    turn = y[2] - base
    variation = p.gap_variation__cosine_1 * math.cos(turn)
    variation += p.gap_variation__sine_1 * math.sin(turn)
    variation += p.gap_variation__cosine_2 * math.cos(2.0 * turn)
    variation += p.gap_variation__sine_2 * math.sin(2.0 * turn)
    gap *= 1.0 + variation
    times = 2.0 if three else 1.0
    stiffness = times * p.shaft_stiffness_nm_per_rad
    damping = times * p.shaft_damping_nm_s_per_rad
    if p.contact_softness__variance_rad2 > 0.0:
        shaft = _soft(twist, slip, gap, stiffness, damping, p)
    elif p.outside__edge_rad > 0.0:
        shaft = _ramped(twist, slip, gap, stiffness, damping, p.outside__edge_rad)
    else:
        shaft = _shaft(twist, slip, gap, stiffness, damping, p)
    if abs(twist) > gap:
        compression = twist - math.copysign(gap, twist)
        shaft += p.stiffness_hardening__stiffness_nm_per_rad3 * compression**3
        shaft += p.flank_asymmetry__share * stiffness * abs(compression)
        if p.contact_exponent__excess != 0.0:
            shaft += _hertzian(compression, stiffness, p) - stiffness * compression
        shaft += p.contact_damping__factor_s_per_rad * stiffness * abs(compression) * slip
        shaft += p.outside__contact_damping_nm_s_per_rad * math.sqrt(abs(compression)) * slip
        if shaft * twist < 0.0:
            shaft *= 1.0 - p.contact_release__share
    else:
        shaft += p.gap_damping__coefficient_nm_s_per_rad * slip
    shaft += p.shaft_hysteresis__torque_nm * y[7]
    dy[10] = 0.0
    if p.outside__bouc_wen_nm != 0.0:
        held = 0.5 * (abs(slip) * y[10] * abs(y[10]) + slip * y[10] * y[10])
        dy[10] = (slip - held) / p.outside__bouc_wen_rad
        shaft += p.outside__bouc_wen_nm * y[10]

    speed = y[1] - base_speed
    dry = p.motor_coulomb_friction__torque_nm + p.friction_drift__torque_nm
    if t > drift_start:
        dry += p.friction_drift__rate_nm_per_s * (t - drift_start)
    dry += p.gear_mesh_friction__coefficient * abs(shaft) / n
    if p.motor_stribeck_friction__torque_nm != 0.0:
        share = speed / p.motor_stribeck_friction__speed_rad_per_s
        dry += p.motor_stribeck_friction__torque_nm * math.exp(-share * share)
    lost = dry * speed / math.sqrt(speed * speed + MOTOR_WIDTH * MOTOR_WIDTH)
    lost += p.motor_viscous_friction__coefficient_nm_s_per_rad * speed
    lost += p.friction_asymmetry__coefficient_nm_s_per_rad * abs(speed)
    lost += p.motor_torque_offset__torque_nm
    if p.motor_torque_ripple__torque_nm != 0.0:
        turn = p.motor_torque_ripple__order * (y[0] + phase) + p.motor_torque_ripple__phase_rad
        lost += p.motor_torque_ripple__torque_nm * math.sin(turn)
    dy[11] = 0.0
    if p.outside__lugre_nm != 0.0:
        dy[11] = (speed - abs(speed) * y[11]) / LUGRE_ANGLE
        lost += p.outside__lugre_nm * (y[11] + LUGRE_DAMPING_S * dy[11])
    if p.outside__stribeck_1_nm != 0.0:
        fading = math.exp(-abs(speed) / p.outside__stribeck_1_rad_per_s)
        lost += p.outside__stribeck_1_nm * fading * speed / math.sqrt(speed**2 + MOTOR_WIDTH**2)
    if p.outside__ripple_nm != 0.0:
        turn = p.outside__ripple_order * (y[0] + phase)
        wave = math.sin(turn) + 0.5 * math.sin(2.0 * turn + 1.0) + 0.25 * math.sin(3.0 * turn + 2.0)
        lost += p.outside__ripple_nm * wave
    if p.outside__time_torque_nm != 0.0:
        turn = 2.0 * math.pi * p.outside__time_frequency_hz * t + p.outside__time_phase_rad
        lost += p.outside__time_torque_nm * math.sin(turn)
    if p.outside__belt_torque_nm != 0.0:
        turn = (y[0] + phase) / p.outside__belt_turns
        sharpness = (p.outside__belt_turns / p.outside__belt_width_rad) ** 2
        pulse = math.exp(sharpness * (math.cos(turn) - 1.0)) - p.outside__belt_mean
        lost += p.outside__belt_torque_nm * pulse

    slow = y[3] - base_speed
    load = p.load_torque_offset__torque_nm
    load += p.load_viscous_friction__coefficient_nm_s_per_rad * slow
    if p.load_coulomb_friction__torque_nm != 0.0:
        load += p.load_coulomb_friction__torque_nm * math.erf(slow / LOAD_WIDTH)
    if p.outside__shaking_nm != 0.0:
        turn = 2.0 * math.pi * p.outside__shaking_hz * t + p.outside__shaking_phase_rad
        load += p.outside__shaking_nm * math.sin(turn)
    load += p.outside__load_coulomb_nm * y[3] / (abs(y[3]) + LOAD_WIDTH)
    if p.outside__position_friction_nm != 0.0:
        turn = y[2] + p.outside__position_friction_phase_rad
        wave = 1.0 + 0.5 * math.cos(turn) + 0.25 * math.sin(2.0 * turn)
        load += p.outside__position_friction_nm * wave * math.erf(y[3] / LOAD_WIDTH)

    internal = load
    inertia = p.load_inertia_kg_m2
    if p.arm__compliance_rad_per_nm > 0.0:
        behind = p.arm__inertia_share * p.load_inertia_kg_m2
        swinging = behind * (1.0 - p.arm__inertia_share)
        decay = _decay(p.arm__damping_ratio, p.arm__compliance_rad_per_nm, swinging)
        bent = y[2] - y[ARM] + decay * (y[3] - y[ARM + 1])
        bent /= p.arm__compliance_rad_per_nm
        inertia -= behind
        dy[ARM] = y[ARM + 1]
        dy[ARM + 1] = (bent - p.arm__gravity_share * _weight(y[ARM], p)) / behind
        load += bent + (1.0 - p.arm__gravity_share) * _weight(y[2], p)
    else:
        load += _weight(y[2], p)
    dy[0] = y[1]
    if belt:
        behind = p.belt__reducer_share * p.motor_inertia_kg_m2
        swinging = behind * (1.0 - p.belt__reducer_share)
        decay = _decay(p.belt__damping_ratio, p.belt__compliance_rad_per_nm, swinging)
        pull = y[0] - y[REDUCER] + decay * (y[1] - y[REDUCER + 1])
        pull /= p.belt__compliance_rad_per_nm
        dy[1] = (torque - lost - pull) / (p.motor_inertia_kg_m2 - behind)
        dy[REDUCER] = y[REDUCER + 1]
        dy[REDUCER + 1] = (pull - shaft / n) / behind
    else:
        dy[1] = (torque - shaft / n - lost) / p.motor_inertia_kg_m2
    if p.base__compliance_rad_per_nm > 0.0:
        decay = _decay(p.base__damping_ratio, p.base__compliance_rad_per_nm, p.base__inertia_kg_m2)
        held = (base + decay * base_speed) / p.base__compliance_rad_per_nm
        dy[BASE] = base_speed
        pushed = internal - held - (torque - lost) + shaft / n - shaft
        dy[BASE + 1] = pushed / p.base__inertia_kg_m2
    dy[2] = y[3]
    dy[8] = 0.0
    dy[9] = 0.0
    if not three:
        dy[3] = (shaft - load) / inertia
        return
    gap = p.outside__second_gap_rad
    second = _shaft(y[8] - y[2], y[9] - y[3], gap, stiffness, damping, p)
    middle = p.outside__second_mass_share * p.load_inertia_kg_m2
    dy[3] = (second - load) / (inertia - middle)
    dy[8] = y[9]
    dy[9] = (shaft - second) / middle


@_jit
def _step(t, y, h, p, phase, asked, drift_start, k, trial):
    """One step of Runge and Kutta, in place; asked, (3, 2): at its begin, middle and end."""
    _slopes(t, y, p, phase, asked[0], drift_start, k[0])
    for i in range(STATES):
        trial[i] = y[i] + 0.5 * h * k[0, i]
    _slopes(t + 0.5 * h, trial, p, phase, asked[1], drift_start, k[1])
    for i in range(STATES):
        trial[i] = y[i] + 0.5 * h * k[1, i]
    _slopes(t + 0.5 * h, trial, p, phase, asked[1], drift_start, k[2])
    for i in range(STATES):
        trial[i] = y[i] + h * k[2, i]
    _slopes(t + h, trial, p, phase, asked[2], drift_start, k[3])
    for i in range(STATES):
        y[i] += h / 6.0 * (k[0, i] + 2.0 * (k[1, i] + k[2, i]) + k[3, i])


@_jit
def _outputs(y, p, phase, asked, shown):
    """Position in rad, speed in rpm, current in A."""
    _, demand = _demand(y, p, phase, asked)
    limit = p.torque_constant_nm_per_a * p.current_limit_a
    torque = min(max(demand, -limit), limit)
    if p.current_loop_lag__time_s > 0.0:
        torque = y[5]
    shown[0], _, speed = _measured(y, p, phase)
    shown[1] = speed * RPM
    shown[2] = torque / p.torque_constant_nm_per_a
    if p.sampled_control__period_s > 0.0:
        shown[1] = y[LAST_SPEED] * RPM


@_jit
def _steadily(t, h, p, ramp_start, asked):
    """What constant speed asks for at the begin, middle and end of a step."""
    for i in range(3):
        asked[i, 0] = p.reference_speed_rpm / RPM
        asked[i, 1] = ramp_start + asked[i, 0] * (t + 0.5 * h * i)


@_jit
def _run(p, settling_rotations, step, each, sampling_s, late, out):
    """Fill ``out``, shape (3, n); returns when the load came to the start angle, −1 if never.

    ``each`` steps are a period of a digital controller. With ``late`` the run begins so much before
    and records from its next tick on; nan: it records from the start angle on.
    """
    n = p.gear_ratio
    reference = p.reference_speed_rpm / RPM
    direction = math.copysign(1.0, reference)
    phase = p.motor_start_angle_rad - n * p.start_angle_rad
    y = np.zeros(STATES)
    y[2] = p.start_angle_rad - direction * 2.0 * math.pi * settling_rotations
    if each > 0 and late > 0.0:
        y[2] -= reference / n * late
    y[8] = y[ARM] = y[2]
    y[0] = y[REDUCER] = n * y[2]
    y[1], y[3], y[9], y[6] = reference, reference / n, reference / n, reference
    y[REDUCER + 1], y[ARM + 1] = reference, reference / n
    y[LAST_SPEED], y[LAST_ANGLE] = reference, y[0] - reference * step * each
    ramp_start = y[0]
    k, trial, asked = np.empty((4, STATES)), np.empty(STATES), np.empty((3, 2))
    older, old, old_t, older_t = y.copy(), y.copy(), 0.0, 0.0
    apart = int(CHECKPOINT_S / step)
    begin = -1.0
    most = int((settling_rotations + 3.0) * 2.0 * math.pi * n / abs(reference) / step)
    for i in range(most):
        t = i * step
        if i % apart == 0:
            older[:] = old
            older_t = old_t
            old[:] = y
            old_t = t
        before = (y[2] - y[BASE] - p.start_angle_rad) * direction
        _steadily(t, step, p, ramp_start, asked)
        _work(i, each, y, p, phase, asked[0])
        _step(t, y, step, p, phase, asked, math.inf, k, trial)
        after = (y[2] - y[BASE] - p.start_angle_rad) * direction
        if before < 0.0 <= after:
            begin = t - step * before / (after - before)
            break
    if begin < 0.0 or out.shape[1] == 0:
        return begin
    if each > 0:
        # A nanosecond behind the tick, so that what it did is seen.
        begin = step * each * round(begin / (step * each)) + 1e-9

    # Once more from the checkpoint, now that the time of the first sample is known.
    skew = (
        p.channel_time_skew__position_s,
        p.channel_time_skew__speed_s,
        p.channel_time_skew__current_s,
    )
    y[:] = older
    done = round(older_t / step)
    samples = out.shape[1]
    following = np.zeros(3, np.int64)
    left, right = np.empty(3), np.empty(3)
    i = 0
    while min(following) < samples:
        t = older_t + i * step
        due = False
        for c in range(3):
            if following[c] < samples:
                due = due or begin + following[c] * sampling_s - skew[c] <= t + step
        _steadily(t, step, p, ramp_start, asked)
        _work(done + i, each, y, p, phase, asked[0])
        if due:
            _outputs(y, p, phase, asked[0], left)
        _step(t, y, step, p, phase, asked, begin, k, trial)
        i += 1
        if not due:
            continue
        _outputs(y, p, phase, asked[2], right)
        for c in range(3):
            while following[c] < samples:
                share = (begin + following[c] * sampling_s - skew[c] - t) / step
                if share > 1.0:
                    break
                out[c, following[c]] = left[c] + share * (right[c] - left[c])
                following[c] += 1
    return begin


@_jit
def _follow(p, side, speed, angle, held, step, each, ticking, out):
    """Fill ``out``, shape (3, n), while the reference follows half-step values from rest.

    ``held`` steps of rest on the flank ``side`` come before the first sample, to settle; a sample
    is every ``each`` steps, a tick of a digital controller every ``ticking``.
    """
    n = p.gear_ratio
    phase = p.motor_start_angle_rad - n * p.start_angle_rad
    load = p.gravity_torque_nm * math.sin(p.start_angle_rad + p.gravity_angle_rad)
    load += p.gravity_phase__torque_nm * math.cos(p.start_angle_rad)
    load += p.load_torque_offset__torque_nm
    gap = p.gap_rad + p.backlash__gap_rad
    y = np.zeros(STATES)
    y[2] = p.start_angle_rad
    y[8] = y[ARM] = y[2]
    y[0] = n * (y[2] + load / p.shaft_stiffness_nm_per_rad + side * gap)
    y[REDUCER] = y[0]
    if p.integral_gain_nm_per_rad > 0.0:
        y[4] = load / n / p.integral_gain_nm_per_rad
    y[5] = load / n
    y[HELD], y[COMING] = load / n, load / n
    start, _, _ = _measured(y, p, phase)
    y[LAST_ANGLE] = start
    k, trial, asked = np.empty((4, STATES)), np.empty(STATES), np.zeros((3, 2))
    asked[:, 1] = start
    for i in range(held):
        _work(i - held, ticking, y, p, phase, asked[0])
        _step(0.0, y, step, p, phase, asked, math.inf, k, trial)
    shown = np.empty(3)
    for i in range(out.shape[1] * each):
        for j in range(3):
            asked[j, 0] = speed[2 * i + j]
            asked[j, 1] = start + angle[2 * i + j]
        _work(i, ticking, y, p, phase, asked[0])
        if i % each == 0:
            _outputs(y, p, phase, asked[0], shown)
            out[:, i // each] = shown
        _step(i * step, y, step, p, phase, asked, 0.0, k, trial)


SETTLED_AT_REST_S = 0.5
AVERAGED_OVER_S = 5e-5
"""Between the speeds that an average is made of: of a ringing of 100 Hz it is good to 1e-4."""

Reference = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""ω_ref in rad/s and θ_ref − θ_ref(0) in rad of the motor, at some times in s."""


def strokes(
    gear_ratio: float,
    range_rad: tuple[float, float],
    speed_rpm: float,
    acceleration_rpm_per_s: float,
    dwell_s: float,
) -> Reference:
    """To and fro between two load angles, a dwell before each stroke."""
    way = gear_ratio * (range_rad[1] - range_rad[0])
    a = acceleration_rpm_per_s / RPM
    top = min(speed_rpm / RPM, math.sqrt(way * a))
    ramp, travel = top / a, way / top + top / a

    def at(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        number, s = np.divmod(time, travel + dwell_s)
        s = np.clip(s - dwell_s, 0.0, travel)
        back = np.minimum(s, travel - s)
        speed = np.minimum(a * back, top)
        early = np.where(back < ramp, 0.5 * a * back**2, top * (back - 0.5 * ramp))
        angle = np.where(s <= 0.5 * travel, early, way - early)
        odd = number % 2 == 1
        return np.where(odd, -speed, speed), np.where(odd, way - angle, angle)

    return at


def _between(averaging_s: float, sampling_hz: float) -> int:
    """Samples to make for each one that is kept, so that an average is over many, whole ones."""
    each = math.ceil(1.0 / (sampling_hz * AVERAGED_OVER_S))
    while abs(averaging_s * sampling_hz * each % 1.0 - 0.5) < 0.5 - 1e-6:
        each += 1
    return each


def _averaged(fine: np.ndarray, each: int, size: int) -> np.ndarray:
    """Trapezoidal means over ``size`` periods from every ``each``-th sample on."""
    sums = np.cumsum(0.5 * (fine[1:] + fine[:-1]))
    sums = np.concatenate(([0.0], sums))
    return np.asarray((sums[size:] - sums[:-size])[::each] / size)


def moving(
    made: Plant,
    reference: Reference,
    duration_s: float,
    sampling_hz: float = 1000.0,
    step_s: float = LONGEST_STEP_S,
    side: float | None = None,
) -> np.ndarray:
    """Position, speed, current of a motion from rest, shape (3, n), without noise.

    ``side``: flank that the load begins on; the one that gravity presses on if ``None``.
    """
    if made.speed_averaging__time_s > 0.0:
        fast = _between(made.speed_averaging__time_s, sampling_hz)
        size = round(made.speed_averaging__time_s * sampling_hz * fast)
        plain = made._replace(speed_averaging__time_s=0.0)
        out = moving(plain, reference, duration_s, fast * sampling_hz, step_s, side)
        fine = np.concatenate((np.full(size, out[1, 0]), out[1]))
        out = out[:, ::fast]
        out[1] = _averaged(fine, fast, size)
        return out
    each = math.ceil(1.0 / (sampling_hz * step_s))
    step = 1.0 / sampling_hz / each
    samples = round(duration_s * sampling_hz) + 1
    half = 0.5 * step * np.arange(2 * samples * each + 1)
    speed, angle = reference(half)
    if side is None:
        pull = made.gravity_torque_nm * math.sin(made.start_angle_rad + made.gravity_angle_rad)
        side = math.copysign(1.0, pull)
    out = np.full((3, samples), np.nan)
    rest = round(SETTLED_AT_REST_S / step)
    ticking = round(made.sampled_control__period_s / step)
    if abs(ticking * step - made.sampled_control__period_s) > 1e-9:
        raise ValueError("a period of the controller is not a whole number of steps")
    _follow(made, side, speed, angle, rest, step, each, ticking, out)
    if not np.all(np.isfinite(out)):
        raise ValueError("the simulation diverged")
    return out


def values_of(bench: Bench) -> dict[str, float]:
    """Parameters of a bench by name, as :func:`plant` takes them."""
    return {info.name: bench.value(info.name) for info in BENCH_PARAMETERS}


def plant(values: Mapping[str, float], **settings: float) -> Plant:
    """From bench parameters by name, effects as ``effect.parameter`` or ``effect__parameter``.

    Raises
    ------
    TypeError
        If a name is unknown, or one is missing.
    """
    named = {name.replace(".", "__"): float(v) for name, v in {**values, **settings}.items()}
    made = Plant(**named)
    if made.sampled_control__period_s > 0.0:
        if made.speed_sensor_lag__time_s > 0.0:
            raise ValueError("a digital controller differentiates the encoder: no speed filter")
        if made.speed_averaging__time_s > 0.0:
            raise ValueError("a digital controller shows the speed of its ticks: no average")
        if made.sampled_control__delay_periods > 1.0:
            raise ValueError("this digital controller has one torque on its way: no dead time")
    sharpness = (made.outside__belt_turns / made.outside__belt_width_rad) ** 2
    return made._replace(outside__belt_mean=float(special.i0e(sharpness)))


def rotation_s(made: Plant) -> float:
    """Time of one rotation of the load."""
    return 2.0 * math.pi * made.gear_ratio * RPM / abs(made.reference_speed_rpm)


def noise_free(
    made: Plant, rotations: float = 5.0, sampling_hz: float = 1000.0, step_s: float = LONGEST_STEP_S
) -> np.ndarray:
    """Position (rad, continuing, zero where the load's zero is), speed (rpm), current (A).

    Shape (3, n), n as many samples as fall into the rotations, both ends included.

    Raises
    ------
    ValueError
        If the motor cannot turn the load round, a channel lags by more than the run goes back, or
        the signals do not stay finite.
    """
    skews = (
        made.channel_time_skew__position_s,
        made.channel_time_skew__speed_s,
        made.channel_time_skew__current_s,
    )
    averaging = made.speed_averaging__time_s
    if max(*skews, skews[1] + averaging) > CHECKPOINT_S:
        raise ValueError(f"a channel lags by more than {CHECKPOINT_S} s")
    if averaging > 0.0:
        fast = _between(averaging, sampling_hz)
        size = round(averaging * sampling_hz * fast)
        plain = made._replace(
            speed_averaging__time_s=0.0, channel_time_skew__speed_s=skews[1] + averaging
        )
        more = (size + fast) / (fast * sampling_hz * rotation_s(made))
        out = noise_free(plain, rotations + more, fast * sampling_hz, step_s)
        kept = math.floor(round(rotations * rotation_s(made) * sampling_hz, 6)) + 1
        speed = _averaged(out[1], fast, size)[:kept]
        out = out[:, ::fast][:, :kept]
        out[1] = speed
        return out
    samples = math.floor(round(rotations * rotation_s(made) * sampling_hz, 6)) + 1
    out = np.full((3, samples), np.nan)
    settling = SETTLING_ROTATIONS
    if made.shaft_hysteresis__torque_nm != 0.0:
        # It forgets with travel: an e-fold for each θ_p, about 4 (δ + m g l/K_s) a rotation.
        wound = made.gravity_torque_nm / made.shaft_stiffness_nm_per_rad
        travel = 4.0 * (made.gap_rad + made.backlash__gap_rad + wound)
        settling += min(10.0 * made.shaft_hysteresis__angle_rad / travel, 8.0)
    step = 1.0 / sampling_hz / math.ceil(1.0 / (sampling_hz * step_s))
    each, late, period = 0, math.nan, made.sampled_control__period_s
    if period > 0.0:
        each = math.ceil(period / step_s)
        while abs((made.sampled_control__delay_periods * each) % 1.0) > 1e-9 and each < 1000:
            each += 1
        step = period / each
        # The load is to come to its start angle at a tick, so begin as much earlier as it is early.
        came = _run(made, settling, step, each, 1.0 / sampling_hz, 0.0, out[:, :0])
        late = math.ceil(came / period) * period - came
    begun = _run(made, settling, step, each, 1.0 / sampling_hz, late, out)
    if begun < 0.0 or not np.all(np.isfinite(out)):
        raise ValueError("the motor does not turn the load round, or the simulation diverged")
    return out


@dataclass(frozen=True, slots=True)
class Noise:
    """Coloured AR(1) noise of the speed, white noise of the current, encoder counts per turn."""

    speed_sd_rpm: float = 1.5
    speed_coefficient: float = 0.6
    current_sd_a: float = 0.05
    encoder_counts: int = 16384


@dataclass(frozen=True, slots=True)
class Made:
    """A recording with what only its maker knows.

    Attributes
    ----------
    recording
        As a measurement would give it; its metadata tell nothing of the truth.
    clean
        Position (from zero unless absolute), speed, current without noise, shape (3, n); without
        lost samples too.
    truth
        All parameters.
    """

    recording: Recording
    clean: np.ndarray
    truth: Plant


def simulate(
    made: Plant,
    rng: np.random.Generator | None = None,
    *,
    name: str = "simulated",
    rotations: float = 5.0,
    sampling_hz: float = 1000.0,
    noise: Noise | None = None,
    absolute_position: bool = False,
    step_s: float = LONGEST_STEP_S,
) -> Made:
    """One recording; ``rng`` of ``None``: neither noise nor lost samples, an ideal encoder."""
    clean = noise_free(made, rotations, sampling_hz, step_s)
    zero = clean[0, 0]
    if absolute_position:
        zero = made.gear_ratio * made.start_angle_rad - made.motor_start_angle_rad
    clean[0] -= zero
    seen = _seen(clean, made, rng, noise, sampling_hz)
    time = np.arange(clean.shape[1]) / sampling_hz
    return Made(Recording(name, time, dict(zip(CHANNELS, seen, strict=True))), clean, made)


def simulate_moving(
    made: Plant,
    reference: Reference,
    duration_s: float,
    rng: np.random.Generator | None = None,
    *,
    name: str = "simulated",
    sampling_hz: float = 1000.0,
    noise: Noise | None = None,
    channels: Sequence[str] = (REFERENCE_SPEED,),
    cut_s: float = 0.0,
    side: float | None = None,
) -> Made:
    """One recording of a motion with these of its reference channels, the first seconds cut off."""
    clean = moving(made, reference, duration_s + cut_s, sampling_hz, side=side)
    time = np.arange(clean.shape[1]) / sampling_hz
    speed, angle = reference(time)
    asked = {REFERENCE_SPEED: speed * RPM, REFERENCE_POSITION: angle}
    cut = round(cut_s * sampling_hz)
    clean = clean[:, cut:]
    clean[0] -= clean[0, 0]
    seen = _seen(clean, made, rng, noise, sampling_hz)
    measured = dict(zip(CHANNELS, seen, strict=True))
    measured |= {channel: asked[channel][cut:] for channel in channels}
    return Made(Recording(name, time[cut:] - time[cut], measured), clean, made)


def _seen(
    clean: np.ndarray,
    made: Plant,
    rng: np.random.Generator | None,
    noise: Noise | None,
    sampling_hz: float,
) -> np.ndarray:
    """As it is measured: encoder counts, noise, lost samples; as it is without a generator."""
    seen = clean.copy()
    if rng is None:
        return seen
    noise = noise or Noise()
    count = 2.0 * math.pi / noise.encoder_counts
    seen[0] = np.round(clean[0] / count) * count
    seen[1] += _autoregressive(clean.shape[1], noise, rng)
    seen[2] += noise.current_sd_a * rng.standard_normal(clean.shape[1])
    _lose_samples(seen[1], made, sampling_hz, rng)
    return seen


def random_recordings(
    values: Mapping[str, float],
    hidden: Mapping[str, float],
    rng: np.random.Generator,
    *,
    gap_rad: tuple[float, float] = (2e-4, 3.5e-3),
    speeds_rpm: Sequence[float] = SPEEDS_RPM,
    noise: Noise | None = None,
    absolute_position: bool = False,
    rotations: float = 5.0,
) -> list[Made]:
    """One recording for each speed, of one gap drawn log-uniformly.

    Load and motor start angles, and the phase of what is periodic in time, are drawn anew for each
    recording.

    Parameters
    ----------
    values
        Bench parameters by name.
    hidden
        Effects, or what no catalogue holds, as ``effect__parameter``.
    """
    gap = math.exp(rng.uniform(*np.log(gap_rad)))
    made = []
    for speed in speeds_rpm:
        start, motor, phase = rng.uniform(-math.pi, math.pi, 3)
        truth = plant(
            {
                **values,
                "gap_rad": gap,
                "reference_speed_rpm": speed,
                "start_angle_rad": start,
                "motor_start_angle_rad": motor,
                "outside__time_phase_rad": phase,
                "outside__shaking_phase_rad": phase,
                **hidden,
            }
        )
        made.append(
            simulate(
                truth,
                rng,
                name=f"{'forward' if speed > 0 else 'reverse'} {abs(speed):g} rpm",
                rotations=rotations,
                noise=noise,
                absolute_position=absolute_position,
            )
        )
    return made


def _autoregressive(size: int, noise: Noise, rng: np.random.Generator) -> np.ndarray:
    phi = noise.speed_coefficient
    white = rng.standard_normal(size)
    white[1:] *= math.sqrt(1.0 - phi * phi)
    filtered: np.ndarray = signal.lfilter([1.0], [1.0, -phi], white)
    return noise.speed_sd_rpm * filtered


def _lose_samples(
    speed: np.ndarray, made: Plant, sampling_hz: float, rng: np.random.Generator
) -> None:
    """For short stretches at random times the recorded speed falls by a share of itself."""
    count = rng.poisson(made.outside__dropouts_per_s * speed.size / sampling_hz)
    for begin in rng.integers(0, speed.size, count):
        length = max(1, round(sampling_hz * rng.exponential(made.outside__dropout_length_s)))
        speed[begin : begin + length] *= 1.0 - made.outside__dropout_share * rng.uniform(0.2, 1.0)
