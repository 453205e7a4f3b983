"""The accuracy promise: 0.01 rpm against SciPy at tight tolerance, on random benches and effects.

The reference is written from the formulas of the design, not from the kernel, in other states
(load angle instead of twist), and integrated by another method (DOP853) at tolerances a thousand
times tighter.
"""

from __future__ import annotations

import math

import numba
import numpy as np
import pytest
from made_recordings import start_state
from scipy.integrate import solve_ivp

from bayesbl.bench.bench import Bench, BenchParameter
from bayesbl.bench.kernel import DONE, HELD_TORQUE, RPM, SLOTS, STATES, Slot, simulate
from bayesbl.bench.motion import Motion, cycle, recorded_motion, sine, torque_ramps
from bayesbl.bench.simulation import simulate_channels, simulate_motions, simulate_states
from bayesbl.config.bench import reference_bench

SAMPLING_HZ = 500.0
PROMISED_RPM = 0.01
AVERAGING = Slot.speed_averaging__time_s

INDEX = {slot.name: int(slot) for slot in Slot}


def random_bench(rng: np.random.Generator) -> tuple[Bench, float, float]:
    """A stable bench, a gap and a start angle, a decade around the reference bench."""

    def log_uniform(low: float, high: float) -> float:
        return float(math.exp(rng.uniform(math.log(low), math.log(high))))

    ratio = log_uniform(40.0, 200.0)
    motor = log_uniform(4e-4, 4e-3)
    load = motor * ratio**2 * log_uniform(0.3, 3.0)
    stiffness = load * log_uniform(30.0, 150.0) ** 2
    total = motor + load / ratio**2
    gain = total * rng.uniform(30.0, 100.0)
    gap_form = "arctan" if rng.random() < 0.6 else "dead_zone"
    gap = log_uniform(1e-4, 4e-3)
    direction = 1.0 if rng.random() < 0.7 else -1.0
    values = {
        "gear_ratio": ratio,
        "motor_inertia_kg_m2": motor,
        "load_inertia_kg_m2": load,
        "shaft_stiffness_nm_per_rad": stiffness,
        "shaft_damping_nm_s_per_rad": 2.0 * rng.uniform(0.03, 0.3) * math.sqrt(stiffness * load),
        "gravity_torque_nm": stiffness * log_uniform(5e-4, 5e-3),
        "speed_gain_nm_s_per_rad": gain,
        "integral_gain_nm_per_rad": gain * rng.uniform(5.0, 50.0),
        "torque_constant_nm_per_a": rng.uniform(0.1, 1.0),
        "current_limit_a": 1e4,
        "reference_speed_rpm": direction * log_uniform(600.0, 3000.0),
        "stiffness_sharpness_per_rad": max(60.0 / gap, log_uniform(3e5, 1e7)),
    }
    bench = Bench({k: BenchParameter(v) for k, v in values.items()}, gap_form=gap_form)
    return bench, gap, rng.uniform(0.0, 2.0 * math.pi)


# Compiled with the slots' numbers as constants, for the reference takes millions of evaluations.
S = Slot


@numba.njit(error_model="numpy")
def reference_slopes(t, y, p, piece, width):
    """Slopes of θ_m, ω_m, θ_l, ω_l, ∫error, drive torque, sensed speed, Dahl z, friction's z.

    ``piece``: start, ω_ref and θ_ref as polynomials of the time since, lowest power first.
    ``width``: speed of the motor over which friction changes its sign.
    """
    motor_angle, motor_speed, load_angle, load_speed, integral, drive, seen, dahl, bristle = y
    n = p[S.gear_ratio]
    ks = p[S.shaft_stiffness_nm_per_rad]
    ds = p[S.shaft_damping_nm_s_per_rad]
    delta = p[S.gap_rad] + p[S.backlash__gap_rad]
    phase = motor_angle + p[S.motor_start_angle_rad] - n * p[S.start_angle_rad]

    order = p[S.gear_transmission_error__order]
    wave = order * phase + p[S.gear_transmission_error__phase_rad]
    error_size = p[S.gear_transmission_error__angle_rad]
    twist_speed = motor_speed / n - load_speed
    x = motor_angle / n - load_angle + error_size * math.sin(wave)
    v = twist_speed + error_size * order * motor_speed * math.cos(wave)
    if p[S.hard_dead_zone] > 0.0:
        shaft = 0.0
        if abs(x) > delta:
            shaft = ks * (x - delta * np.sign(x)) + ds * v
    else:
        alpha = p[S.stiffness_sharpness_per_rad]
        stiffness = (ks / math.pi) * (
            math.pi + math.atan(alpha * (x - delta)) - math.atan(alpha * (x + delta))
        )
        shaft = (x - delta * np.sign(x) + ds / ks * v) * stiffness
    v_edge = p[S.contact_softness__variance_rad2]
    if v_edge > 0.0:
        # The mean over a logistic edge, by its distribution function and that one's integral.
        scale = math.sqrt(3.0 * v_edge) / math.pi
        if abs(x) > delta:
            shaft -= ks * math.copysign(abs(x) - delta, x) + ds * v
        for side in (1.0, -1.0):
            z = (side * x - delta) / scale
            shaft += side * ks * scale * (max(z, 0.0) + math.log1p(math.exp(-abs(z))))
            shaft += ds * v * 0.5 * (1.0 + math.tanh(0.5 * z))
    if abs(x) > delta:
        e = abs(x) - delta
        at = p[S.gravity_torque_nm] / ks
        shaft += np.sign(x) * ks * (at * (e / at) ** (1.0 + p[S.contact_exponent__excess]) - e)
        shaft += p[S.stiffness_hardening__stiffness_nm_per_rad3] * (x - delta * np.sign(x)) ** 3
        shaft += p[S.flank_asymmetry__share] * ks * (abs(x) - delta)
        shaft += p[S.contact_damping__factor_s_per_rad] * ks * (abs(x) - delta) * v
        if shaft * x < 0.0:
            shaft *= 1.0 - p[S.contact_release__share]
    else:
        shaft += p[S.gap_damping__coefficient_nm_s_per_rad] * v
    shaft += p[S.shaft_hysteresis__torque_nm] * dahl
    dahl_slope = 0.0
    if p[S.shaft_hysteresis__angle_rad] > 0.0:
        dahl_slope = (twist_speed / p[S.shaft_hysteresis__angle_rad]) * (
            1.0 - dahl * np.sign(twist_speed)
        )

    eccentricity = p[S.encoder_eccentricity__angle_rad]
    at_encoder = phase + p[S.encoder_eccentricity__phase_rad]
    shown_angle = motor_angle + eccentricity * math.sin(at_encoder)
    shown_speed = motor_speed * (1.0 + eccentricity * math.cos(at_encoder))
    seen_slope = 0.0
    if p[S.speed_sensor_lag__time_s] > 0.0:
        seen_slope = (shown_speed - seen) / p[S.speed_sensor_lag__time_s]
        shown_speed = seen
    s = t - piece[0]
    asked_speed = piece[1] + piece[2] * s + piece[3] * s**2 + piece[4] * s**3
    asked_angle = piece[5] + piece[6] * s + piece[7] * s**2 + piece[8] * s**3 + piece[9] * s**4
    error = asked_speed - shown_speed
    error += p[S.position_gain_per_s] * (asked_angle - shown_angle)
    demand = p[S.speed_gain_nm_s_per_rad] * error + p[S.integral_gain_nm_per_rad] * integral
    if math.isinf(p[S.load_inertia_kg_m2]):
        demand = asked_speed  # the output is held, and a torque is asked for
    drive_slope = 0.0
    if p[S.current_loop_lag__time_s] > 0.0:
        drive_slope = (demand - drive) / p[S.current_loop_lag__time_s]
        demand = drive

    added = p[S.motor_coulomb_friction__width_rad_per_s]
    width += added
    turning, bristle_slope = math.tanh(motor_speed / width), 0.0
    angle = p[S.motor_coulomb_friction__presliding_rad]
    if angle > 0.0:
        bristle_slope = min((abs(motor_speed) + added) / angle, 1e4) * (turning - bristle)
        turning += angle / (angle + 1e-5) * (bristle - turning)
    losses = p[S.motor_coulomb_friction__torque_nm] * turning
    losses += p[S.motor_viscous_friction__coefficient_nm_s_per_rad] * motor_speed
    if p[S.motor_stribeck_friction__speed_rad_per_s] > 0.0:
        fading = math.exp(-((motor_speed / p[S.motor_stribeck_friction__speed_rad_per_s]) ** 2))
        losses += p[S.motor_stribeck_friction__torque_nm] * fading * turning
    losses += p[S.motor_quadratic_drag__coefficient_nm_s2_per_rad2] * motor_speed * abs(motor_speed)
    losses += p[S.friction_asymmetry__coefficient_nm_s_per_rad] * motor_speed * turning
    losses += p[S.motor_torque_offset__torque_nm]
    losses += p[S.gear_mesh_friction__coefficient] * abs(shaft) / n * turning
    losses += p[S.motor_torque_ripple__torque_nm] * math.sin(
        p[S.motor_torque_ripple__order] * phase + p[S.motor_torque_ripple__phase_rad]
    )
    losses += (p[S.friction_drift__torque_nm] + p[S.friction_drift__rate_nm_per_s] * t) * turning

    load = p[S.gravity_torque_nm] * math.sin(load_angle + p[S.gravity_angle_rad])
    load += p[S.gravity_phase__torque_nm] * math.cos(load_angle)
    load += p[S.load_coulomb_friction__torque_nm] * math.tanh(load_speed * n / width)
    load += p[S.load_viscous_friction__coefficient_nm_s_per_rad] * load_speed
    load += p[S.load_torque_offset__torque_nm]
    return np.array(
        [
            motor_speed,
            (demand - shaft / n - losses) / p[S.motor_inertia_kg_m2],
            load_speed,
            (shaft - load) / p[S.load_inertia_kg_m2],
            error,
            drive_slope,
            seen_slope,
            dahl_slope,
            bristle_slope,
        ]
    )


def reference_channels(
    p: np.ndarray, state: np.ndarray, times: np.ndarray, motion: Motion | None = None
) -> np.ndarray:
    """Recorded speed in rpm and current in A from the kernel's state at the first sample.

    Without a position loop where there is a motion.
    """
    steady = np.zeros((1, 10))
    steady[0, [1, 6]] = p[Slot.reference_speed_rpm] / RPM
    pieces = steady if motion is None else motion.pieces
    held = math.isinf(p[Slot.load_inertia_kg_m2])
    fastest = max(float(np.max(np.abs(pieces[:, 1]))), abs(p[Slot.reference_speed_rpm]) / RPM)
    width = 0.1 if held else 5e-4 * fastest
    n = p[Slot.gear_ratio]
    start = state[:9].copy()
    start[2] = state[0] / n - state[2]
    start[3] = state[1] / n - state[3]
    shaft_rate = math.sqrt(
        p[Slot.shaft_stiffness_nm_per_rad]
        * (1.0 / p[Slot.load_inertia_kg_m2] + 1.0 / (n**2 * p[Slot.motor_inertia_kg_m2]))
    )
    fastest = max(
        shaft_rate,
        abs(p[Slot.reference_speed_rpm] / RPM)
        * max(p[Slot.motor_torque_ripple__order], p[Slot.gear_transmission_error__order]),
    )
    parts = []
    for piece, end in zip(pieces, [*pieces[1:, 0], np.inf], strict=True):
        begin, end = max(piece[0], times[0]), min(end, times[-1])
        if end <= begin and parts:
            break
        inside = times[(times >= begin) & (times < end)]
        solution = solve_ivp(
            reference_slopes,
            (begin, end),
            start,
            method="DOP853",
            t_eval=[*inside, end],
            args=(p, piece, width),
            rtol=1e-11,
            # in proportion to what each state does to the motor speed
            atol=np.array([1e-6, 1e-6, 1e-10, 1e-8, 1e-7, 1e-8, 1e-6, 1e-7, 1e-8]),
            max_step=0.4 / fastest,
        )
        assert solution.success
        start = solution.y[:, -1]
        parts.append(solution.y[:, : inside.size])
    y = np.concatenate([*parts, start[:, None]], axis=1)
    eccentricity = p[Slot.encoder_eccentricity__angle_rad]
    phase = y[0] + p[Slot.motor_start_angle_rad] - n * p[Slot.start_angle_rad]
    speed = y[1] * (1 + eccentricity * np.cos(phase + p[Slot.encoder_eccentricity__phase_rad]))
    if p[Slot.speed_sensor_lag__time_s] > 0.0:
        speed = y[6]
    asked = p[Slot.reference_speed_rpm] if motion is None else motion.speed_rpm(times)
    torque = p[Slot.speed_gain_nm_s_per_rad] * (asked / RPM - speed)
    torque += p[Slot.integral_gain_nm_per_rad] * y[4]
    if p[Slot.current_loop_lag__time_s] > 0.0:
        torque = y[5]
    return np.array([speed * RPM, torque / p[Slot.torque_constant_nm_per_a]])


def largest_errors(parameters: np.ndarray, duration_s: float) -> np.ndarray:
    """Largest error of speed (rpm) and current (A) over the duration."""
    samples = math.floor(duration_s * SAMPLING_HZ)
    channels = simulate_channels(parameters[None], samples, SAMPLING_HZ)[0]
    state = start_state(parameters)
    exact = reference_channels(parameters, state, np.arange(samples) / SAMPLING_HZ)
    return np.max(np.abs(channels[1:] - exact), axis=1)


def test_speed_is_within_the_promise_on_random_benches_and_gaps() -> None:
    errors = []
    for seed in range(30):
        bench, gap, start_angle = random_bench(np.random.default_rng(seed))
        parameters = bench.vector(gap_rad=gap, start_angle_rad=start_angle)[0]
        errors.append(largest_errors(parameters, 1.1 * bench.rotation_period_s())[0])
    assert max(errors) < PROMISED_RPM
    assert np.median(errors) < PROMISED_RPM / 10


def test_speed_is_steady_from_the_first_sample_on_random_benches() -> None:
    # A run ten thousand times more accurate also starts much earlier.
    for seed in range(100, 140):
        bench, gap, start_angle = random_bench(np.random.default_rng(seed))
        settings = {"rotations": 1.0, "sampling_hz": SAMPLING_HZ, "start_angle_rad": start_angle}
        speed = bench.simulate_many(gap, **settings)
        exact = bench.simulate_many(gap, **settings, accuracy_rpm=1e-6)
        assert np.max(np.abs(speed - exact)) < PROMISED_RPM


@pytest.mark.parametrize(
    "settings",
    [
        {"integral_gain_nm_per_rad": 0.05},
        {"integral_gain_nm_per_rad": 0.0},
        {"position_gain_per_s": 0.3},
        {"shaft_damping_nm_s_per_rad": 0.0},
        {"reference_speed_rpm": 100.0},
        {"rigid": 1.0},
        {"shaft_hysteresis__torque_nm": 50.0, "shaft_hysteresis__angle_rad": 5e-3},
    ],
)
def test_unusual_benches_are_steady_from_the_first_sample(settings: dict[str, float]) -> None:
    parameters = reference_bench().vector(**{"gap_rad": 1e-3, "start_angle_rad": 0.3, **settings})
    speed = simulate_channels(parameters, 2000, SAMPLING_HZ, speed_alone=True)
    exact = simulate_channels(parameters, 2000, SAMPLING_HZ, accuracy_rpm=1e-6)[:, 1:2]
    assert np.max(np.abs(speed - exact)) < PROMISED_RPM


EFFECT_RANGES: dict[str, dict[str, tuple[float, float]]] = {
    "backlash": {"gap_rad": (1e-4, 1e-3)},
    "motor_coulomb_friction": {"torque_nm": (0.05, 1.0)},
    "motor_viscous_friction": {"coefficient_nm_s_per_rad": (1e-4, 5e-3)},
    "motor_stribeck_friction": {"torque_nm": (0.1, 1.0), "speed_rad_per_s": (50.0, 400.0)},
    "motor_quadratic_drag": {"coefficient_nm_s2_per_rad2": (1e-6, 2e-5)},
    "friction_asymmetry": {"coefficient_nm_s_per_rad": (-2e-3, 2e-3)},
    "motor_torque_offset": {"torque_nm": (-1.0, 1.0)},
    "load_coulomb_friction": {"torque_nm": (5.0, 60.0)},
    "load_viscous_friction": {"coefficient_nm_s_per_rad": (1.0, 40.0)},
    "load_torque_offset": {"torque_nm": (-60.0, 60.0)},
    "gravity_phase": {"torque_nm": (-100.0, 100.0)},
    "gear_mesh_friction": {"coefficient": (0.02, 0.3)},
    "motor_torque_ripple": {"torque_nm": (-0.5, 0.5), "order": (1, 12), "phase_rad": (-3, 3)},
    "gear_transmission_error": {
        "angle_rad": (-1e-4, 1e-4),
        "order": (1, 4),
        "phase_rad": (-3, 3),
    },
    "encoder_eccentricity": {"angle_rad": (-0.01, 0.01), "phase_rad": (-3, 3)},
    "stiffness_hardening": {"stiffness_nm_per_rad3": (-1e9, 5e9)},
    "contact_exponent": {"excess": (-0.1, 0.5)},
    "contact_softness": {"variance_rad2": (1e-11, 5e-9)},
    "flank_asymmetry": {"share": (-0.4, 0.4)},
    "contact_damping": {"factor_s_per_rad": (0.1, 2.0)},
    "contact_release": {"share": (0.1, 1.0)},
    "gap_damping": {"coefficient_nm_s_per_rad": (5.0, 100.0)},
    "shaft_hysteresis": {"torque_nm": (5.0, 60.0), "angle_rad": (1e-4, 2e-3)},
    "current_loop_lag": {"time_s": (5e-4, 3e-3)},
    "speed_sensor_lag": {"time_s": (5e-4, 3e-3)},
    "friction_drift": {"torque_nm": (-0.5, 0.5), "rate_nm_per_s": (-0.05, 0.05)},
}


def with_effects(rng: np.random.Generator, names: list[str]) -> np.ndarray:
    """The reference bench with these effects at random strength, a random gap and start angle."""
    values = {
        f"{name}__{key}": rng.uniform(*bounds)
        for name in names
        for key, bounds in EFFECT_RANGES[name].items()
    }
    for key in ("motor_torque_ripple__order", "gear_transmission_error__order"):
        if key in values:
            values[key] = round(values[key])
    return reference_bench().vector(
        gap_rad=math.exp(rng.uniform(math.log(1e-4), math.log(3e-3))),
        start_angle_rad=rng.uniform(0.0, 2.0 * math.pi),
        hard_dead_zone=float(rng.random() < 0.3),
        current_limit_a=1e4,
        **values,
    )[0]


@pytest.mark.long
@pytest.mark.parametrize("name", list(EFFECT_RANGES))
def test_each_effect_keeps_the_promise(name: str) -> None:
    seed = int.from_bytes(name.encode()[:8], "big")
    for draw in range(2):
        parameters = with_effects(np.random.default_rng([seed, draw]), [name])
        assert largest_errors(parameters, 2.0)[0] < PROMISED_RPM


def sampled_reference(p: np.ndarray, state: np.ndarray, samples: int) -> np.ndarray:
    """As ``reference_channels`` under a sampled controller, at its ticks, from one of them on.

    From tick to tick the equations have no controller but a constant torque on the motor. Torques
    wait in a list until they act; the current shown is d periods old.
    """
    period, delay = p[S.sampled_control__period_s], p[S.sampled_control__delay_periods]
    n, constant = p[S.gear_ratio], p[S.torque_constant_nm_per_a]
    free = p.copy()
    free[[S.speed_gain_nm_s_per_rad, S.integral_gain_nm_per_rad]] = 0.0
    y, (held, coming, angle, speed, *older) = state[:9].copy(), state[HELD_TORQUE:]
    on_the_way = [coming, *older]  # the newest first
    late = delay - len(older)
    instant = p[S.sampled_control__instant_share]
    y[2], y[3] = state[0] / n - state[2], state[1] / n - state[3]
    total, reference = state[4], p[S.reference_speed_rpm] / RPM

    def moved(y: np.ndarray, torque: float, duration_s: float) -> np.ndarray:
        if duration_s == 0.0:
            return y
        free[S.motor_torque_offset__torque_nm] = p[S.motor_torque_offset__torque_nm] - torque
        solution = solve_ivp(
            reference_slopes,
            (0.0, duration_s),
            y,
            method="DOP853",
            args=(free, np.zeros(10), 5e-4 * abs(reference)),
            rtol=1e-11,
            atol=np.array([1e-9, 1e-7, 1e-12, 1e-9, 1e-7, 1e-8, 1e-6, 1e-7, 1e-8]),
        )
        return np.asarray(solution.y[:, -1])

    logged = []
    for _ in range(samples):
        shown = late * held + (1.0 - late) * on_the_way[-1]
        logged.append((speed * RPM, shown / constant))
        y = moved(y, held, late * period)
        held = on_the_way.pop()
        y = moved(y, held, (1.0 - late) * period)
        speed, angle = (1.0 - instant) * (y[0] - angle) / period + instant * y[1], y[0]
        total += period * (reference - speed)
        coming = p[S.speed_gain_nm_s_per_rad] * (reference - speed)
        coming += p[S.integral_gain_nm_per_rad] * total
        on_the_way.insert(0, coming)
        if delay <= 0.0:
            held = coming
    return np.array(logged).T


@pytest.mark.parametrize(
    ("period_s", "delay", "share"),
    [
        *[(2e-3, d, 0.0) for d in (0.0, 0.4, 1.0)],
        *[(2e-4, 0.4, 0.0), (1e-3, 3.0, 0.0), (1e-3, 1.6, 0.0), (2e-4, 16.0, 0.0)],
        *[(2e-3, 1.0, 1.0), (1e-3, 1.6, 0.4)],
    ],
)
@pytest.mark.parametrize("effects", [[], ["load_coulomb_friction", "gear_transmission_error"]])
def test_a_sampled_controller_keeps_the_promise(
    period_s: float, delay: float, share: float, effects: list[str]
) -> None:
    parameters = with_effects(np.random.default_rng(6), effects)
    parameters[[S.sampled_control__period_s, S.sampled_control__delay_periods]] = period_s, delay
    parameters[S.sampled_control__instant_share] = share
    parameters[S.start_angle_rad] = 3.0  # a flank changes soon
    samples = round(0.4 / period_s)
    channels = simulate_channels(parameters[None], samples, 1.0 / period_s)[0]
    state = start_state(parameters)
    exact = sampled_reference(parameters, state, samples)
    assert np.ptp(exact[0]) > 5.0
    assert np.max(np.abs(channels[1] - exact[0])) < PROMISED_RPM
    assert np.max(np.abs(channels[2] - exact[1])) < 1e-3


def test_short_steps_between_ticks_heed_a_damping_faster_than_any_oscillation() -> None:
    parameters = with_effects(np.random.default_rng(1), [])
    parameters[[S.sampled_control__period_s, S.sampled_control__delay_periods]] = 3e-4, 0.5
    parameters[S.shaft_damping_nm_s_per_rad] *= 100.0
    parameters[S.start_angle_rad] = 3.0
    samples = 700
    channels = simulate_channels(parameters[None], samples, 1.0 / 3e-4)[0]
    exact = sampled_reference(parameters, start_state(parameters), samples)
    assert np.max(np.abs(channels[1] - exact[0])) < PROMISED_RPM


def test_between_ticks_far_from_an_edge_no_equation_is_integrated() -> None:
    """A rotation takes fewer right-hand sides than ticks; an effect of no size takes many."""
    parameters = reference_bench().vector(gap_rad=8e-4)[0]
    parameters[[S.sampled_control__period_s, S.sampled_control__delay_periods]] = 2.5e-4, 1.3
    parameters[[S.motor_coulomb_friction__torque_nm, S.load_coulomb_friction__torque_nm]] = 0.1, 5.0
    moments = np.arange(3000) * 1e-3
    shown, evaluations = [], []
    for nothing in (0.0, 1e-9):
        parameters[S.gear_mesh_friction__coefficient] = nothing
        out = np.empty((3, moments.size))
        run = simulate(parameters, 0.5, 1e-3, moments, 1e-3, out, np.empty(0))
        assert run[0] == DONE
        shown.append(out)
        evaluations.append(run[1])
    assert evaluations[0] < moments[-1] / 2.5e-4 < 0.1 * evaluations[1]
    assert np.max(np.abs(shown[0][1] - shown[1][1])) < 1e-3
    assert np.max(np.abs(shown[0][2] - shown[1][2])) < 1e-3


@pytest.mark.long
def test_any_set_of_effects_keeps_the_promise() -> None:
    for seed in range(8):
        rng = np.random.default_rng(seed)
        names = list(rng.choice(list(EFFECT_RANGES), size=4 if seed else 19, replace=False))
        assert largest_errors(with_effects(rng, names), 2.0)[0] < PROMISED_RPM


def test_position_loop_agrees_with_the_reference() -> None:
    bench = reference_bench().with_parameters(position_gain_per_s=5.0)
    parameters = bench.vector(gap_rad=8e-4)[0]
    state = np.zeros(STATES)
    state[1] = 2000.0 / RPM
    state[2] = 2e-3
    samples = 700
    states = simulate_states(parameters, state, samples, SAMPLING_HZ)
    exact = reference_channels(parameters, state, np.arange(samples) / SAMPLING_HZ)
    assert np.max(np.abs(states[1] * RPM - exact[0])) < PROMISED_RPM


MOTIONS = {
    "strokes": cycle(120.0, (-0.3, 0.4), 1500.0, 6000.0, 0.1, 1.5),
    "sine": sine(120.0, (0.2, 0.9), 0.9, 1.5),
    "cycle": cycle(120.0, [0.1, -0.1, 0.3], 800.0, 9000.0, 0.05, 1.5),
    "S-curves": cycle(120.0, (-0.3, 0.4), 1500.0, 6000.0, 0.1, 1.5, 60000.0),
}


@pytest.mark.long
@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize(
    "effects",
    [[], ["motor_coulomb_friction", "load_coulomb_friction", "gear_mesh_friction"]],
    ids=["bare", "sticking"],
)
def test_motions_keep_the_promise(name: str, effects: list[str]) -> None:
    motion, samples = MOTIONS[name], 700
    parameters = with_effects(np.random.default_rng(len(name)), effects)
    parameters[Slot.start_angle_rad] = motion.start_angle_rad
    parameters[Slot.gravity_angle_rad] = 0.7
    channels = simulate_motions(parameters[None], motion, samples, SAMPLING_HZ)[0]
    states = simulate_motions(parameters[None], motion, 1, SAMPLING_HZ, states=True)[0]
    times = np.arange(samples) / SAMPLING_HZ
    exact = reference_channels(parameters, states[:, 0], times, motion)
    assert np.max(np.abs(channels[1] - exact[0])) < PROMISED_RPM


@pytest.mark.parametrize(
    ("width_rad_per_s", "presliding_rad"), [(2.0, 0.0), (0.0, 0.02), (0.0, 1e-3), (1.0, 0.02)]
)
def test_friction_near_rest_keeps_the_promise(
    width_rad_per_s: float, presliding_rad: float
) -> None:
    motion, samples = MOTIONS["strokes"], 700
    names = ["motor_coulomb_friction", "gear_mesh_friction"]
    parameters = with_effects(np.random.default_rng(3), names)
    parameters[Slot.start_angle_rad] = motion.start_angle_rad
    sharp = simulate_motions(parameters[None], motion, samples, SAMPLING_HZ)[0]
    parameters[S.motor_coulomb_friction__width_rad_per_s] = width_rad_per_s
    parameters[S.motor_coulomb_friction__presliding_rad] = presliding_rad
    channels = simulate_motions(parameters[None], motion, samples, SAMPLING_HZ)[0]
    states = simulate_motions(parameters[None], motion, 1, SAMPLING_HZ, states=True)[0]
    times = np.arange(samples) / SAMPLING_HZ
    exact = reference_channels(parameters, states[:, 0], times, motion)
    assert np.max(np.abs(channels[1] - exact[0])) < PROMISED_RPM
    assert np.max(np.abs(channels[1] - sharp[1])) > 10.0 * PROMISED_RPM


def test_friction_that_hardly_bends_jumps_between_ticks() -> None:
    """The limit of no angle is smooth, though its rate is fast compared with the ticks."""
    motion, samples = MOTIONS["strokes"], 700
    parameters = with_effects(np.random.default_rng(3), ["motor_coulomb_friction"])
    parameters[Slot.start_angle_rad] = motion.start_angle_rad
    parameters[S.sampled_control__period_s] = 5e-4
    matrix = np.repeat(parameters[None], 3, axis=0)
    matrix[:, S.motor_coulomb_friction__presliding_rad] = 0.0, 1e-9, 1e-7
    jumps, hardly, little = simulate_motions(matrix, motion, samples, SAMPLING_HZ)[:, 1]
    assert np.max(np.abs(hardly - jumps)) < PROMISED_RPM
    assert np.max(np.abs(little - jumps)) < 100.0 * PROMISED_RPM


@pytest.mark.parametrize(
    "effects",
    [[], ["motor_coulomb_friction", "gear_mesh_friction", "current_loop_lag"]],
    ids=["bare", "sticking"],
)
def test_a_held_output_keeps_the_promise(effects: list[str]) -> None:
    motion, samples = torque_ramps([1.0, 6.0], 2, 0.35), 700
    parameters = with_effects(np.random.default_rng(5), effects)
    found = simulate_motions(parameters[None], motion, samples, SAMPLING_HZ, states=True)[0]
    times = np.arange(samples) / SAMPLING_HZ
    held = parameters.copy()
    held[Slot.load_inertia_kg_m2] = math.inf
    exact = reference_channels(held, found[:, 0], times, motion)
    assert np.max(np.abs(found[1] * RPM - exact[0])) < PROMISED_RPM
    assert np.max(np.abs(found[1] * RPM)) > 100.0
    load_angle = found[0] / parameters[Slot.gear_ratio] - found[2]
    assert load_angle == pytest.approx(parameters[Slot.start_angle_rad], abs=1e-9)


def test_a_motion_at_constant_speed_is_steady_rotation() -> None:
    # From the middle of a flank, where the start of a motion is that of the settling.
    bench, time = reference_bench(), np.arange(4000) / SAMPLING_HZ
    motion = recorded_motion(time, np.full(time.size, 2000.0))
    parameters = bench.vector(gap_rad=8e-4, start_angle_rad=0.5 * math.pi)
    moving = simulate_motions(parameters, motion, time.size, SAMPLING_HZ)[0]
    steady = simulate_channels(parameters, time.size, SAMPLING_HZ)[0]
    assert np.max(np.abs(moving - steady)[1, 300:]) < PROMISED_RPM


def test_recorded_references_make_the_motion_that_they_were_recorded_of() -> None:
    parameters = reference_bench().vector(gap_rad=8e-4, start_angle_rad=0.2)
    time = np.arange(1500) / 1000.0
    for motion in MOTIONS.values():
        speed, position = motion.speed_rpm(time), motion.position_rad(time)
        made = simulate_motions(parameters, motion, time.size, 1000.0)[0, 1]
        by_speed = simulate_motions(parameters, recorded_motion(time, speed), time.size, 1000.0)
        assert np.max(np.abs(by_speed[0, 1] - made)) < 0.05
        recorded = recorded_motion(time, position_rad=position)
        by_position = simulate_motions(parameters, recorded, time.size, 1000.0)
        assert np.max(np.abs(by_position[0, 1] - made)) < 0.3


@pytest.mark.parametrize("name", MOTIONS)
def test_the_average_speed_of_a_motion_is_the_change_of_its_position(name: str) -> None:
    motion, steps = MOTIONS[name], 3
    parameters = reference_bench().vector(
        gap_rad=8e-4,
        start_angle_rad=motion.start_angle_rad,
        speed_averaging__time_s=steps * 1e-3,
    )
    position, speed, _ = simulate_motions(parameters, motion, 1500, 1000.0)[0]
    change = (position[steps:] - position[:-steps]) / (steps * 1e-3) * RPM
    assert np.max(np.abs(speed[steps:] - change)) < PROMISED_RPM
    instant = simulate_motions(parameters * (np.arange(SLOTS) < AVERAGING), motion, 1500, 1000.0)
    assert np.max(np.abs(speed - instant[0, 1])) > 1.0


def test_a_load_at_rest_on_its_flank_stays_there() -> None:
    held = recorded_motion(np.arange(2000) / 1000.0, np.zeros(2000))
    for effects in ([], ["motor_coulomb_friction", "load_coulomb_friction"]):
        parameters = with_effects(np.random.default_rng(3), effects)
        parameters[[Slot.start_angle_rad, Slot.load_coulomb_friction__torque_nm]] = 0.5, 0.0
        speed = simulate_motions(parameters[None], held, 2000, 1000.0)[0, 1]
        assert np.max(np.abs(speed)) < PROMISED_RPM


def test_a_vertical_axis_feels_no_angle() -> None:
    motion = MOTIONS["strokes"]
    matrix = reference_bench().vector(
        gap_rad=8e-4, gravity_torque_nm=0.0, start_angle_rad=np.array([0.0, 1.0])
    )
    first, second = simulate_motions(matrix, motion, 700, SAMPLING_HZ)[:, 1]
    assert np.max(np.abs(first - second)) < PROMISED_RPM


def test_the_gravity_angle_turns_the_posture() -> None:
    bench, motion = reference_bench(), MOTIONS["strokes"]
    turned = bench.vector(gap_rad=8e-4, start_angle_rad=-0.3, gravity_angle_rad=0.6)
    placed = bench.vector(gap_rad=8e-4, start_angle_rad=0.3)
    first, second = (simulate_motions(v, motion, 700, SAMPLING_HZ)[0] for v in (turned, placed))
    assert np.max(np.abs(first[1:] - second[1:])) < PROMISED_RPM


def test_parameter_vectors_have_a_place_for_everything() -> None:
    assert sorted(INDEX.values()) == list(range(SLOTS))


@pytest.mark.parametrize("gap_rad", [0.0, 8e-4])
@pytest.mark.parametrize("presliding_rad", [0.0, 1e-3])
def test_a_reversal_within_a_tick_of_the_controller(gap_rad: float, presliding_rad: float) -> None:
    """Dry friction turns with the motor, between two ticks too: as by adaptive steps.

    A damping of next to nothing in the contact makes every step adaptive.
    """
    motion = cycle(120.0, (-0.05, 0.0513), 400.0, 40_000.0, 0.0, 1.5)
    row = reference_bench().vector(gap_rad=gap_rad)[0].copy()
    row[Slot.start_angle_rad] = motion.start_angle_rad
    row[Slot.reference_speed_rpm] = 400.0
    row[Slot.sampled_control__period_s], row[Slot.sampled_control__delay_periods] = 5e-4, 1.3
    row[Slot.motor_coulomb_friction__torque_nm] = 0.5
    row[Slot.motor_coulomb_friction__presliding_rad] = presliding_rad
    both = np.repeat(row[None], 2, axis=0)
    both[1, Slot.contact_damping__factor_s_per_rad] = 1e-12
    speed_rpm = simulate_motions(both, motion, 1500, 1000.0)[:, 1]
    assert np.abs(speed_rpm[0] - speed_rpm[1]).max() < 0.01
