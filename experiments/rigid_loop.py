"""A rigid drive under its speed controller, simulated apart from the package: what is named of it.

Runge and Kutta at fixed steps, any number of torques that repeat with the motor and of errors of
the encoder's angle, dry and viscous friction, a lag of the sensor; the controller is given the
noise. The bench believed knows inertia and gains within 5 %. Speeds, sizes, noise and gains are
drawn.

    bayesbl run configs/rigid_loop.toml
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numba
import numpy as np
import xarray as xr
from study_tools import StudyRow

from bayesbl.config.bench import load_bench
from bayesbl.config.kinds import DiagnoseConfig
from bayesbl.diagnosis.rigid.speed_loop import comparison
from bayesbl.diagnosis.task import Task
from bayesbl.recording.types import MOTOR_SPEED, Recording

RPM = 60.0 / (2.0 * math.pi)
STEPS = 10
"""In a sample."""


_jit = numba.njit(nogil=True)  # not cached: a study loads this file under a name of its own


@dataclass(frozen=True, slots=True)
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


@_jit
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


@_jit
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


BENCH = """
schema = 1
kind = "bench"
drive = "rigid"
[parameters]
gear_ratio = {value = 1.0}
motor_inertia_kg_m2 = {value = 2e-3, relative_tolerance = 0.05}
load_inertia_kg_m2 = {value = 1e-9}
speed_gain_nm_s_per_rad = {value = 0.15, relative_tolerance = 0.05}
integral_gain_nm_per_rad = {value = 4.0, relative_tolerance = 0.05}
"""
FREE = ("motor_inertia_kg_m2", "speed_gain_nm_s_per_rad", "integral_gain_nm_per_rad")
RIPPLE, ECCENTRICITY = "motor_torque_ripple", "encoder_eccentricity"


class Row(StudyRow):
    """A row: drives drawn anew, each recorded at five speeds, halves fitted and held out."""

    hidden: tuple[Literal["ripple", "eccentricity"], ...] = ()


COLUMNS = {
    "hidden": ("1", "laws that were hidden: three orders of a ripple, an eccentric encoder"),
    "named": ("1", "of these, named with their order"),
    "false_names": ("1", "names of what is not there, parameters included"),
    "worst_size": ("1", "largest relative error of a named size, of lines that stand out by 10 sd"),
    "worst_z": ("1", "largest error of a named size in its standard deviations"),
}


def drawn_drive(row: Row, rng: np.random.Generator) -> tuple[Drive, np.ndarray, float]:
    """A drive, its five speeds in rpm, and the noise of its speed in rpm."""
    drive = Drive(coulomb=rng.uniform(0.05, 0.5))
    for name in ("inertia", "speed_gain", "integral_gain"):
        drive = replace(drive, **{name: getattr(drive, name) * rng.uniform(0.95, 1.05)})
    phases = rng.uniform(0.0, 2.0 * math.pi, 4)
    torque = math.exp(rng.uniform(math.log(0.02), math.log(0.2)))
    angle = math.exp(rng.uniform(math.log(5e-4), math.log(5e-3)))
    if "ripple" in row.hidden:
        sizes = torque, 0.4 * torque, 0.2 * torque
        waves = tuple(zip((6.0, 12.0, 18.0), sizes, phases.tolist(), strict=False))
        drive = replace(drive, torques=waves)
    if "eccentricity" in row.hidden:
        drive = replace(drive, angles=((1.0, angle, float(phases[3])),))
    speeds = np.exp(rng.uniform(math.log(100.0), math.log(1500.0), 5)) * rng.choice([-1, 1], 5)
    return drive, speeds, rng.uniform(0.3, 2.0)


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One drive, through the method that a configuration asks for."""
    rng = np.random.default_rng(seed)
    drive, speeds, noise = drawn_drive(row, rng)
    made = [
        replace(recorded(drive, rpm, int(rng.integers(2**31)), noise_rpm=noise), name=f"{k}")
        for k, rpm in enumerate(speeds)
    ]
    with tempfile.TemporaryDirectory() as place:
        bench = Path(place, "bench.toml")
        bench.write_text(BENCH)
        config = DiagnoseConfig.model_validate(
            {
                "schema": 1,
                "kind": "diagnose",
                "run": {"output": place},
                "bench": str(bench),
                "unknowns": {"bench_parameters": list(FREE)},
                "recordings": [{"name": r.name, "file": str(bench), "use": "split"} for r in made],
            }
        )
        found = comparison(Task(config, load_bench(bench), tuple(made))).diagnose(None)
    truth = {(RIPPLE, order): size for order, size, _ in drive.torques}
    truth |= {(ECCENTRICITY, order): size for order, size, _ in drive.angles}
    sizes = {}
    for effect in found.effects:
        parameters = dict(effect.parameters)
        order = parameters.pop("order").value if "order" in parameters else 1.0
        sizes[effect.name, order] = next(iter(parameters.values()))
    hits = {key: sizes[key] for key in truth if key in sizes}
    return {
        "hidden": float(len(truth)),
        "named": float(len(hits)),
        "false_names": float(len(sizes.keys() - truth.keys()) + len(found.parameter_errors)),
        "worst_size": max(
            (abs(e.value / truth[k] - 1.0) for k, e in hits.items() if e.value > 10.0 * e.sd),
            default=0.0,
        ),
        "worst_z": max((abs(e.value - truth[k]) / e.sd for k, e in hits.items()), default=0.0),
    }


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """How many are named, how many falsely, and how far the sizes are off."""
    return {
        "drives": float(cases["named"].size),
        "hidden": float(cases["hidden"].values.sum()),
        "named": float(cases["named"].values.sum()),
        "false_names": float(cases["false_names"].values.sum()),
        "largest_size_error_%": 100.0 * float(cases["worst_size"].values.max()),
        "largest_z": float(cases["worst_z"].values.max()),
    }
