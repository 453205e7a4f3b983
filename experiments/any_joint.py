"""Does every command end in an answer or in a sentence, whatever the joint? Joints drawn at random.

A case draws a joint, a motion and what its bench file does not know, writes the files that a user
has, and gives commands in this process. It counts how they end. A command that ends in a traceback
is counted and printed; nothing here says whether an answer is right.

    bayesbl run configs/any_joint.toml
"""

from __future__ import annotations

import io
import math
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import xarray as xr
from study_tools import StudyRow, write_csv

from bayesbl.bench.bench import Bench, BenchEffect, BenchParameter, EffectParameterValue
from bayesbl.bench.effect_declaration import ORDER, PHASE, RigidLaw
from bayesbl.cli import FAILED, WITHHELD, WRONG, status
from bayesbl.config.bench import dump_bench, reference_bench
from bayesbl.diagnosis.rigid.inverse import SKEW, TORQUE_LAWS, required_torque
from bayesbl.diagnosis.rigid.motion import Motion
from bayesbl.units import RPM_PER_RAD_PER_S

COLUMNS = {
    "answered": ("1", "commands that answered"),
    "withheld": ("1", "commands that withheld an answer, with a reason"),
    "refused": ("1", "commands that refused, with a sentence"),
    "tracebacks": ("1", "commands that ended in a traceback, or without a word"),
}


class Row(StudyRow):
    """A row: so many joints of one kind."""

    joint: Literal["rigid", "turning"]


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One joint: how its commands end."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        commands = JOINTS[row.joint](rng)
        ends = [ending(command, f"{row.joint} {index}") for command in commands]
    return {name: float(ends.count(name)) for name in COLUMNS}


def ending(command: Sequence[str], case: str) -> str:
    """How a command ends."""
    said = io.StringIO()
    with redirect_stdout(said), redirect_stderr(said):
        code = status(command)
    if code == FAILED or "Traceback" in said.getvalue() or not said.getvalue().strip():
        print(f"{case}: {' '.join(command)}\n{said.getvalue()}", file=sys.stderr)
        return "tracebacks"
    return {WRONG: "refused", WITHHELD: "withheld"}.get(code, "answered")


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """How all commands ended."""
    return {
        "joints": float(cases.sizes["case"]),
        **{name: float(cases[name].values.sum()) for name in COLUMNS},
    }


# A rigid axis


@dataclass(frozen=True, slots=True)
class Machine:
    """A rigid axis and how it is recorded: a sampling rate and names of channels."""

    bench: Bench
    hz: float
    seconds: float
    channels: tuple[str, ...]


def rigid(rng: np.random.Generator) -> list[list[str]]:
    """Recordings of an axis with some effects, its bench file without them; two diagnoses."""
    machine = drawn_machine(rng)
    hidden = rng.choice(sorted(TORQUE_LAWS), rng.integers(0, 6), replace=False)
    strengths = {str(name): math.exp(rng.uniform(math.log(0.01), math.log(2.0))) for name in hidden}
    shapes = {name: drawn_shape(rng) for name in strengths}
    moved = MOTIONS[int(rng.integers(len(MOTIONS)))]
    names = [f"r{k}.csv" for k in range(rng.integers(1, 4))]
    for name in names:
        write_rigid(name, rng, machine, moved, strengths, shapes)
    Path("bench.toml").write_text(dump_bench(machine.bench))
    Path("diagnose.toml").write_text(drawn_configuration(rng, names, machine.channels))
    commands = [["check", "diagnose.toml"], ["diagnose", "diagnose.toml", "--no-figures"]]
    if rng.random() < 0.3:
        commands.append(["diagnose", *names, "--bench", "bench.toml", "--no-figures"])
    return commands


def drawn_machine(rng: np.random.Generator) -> Machine:
    """Of any size, with or without a gear and gravity; its bench file may know them badly."""
    ratio = float(rng.choice([1.0, 6.0, 100.0, 257.0]))
    inertia = math.exp(rng.uniform(math.log(1e-5), math.log(1.0)))
    parameters = {
        "gear_ratio": ratio,
        "motor_inertia_kg_m2": inertia,
        "load_inertia_kg_m2": inertia * ratio**2 * rng.uniform(0.0, 5.0) + 1e-9,
        "gravity_torque_nm": rng.choice([0.0, inertia * ratio * 10.0 ** rng.uniform(0.0, 4.0)]),
        "torque_constant_nm_per_a": 0.5,
        "current_limit_a": 1e6,
        "shaft_stiffness_nm_per_rad": 1e5,
        "shaft_damping_nm_s_per_rad": 100.0,
        "speed_gain_nm_s_per_rad": 0.2,
        "integral_gain_nm_per_rad": 2.0,
        "reference_speed_rpm": 300.0,
    }
    tolerant = rng.random(len(parameters)) < 0.3
    bench = Bench(
        {
            name: BenchParameter(float(value), 0.1 * float(value) * is_tolerant)
            for (name, value), is_tolerant in zip(parameters.items(), tolerant, strict=True)
        },
        drive="rigid",
    )
    torque = str(rng.choice(["motor_torque_nm", "motor_current_a"]))
    motion = [
        ["motor_position_rad"],
        ["motor_speed_rpm"],
        ["motor_position_rad", "motor_speed_rpm"],
    ]
    channels = [
        *motion[rng.integers(3)],
        torque,
        *rng.choice(["load_position_rad"], rng.integers(2)),
    ]
    return Machine(bench, float(rng.choice([150.0, 250.0])), rng.uniform(4.0, 6.0), tuple(channels))


def sines(rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """To and fro, rad."""
    speed = math.exp(rng.uniform(math.log(0.1), math.log(300.0)))
    rates = 2.0 * math.pi * rng.uniform(0.1, 2.0, 3)
    phases = rng.uniform(0.0, 2.0 * math.pi, 3)
    waves = [speed / w * np.sin(w * time + p) for w, p in zip(rates, phases, strict=True)]
    return np.asarray(sum(waves))


def turning(rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """One way, at one speed, rad."""
    return np.asarray(rng.choice([-1.0, 1.0]) * math.exp(rng.uniform(-2.0, 6.0)) * time)


def moves(rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """From place to place with rests, rad."""
    stops = np.sort(rng.uniform(0.0, time[-1], 2 * rng.integers(1, 6)))
    places = math.exp(rng.uniform(-1.0, 5.0)) * rng.standard_normal(stops.size // 2 + 1)
    position = np.full(time.size, places[0])
    for k, (start, stop) in enumerate(zip(stops[::2], stops[1::2], strict=True)):
        x = np.clip((time - start) / (stop - start), 0.0, 1.0)
        position += (places[k + 1] - places[k]) * x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    return position


def resting(rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """Not at all, or once."""
    return np.where(time > rng.uniform(-1.0, 1.0) * time[-1], 1e-3 * rng.standard_normal(), 0.0)


MOTIONS: Sequence[Callable[[np.random.Generator, np.ndarray], np.ndarray]] = (
    sines,
    sines,
    moves,
    moves,
    turning,
    resting,
)


def drawn_shape(rng: np.random.Generator) -> dict[str, float]:
    """What an effect is not linear in: an order or a speed in units of the RMS speed; a phase."""
    order = float(rng.choice([1.0, 2.0, 7.0, rng.uniform(0.5, 64.0)]))
    return {
        ORDER: order,
        PHASE: rng.uniform(-math.pi, math.pi),
        "speed": 10.0 ** rng.uniform(-2, 0),
    }


def write_rigid(
    name: str,
    rng: np.random.Generator,
    machine: Machine,
    moved: Callable[[np.random.Generator, np.ndarray], np.ndarray],
    strengths: Mapping[str, float],
    shapes: Mapping[str, Mapping[str, float]],
) -> None:
    """A recording of what this motion takes, with noise, an encoder's steps, and odd ends."""
    time = np.arange(round(machine.seconds * machine.hz)) / machine.hz
    angle = moved(rng, time)
    speed = np.gradient(angle, time)
    acceleration = np.gradient(speed, time)
    sway = np.gradient(np.gradient(np.exp(1j * angle), time), time)
    motion = Motion(time, angle, speed, acceleration, sway)
    bench = machine.bench.with_parameters(
        motor_inertia_kg_m2=machine.bench.value("motor_inertia_kg_m2") * rng.choice([1.0, 0.6, 1.5])
    )
    torque = required_torque(motion, bench)
    scale = float(np.sqrt(np.mean(torque**2))) or 1e-3
    for effect, strength in strengths.items():
        law = TORQUE_LAWS[effect]
        signal = law.signal(motion, bench, unit_of(law, motion, shapes[effect]))
        size = float(np.sqrt(np.mean(signal**2)))
        torque = torque + (strength * scale / size * signal if size > 0.0 else 0.0)
        if effect == SKEW:
            torque = np.interp(time - rng.uniform(-0.01, 0.01), time, torque)
    noise = scale * math.exp(rng.uniform(math.log(1e-4), 0.0))
    torque = torque + noise * rng.standard_normal(time.size)
    count = math.exp(rng.uniform(math.log(1e-6), math.log(1e-2)))
    load = angle / bench.value("gear_ratio") + 1e-4 * np.sign(speed)
    made = {
        "time_s": time,
        "motor_position_rad": np.round(angle / count) * count,
        "motor_speed_rpm": RPM_PER_RAD_PER_S * (speed + count * rng.standard_normal(time.size)),
        "motor_torque_nm": torque,
        "motor_current_a": torque / bench.value("torque_constant_nm_per_a"),
        "load_position_rad": load + 1e-6 * rng.standard_normal(time.size),
    }
    write_csv({channel: made[channel] for channel in ("time_s", *machine.channels)}, Path(name))


def unit_of(law: RigidLaw, motion: Motion, shape: Mapping[str, float]) -> dict[str, float]:
    """Parameters of one unit of an effect."""
    parameters = dict.fromkeys((law.amplitude, *law.linear), 1.0)
    if law.scanned == ORDER:
        parameters[ORDER] = shape[ORDER]
    elif law.scanned is not None:
        unit = float(np.sqrt(np.mean(motion.speed**2))) or 1.0
        parameters[law.scanned] = shape["speed"] * unit
    return {**parameters, PHASE: shape[PHASE]}


KNOWN_BY = {"load_angle_known": "load_position_rad", "motor_angle_known": "motor_position_rad"}


def drawn_configuration(
    rng: np.random.Generator, names: Sequence[str], channels: Sequence[str]
) -> str:
    """What a user may say of the comparison."""
    lines = ["schema = 1", 'kind = "diagnose"', 'bench = "bench.toml"', "[comparison]"]
    lines.append(f'method = "{rng.choice(["inverse", "inverse", "inverse", "free_motion"])}"')
    for key, channel in KNOWN_BY.items():
        # A mistake now and then: whoever says it where no channel shows it is refused.
        known = rng.random() < (0.5 if channel in channels else 0.05)
        lines.append(f"{key} = {str(known).lower()}")
    if rng.random() < 0.3:
        lines.append(f"cutoff_hz = {rng.uniform(2.0, 60.0):.3g}")
    unknown = [[], ["motor_inertia_kg_m2"], ["load_inertia_kg_m2"], ["gravity_torque_nm"]]
    lines += ["[unknowns]", f"bench_parameters = {unknown[rng.integers(4)]}"]
    uses = ["split"] if len(names) == 1 else [*["fit"] * (len(names) - 1), "hold_out"]
    for name, use in zip(names, uses, strict=True):
        lines += ["[[recordings]]", f'name = "{name[:-4]}"', f'file = "{name}"', f'use = "{use}"']
    return "\n".join(lines).replace("'", '"') + "\n"


# A joint with a gap that turns at one speed


def turning_joint(rng: np.random.Generator) -> list[list[str]]:
    """Two recordings of a joint that gravity may load to any side or not at all."""
    bench = reference_bench()
    ratio = float(rng.choice([60.0, 120.0]))
    torques = {
        "load_torque_offset": float(rng.choice([0.0, rng.uniform(-900.0, 900.0)])),
        "load_coulomb_friction": float(rng.choice([0.0, rng.uniform(0.0, 100.0)])),
    }
    lag = {"current_loop_lag": {"time_s": 5e-4}, "sampled_control": {"period_s": 1e-3}}
    effects = [
        BenchEffect(name, {"torque_nm": EffectParameterValue(torque)})
        for name, torque in torques.items()
        if torque
    ]
    effects += [
        BenchEffect(name, {k: EffectParameterValue(v) for k, v in parameters.items()})
        for name, parameters in lag.items()
        if rng.random() < 0.2
    ]
    gravity = float(rng.choice([0.0, 0.0, 5.0, rng.uniform(20.0, 600.0)]))
    speed = float(rng.choice([-1.0, 1.0]) * rng.uniform(600.0, 2500.0)) * ratio / 120.0
    bench = bench.with_effects(*effects).with_parameters(
        gravity_torque_nm=gravity,
        gear_ratio=ratio,
        reference_speed_rpm=speed,
        current_limit_a=200.0,
    )
    known = bench.with_effects() if rng.random() < 0.3 else bench
    Path("bench.toml").write_text(dump_bench(known))
    Path("sweep.toml").write_text(
        'schema = 1\nkind = "sweep"\nbench = "bench.toml"\n[sweep]\nbench_draws = 0\n'
        "gap_rad = {low = 2e-4, high = 2e-3, count = 5}\nstart_angles = 2\nrotations = 2.3\n"
        "sampling_hz = 250\ndegree = 2\n"
    )
    Path("short.toml").write_text(
        'schema = 1\nkind = "compare"\n[posterior]\nensembles = 2\nmax_steps = 300\n'
    )
    for name in ("a.csv", "b.csv"):
        write_turning(name, rng, bench)
    by_bench = ["--bench", "bench.toml", "--no-figures"]
    commands = [["check", "sweep.toml"], ["sweep", "sweep.toml", "--no-figures"]]
    short = ["--config", "short.toml", "--no-figures"]
    route = str(rng.choice(["auto", "direct", "amplitude"]))
    measured = [
        ["fit", "a.csv", *by_bench, "--route", route],
        ["fit", "a.csv", *short],
        ["compare", "a.csv", "b.csv", *short],
        ["compare", "a.csv", "b.csv", *by_bench, "--route", route],
        ["plan", *by_bench],
    ]
    return [*commands, *(measured[i] for i in rng.choice(5, 2, replace=False))]


def write_turning(name: str, rng: np.random.Generator, bench: Bench) -> None:
    """A recording with noise, and maybe without a current."""
    seen = bench.simulate(
        math.exp(rng.uniform(math.log(2e-4), math.log(2e-3))),
        rotations=float(rng.uniform(2.2, 4.0)),
        sampling_hz=float(rng.choice([200.0, 500.0])),
        start_angle_rad=float(rng.uniform(0.0, 2.0 * math.pi)),
    )
    speed, current = seen.channels["motor_speed_rpm"], seen.channels["motor_current_a"]
    noise = math.exp(rng.uniform(math.log(1e-3), math.log(5.0)))
    shaken = float(rng.choice([0.0, 5.0])) * np.sin(2.0 * math.pi * 9.7 * seen.time_s)
    columns = {
        "time_s": seen.time_s,
        "motor_speed_rpm": speed + shaken + noise * rng.standard_normal(speed.size),
    }
    if rng.random() < 0.8:
        columns["motor_current_a"] = current + 0.02 * noise * rng.standard_normal(speed.size)
    write_csv(columns, Path(name))


JOINTS: Mapping[str, Callable[[np.random.Generator], list[list[str]]]] = {
    "rigid": rigid,
    "turning": turning_joint,
}
