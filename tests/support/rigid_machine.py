"""A rigid machine on paper, for tests: prescribed motion, torque by formulas of its own, AR noise.

Shares nothing with the package but the equations; friction switches sign without smoothing.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from bayesbl.bench.bench import Bench, BenchParameter
from bayesbl.recording.types import MOTOR_POSITION, MOTOR_SPEED, MOTOR_TORQUE, Recording

RATIO = 100.0
MOTOR_INERTIA = 2e-3
LOAD_INERTIA = 60.0
GRAVITY = 300.0
SAMPLING_HZ = 250.0


def motion(seed: int, seconds: float = 8.0) -> tuple[np.ndarray, ...]:
    """Time, motor angle, speed and acceleration of slow sweeps to and fro, SI."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * SAMPLING_HZ)) / SAMPLING_HZ
    angle, speed, acceleration = (np.zeros_like(time) for _ in range(3))
    for cycles, size in ((0.13, 60.0), (0.31, 30.0), (0.73, 6.0)):
        w = 2.0 * np.pi * cycles * rng.uniform(0.9, 1.1)
        phase = rng.uniform(0.0, 2.0 * np.pi)
        angle += size * np.sin(w * time + phase)
        speed += size * w * np.cos(w * time + phase)
        acceleration -= size * w**2 * np.sin(w * time + phase)
    return time, angle, speed, acceleration


def ar_noise(rng: np.random.Generator, size: int, sd: float, coefficient: float) -> np.ndarray:
    """AR(1) noise of this standard deviation."""
    white = rng.standard_normal(size + 500) * sd * np.sqrt(1.0 - coefficient**2)
    return lfilter([1.0], [1.0, -coefficient], white)[500:]


def recording(
    name: str,
    seed: int,
    *,
    coulomb: float = 0.0,
    viscous: float = 0.0,
    stribeck: tuple[float, float] = (0.0, 1.0),
    ripple: tuple[float, float, float] = (0.0, 1.0, 0.0),
    offset: float = 0.0,
    noise: float = 0.1,
) -> Recording:
    """A recording of position, speed and torque."""
    time, angle, speed, acceleration = motion(seed)
    rng = np.random.default_rng(seed + 1000)
    torque = (MOTOR_INERTIA + LOAD_INERTIA / RATIO**2) * acceleration
    torque += GRAVITY / RATIO * np.sin(angle / RATIO)
    torque += coulomb * np.sign(speed) + viscous * speed + offset
    torque += stribeck[0] * np.exp(-((speed / stribeck[1]) ** 2)) * np.sign(speed)
    torque += ripple[0] * np.sin(ripple[1] * angle + ripple[2])
    torque += ar_noise(rng, time.size, noise, 0.6)
    channels = {
        MOTOR_POSITION: angle + 1e-4 * rng.standard_normal(time.size),
        MOTOR_SPEED: speed * 60.0 / (2.0 * np.pi),
        MOTOR_TORQUE: torque,
    }
    return Recording(name, time, channels)


def bench(**values: float) -> Bench:
    """The machine's own bench, nothing hidden in it."""
    known = {
        "gear_ratio": RATIO,
        "motor_inertia_kg_m2": MOTOR_INERTIA,
        "load_inertia_kg_m2": LOAD_INERTIA,
        "gravity_torque_nm": GRAVITY,
        "shaft_stiffness_nm_per_rad": 1e5,
        "shaft_damping_nm_s_per_rad": 100.0,
        "speed_gain_nm_s_per_rad": 0.2,
        "integral_gain_nm_per_rad": 2.0,
        "torque_constant_nm_per_a": 0.5,
        "current_limit_a": 40.0,
        "reference_speed_rpm": 300.0,
    }
    return Bench({k: BenchParameter(v) for k, v in (known | values).items()}, drive="rigid")
