"""How fast the simulator is, and how close, beside SciPy's LSODA on a compiled right-hand side.

    python experiments/benchmark_simulator.py

Prints, for 18 s of the reference bench at 1 kHz on one thread: milliseconds for each simulation
(the fastest of many), right-hand sides, the largest error of the speed against a reference at
tight tolerance; then the cost of effects and of many simulations over the cores.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable

import numba
import numpy as np
from made_recordings import start_state
from scipy.integrate import solve_ivp

from bayesbl.bench import kernel
from bayesbl.bench.kernel import RPM, STATES, Slot
from bayesbl.bench.simulation import simulate_channels
from bayesbl.bench.steady import settling_time_s
from bayesbl.config.bench import reference_bench

SAMPLING_HZ = 1000.0
SAMPLES = 18_001
GAPS = (2e-4, 8e-4, 3e-3)
LSODA_TOLERANCES = (1e-6, 1e-8)
REFERENCE_TOLERANCE = 1e-11


@numba.njit(error_model="numpy")
def slopes(t, y, q):
    """θ_m, ω_m, θ_l, ω_l, ∫error; written from the formulas, arctan form."""
    n, jm, jl, ks, ds, mgl, kp, ki, omega, delta, alpha = q
    twist = y[0] / n - y[2]
    stiffness = (ks / math.pi) * (
        math.pi + math.atan(alpha * (twist - delta)) - math.atan(alpha * (twist + delta))
    )
    slip = y[1] / n - y[3]
    torque = (twist - delta * np.sign(twist) + ds / ks * slip) * stiffness
    error = omega - y[1]
    return np.array(
        [
            y[1],
            (kp * error + ki * y[4] - torque / n) / jm,
            y[3],
            (torque - mgl * math.sin(y[2])) / jl,
            error,
        ]
    )


def fastest_ms(run: Callable[[], object], repeats: int) -> float:
    """Fastest of several runs, ms."""
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        run()
        times.append(time.perf_counter() - begin)
    return 1e3 * min(times)


def scipy_speed(parameters: np.ndarray, method: str, tolerance: float) -> tuple[np.ndarray, int]:
    """Speed in rpm by SciPy from the same first state, and the number of right-hand sides."""
    q = parameters[
        [
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
        ]
    ]
    q[8] /= RPM
    state = start_state(parameters, accuracy_rpm=1e-3)
    n = q[0]
    start = [state[0], state[1], state[0] / n - state[2], state[1] / n - state[3], state[4]]
    times = np.arange(SAMPLES) / SAMPLING_HZ
    solution = solve_ivp(
        slopes,
        (0.0, times[-1]),
        start,
        method=method,
        t_eval=times,
        args=(q,),
        rtol=tolerance,
        atol=tolerance * np.array([1e3, 1e3, 1e-1, 1.0, 10.0]),
        max_step=3e-3 if method == "DOP853" else 6e-3,
    )
    return solution.y[1] * RPM, solution.nfev


def compare_with_scipy() -> None:
    """One table row for each gap and method."""
    bench = reference_bench()
    print(
        f"18 s at 1 kHz, one thread, reference bench\n{'':34}{'ms':>9}{'RHS':>9}{'error rpm':>12}"
    )
    for gap in GAPS:
        p = bench.vector(gap_rad=gap, start_angle_rad=0.5)
        exact, _ = scipy_speed(p[0], "DOP853", REFERENCE_TOLERANCE)
        for accuracy in (0.1, 0.01, 0.001):
            speed = np.empty((1, SAMPLES))
            settling = settling_time_s(p, accuracy)[0]
            state = np.empty(STATES)
            times = np.arange(SAMPLES) / SAMPLING_HZ
            arguments = (p[0], settling, 1.0 / SAMPLING_HZ, times, accuracy)
            _, cost = kernel.simulate(*arguments, speed, state)
            error = np.max(np.abs(speed[0] - exact))
            for label, rows in (("speed", 1), ("all channels", 3)):
                out = np.empty((rows, SAMPLES))
                ms = fastest_ms(lambda: kernel.simulate(*arguments, out, state), 30)  # noqa: B023
                name = f"gap {gap:g}, {accuracy:g} rpm, {label}"
                print(f"{name:34}{ms:9.2f}{cost:9d}{error:12.5f}")
        for tolerance in LSODA_TOLERANCES:
            speed, cost = scipy_speed(p[0], "LSODA", tolerance)
            error = np.max(np.abs(speed - exact))
            ms = fastest_ms(lambda: scipy_speed(p[0], "LSODA", tolerance), 2)  # noqa: B023
            print(f"{f'gap {gap:g}, LSODA, rtol {tolerance:g}':34}{ms:9.1f}{cost:9d}{error:12.5f}")


def cost_of_effects() -> None:
    """Milliseconds with effects on, all channels, default accuracy."""
    settings: dict[str, dict[str, float]] = {
        "none": {},
        "load Coulomb friction": {"load_coulomb_friction__torque_nm": 15.0},
        "current and speed lag 1 ms": {
            "current_loop_lag__time_s": 1e-3,
            "speed_sensor_lag__time_s": 1e-3,
        },
        "hysteresis": {"shaft_hysteresis__torque_nm": 20.0, "shaft_hysteresis__angle_rad": 1e-3},
        "encoder eccentricity": {"encoder_eccentricity__angle_rad": 0.005},
        "torque ripple, order 8": {
            "motor_torque_ripple__torque_nm": 0.2,
            "motor_torque_ripple__order": 8.0,
        },
        "torque ripple, order 48": {
            "motor_torque_ripple__torque_nm": 0.2,
            "motor_torque_ripple__order": 48.0,
        },
        "transmission error, order 2": {
            "gear_transmission_error__angle_rad": 5e-5,
            "gear_transmission_error__order": 2.0,
        },
        "transmission error, order 48": {
            "gear_transmission_error__angle_rad": 2e-6,
            "gear_transmission_error__order": 48.0,
        },
        "speed skew 2 ms": {"channel_time_skew__speed_s": 2e-3},
    }
    print(
        "\n18 s with effects, all channels, 0.01 rpm (against 0.0001 rpm)\n"
        f"{'':34}{'ms':>9}{'RHS':>9}{'error rpm':>12}"
    )
    for name, values in settings.items():
        p = reference_bench().vector(gap_rad=8e-4, start_angle_rad=0.5, **values)
        ms = fastest_ms(lambda: simulate_channels(p, SAMPLES, SAMPLING_HZ), 10)  # noqa: B023
        speed = simulate_channels(p, SAMPLES, SAMPLING_HZ, speed_alone=True)[:, 0]
        exact = simulate_channels(p, SAMPLES, SAMPLING_HZ, accuracy_rpm=1e-4, speed_alone=True)[
            :, 0
        ]
        settling = settling_time_s(p, 0.01)[0]
        state, out = np.empty(STATES), np.empty((3, SAMPLES))
        times = np.arange(SAMPLES) / SAMPLING_HZ
        _, cost = kernel.simulate(p[0], settling, 1.0 / SAMPLING_HZ, times, 0.01, out, state)
        print(f"{name:34}{ms:9.2f}{cost:9d}{np.max(np.abs(speed - exact)):12.5f}")


def many_at_once() -> None:
    """Simulations a second over the cores."""
    gaps = np.geomspace(1e-4, 4e-3, 400)
    p = reference_bench().vector(gap_rad=gaps, start_angle_rad=np.linspace(0.0, 6.0, gaps.size))
    print("\n400 simulations of 18 s, speed, 0.01 rpm")
    for workers in sorted({1, os.cpu_count() or 1}):
        begin = time.perf_counter()
        simulate_channels(p, SAMPLES, SAMPLING_HZ, workers=workers, speed_alone=True)
        print(f"{workers} workers: {time.perf_counter() - begin:.2f} s")


if __name__ == "__main__":
    compare_with_scipy()
    cost_of_effects()
    many_at_once()
