"""Does an identified bench measure later gaps as a known one does?

    bayesbl run configs/identify.toml

A case is a joint of ``independent_bench.py``: its gear ratio, and eight parameters log-uniform
within a factor of two of the reference bench, redrawn where the loop is not stable or the drive too
weak; its data sheet is off by up to ``SHEET_TOLERANCE`` in each, uniformly. Forward, reverse and a
slower recording identify the bench; two later recordings, forward and reverse, with a gap that has
grown in between, are then matched with it, and with the true bench for comparison. With ``strokes``
the third recording is of strokes to and fro instead of the slower speed, with ``strokes_alone`` all
are, the later ones too. ``wrong`` is the factor by which one value of the data sheet, drawn for
each case, is wrong besides: it has to be named, and nothing is measured later.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from time import perf_counter

import numpy as np
import xarray as xr
from calibration_statistics import coverage_band
from independent_bench import RPM, plant, simulate, simulate_moving, strokes, values_of
from pydantic import NonNegativeFloat
from study_tools import (
    LEVEL,
    StudyRow,
    held,
    interval_of,
    is_withheld,
    mean,
    random_start,
    without_current,
)

from bayesbl.bench.bench import Bench, BenchParameter
from bayesbl.bench.parameters import CORRECTABLE_PARAMETERS
from bayesbl.bench.steady import contact_rates
from bayesbl.config.bench import reference_bench
from bayesbl.identification.groups import reason_of
from bayesbl.identification.identify import Problem, identified_bench, identify, parameter_draws
from bayesbl.matching.observed import Observed, observed
from bayesbl.matching.signals import GAP
from bayesbl.measurement.direct_route import fit_directly
from bayesbl.sampling.chains import SamplerSettings

GEAR_RATIO = (50.0, 200.0)
FACTOR = 2.0
SHEET_TOLERANCE = 0.25
GAP_RAD = (2e-4, 3e-3)
GAP_RANGE_RAD = (1e-4, 1e-2)
GREW = 1.15
SPEEDS_RPM = (2000.0, -2000.0, 1200.0)
LATER_RPM = (2000.0, -2000.0)
ROTATIONS = 3.0
SLOWEST_DECAY_PER_S = 1.0
"""Of the linear loop in contact: slower ones do not settle between two impacts."""
LARGEST_CURRENT_SHARE = 0.6
"""Of the drive's limit, that gravity takes at most: impacts need the rest."""
STROKES_RAD = (-1.0, 1.0)
STROKES_RPM = 2000.0
STROKES_S = 12.0
DWELL_S = 0.15
STROKES_CURRENT_SHARE = 0.7
STROKES_ALONE = ((1.0, 1.0), (0.5, 1.0), (1.0, 0.3))
"""Shares of that speed and of the way, of each recording."""
FAST_DIRECT = SamplerSettings(ensembles=2, max_steps=8000)


class Row(StudyRow):
    """``wrong``: 0 for a data sheet within its tolerance; ``current``: whether it is recorded.

    ``strokes``: they are the third recording. ``strokes_alone``: all recordings are of strokes, the
    later pair too, as of a joint that cannot turn round.
    """

    current: bool = True
    strokes: bool = False
    strokes_alone: bool = False
    wrong: NonNegativeFloat = 0.0


COLUMNS = {
    "withheld": ("1", "1 where the identification is withheld"),
    "agrees": ("1", "1 where its verdict is agrees"),
    "named": ("1", "1 where the wrong value of the data sheet is named, alone or among others"),
    "named_alone": ("1", "1 where it is named, and no other with it"),
    "identify_seconds": ("s", "time of the identification"),
    "gap_z": ("1", "identified ln δ less the true one, in its standard deviations"),
    **{
        f"{name}_{what}": ("1", f"{meaning}, {name}")
        for name in CORRECTABLE_PARAMETERS
        for what, meaning in (
            ("covered", "1 where the interval holds the truth"),
            ("learned", "1 − posterior sd / prior sd"),
        )
    },
    "pair_withheld": ("1", "1 where a later gap or the change is withheld"),
    "known_withheld": ("1", "the same with the true bench"),
    **{
        f"{name}_{what}": (unit, f"{meaning}, {name}")
        for name in ("gap", "change")
        for what, unit, meaning in (
            ("covered", "1", "1 where the interval holds the truth"),
            ("width_rad", "rad", "width of the interval"),
            ("known_covered", "1", "the same with the true bench"),
            ("known_width_rad", "rad", "width with the true bench"),
        )
    },
}


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One joint: identified, and measured later."""
    truth_seed, identify_seed, pair_seed = seed.spawn(3)
    rng = np.random.default_rng(truth_seed)
    joint = random_joint(rng)
    sheet, wrong = data_sheet(joint, row.wrong, rng)
    gap = math.exp(rng.uniform(*np.log(GAP_RAD)))
    seen = [recorded(row, joint, gap, speed, f"{i}", rng) for i, speed in enumerate(SPEEDS_RPM)]
    if row.strokes:
        seen[-1] = stroked(joint, gap, "strokes", rng)
    if row.strokes_alone:
        seen = [
            stroked(joint, gap, f"strokes {i}", rng, pace, reach)
            for i, (pace, reach) in enumerate(STROKES_ALONE)
        ]
    problem = Problem(sheet, tuple(seen), (), tuple(sheet.tolerances), (), GAP_RANGE_RAD)
    begin = perf_counter()
    found = identify(problem, FAST_DIRECT, identify_seed)
    values = {name: math.nan for name in COLUMNS}
    values |= {
        "identify_seconds": perf_counter() - begin,
        "withheld": float(reason_of(found) is not None),
        "agrees": float(found.verdict == "agrees" and found.beyond is None),
    }
    if wrong is not None:
        names = () if found.beyond is None else (found.beyond.name, *found.beyond.could_be)
        return values | {
            "named": float(wrong in names),
            "named_alone": float(names == (wrong,)),
        }
    draws = parameter_draws(found, problem.parameters)
    for name, own in zip(problem.parameters, draws.T, strict=True):
        values[f"{name}_covered"] = held(own, joint.value(name))
        half = sheet.tolerances[name]
        values[f"{name}_learned"] = 1.0 - float(own.std()) / (half / math.sqrt(3.0))
    logarithm = np.log(found.posterior.values(GAP, seen[0].name))
    values["gap_z"] = float((logarithm.mean() - math.log(gap)) / logarithm.std())
    grown = (gap, GREW * gap)
    pair = [
        recorded(row, joint, own, speed, f"later {i}", rng)
        for i, (own, speed) in enumerate(zip(grown, LATER_RPM, strict=True))
    ]
    if row.strokes_alone:
        pair = [stroked(joint, own, f"later {i}", rng) for i, own in enumerate(grown)]
    bench = identified_bench(found, problem)
    values |= measured(bench, pair, grown, pair_seed, "")
    return values | measured(joint, pair, grown, pair_seed, "known_")


def measured(
    bench: Bench,
    pair: list[Observed],
    gaps_rad: tuple[float, float],
    seed: np.random.SeedSequence,
    prefix: str,
) -> dict[str, float]:
    """The second gap and the change, by this bench."""
    match = fit_directly(bench, pair, GAP_RANGE_RAD, {}, FAST_DIRECT, seed)
    gap, change = match.posterior.values(GAP, pair[1].name), match.change_rad
    return {
        f"{prefix or 'pair_'}withheld": float(is_withheld(match)),
        f"gap_{prefix}covered": held(gap, gaps_rad[1]),
        f"gap_{prefix}width_rad": float(np.ptp(interval_of(gap))),
        f"change_{prefix}covered": held(change, gaps_rad[1] - gaps_rad[0]),
        f"change_{prefix}width_rad": float(np.ptp(interval_of(change))),
    }


def random_joint(
    rng: np.random.Generator,
    factor: float = FACTOR,
    gear_ratio: tuple[float, float] | None = GEAR_RATIO,
) -> Bench:
    """A bench known exactly, with a stable loop and a drive that lifts its load."""
    reference = reference_bench()
    while True:
        values = {name: reference.value(name) for name in reference.parameters}
        if gear_ratio is not None:
            values["gear_ratio"] = math.exp(rng.uniform(*np.log(gear_ratio)))
        for name in CORRECTABLE_PARAMETERS:
            values[name] *= factor ** rng.uniform(-1.0, 1.0)
        bench = Bench({name: BenchParameter(value) for name, value in values.items()})
        slowest = float(np.max(contact_rates(bench.vector()).real))
        torque = values["torque_constant_nm_per_a"] * values["current_limit_a"]
        share = values["gravity_torque_nm"] / values["gear_ratio"] / torque
        if slowest < -SLOWEST_DECAY_PER_S and share < LARGEST_CURRENT_SHARE:
            return bench


def data_sheet(
    joint: Bench, wrong: float, rng: np.random.Generator, off: float = SHEET_TOLERANCE
) -> tuple[Bench, str | None]:
    """Values from which the true ones are off uniformly within the tolerance; one wrong besides."""
    parameters = dict(joint.parameters)
    for name in CORRECTABLE_PARAMETERS:
        value = joint.value(name) / (1.0 + off * rng.uniform(-1.0, 1.0))
        parameters[name] = BenchParameter(value, off * value)
    if not wrong:
        return replace(joint, parameters=parameters), None
    name = str(rng.choice(CORRECTABLE_PARAMETERS))
    value = joint.value(name) * wrong
    parameters[name] = BenchParameter(value, off * value)
    return replace(joint, parameters=parameters), name


def recorded(
    row: Row, joint: Bench, gap_rad: float, speed_rpm: float, name: str, rng: np.random.Generator
) -> Observed:
    """A recording from a random start."""
    turning = values_of(joint) | {"gap_rad": gap_rad, "reference_speed_rpm": speed_rpm}
    truth = plant(turning | random_start(rng))
    recording = simulate(truth, rng, name=name, rotations=ROTATIONS).recording
    return observed(recording if row.current else without_current(recording), joint, speed_rpm)


def stroked(
    joint: Bench,
    gap_rad: float,
    name: str,
    rng: np.random.Generator,
    pace: float = 1.0,
    reach: float = 1.0,
    **effects: float,
) -> Observed:
    """A recording of strokes about hanging, as fast as leaves the drive a reserve.

    ``pace``, ``reach``: shares of that speed and of the way. ``effects``: what the joint has more.
    """
    values = values_of(joint) | effects
    way = reach * STROKES_RAD[0], reach * STROKES_RAD[1]
    truth = plant(values | {"gap_rad": gap_rad, "start_angle_rad": way[0]})
    reference = strokes(
        joint.value("gear_ratio"),
        way,
        pace * STROKES_RPM,
        pace**2 * acceleration_rpm_per_s(joint),
        DWELL_S,
    )
    recording = simulate_moving(truth, reference, STROKES_S, rng, name=name).recording
    return observed(recording, joint)


def acceleration_rpm_per_s(joint: Bench) -> float:
    """That takes, with gravity, ``STROKES_CURRENT_SHARE`` of the drive's largest torque."""
    ratio = joint.value("gear_ratio")
    inertia = joint.value("motor_inertia_kg_m2") + joint.value("load_inertia_kg_m2") / ratio**2
    torque = joint.value("torque_constant_nm_per_a") * joint.value("current_limit_a")
    left = STROKES_CURRENT_SHARE * torque - joint.value("gravity_torque_nm") / ratio
    return left / inertia * RPM


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """Shares covered and withheld, and widths against those with the bench known."""
    size = cases.sizes["case"]
    line: dict[str, float | str] = {"joints": float(size)}
    line["withheld"] = mean(cases["withheld"].values)
    line["agrees"] = mean(cases["agrees"].values)
    line["median_identify_seconds"] = float(np.median(cases["identify_seconds"].values))
    if row.wrong:
        line["named"] = mean(cases["named"].values)
        line["named_alone"] = mean(cases["named_alone"].values)
        return line
    line["band_low"], line["band_high"] = coverage_band(size, LEVEL)
    parameters = [cases[f"{name}_covered"].values for name in CORRECTABLE_PARAMETERS]
    line["parameters_covered"] = float(np.nanmean(parameters))
    for name, own in zip(CORRECTABLE_PARAMETERS, parameters, strict=True):
        line[f"{name}_covered"] = mean(own)
        line[f"{name}_learned"] = float(np.nanmedian(cases[f"{name}_learned"].values))
    answered = cases["withheld"].values + cases["pair_withheld"].values == 0.0
    line["pair_withheld"] = 1.0 - float(np.mean(answered))
    line["known_withheld"] = mean(cases["known_withheld"].values)
    for name in ("gap", "change"):
        line[f"{name}_covered"] = mean(cases[f"{name}_covered"].values[answered])
        line[f"{name}_known_covered"] = mean(cases[f"{name}_known_covered"].values)
        ratio = cases[f"{name}_width_rad"].values / cases[f"{name}_known_width_rad"].values
        line[f"{name}_width_over_known"] = float(np.median(ratio[answered]))
    return line
