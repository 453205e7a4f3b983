"""The accuracy promise: 0.01 rpm against SciPy at tight tolerance, on random benches and gaps.

The reference is written from the formulas of the design, not from the kernel, and integrated by
another method (DOP853) at tolerances a thousand times tighter.
"""

from __future__ import annotations

import math

import numba
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bayesbl.physics.bench import Bench, BenchParameter
from bayesbl.physics.kernel import RPM, Slot
from bayesbl.physics.simulation import simulate_channels, simulate_speeds, start_states

SAMPLING_HZ = 500.0


def random_bench(rng: np.random.Generator) -> tuple[Bench, float, float]:
    """A stable bench with a gap and a start angle, a decade around the reference bench."""

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


@numba.njit(error_model="numpy")
def reference_slopes(t, y, q):
    """State θ_m, ω_m, θ_l, ω_l, ∫error; ``q`` as in :func:`reference_solution`."""
    n, jm, jl, ks, ds, mgl, kp, ki, omega, delta, alpha, hard = q
    motor_angle, motor_speed, load_angle, load_speed, integral = y
    twist = motor_angle / n - load_angle
    twist_speed = motor_speed / n - load_speed
    if hard > 0.0:
        torque = 0.0
        if abs(twist) > delta:
            torque = ks * (twist - delta * np.sign(twist)) + ds * twist_speed
    else:
        stiffness = (ks / math.pi) * (
            math.pi + math.atan(alpha * (twist - delta)) - math.atan(alpha * (twist + delta))
        )
        torque = (twist - delta * np.sign(twist) + ds / ks * twist_speed) * stiffness
    error = omega - motor_speed
    drive = kp * error + ki * integral
    return np.array(
        [
            motor_speed,
            (drive - torque / n) / jm,
            load_speed,
            (torque - mgl * math.sin(load_angle)) / jl,
            error,
        ]
    )


def reference_solution(
    parameters: np.ndarray, state: np.ndarray, times: np.ndarray, limit_s: float
) -> np.ndarray:
    """Motor speed in rpm at the times, from the state of the kernel's first sample."""
    q = np.array(
        [
            parameters[slot]
            for slot in (
                Slot.gear_ratio,
                Slot.motor_inertia_kg_m2,
                Slot.load_inertia_kg_m2,
                Slot.shaft_stiffness_nm_per_rad,
                Slot.shaft_damping_nm_s_per_rad,
                Slot.gravity_torque_nm,
                Slot.speed_gain_nm_s_per_rad,
                Slot.integral_gain_nm_per_rad,
                Slot.reference_speed_rpm,
                Slot.gap_rad,
                Slot.stiffness_sharpness_per_rad,
                Slot.hard_dead_zone,
            )
        ]
    )
    q[8] /= RPM
    n = q[0]
    start = [state[0], state[1], state[0] / n - state[2], state[1] / n - state[3], state[4]]
    # Absolute tolerances in proportion to what each state does to the motor speed.
    solution = solve_ivp(
        reference_slopes,
        (times[0], times[-1]),
        start,
        method="DOP853",
        t_eval=times,
        args=(q,),
        rtol=1e-11,
        atol=np.array([1e-6, 1e-6, 1e-10, 1e-8, 1e-7]),
        max_step=limit_s,
    )
    assert solution.success
    return solution.y[1] * RPM


def largest_errors(seeds: range, rotations: float) -> list[tuple[float, Bench, float]]:
    results = []
    for seed in seeds:
        bench, gap, start_angle = random_bench(np.random.default_rng(seed))
        parameters = bench.vector(gap_rad=gap, start_angle_rad=start_angle)
        samples = bench.samples(rotations, SAMPLING_HZ)
        speed = simulate_speeds(parameters, samples, SAMPLING_HZ)[0]
        state = start_states(parameters)[0]
        times = np.arange(samples) / SAMPLING_HZ
        shaft_rate = math.sqrt(
            bench.value("shaft_stiffness_nm_per_rad")
            * (
                1.0 / bench.value("load_inertia_kg_m2")
                + 1.0 / (bench.value("gear_ratio") ** 2 * bench.value("motor_inertia_kg_m2"))
            )
        )
        exact = reference_solution(parameters[0], state, times, 0.3 / shaft_rate)
        results.append((float(np.max(np.abs(speed - exact))), bench, gap))
    return results
