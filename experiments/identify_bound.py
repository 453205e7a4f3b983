"""How sharp can a later gap be, measured with a bench that recordings have identified?

    python experiments/identify_bound.py

Of the joints of ``identify.py`` (its first row, data sheet off by up to 25 %): the Cramér-Rao bound
of the second gap and of the change in a later pair, with all parameters of the bench unknown, over
that with the bench known. With J the whitened derivatives of a recording, its own unknowns (start
angle, delay of a motion) projected out, the information JᵀJ about ln p and ln δ adds up over
recordings; the data sheet adds the inverse variance of its uniform priors. The gap of the
identifying recordings is one more unknown. Two minutes of one core; the table is
experiments/results/identify_bound.csv.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from identify import (
    DWELL_S,
    GAP_RAD,
    GREW,
    LATER_RPM,
    ROTATIONS,
    STROKES_RAD,
    STROKES_RPM,
    STROKES_S,
    acceleration_rpm_per_s,
    data_sheet,
    random_joint,
)

from bayesbl.bench.bench import Bench
from bayesbl.bench.motion import cycle
from bayesbl.config.bench import reference_bench
from bayesbl.matching.least_squares import fit_at
from bayesbl.matching.observed import Observed
from bayesbl.matching.planning import noise_of_bench
from bayesbl.matching.signals import (
    SimulatedSignals,
    gap_unknown,
    reference_delay_unknown,
    start_angle_unknown,
    tolerance_unknowns,
)
from bayesbl.recording.types import FloatArray
from bayesbl.runs.study import seed_of_case

SEED, ROW = 61, "speed and current"
"""Of the study's first row: the first joints here are those of ``identify_core.toml``."""

JOINTS, IN_CORE = 40, 8
SAMPLING_HZ = 1000.0
START_ANGLE_RAD = 0.5
STROKES = "strokes"
THREE = (2000.0, -2000.0, 1200.0)
SIX = (2000.0, -2000.0, 1200.0, -1200.0, 600.0, -600.0)
SETS: Mapping[str, Mapping[float | str, float]] = {
    "the data sheet alone": {},
    "three of three rotations": dict.fromkeys(THREE, ROTATIONS),
    "three of ten rotations": dict.fromkeys(THREE, 10.0),
    "three of thirty rotations": dict.fromkeys(THREE, 30.0),
    "three speeds both ways, ten rotations": dict.fromkeys(SIX, 10.0),
    "forward, reverse, strokes": {2000.0: ROTATIONS, -2000.0: ROTATIONS, STROKES: 1.0},
    "strokes alone": {STROKES: 1.0},
}
"""What identifies the bench: rotations at a speed in rpm, recordings of strokes."""

TABLE = Path(__file__).parent / "results" / "identify_bound.csv"


def turning(joint: Bench, speed_rpm: float) -> Observed:
    """One rotation."""
    period = joint.rotation_period_s(speed_rpm)
    samples = round(period * SAMPLING_HZ) + NOISE.order
    return Observed("r", np.zeros((2, samples)), SAMPLING_HZ, speed_rpm, period)


def stroking(joint: Bench) -> Observed:
    """The strokes of the study."""
    motion = cycle(
        joint.value("gear_ratio"),
        STROKES_RAD,
        STROKES_RPM,
        acceleration_rpm_per_s(joint),
        DWELL_S,
        STROKES_S,
    )
    samples = round(STROKES_S * SAMPLING_HZ)
    return Observed("r", np.zeros((2, samples)), SAMPLING_HZ, STROKES_RPM, STROKES_S, motion=motion)


def information(sheet: Bench, joint: Bench, gap_rad: float, seen: Observed) -> FloatArray:
    """Of a recording about ln p and ln δ at their true values, shape (k + 1, k + 1)."""
    names = list(sheet.tolerances)
    moves = seen.motion is not None
    own = [start_angle_unknown("r"), *([reference_delay_unknown("r")] if moves else [])]
    shared = [*tolerance_unknowns(sheet), gap_unknown(1e-5, 1e-1)]
    model = SimulatedSignals(sheet, [seen], [*shared, *own], [NOISE])
    start = STROKES_RAD[0] if moves else START_ANGLE_RAD
    there = [*(math.log(joint.value(name)) for name in names), math.log(gap_rad), start]
    jacobian = fit_at(model, np.array([*there, 0.0][: len(model.unknowns)])).derivatives()
    root, _ = np.linalg.qr(jacobian[:, len(shared) :])
    left = jacobian[:, : len(shared)]
    left = left - root @ (root.T @ left)
    return np.asarray(left.T @ left)


def sds(
    prior_sd: FloatArray, identifying: Sequence[FloatArray], pair: Sequence[FloatArray]
) -> FloatArray:
    """Bounds of ln δ of the second of a pair and of the change over the first δ.

    Shape (2, 2): with the bench unknown, and known.
    """
    k = prior_sd.size
    whole = np.zeros((k + 2, k + 2))
    whole[:k, :k] = np.diag(prior_sd**-2.0)
    if identifying:
        told = np.sum(identifying, axis=0)
        whole[:k, :k] += told[:k, :k] - np.outer(told[:k, k], told[k, :k]) / told[k, k]
    for place, one in zip((k, k + 1), pair, strict=True):
        at = [*range(k), place]
        whole[np.ix_(at, at)] += one
    scale = np.sqrt(np.diag(whole))
    unknown = np.linalg.inv(whole / np.outer(scale, scale)) / np.outer(scale, scale)
    change = np.array([-1.0, GREW])
    found = []
    for covariance in (unknown[k:, k:], np.linalg.inv(whole[k:, k:])):
        found.append([covariance[1, 1], change @ covariance @ change])
    return np.sqrt(found)


def bounds_of(index: int) -> dict[str, FloatArray]:
    """Of every set, for one joint of the study."""
    rng = np.random.default_rng(seed_of_case(SEED, ROW, index).spawn(1)[0])
    joint = random_joint(rng)
    sheet, _ = data_sheet(joint, 0.0, rng)
    gap_rad = math.exp(rng.uniform(*np.log(GAP_RAD)))
    prior_sd = np.array([u.prior_sd for u in tolerance_unknowns(sheet)])
    each: dict[float | str, FloatArray] = {
        speed: information(sheet, joint, gap_rad, turning(joint, speed)) for speed in SIX
    }
    each[STROKES] = information(sheet, joint, gap_rad, stroking(joint))
    pair = [
        ROTATIONS * information(sheet, joint, gap, turning(joint, speed))
        for gap, speed in zip((gap_rad, GREW * gap_rad), LATER_RPM, strict=True)
    ]
    return {
        name: sds(prior_sd, [n * each[key] for key, n in parts.items()], pair)
        for name, parts in SETS.items()
    }


NOISE = noise_of_bench(reference_bench())

if __name__ == "__main__":
    bounds = [bounds_of(index) for index in range(JOINTS)]
    with TABLE.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(
            ["recordings", "joints", "gap_over_known", "change_over_known", "gap_sd_%", "known_%"]
        )
        for name in SETS:
            for count in (IN_CORE, JOINTS):
                every = np.array([one[name] for one in bounds[:count]])
                ratio = np.median(every[:, 0] / every[:, 1], axis=0)
                sd = 100.0 * np.median(every[:, :, 0], axis=0)
                row = [name, count, *(f"{value:.4g}" for value in (*ratio, *sd))]
                table.writerow(row)
                print(*row, sep=", ")
