"""What does a user get whose joint two other simulators made?

    bayesbl run configs/other_simulators.toml

The *integrator* takes classical steps of 10 µs through a dead zone; its teeth pull or do not, its
friction is dry. The *multibody* joints are MuJoCo's (``pip install mujoco``): motor and load as
bodies, the gap a hinge with stiff stops behind a spring, or a tendon with a dead band, which damps
in the gap too. Every controller is digital: it reads the speed of the instant, or a difference of
its encoder, and its torque acts at once or some ticks later. A bench file states its period in half
of the joints, never its dead time, and no friction; each value is off by up to its tolerance.
Neither simulator shares a line with the package's own, or with ``independent_bench.py``.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numba
import numpy as np
import other_joints
import xarray as xr
from other_joints import compared
from study_tools import StudyRow, written

from bayesbl.bench.bench import Bench, BenchEffect, BenchParameter, EffectParameterValue
from bayesbl.config.bench import dump_bench, reference_bench
from bayesbl.recording.types import (
    MOTOR_CURRENT,
    MOTOR_POSITION,
    MOTOR_SPEED,
    FloatArray,
    Recording,
)
from bayesbl.units import RPM_PER_RAD_PER_S

HZ = 1000.0
SETTLING_S = 8.0
ROTATIONS = 4.0
STEP_S = 1e-5
MULTIBODY_STEP_S = 5e-5
TORQUE_CONSTANT = 0.494
CURRENT_SD_A = 0.02

# Of each parameter: the range of its true value over the reference joint's, its tolerance.
DRAWN = {
    "motor_inertia_kg_m2": (0.7, 1.4, 0.03),
    "load_inertia_kg_m2": (0.6, 1.8, 0.05),
    "shaft_stiffness_nm_per_rad": (0.6, 1.8, 0.08),
    "shaft_damping_nm_s_per_rad": (0.6, 1.8, 0.2),
    "gravity_torque_nm": (0.6, 1.4, 0.04),
    "speed_gain_nm_s_per_rad": (0.7, 1.3, 0.01),
    "integral_gain_nm_per_rad": (0.7, 1.3, 0.01),
    "torque_constant_nm_per_a": (1.0, 1.0, 0.02),
}


class Row(StudyRow):
    """``joints`` of one simulator, with the motor's current or by its speed alone."""

    simulator: Literal["integrator", "multibody"]
    with_current: bool = True


COLUMNS = {
    "period_s": ("s", "of the controller"),
    "dead_periods": ("1", "until its torque acts"),
    "reads_instant": ("1", "1 where it reads the speed of the instant, 0 for a difference"),
    "period_stated": ("1", "1 where the bench file states its period"),
    "noise_rpm": ("rpm", "standard deviation of the speed's noise"),
    "last_rad": ("rad", "gap of the last recording"),
    **{name: about for name, about in other_joints.COLUMNS.items() if name != "frequency_hz"},
}


@dataclass(frozen=True, slots=True)
class Joint:
    """``values``: of the bench's parameters, SI; ``pulls``: teeth in contact may pull; ``counts``:
    of its encoder a turn, 0 for none; ``tendon``: of a multibody joint, else a spring."""

    values: Mapping[str, float]
    speed_rad_per_s: float
    period_s: float
    dead_periods: int
    reads_instant: bool
    noise_rpm: float
    motor_friction_nm: float
    load_friction_nm: float
    counts: int
    pulls: bool
    tendon: bool


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One joint, as a user would measure it."""
    rng = np.random.default_rng(seed)
    joint = drawn(row, rng)
    stated = bool(rng.integers(2))
    gap = math.exp(rng.uniform(*np.log([1e-4, 1.2e-3])))
    gaps = (gap, gap * rng.uniform(1.0, 1.5))
    values = {name: math.nan for name in COLUMNS}
    values |= {name: 0.0 for name in COLUMNS if name.endswith(("answered", "wrong", "refused"))}
    values |= {
        "period_s": joint.period_s,
        "dead_periods": float(joint.dead_periods),
        "reads_instant": float(joint.reads_instant),
        "period_stated": float(stated),
        "noise_rpm": joint.noise_rpm,
        "delta_rad": gaps[0],
        "last_rad": gaps[1],
    }
    simulated = by_steps if row.simulator == "integrator" else by_bodies
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bench = folder / "joint.toml"
        bench.write_text(dump_bench(data_sheet(joint, stated, rng)), encoding="utf-8")
        pair = []
        for place, own in enumerate(gaps):
            clean = simulated(joint, own, rng.uniform(0.0, 2.0 * math.pi))
            recording = recorded(row, joint, clean, f"snapshot_{place}", rng)
            pair.append(written(recording, folder / f"snapshot_{place}.csv"))
        return values | compared(f"{row.name} {index}", pair, bench, gaps, "direct")


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """As of other joints."""
    return other_joints.summarise(row, cases)


def drawn(row: Row, rng: np.random.Generator) -> Joint:
    """A joint at random."""
    reference = reference_bench()
    values = {
        name: reference.value(name) * rng.uniform(low, high)
        for name, (low, high, _) in DRAWN.items()
    }
    values["shaft_damping_nm_s_per_rad"] = values["shaft_stiffness_nm_per_rad"] * rng.uniform(
        1.5e-3, 3e-3
    )
    values["torque_constant_nm_per_a"] = TORQUE_CONSTANT
    values["gear_ratio"] = reference.value("gear_ratio")
    by_steps = row.simulator == "integrator"
    periods = (1.25e-4, 2.5e-4, 5e-4, 1e-3, 2e-3) if by_steps else (2.5e-4, 5e-4, 1e-3)
    return Joint(
        values,
        rng.choice([1000.0, 1500.0, 2000.0, 2500.0]) / RPM_PER_RAD_PER_S,
        float(rng.choice(periods)),
        int(rng.integers(3 if by_steps else 2)),
        bool(rng.integers(2)) if by_steps else True,
        float(rng.choice([0.05, 0.2, 1.0])),
        rng.uniform(0.0, 0.3) * (rng.random() < 0.7),
        rng.uniform(0.0, 0.05) * values["gravity_torque_nm"] * (rng.random() < 0.5) * by_steps,
        int(rng.choice([0, 0, 2**17, 2**20])) if by_steps else 0,
        bool(rng.integers(2)),
        bool(rng.integers(2)),
    )


def data_sheet(joint: Joint, stated: bool, rng: np.random.Generator) -> Bench:
    """Values off uniformly within their tolerances; with the controller's period where stated."""
    reference = replace(reference_bench(), gap_form="dead_zone")
    parameters = dict(reference.parameters)
    for name, (_, _, share) in DRAWN.items():
        value = joint.values[name] / (1.0 + share * rng.uniform(-1.0, 1.0))
        parameters[name] = BenchParameter(value, share * value)
    speed = joint.speed_rad_per_s * RPM_PER_RAD_PER_S
    parameters["reference_speed_rpm"] = BenchParameter(speed)
    bench = replace(reference, parameters=parameters)
    if not stated:
        return bench
    period = EffectParameterValue(joint.period_s)
    return bench.with_effects(BenchEffect("sampled_control", {"period_s": period}))


def recorded(
    row: Row, joint: Joint, clean: FloatArray, name: str, rng: np.random.Generator
) -> Recording:
    """Position, speed and torque at the recorder's times, (3, n), as a recording with noise."""
    position, speed, torque = clean
    noisy = speed * RPM_PER_RAD_PER_S + joint.noise_rpm * rng.standard_normal(speed.size)
    channels = {MOTOR_POSITION: position - position[0], MOTOR_SPEED: noisy}
    if row.with_current:
        added = CURRENT_SD_A * rng.standard_normal(speed.size)
        channels[MOTOR_CURRENT] = torque / TORQUE_CONSTANT + added
    return Recording(name, np.arange(speed.size) / HZ, channels)


def _samples(joint: Joint) -> int:
    rotation_s = 2.0 * math.pi * joint.values["gear_ratio"] / joint.speed_rad_per_s
    return int(ROTATIONS * rotation_s * HZ)


def by_steps(joint: Joint, gap_rad: float, start_rad: float) -> FloatArray:
    """Position, speed and torque of the motor, (3, n), every controller's tick or millisecond."""
    v = joint.values
    every = max(1, round(1.0 / (HZ * joint.period_s)))
    step = round(joint.period_s / STEP_S)
    ticks = _samples(joint) * every if joint.period_s < 1.0 / HZ else _ticks(joint)
    made = _integrated(
        np.array(
            [
                v["gear_ratio"],
                v["motor_inertia_kg_m2"],
                v["load_inertia_kg_m2"],
                v["shaft_stiffness_nm_per_rad"],
                v["shaft_damping_nm_s_per_rad"],
                v["gravity_torque_nm"],
                gap_rad,
                joint.motor_friction_nm,
                joint.load_friction_nm,
                float(joint.pulls),
            ]
        ),
        (v["speed_gain_nm_s_per_rad"], v["integral_gain_nm_per_rad"], joint.speed_rad_per_s),
        (joint.period_s, joint.reads_instant, joint.dead_periods, joint.counts),
        start_rad,
        (int(SETTLING_S / joint.period_s), ticks, step),
    )
    # A recorder that is faster than the loop sees each tick for several samples.
    repeated = max(1, round(joint.period_s * HZ))
    return np.asarray(np.repeat(made[:, ::every], repeated, axis=1))


def _ticks(joint: Joint) -> int:
    return int(_samples(joint) / (HZ * joint.period_s))


@numba.njit(cache=False)  # type: ignore[misc, untyped-decorator, unused-ignore]
def _integrated(p, loop, drive, start, counted):  # type: ignore[no-untyped-def]
    ratio, wanted = p[0], loop[2]
    period, instant, dead, counts = drive
    skipped, ticks, steps = counted
    state = np.array([start * ratio, wanted, 0.0, 0.0])
    summed, held, before = 0.0, 0.0, start * ratio - wanted * period
    waiting = np.zeros(4)
    out = np.zeros((3, ticks))
    h = period / steps
    for tick in range(skipped + ticks):
        angle = state[0]
        if counts > 0:
            count = 2.0 * np.pi / counts
            angle = np.floor(angle / count) * count
        speed = state[1] if instant else (angle - before) / period
        before = angle
        summed += (wanted - speed) * period
        demand = loop[0] * (wanted - speed) + loop[1] * summed
        if dead == 0:
            held = demand
        else:
            held = waiting[dead - 1]
            for i in range(dead - 1, 0, -1):
                waiting[i] = waiting[i - 1]
            waiting[0] = demand
        if tick >= skipped:
            out[:, tick - skipped] = angle, speed, held
        for _ in range(steps):
            k1 = _slope(state, held, p)
            k2 = _slope(state + 0.5 * h * k1, held, p)
            k3 = _slope(state + 0.5 * h * k2, held, p)
            k4 = _slope(state + h * k3, held, p)
            state = state + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
    return out


@numba.njit(cache=False)  # type: ignore[misc, untyped-decorator, unused-ignore]
def _slope(y, torque, p):  # type: ignore[no-untyped-def]
    ratio, motor, load, stiffness, damping, gravity, gap, at_motor, at_load, pulls = p
    angle, speed, twist, rate = y
    shaft = 0.0
    if abs(twist) > gap:
        side = 1.0 if twist > 0.0 else -1.0
        shaft = stiffness * (twist - side * gap) + damping * rate
        if pulls == 0.0 and shaft * side < 0.0:
            shaft = 0.0
    load_speed = speed / ratio - rate
    against = gravity * np.sin(angle / ratio - twist) + at_load * np.tanh(load_speed / 1e-3)
    motor_slope = (torque - shaft / ratio - at_motor * np.tanh(speed / 0.1)) / motor
    load_slope = (shaft - against) / load
    return np.array([speed, motor_slope, rate, motor_slope / ratio - load_slope])


def by_bodies(joint: Joint, gap_rad: float, start_rad: float) -> FloatArray:
    """The same by MuJoCo, every millisecond."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(_bodies(joint, gap_rad))
    data: Any = mujoco.MjData(model)
    v, wanted = joint.values, joint.speed_rad_per_s
    ratio = v["gear_ratio"]
    data.qpos[0], data.qvel[0] = start_rad, wanted / ratio
    every, sample = (round(s / MULTIBODY_STEP_S) for s in (joint.period_s, 1.0 / HZ))
    summed, held, waiting, out = 0.0, 0.0, [0.0] * joint.dead_periods, []
    skipped = round(SETTLING_S / MULTIBODY_STEP_S)
    for step in range(skipped + _samples(joint) * sample):
        if step % every == 0:
            error = wanted - data.qvel[0] * ratio
            summed += error * joint.period_s
            waiting.append(
                v["speed_gain_nm_s_per_rad"] * error + v["integral_gain_nm_per_rad"] * summed
            )
            held = waiting.pop(0)
        data.ctrl[0] = held
        if step >= skipped and (step - skipped) % sample == 0:
            out.append((data.qpos[0] * ratio, data.qvel[0] * ratio, held))
        mujoco.mj_step(model, data)
    return np.array(out).T


def _bodies(joint: Joint, gap_rad: float) -> str:
    """All as it is at the load: the motor has the inertia of its rotor behind the gear."""
    v = joint.values
    ratio, inertia, gravity = v["gear_ratio"], v["load_inertia_kg_m2"], v["gravity_torque_nm"]
    # A point mass on an arm that leaves inertia about its own centre.
    arm = min(0.5, 0.6 * inertia * 9.81 / gravity)
    mass = gravity / 9.81 / arm
    own = inertia - mass * arm**2
    load = f'<inertial pos="0 0 {-arm}" mass="{mass}" diaginertia="{own} {own} {own}"/>'
    stiffness, damping = v["shaft_stiffness_nm_per_rad"], v["shaft_damping_nm_s_per_rad"]
    tendon = ""
    if joint.tendon:
        tendon = f"""<tendon><fixed springlength="{-gap_rad} {gap_rad}" stiffness="{stiffness}"
            damping="{damping}"><joint joint="gap" coef="1"/></fixed></tendon>"""
        behind = f"""<body><joint name="gap" type="hinge" axis="0 1 0"/>{load}</body>"""
    else:
        behind = f"""<body><joint type="hinge" axis="0 1 0" stiffness="{stiffness}"
            damping="{damping}"/><inertial pos="0 0 0" mass="0.01" diaginertia="0.02 0.02 0.02"/>
            <body><joint type="hinge" axis="0 1 0" limited="true" range="{-gap_rad} {gap_rad}"
            solreflimit="0.0006 1" solimplimit="0.99 0.999 0.00001"/>{load}</body></body>"""
    rotor = v["motor_inertia_kg_m2"] * ratio**2 - 1e-3
    return f"""<mujoco><compiler angle="radian"/>
        <option timestep="{MULTIBODY_STEP_S}" integrator="implicitfast" gravity="0 0 -9.81"
            iterations="100" tolerance="1e-12"/>
        <worldbody><body><joint name="motor" type="hinge" axis="0 1 0" armature="{rotor}"
            frictionloss="{joint.motor_friction_nm * ratio}"/>
            <inertial pos="0 0 0" mass="0.001" diaginertia="0.001 0.001 0.001"/>{behind}</body>
        </worldbody>{tendon}
        <actuator><motor joint="motor" gear="{ratio}"/></actuator></mujoco>"""
