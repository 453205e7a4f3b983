"""A rigid drive under its speed controller on paper, for tests: Runge and Kutta, fixed steps.

Shares nothing with the package but the equations. Any number of torques that repeat with the motor,
errors of the encoder's angle, lags, dry and viscous friction; the controller sees the noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

from bayesbl.recording.types import MOTOR_SPEED, Recording

RPM = 60.0 / (2.0 * math.pi)
STEPS = 10
"""In a sample."""


@dataclass(frozen=True)
class Drive:
    """SI; waves as (order, size, phase): torques in N m that brake, errors of the angle in rad."""

    inertia: float = 2e-3
    speed_gain: float = 0.15
    integral_gain: float = 4.0
    coulomb: float = 0.3
    viscous: float = 0.0
    sensor_lag_s: float = 0.0
    torques: tuple[tuple[float, float, float], ...] = ()
    angles: tuple[tuple[float, float, float], ...] = ()
    hum: tuple[float, float] = (0.0, 0.0)  # frequency in Hz and size in N m


@numba.njit(cache=True)
def _slopes(t, y, noise, p, torques, angles, out):  # type: ignore[no-untyped-def]
    inertia, kp, ki, coulomb, viscous, lag, reference, hum_hz, hum = p
    angle, speed, integral, shown = y
    seen = speed
    for order, size, phase in angles:
        seen += size * order * speed * math.cos(order * angle + phase)
    measured = shown if lag > 0.0 else seen
    error = reference - measured - noise
    lost = coulomb * math.tanh(speed / 0.1) + viscous * speed
    for order, size, phase in torques:
        lost += size * math.sin(order * angle + phase)
    lost += hum * math.sin(2.0 * math.pi * hum_hz * t)
    out[0] = speed
    out[1] = (kp * error + ki * integral - lost) / inertia
    out[2] = error
    out[3] = (seen - shown) / lag if lag > 0.0 else 0.0
    return measured


@numba.njit(cache=True)
def _run(y, noise, step, steps, settling, p, torques, angles):  # type: ignore[no-untyped-def]
    n = noise.size - settling
    speeds = np.empty(n)
    k = np.empty((4, 4))
    for i in range(noise.size):
        for j in range(steps):
            t = (i * steps + j) * step
            measured = _slopes(t, y, noise[i], p, torques, angles, k[0])
            if j == 0 and i >= settling:
                speeds[i - settling] = measured + noise[i]
            _slopes(t + 0.5 * step, y + 0.5 * step * k[0], noise[i], p, torques, angles, k[1])
            _slopes(t + 0.5 * step, y + 0.5 * step * k[1], noise[i], p, torques, angles, k[2])
            _slopes(t + step, y + step * k[2], noise[i], p, torques, angles, k[3])
            y += step / 6.0 * (k[0] + 2.0 * (k[1] + k[2]) + k[3])
    return speeds


def recorded(
    drive: Drive,
    rpm: float,
    seed: int,
    *,
    lasting_s: float = 6.0,
    hz: float = 1000.0,
    noise_rpm: float = 1.0,
) -> Recording:
    """The speed that the controller is given, in steady rotation from a random angle."""
    rng = np.random.default_rng(seed)
    settling = round(hz)
    noise = noise_rpm / RPM * rng.standard_normal(round(lasting_s * hz) + settling)
    start = np.array([rng.uniform(0.0, 2.0 * math.pi), rpm / RPM, 0.0, rpm / RPM])
    start[2] = (math.copysign(drive.coulomb, rpm) + drive.viscous * rpm / RPM) / drive.integral_gain
    p = (
        drive.inertia,
        drive.speed_gain,
        drive.integral_gain,
        drive.coulomb,
        drive.viscous,
        drive.sensor_lag_s,
        rpm / RPM,
        *drive.hum,
    )
    waves = [np.array(w or ((1.0, 0.0, 0.0),)) for w in (drive.torques, drive.angles)]
    speed = RPM * _run(start, noise, 1.0 / hz / STEPS, STEPS, settling, p, *waves)
    time = np.arange(speed.size) / hz
    name = f"{abs(rpm):g} rpm{' reverse' if rpm < 0.0 else ''}"
    return Recording(name, time, {MOTOR_SPEED: speed})
