"""What do the routes make of a drive whose controller is digital?

    bayesbl run configs/sampled_control.toml

A case is a joint of the independent simulator under a sampled controller (encoder difference, sum,
torque held and a period late) with a random gap, by a bench that believes it continuous and by one
that is told the period. Matched directly: two recordings of an unchanged gap. Diagnosed: 2000,
−2000 and 1200 rpm, all of the catalogue. An answer is *wrong* where it is given and its 90 %
interval does not hold the truth.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
import xarray as xr
from false_wear import GAP_RANGE_RAD
from hidden_effects import LEVEL_SD, NAMES, VERDICTS
from independent_bench import SPEEDS_RPM, plant, simulate, values_of
from pydantic import Field
from study_tools import FAST, StudyRow, is_withheld, random_start

from bayesbl.bench.bench import Bench, BenchEffect, EffectParameterValue
from bayesbl.config.bench import reference_bench
from bayesbl.diagnosis.closed_loop.diagnosis import diagnosis_of, search
from bayesbl.matching.observed import observed
from bayesbl.matching.signals import GAP, gap_unknown, start_angle_unknown
from bayesbl.measurement.direct_route import fit_directly
from bayesbl.recording.types import MOTOR_CURRENT, MOTOR_SPEED, Recording

TRUTH_RAD = (2e-4, 3e-3)


class Row(StudyRow):
    """A row: the drive, what is recorded, what the bench believes and what is asked.

    ``softer``: both gains times this; the reference gains are unstable at 4 ms. ``unlike``: what no
    bench is told, as ``Plant`` takes it: another delay, a recorder that misses the ticks.
    """

    period_s: float = Field(gt=0.0)
    softer: float = Field(1.0, gt=0.0)
    unlike: dict[str, float] = Field(default_factory=dict)
    current: bool = True
    believed: Literal["continuous", "sampled"]
    asked: Literal["compare", "diagnose"]


COLUMNS = {
    "delta_rad": ("rad", "gap simulated"),
    "fitted_rad": ("rad", "median, of the second recording"),
    "z": ("1", "error of ln δ in standard deviations"),
    "sd": ("1", "standard deviation of ln δ"),
    "withheld": ("1", "1 where no gap is given"),
    "change_withheld": ("1", "1 where no change is given"),
    "probability_increase": ("1", "that the gap grew"),
    "verdict": ("1", f"place in {', '.join(VERDICTS)}"),
    "named": ("1", "bits of the names given"),
    "case_s": ("s", "time of match or diagnosis"),
}


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One joint, matched or diagnosed."""
    truth_seed, fit_seed = seed.spawn(2)
    generator = np.random.default_rng(truth_seed)
    bench = reference_bench()
    gains = {n: row.softer * bench.value(n) for n in bench.parameters if n.endswith(GAINS)}
    bench = bench.with_parameters(**gains)
    gap = math.exp(generator.uniform(*np.log(TRUTH_RAD)))
    speeds = SPEEDS_RPM if row.asked == "diagnose" else (SPEEDS_RPM[0],) * 2
    recordings = [
        _recorded(row, bench, gap, speed, f"{place} at {speed:g} rpm", generator)
        for place, speed in enumerate(speeds)
    ]
    if row.believed == "sampled":
        period = EffectParameterValue(row.period_s)
        bench = bench.with_effects(BenchEffect("sampled_control", {"period_s": period}))
    begin = time.perf_counter()
    answer = _diagnosed if row.asked == "diagnose" else _compared
    found = answer(bench, recordings, speeds, fit_seed)
    error = math.log(found["fitted_rad"] / gap)
    z = error / found["sd"] if found["sd"] > 0.0 else math.nan
    return {**found, "delta_rad": gap, "z": z, "case_s": time.perf_counter() - begin}


GAINS = ("speed_gain_nm_s_per_rad", "integral_gain_nm_per_rad")


def _recorded(
    row: Row, bench: Bench, gap: float, speed: float, name: str, generator: np.random.Generator
) -> Recording:
    run = {"gap_rad": gap, "reference_speed_rpm": speed, "sampled_control.period_s": row.period_s}
    truth = plant(values_of(bench) | run | random_start(generator) | row.unlike)
    made = simulate(truth, generator, name=name).recording
    kept = (MOTOR_SPEED, MOTOR_CURRENT) if row.current else (MOTOR_SPEED,)
    return Recording(name, made.time_s, {k: made.channels[k] for k in kept})


def _compared(
    bench: Bench,
    recordings: Sequence[Recording],
    speeds: Sequence[float],
    seed: np.random.SeedSequence,
) -> dict[str, float]:
    seen = [observed(r, bench, s) for r, s in zip(recordings, speeds, strict=True)]
    found = fit_directly(bench, seen, GAP_RANGE_RAD, {}, FAST, seed)
    draws = np.log(found.posterior.values(GAP, recordings[1].name))
    withheld = is_withheld(found, (1,))
    named = {c.name for c in found.joint.changed}
    return {
        "fitted_rad": float(np.exp(np.median(draws))),
        "sd": float(draws.std()),
        "withheld": float(withheld),
        "change_withheld": float(withheld),
        "probability_increase": float(np.mean(found.change_rad > 0.0)),
        "verdict": math.nan,
        "named": float(sum(1 << NAMES.index(name) for name in named if name in NAMES)),
    }


def _diagnosed(
    bench: Bench,
    recordings: Sequence[Recording],
    speeds: Sequence[float],
    seed: np.random.SeedSequence,
) -> dict[str, float]:
    seen = [observed(r, bench, s) for r, s in zip(recordings, speeds, strict=True)]
    unknowns = [gap_unknown(1e-4, 4e-3, s.name) for s in seen]
    unknowns += [start_angle_unknown(s.name) for s in seen]
    found = search(bench, seen, (), unknowns)
    answer = diagnosis_of(found)
    delta = answer.delta_after
    members = [effect.members for effect in found.naming.effects]
    return {
        "fitted_rad": math.nan if delta is None else math.exp(delta.value),
        "sd": math.nan if delta is None else delta.sd,
        "withheld": float(delta is None),
        "change_withheld": math.nan,
        "probability_increase": math.nan,
        "verdict": float(VERDICTS.index(answer.verdict)),
        "named": float(sum(1 << NAMES.index(m[0]) for m in members)),
    }


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """Answers given, those that are wrong, and what was named."""
    column = {name: cases[name].values for name in COLUMNS}
    given = column["withheld"] == 0.0
    z, off = column["z"][given], column["fitted_rad"][given] / column["delta_rad"][given] - 1.0
    names = [_named(int(bits)) for bits in column["named"]]
    counted = {name: names.count(name) for name in dict.fromkeys(names)}
    return {
        "n": float(given.size),
        "given": float(given.sum()),
        "wrong": float(np.sum(np.abs(z) > LEVEL_SD)),
        "largest_z": float(np.max(np.abs(z), initial=0.0)),
        "off_median_percent": 100.0 * float(np.median(np.abs(off))) if given.any() else math.nan,
        "called_grown": float(
            np.sum((column["probability_increase"] > 0.95) & (column["change_withheld"] == 0.0))
        ),
        "names": "; ".join(f"{name} {n}" for name, n in counted.items()),
        "median_s": float(np.median(column["case_s"])),
    }


def _named(bits: int) -> str:
    return " + ".join(name for k, name in enumerate(NAMES) if bits >> k & 1) or "nothing"
