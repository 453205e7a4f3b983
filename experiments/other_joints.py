"""What does a user get whose joint is not built as the bench?

    bayesbl run configs/other_joints_core.toml      # or other_joints.toml

A case is a joint of ``independent_bench.py`` with a part that its data sheet does not know: a belt,
an elastic arm, a base that gives way, a gap that varies over the load's angle, a second gap, or
something that shakes it. Parameters lie within a fifth of the reference bench; the data sheet is
off by up to 15 % in each. As a user would: files, then ``compare`` of two recordings between which
the gap grew by a quarter. Only the package's public functions are used.

An answer is *confidently wrong* where its outcome is converged or usable and an interval of 99 %
excludes the truth.
"""

from __future__ import annotations

import math
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from time import perf_counter
from typing import Literal

import numpy as np
import xarray as xr
from pydantic import BaseModel, ConfigDict, PositiveInt

sys.path.append(str(Path(__file__).parent))

from calibration_statistics import coverage_band
from identify import SLOWEST_DECAY_PER_S
from independent_bench import plant, simulate

import bayesbl
from bayesbl.bench.bench import Bench, BenchParameter
from bayesbl.bench.parameters import CORRECTABLE_PARAMETERS
from bayesbl.bench.steady import contact_rates
from bayesbl.config.bench import dump_bench, reference_bench
from bayesbl.errors import UserError
from bayesbl.recording.types import Recording

LEVEL = 0.9
WIDE = 0.99
FACTOR = 1.2
SHEET_TOLERANCE = 0.15
GAP_RAD = (3e-4, 2e-3)
GREW = 1.25
SPEED_RPM = 2000.0
ROTATIONS = 4.0

Structure = Literal["none", "belt", "arm", "base", "varying gap", "two gaps", "shaken"]


class Row(BaseModel):
    """``structure``: what the joint has and its data sheet lacks, at a frequency in this range."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    joints: PositiveInt
    structure: Structure
    low_hz: float = 0.0
    high_hz: float = 0.0


COLUMNS = {
    "frequency_hz": ("Hz", "of the part that the data sheet lacks; nan if it has none"),
    "seconds": ("s", "of all commands"),
    "refused": ("1", "1 where a command refused in words"),
    **{
        f"{what}_{score}": ("1", f"{meaning}, {what}")
        for what in ("first", "last", "change")
        for score, meaning in (
            ("answered", "1 where a value is given"),
            ("covered", f"1 where the interval of {LEVEL:.0%} holds the truth"),
            ("wrong", f"1 where a given interval of {WIDE:.0%} excludes the truth"),
            ("ratio", "median over truth"),
            ("relative_width", "width of the interval over the truth"),
        )
    },
}


def count(row: Row) -> int:
    """Number of joints."""
    return row.joints


def _spring(inertia: float, share: float, hz: float) -> float:
    """Compliance of a spring between two parts of an inertia, rad/(N m)."""
    return 1.0 / ((2.0 * math.pi * hz) ** 2 * inertia * share * (1.0 - share))


def _belt(joint: Bench, hz: float, rng: np.random.Generator) -> dict[str, float]:
    share = rng.uniform(0.15, 0.6)
    return {
        "belt__compliance_rad_per_nm": _spring(joint.value("motor_inertia_kg_m2"), share, hz),
        "belt__damping_time_s": 2.0 * rng.uniform(0.01, 0.1) / (2.0 * math.pi * hz),
        "belt__reducer_share": share,
    }


def _arm(joint: Bench, hz: float, rng: np.random.Generator) -> dict[str, float]:
    share = rng.uniform(0.1, 0.5)
    return {
        "arm__compliance_rad_per_nm": _spring(joint.value("load_inertia_kg_m2"), share, hz),
        "arm__damping_time_s": 2.0 * rng.uniform(0.01, 0.1) / (2.0 * math.pi * hz),
        "arm__inertia_share": share,
        "arm__gravity_share": rng.uniform(0.2, 0.9),
    }


def _base(joint: Bench, hz: float, rng: np.random.Generator) -> dict[str, float]:
    inertia = joint.value("load_inertia_kg_m2") * rng.uniform(1.0, 6.0)
    return {
        "base__compliance_rad_per_nm": 1.0 / ((2.0 * math.pi * hz) ** 2 * inertia),
        "base__damping_time_s": 2.0 * rng.uniform(0.01, 0.1) / (2.0 * math.pi * hz),
        "base__inertia_kg_m2": inertia,
    }


def _varying(joint: Bench, hz: float, rng: np.random.Generator) -> dict[str, float]:
    size, angle = rng.uniform(0.1, 0.3), rng.uniform(-math.pi, math.pi)
    second = 0.4 * size * rng.standard_normal(2)
    return {
        "gap_variation__cosine_1": size * math.cos(angle),
        "gap_variation__sine_1": size * math.sin(angle),
        "gap_variation__cosine_2": float(second[0]),
        "gap_variation__sine_2": float(second[1]),
    }


def _shaken(joint: Bench, hz: float, rng: np.random.Generator) -> dict[str, float]:
    torque = joint.value("gravity_torque_nm") * rng.uniform(0.02, 0.05)
    return {"outside__shaking_nm": torque, "outside__shaking_hz": hz}


PARTS: Mapping[str, Callable[[Bench, float, np.random.Generator], dict[str, float]]] = {
    "none": lambda joint, hz, rng: {},
    "belt": _belt,
    "arm": _arm,
    "base": _base,
    "varying gap": _varying,
    "two gaps": lambda joint, hz, rng: {"outside__second_gap_rad": 2e-4},
    "shaken": _shaken,
}


def random_joint(rng: np.random.Generator) -> Bench:
    """A bench known exactly, near the reference one, with a stable loop."""
    reference = reference_bench()
    while True:
        values = {name: reference.value(name) for name in reference.parameters}
        for name in CORRECTABLE_PARAMETERS:
            values[name] *= FACTOR ** rng.uniform(-1.0, 1.0)
        bench = Bench({name: BenchParameter(value) for name, value in values.items()})
        if np.max(contact_rates(bench.vector()).real) < -SLOWEST_DECAY_PER_S:
            return bench


def data_sheet(joint: Bench, rng: np.random.Generator) -> Bench:
    """Values from which the true ones are off uniformly within the tolerance."""
    parameters = dict(joint.parameters)
    for name in CORRECTABLE_PARAMETERS:
        value = joint.value(name) / (1.0 + SHEET_TOLERANCE * rng.uniform(-1.0, 1.0))
        parameters[name] = BenchParameter(value, SHEET_TOLERANCE * value)
    return Bench(parameters)


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One joint, as a user would measure it."""
    rng = np.random.default_rng(seed)
    joint = random_joint(rng)
    sheet = data_sheet(joint, rng)
    hz = math.exp(rng.uniform(*np.log([row.low_hz, row.high_hz]))) if row.low_hz else math.nan
    part = PARTS[row.structure](joint, hz, rng)
    gap = math.exp(rng.uniform(*np.log(GAP_RAD)))
    values = {name: math.nan for name in COLUMNS} | {"frequency_hz": hz, "refused": 0.0}
    for what in ("first", "last", "change"):
        values |= {f"{what}_answered": 0.0, f"{what}_wrong": 0.0}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)

        def recorded(label: str, gap_rad: float, speed_rpm: float) -> Path:
            start, motor, phase = rng.uniform(-math.pi, math.pi, 3)
            truth = plant(
                {parameter: item.value for parameter, item in joint.parameters.items()}
                | {"gap_rad": gap_rad, "reference_speed_rpm": speed_rpm}
                | {"start_angle_rad": start, "motor_start_angle_rad": motor}
                | ({"outside__shaking_phase_rad": phase} if row.structure == "shaken" else {})
                | part
            )
            recording = simulate(truth, rng, name=label, rotations=ROTATIONS).recording
            return written(recording, folder / f"{label}.csv")

        bench = folder / "joint.toml"
        bench.write_text(dump_bench(sheet), encoding="utf-8")
        grown = (gap, GREW * gap)
        pair = [recorded(f"snapshot_{i}", own, SPEED_RPM) for i, own in enumerate(grown)]
        begin = perf_counter()
        try:
            answers = {
                level: bayesbl.compare(*pair, bench=bench, level=level, seed=1, workers=1).summary
                for level in (LEVEL, WIDE)
            }
        except UserError:
            values["refused"] = 1.0
            return values | {"seconds": perf_counter() - begin}
        values["seconds"] = perf_counter() - begin
    truths = {"first": grown[0], "last": grown[1], "change": grown[1] - grown[0]}
    for what, truth in truths.items():
        intervals = {level: interval_of(answer, what) for level, answer in answers.items()}
        usual, wide = intervals[LEVEL], intervals[WIDE]
        if usual is None or wide is None:
            continue
        values |= {
            f"{what}_answered": 1.0,
            f"{what}_covered": float(usual["low"] <= truth <= usual["high"]),
            f"{what}_wrong": float(not wide["low"] <= truth <= wide["high"]),
            f"{what}_ratio": usual["median"] / truth,
            f"{what}_relative_width": (usual["high"] - usual["low"]) / truth,
        }
    return values


def interval_of(summary: Mapping[str, object], what: str) -> Mapping[str, float] | None:
    """An interval of ``summary.json``; ``None`` where the answer is withheld."""
    if what == "change":
        return summary["change_rad"]  # type: ignore[return-value]
    snapshot = summary["snapshots"][0 if what == "first" else -1]  # type: ignore[index]
    return snapshot["delta_rad"]  # type: ignore[no-any-return]


def written(recording: Recording, path: Path) -> Path:
    """A recording as CSV."""
    columns = {"time_s": recording.time_s, **recording.channels}
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, "%.9g", ",", header=",".join(columns), comments="")
    return path


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """Shares answered, covered and confidently wrong."""
    size = cases.sizes["case"]
    line: dict[str, float | str] = {"joints": float(size), "refused": _mean(cases["refused"])}
    for what in ("first", "last", "change"):
        answered = cases[f"{what}_answered"].values > 0.0
        line[f"{what}_answered"] = float(answered.mean())
        line[f"{what}_wrong"] = float(cases[f"{what}_wrong"].values.sum())
        line[f"{what}_covered"] = _mean(cases[f"{what}_covered"][answered])
        line[f"{what}_relative_width"] = _mean(cases[f"{what}_relative_width"][answered])
        line[f"{what}_band_low"], line[f"{what}_band_high"] = coverage_band(
            max(int(answered.sum()), 1), LEVEL
        )
    line["median_seconds"] = float(np.median(cases["seconds"].values))
    return line


def _mean(values: xr.DataArray) -> float:
    return float(np.nanmean(values.values)) if values.size else math.nan
