"""What does a user get whose joint, or recording, is not as the bench has it?

    bayesbl run configs/other_joints_core.toml      # or other_joints.toml

A case is a joint of ``independent_bench.py`` with a part that its data sheet does not know: a belt,
an elastic arm, a base that gives way, a gap that varies over the load's angle, a second gap,
a contact that stiffens with its load or begins softly,
something that shakes it, noise that is louder around impacts, impacts that are unlike, another
speed, another gravity, a fieldbus, a digital loop. A *drive* has friction on both sides, cogging,
and a digital loop that filters the speed of its encoder; its sheet gives the loop's period only.
Parameters lie within a fifth of the reference
bench; the data sheet is off by up to ``sheet_off`` in each. As a user would: files, then
``compare`` of two recordings between which the gap grew by a quarter. Only the package's public
functions are used, and both routes are looked at.

An answer is *confidently wrong* where its outcome is converged or usable and an interval of 99 %
excludes the truth.
"""

from __future__ import annotations

import math
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import xarray as xr
from identify import data_sheet, random_joint
from independent_bench import CHANNELS, Noise, plant, simulate, values_of
from outside_noise import around_impacts, unlike_impacts
from pydantic import BaseModel
from study_tools import LEVEL, StudyRow, held, interval_of, mean, written

import bayesbl
from bayesbl.bench.bench import Bench, BenchEffect, EffectParameterValue
from bayesbl.config.bench import dump_bench
from bayesbl.errors import UserError
from bayesbl.noise.process import NoiseModel
from bayesbl.recording.types import FloatArray, Recording

WIDE = 0.99
FACTOR = 1.2
GAP_RAD = (3e-4, 2e-3)
GREW = 1.25
SPEED_RPM = 2000.0
SPEED_OFF = 0.05  # of a drive's: its rotation is no whole number of samples, ticks or counts
ROTATIONS = 4.0
LOUDER = 5.0
UNLIKE = 0.15
OTHER_SPEED = 1.05
HEAVIER = 1.05
FIELDBUS_HZ, FIELDBUS_JITTER_S = 250.0, 4e-4
EXCESS = (0.03, 0.5)
EDGE_SHARE = (3e-3, 5e-2)
LOOP_PERIODS_S = (1.25e-4, 2.5e-4, 5e-4)
QUIET = Noise(0.3, 0.6, 0.02)
FINE_HZ = 4000.0

Structure = Literal[
    "none",
    "belt",
    "arm",
    "base",
    "varying gap",
    "two gaps",
    "hertzian",
    "soft edges",
    "soft onset",
    "shaken",
    "louder around impacts",
    "unlike impacts",
    "other speed",
    "heavier",
    "fieldbus",
    "differentiated encoder",
    "digital loop",
    "drive",
]


class Row(StudyRow):
    """``structure``: what the joint has and its data sheet lacks, at a frequency in this range.

    ``sheet_off``: of each value of the data sheet, which is also its tolerance; 0: it is exact.
    """

    structure: Structure
    low_hz: float = 0.0
    high_hz: float = 0.0
    sheet_off: float = 0.15


ROUTES = ("answer", "direct", "amplitude")
TRUTHS = ("first", "last", "change")
COLUMNS = {
    "frequency_hz": ("Hz", "of the part that the data sheet lacks; nan if it has none"),
    "delta_rad": ("rad", "gap of the first recording"),
    "refused": ("1", "1 where a command refused in words"),
    **{
        f"{route}_{what}_{score}": ("1", f"{meaning}, {what}, {route}")
        for route in ROUTES
        for what in (TRUTHS if route == "answer" else TRUTHS[:2])
        for score, meaning in (
            ("answered", "1 where a value is given"),
            ("covered", f"1 where the interval of {LEVEL:.0%} holds the truth"),
            ("wrong", f"1 where a given interval of {WIDE:.0%} excludes the truth"),
            ("ratio", "median over truth"),
            ("z", "error of the median in standard deviations"),
            ("relative_width", f"width of the interval of {LEVEL:.0%} over the truth"),
        )
    },
}


def _spring(inertia: float, share: float, hz: float) -> float:
    """Compliance of a spring between two parts of an inertia, rad/(N m)."""
    return 1.0 / ((2.0 * math.pi * hz) ** 2 * inertia * share * (1.0 - share))


def _belt(joint: Bench, hz: float, rng: np.random.Generator) -> dict[str, float]:
    share = rng.uniform(0.15, 0.6)
    return {
        "belt__compliance_rad_per_nm": _spring(joint.value("motor_inertia_kg_m2"), share, hz),
        "belt__damping_ratio": rng.uniform(0.01, 0.1),
        "belt__reducer_share": share,
    }


def _arm(joint: Bench, hz: float, rng: np.random.Generator) -> dict[str, float]:
    share = rng.uniform(0.1, 0.5)
    return {
        "arm__compliance_rad_per_nm": _spring(joint.value("load_inertia_kg_m2"), share, hz),
        "arm__damping_ratio": rng.uniform(0.01, 0.1),
        "arm__inertia_share": share,
        "arm__gravity_share": rng.uniform(0.2, 0.9),
    }


def _base(joint: Bench, hz: float, rng: np.random.Generator) -> dict[str, float]:
    inertia = joint.value("load_inertia_kg_m2") * rng.uniform(1.0, 6.0)
    return {
        "base__compliance_rad_per_nm": 1.0 / ((2.0 * math.pi * hz) ** 2 * inertia),
        "base__damping_ratio": rng.uniform(0.01, 0.1),
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
    torque = rng.uniform(10.0, 20.0)
    return {"outside__shaking_nm": torque, "outside__shaking_hz": hz}


def _soft(joint: Bench, hz: float, rng: np.random.Generator) -> dict[str, float]:
    windup = joint.value("gravity_torque_nm") / joint.value("shaft_stiffness_nm_per_rad")
    return {"outside__edge_rad": windup * math.exp(rng.uniform(*np.log(EDGE_SHARE)))}


def _digital_loop(joint: Bench, hz: float, rng: np.random.Generator) -> dict[str, float]:
    speed_rpm = SPEED_RPM * (1.0 + SPEED_OFF * rng.uniform(-1.0, 1.0))
    return {
        "sampled_control__period_s": rng.choice(LOOP_PERIODS_S),
        "reference_speed_rpm": speed_rpm,
    }


def _drive(joint: Bench, hz: float, rng: np.random.Generator) -> dict[str, float]:
    gravity = joint.value("gravity_torque_nm")
    at_motor, speed = gravity / joint.value("gear_ratio"), SPEED_RPM * math.tau / 60.0
    dry, viscous, at_load = rng.uniform(0.0, [0.06, 0.06, 0.05])
    return _digital_loop(joint, hz, rng) | {
        "outside__loop_counts": float(2 ** rng.integers(14, 21)),
        "outside__loop_filter": rng.uniform(0.3, 1.0),
        "outside__lugre_nm": dry * at_motor,
        "motor_viscous_friction__coefficient_nm_s_per_rad": viscous * at_motor / speed,
        "outside__load_coulomb_nm": at_load * gravity,
        "outside__ripple_nm": rng.uniform(0.0, 0.01) * at_motor,
        "outside__ripple_order": float(rng.choice([4, 6, 10])),
    }


PARTS: Mapping[str, Callable[[Bench, float, np.random.Generator], dict[str, float]]] = {
    "none": lambda joint, hz, rng: {},
    "belt": _belt,
    "arm": _arm,
    "base": _base,
    "varying gap": _varying,
    "two gaps": lambda joint, hz, rng: {"outside__second_gap_rad": 2e-4},
    "hertzian": lambda joint, hz, rng: {"contact_exponent__excess": rng.uniform(*EXCESS)},
    "soft edges": _soft,
    "soft onset": _soft,
    "shaken": _shaken,
    "differentiated encoder": lambda joint, hz, rng: {
        "sampled_control__period_s": 1e-3,
        "outside__loop_counts": 16384.0,
    },
    "digital loop": _digital_loop,
    "drive": _drive,
}


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One joint, as a user would measure it."""
    rng = np.random.default_rng(seed)
    joint = random_joint(rng, FACTOR, None)
    sheet, _ = data_sheet(joint, 0.0, rng, row.sheet_off)
    hz = math.exp(rng.uniform(*np.log([row.low_hz, row.high_hz]))) if row.low_hz else math.nan
    part = PARTS.get(row.structure, PARTS["none"])(joint, hz, rng)
    if "sampled_control__period_s" in part and "reference_speed_rpm" in part:
        period = EffectParameterValue(part["sampled_control__period_s"])
        sheet = sheet.with_effects(BenchEffect("sampled_control", {"period_s": period}))
    if row.structure == "heavier":
        part["gravity_torque_nm"] = HEAVIER * joint.value("gravity_torque_nm")
    gap = math.exp(rng.uniform(*np.log(GAP_RAD)))
    values = {name: math.nan for name in COLUMNS} | {"frequency_hz": hz, "refused": 0.0}
    values |= {name: 0.0 for name in COLUMNS if name.endswith(("answered", "wrong"))}
    values["delta_rad"] = gap
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)

        def file(label: str, gap_rad: float) -> Path:
            start, motor, phase = rng.uniform(-math.pi, math.pi, 3)
            truth = values_of(joint) | {
                "gap_rad": gap_rad,
                "reference_speed_rpm": SPEED_RPM,
                "start_angle_rad": start,
                "motor_start_angle_rad": motor,
            }
            if row.structure == "soft onset":
                # The gap of such a joint is where its teeth begin to touch.
                truth["gap_rad"] += part["outside__edge_rad"]
            if row.structure == "shaken":
                truth["outside__shaking_phase_rad"] = phase
            return written(recorded(row, truth | part, label, rng), folder / f"{label}.csv")

        bench = folder / "joint.toml"
        bench.write_text(dump_bench(sheet), encoding="utf-8")
        gaps = (gap, GREW * gap)
        pair = [file(f"snapshot_{i}", own) for i, own in enumerate(gaps)]
        return values | compared(f"{row.name} {index}", pair, bench, gaps)


def compared(
    case: str,
    pair: Sequence[Path],
    bench: Path,
    gaps_rad: tuple[float, float],
    route: Literal["auto", "direct"] = "auto",
) -> dict[str, float]:
    """What ``compare`` says of two recordings, beside the truth; each answer is printed."""
    try:
        result = bayesbl.compare(*pair, bench=bench, route=route, level=LEVEL, seed=1, workers=1)
    except UserError as refusal:
        print(f"{case}: {refusal}", file=sys.stderr)
        return {"refused": 1.0}
    values: dict[str, float] = {}
    truths = {"first": gaps_rad[0], "last": gaps_rad[1], "change": gaps_rad[1] - gaps_rad[0]}
    summary: Any = result.summary
    tree: Any = result.to_xarray()
    for what, truth in truths.items():
        if summary["outcome"] == "refused":
            continue
        if what == "change":
            if summary["change_rad"] is not None:
                values |= scores("answer_change", tree["change/change_rad"].values, truth)
            continue
        place = 0 if what == "first" else -1
        snapshot = summary["snapshots"][place]
        if snapshot["delta_rad"] is not None:
            draws = tree["gap/delta_rad"].isel(snapshot=place).values
            values |= scores(f"answer_{what}", draws, truth)
        for route, found in snapshot["routes"].items():
            if found["delta_rad"] is not None:
                drawn = tree[f"{route}/posterior/delta_rad"].isel(snapshot=place).values
                values |= scores(f"{route}_{what}", drawn, truth)
    for snapshot in summary["snapshots"]:
        for route, found in snapshot["routes"].items():
            reason = found["reason"]
            told = "" if reason is None else f"{reason['code']}: {reason['text'][:160]}"
            of = found["delta_rad"] or {"median": math.nan, "low": math.nan, "high": math.nan}
            print(
                f"{case} {snapshot['name']} {route}: {1e3 * of['median']:.4f} "
                f"({1e3 * of['low']:.4f} to {1e3 * of['high']:.4f}) mrad "
                f"{found.get('diagnostics', {}).get('outcome')} {told}",
                file=sys.stderr,
            )
    return values


def scores(name: str, draws: FloatArray, truth: float) -> dict[str, float]:
    """Of an answer that is given, by its draws."""
    low, high = interval_of(draws)
    middle, sd = float(np.nanmedian(draws)), float(np.nanstd(draws))
    return {
        f"{name}_answered": 1.0,
        f"{name}_covered": held(draws, truth),
        f"{name}_wrong": 1.0 - held(draws, truth, WIDE),
        f"{name}_ratio": middle / truth,
        f"{name}_z": (middle - truth) / sd,
        f"{name}_relative_width": (high - low) / truth,
    }


def recorded(row: Row, truth: dict[str, float], label: str, rng: np.random.Generator) -> Recording:
    """A recording of a joint, as this row's recorder has it."""
    if row.structure == "other speed":
        truth = truth | {"reference_speed_rpm": OTHER_SPEED * SPEED_RPM}
    rotation_s = 60.0 * truth["gear_ratio"] / truth["reference_speed_rpm"]
    noise = QUIET if row.structure == "heavier" else Noise()
    if row.structure not in ("louder around impacts", "unlike impacts", "fieldbus"):
        made = simulate(plant(truth), rng, name=label, rotations=ROTATIONS, noise=noise)
        return made.recording
    hz = FINE_HZ if row.structure == "fieldbus" else 1000.0
    clean = simulate(plant(truth), rotations=ROTATIONS, sampling_hz=hz).clean
    time = np.arange(clean.shape[1]) / hz
    if row.structure == "unlike impacts":
        clean[1:] = unlike_impacts(clean[1:], hz, rotation_s, UNLIKE, rng)
    if row.structure == "fieldbus":
        ticks = np.arange(1, int(time[-1] * FIELDBUS_HZ)) / FIELDBUS_HZ
        at = ticks + FIELDBUS_JITTER_S * rng.standard_normal(ticks.size)
        clean = np.stack([np.interp(at, time, channel) for channel in clean])
        time = at
    added = noise.speed_sd_rpm * NoiseModel(1.0, (noise.speed_coefficient,)).draw(time.size, rng)
    if row.structure == "louder around impacts":
        added *= 1.0 + (LOUDER - 1.0) * around_impacts(clean[1], hz, rotation_s)
    clean[1] += added
    clean[2] += noise.current_sd_a * rng.standard_normal(time.size)
    return Recording(label, time, dict(zip(CHANNELS, clean, strict=True)))


def summarise(row: BaseModel, cases: xr.Dataset) -> Mapping[str, float | str]:
    """Shares answered, covered and confidently wrong."""
    size = cases.sizes["case"]
    line: dict[str, float | str] = {"joints": float(size), "refused": mean(cases["refused"])}
    for name in (n.removesuffix("_answered") for n in COLUMNS if n.endswith("_answered")):
        answered = cases[f"{name}_answered"].values > 0.0
        line[f"{name}_answered"] = float(answered.mean())
        line[f"{name}_wrong"] = float(cases[f"{name}_wrong"].values.sum())
        for score in ("covered", "relative_width"):
            line[f"{name}_{score}"] = mean(cases[f"{name}_{score}"][answered])
        worst = cases[f"{name}_z"].values[answered]
        line[f"{name}_worst_z"] = float(np.max(np.abs(worst))) if worst.size else math.nan
    return line
