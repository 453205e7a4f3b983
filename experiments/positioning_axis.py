"""A rigid positioning axis, simulated apart from the package, and how often its laws are named.

The axis moves to and fro under a cascaded position loop and rests between moves. Friction is dry,
without any smoothing: a time step's impulse of friction stops the axis or opposes it (Moreau 1988).
Speeds are drawn over nearly three decades, and every torque is drawn relative to the Coulomb
friction, whose own unit is drawn too: nothing here has a size that a naming could know beforehand.

    bayesbl run configs/positioning_axis.toml
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np
import xarray as xr
from pydantic import Field
from study_tools import StudyRow, written

from bayesbl.bench.bench import Bench, BenchParameter
from bayesbl.config.bench import dump_bench, load_bench
from bayesbl.config.kinds import DiagnoseConfig
from bayesbl.diagnosis.rigid.inverse import comparison
from bayesbl.diagnosis.task import Task
from bayesbl.recording.readers import read_recording
from bayesbl.recording.types import MOTOR_POSITION, MOTOR_TORQUE, Recording

STEPS = 10
"""Time steps in a sample."""

_jit = numba.njit(nogil=True)  # not cached: a study loads this file under a name of its own


@dataclass(frozen=True, slots=True)
class Axis:
    """What only its maker knows; SI.

    Attributes
    ----------
    stribeck_nm, stribeck_speed_rad_per_s
        Friction above Coulomb's at standstill, and the speed over which it fades.
    count_rad, torque_noise_nm
        Step of the encoder; standard deviation of the white noise of the torque.
    """

    inertia_kg_m2: float
    coulomb_nm: float
    viscous_nm_s_per_rad: float
    offset_nm: float
    stribeck_nm: float
    stribeck_speed_rad_per_s: float
    top_speed_rad_per_s: float
    acceleration_rad_per_s2: float
    travel_rad: float
    rest_s: float
    count_rad: float
    torque_noise_nm: float


def drawn_axis(rng: np.random.Generator) -> Axis:
    """An axis with a top speed between 0.05 and 20 rad/s."""
    speed = math.exp(rng.uniform(math.log(0.05), math.log(20.0)))
    coulomb = math.exp(rng.uniform(math.log(0.05), math.log(50.0)))
    acceleration = speed / rng.uniform(0.05, 0.3)
    travel = speed * rng.uniform(0.5, 1.5)
    return Axis(
        inertia_kg_m2=coulomb * rng.uniform(1.0, 5.0) / acceleration,
        coulomb_nm=coulomb,
        viscous_nm_s_per_rad=coulomb * rng.uniform(0.5, 3.0) / speed,
        offset_nm=coulomb * rng.uniform(0.1, 0.4) * rng.choice([-1.0, 1.0]),
        stribeck_nm=coulomb * rng.uniform(0.0, 0.15),
        stribeck_speed_rad_per_s=speed * rng.uniform(0.02, 0.1),
        top_speed_rad_per_s=speed,
        acceleration_rad_per_s2=acceleration,
        travel_rad=travel,
        rest_s=rng.uniform(0.0, 0.5),
        count_rad=travel * math.exp(rng.uniform(math.log(1e-5), math.log(1e-3))),
        torque_noise_nm=coulomb * math.exp(rng.uniform(math.log(0.01), math.log(0.2))),
    )


def reference(axis: Axis, time_s: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Trapezoidal moves to and fro of different length and speed, rests between; rad."""
    position = np.zeros_like(time_s)
    begin, at, forward = 0.2, 0.0, True
    while begin < time_s[-1]:
        target = axis.travel_rad * (rng.uniform(0.6, 1.0) if forward else rng.uniform(0.0, 0.4))
        way = abs(target - at)
        speed = min(
            axis.top_speed_rad_per_s * rng.uniform(0.3, 1.0),
            math.sqrt(way * axis.acceleration_rad_per_s2),
        )
        ramp = speed / axis.acceleration_rad_per_s2
        lasting = way / speed + ramp
        t = np.clip(time_s - begin, 0.0, lasting)
        up, down = np.minimum(t, ramp), np.maximum(t - (lasting - ramp), 0.0)
        half = 0.5 * axis.acceleration_rad_per_s2
        gone = half * up**2 + speed * np.maximum(t - ramp, 0.0) - half * down**2
        position += math.copysign(1.0, target - at) * gone
        begin, at, forward = begin + lasting + axis.rest_s, target, not forward
    return position


@_jit
def _run(wanted, step, steps, j, tc, b, t0, ts, vs, count, kp, kv):  # type: ignore[no-untyped-def]
    n = wanted.size
    seen, torque = np.empty(n), np.empty(n)
    x = 0.0
    v = 0.0
    for i in range(n):
        seen[i] = round(x / count) * count
        force = kv * (kp * (wanted[i] - seen[i]) - v)
        torque[i] = force
        for _ in range(steps):
            free = v + step * (force - b * v - t0) / j
            stop = step * (tc + ts * math.exp(-((v / vs) ** 2))) / j
            old = v
            v = 0.0 if abs(free) <= stop else free - math.copysign(stop, free)
            x += 0.5 * step * (old + v)
    return seen, torque


def recorded(
    axis: Axis, name: str, rng: np.random.Generator, *, lasting_s: float = 20.0, hz: float = 1000.0
) -> Recording:
    """Position by the encoder and torque with noise."""
    time = np.arange(round(lasting_s * hz)) / hz
    bandwidth = 2.0 * math.pi * 12.0
    position, torque = _run(
        reference(axis, time, rng),
        1.0 / hz / STEPS,
        STEPS,
        axis.inertia_kg_m2,
        axis.coulomb_nm,
        axis.viscous_nm_s_per_rad,
        axis.offset_nm,
        axis.stribeck_nm,
        axis.stribeck_speed_rad_per_s,
        axis.count_rad,
        0.3 * bandwidth,
        axis.inertia_kg_m2 * bandwidth,
    )
    # Held from one sample to the next, and measured as its mean around a sample.
    torque = 0.5 * (torque + np.concatenate((torque[:1], torque[:-1])))
    torque = torque + axis.torque_noise_nm * rng.standard_normal(time.size)
    return Recording(name, time, {MOTOR_POSITION: position, MOTOR_TORQUE: torque})


def believed(axis: Axis) -> Bench:
    """A rigid bench without friction, its inertia a fifth too small."""
    inertia = BenchParameter(0.8 * axis.inertia_kg_m2, 0.5 * axis.inertia_kg_m2)
    known = {
        "gear_ratio": 1.0,
        "load_inertia_kg_m2": 1e-9 * axis.inertia_kg_m2,
        "shaft_stiffness_nm_per_rad": 1.0,
        "shaft_damping_nm_s_per_rad": 0.0,
        "speed_gain_nm_s_per_rad": 1.0,
        "integral_gain_nm_per_rad": 0.0,
        "torque_constant_nm_per_a": 1.0,
        "current_limit_a": 1.0,
        "reference_speed_rpm": 1.0,
    }
    idle = frozenset(known) - {"gear_ratio", "load_inertia_kg_m2"}
    values = {name: BenchParameter(value) for name, value in known.items()}
    return Bench({**values, "motor_inertia_kg_m2": inertia}, drive="rigid", assumed=idle)


class Row(StudyRow):
    """A row: axes drawn anew, one recording to fit on and one held out."""

    lasting_s: float = Field(default=20.0, gt=0.0)
    sampling_hz: float = Field(default=1000.0, gt=0.0)


COLUMNS = {
    "coulomb": ("1", "named Coulomb friction over the true one; 0 if it is not named"),
    "viscous": ("1", "the same of viscous friction"),
    "offset": ("1", "the same of the offset"),
    "stribeck": ("1", "1 where Stribeck friction is named too"),
    "others": ("1", "names of what is not there"),
    "held_out": ("1", "RMS of the held-out recording after naming, in Coulomb frictions"),
}

_LAWS = {
    "coulomb": "motor_coulomb_friction",
    "viscous": "motor_viscous_friction",
    "offset": "motor_torque_offset",
}
WITHIN = 0.05


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One axis, through the files that a user has."""
    rng = np.random.default_rng(seed)
    axis = drawn_axis(rng)
    made = [
        recorded(axis, name, rng, lasting_s=row.lasting_s, hz=row.sampling_hz)
        for name in ("fit", "hold_out")
    ]
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        bench = folder / "bench.toml"
        bench.write_text(dump_bench(believed(axis)))
        entries = []
        for recording in made:
            file = written(recording, folder / f"{recording.name}.csv", "%.12g")
            entries.append({"name": recording.name, "file": str(file), "use": recording.name})
        config = DiagnoseConfig.model_validate(
            {
                "schema": 1,
                "kind": "diagnose",
                "run": {"output": str(folder / "result")},
                "bench": str(bench),
                "comparison": {"method": "inverse"},
                "unknowns": {"bench_parameters": ["motor_inertia_kg_m2"]},
                "recordings": entries,
            }
        )
        recordings = tuple(read_recording(entry["file"]) for entry in entries)
        found = comparison(Task(config, load_bench(bench), recordings)).diagnose(None)
    named = {e.name: next(iter(e.parameters.values())).value for e in found.effects}
    truth = (axis.coulomb_nm, axis.viscous_nm_s_per_rad, axis.offset_nm)
    shares = {
        short: named.get(name, 0.0) / value
        for (short, name), value in zip(_LAWS.items(), truth, strict=True)
    }
    known = {*_LAWS.values(), "motor_stribeck_friction"}
    return {
        **shares,
        "stribeck": float("motor_stribeck_friction" in named),
        "others": float(len(named.keys() - known)),
        "held_out": found.disagreement["over_all"]["held_out"]["after"] / axis.coulomb_nm,
    }


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """How many have all three within 5 %, the largest error, and how many false names there are."""
    shares = np.stack([cases[short].values for short in _LAWS])
    errors = np.abs(shares - 1.0).max(axis=0)
    return {
        "axes": float(errors.size),
        "all_three_within_5_%": float(np.count_nonzero(errors < WITHIN)),
        "median_error_%": 100.0 * float(np.median(errors)),
        "largest_error_%": 100.0 * float(errors.max()),
        "with_stribeck": float(cases["stribeck"].values.sum()),
        "false_names": float(cases["others"].values.sum()),
    }
