"""Whether the play that torque ramps give is the play, by a simulator that shares nothing with it.

    bayesbl run configs/torque_ramps_study.toml

Every case is another gearbox of ``torque_ramp_rig.py``: its play, flanks, friction, pattern round
the turn and ramps are drawn. The truth is half of the mean width at zero torque that ramps of the
simulator leave, over many cycles and the whole turn; beside it stands how often the interval holds
the simulator's dead zone, which is smaller by the compliance that friction holds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
import xarray as xr
from pydantic import Field
from scipy.stats import binom
from study_tools import LEVEL, StudyRow, interval_of
from torque_ramp_rig import Gearbox, Ramps, measured, reading, simulate

from bayesbl.measurement.ramp_route import described, of_every_cycle
from bayesbl.ramps.flanks import Flanks, find_flanks
from bayesbl.ramps.play import Widths, sample_play
from bayesbl.ramps.torque_cycles import Ramps as Found
from bayesbl.ramps.torque_cycles import find_ramps
from bayesbl.sampling.chains import SamplerSettings

RESOLUTION_RAD = 9.6e-5
TURN_POSITIONS, TURN_CYCLES = 6, 6
STEPS = 250

COLUMNS = {
    "answered": ("1", "1 where δ is given"),
    "none": ("1", "probability of no play"),
    "covered": ("1", "1 where the interval holds what ramps leave on average"),
    "dead_zone_covered": ("1", "1 where the interval holds the simulator's dead zone"),
    "relative_error": ("1", "median over the truth, less 1"),
    "relative_width": ("1", "width of the interval over the truth"),
    "held_ratio": ("1", "what ramps leave beyond the dead zone over the compliance told as held"),
}


class Row(StudyRow):
    """A row: what kind of gearboxes, and at how many positions they are ramped."""

    kind: Literal["play", "preloaded", "too_small"]
    positions: int = Field(ge=1)
    cycles: int = Field(default=5, ge=1)
    stiff: bool = False


def drawn(row: Row, generator: np.random.Generator) -> tuple[Gearbox, Ramps]:
    """A gearbox and its ramps."""
    friction = generator.uniform(0.8, 2.0)
    box = Gearbox(
        play_rad=math.exp(generator.uniform(math.log(2e-3), math.log(2e-2))),
        stiffness_nm_per_rad=math.exp(generator.uniform(math.log(300.0), math.log(2000.0))),
        hardening_rad=generator.uniform(0.01, 0.05),
        friction_nm=friction,
        stribeck=generator.uniform(1.0, 1.3),
        load_friction=generator.uniform(0.0, 0.2),
        variation=generator.uniform(0.05, 0.25),
        pattern=generator.uniform(0.05, 0.5) if row.positions > 1 else 0.0,
        surface=int(generator.integers(1 << 30)),
    )
    if row.stiff:
        stiffness = friction / (0.02 * box.play_rad)
        box = Gearbox(**{**vars(box), "stiffness_nm_per_rad": stiffness, "hardening_rad": 0.05})
    ratio = generator.uniform(2.0, 3.0)
    if row.kind == "preloaded":
        # An interference that both flanks bear over the whole of the small ramps.
        preload = friction * generator.uniform(2.0, 4.0)
        box = Gearbox(**{**vars(box), "play_rad": -preload / box.stiffness_nm_per_rad})
    if row.kind == "too_small":
        return box, Ramps((0.5 * friction,), (row.cycles,), (4.0,))
    large = friction * generator.uniform(12.0, 20.0)
    return box, Ramps((ratio * friction, large), (row.cycles, 2), (4.0, 16.0))


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> dict[str, float]:
    made_seed, sampler_seed = seed.spawn(2)
    generator = np.random.default_rng(made_seed)
    box, ramps = drawn(row, generator)
    angles = generator.uniform(0.0, 2.0 * np.pi) + 2.0 * np.pi * np.arange(
        row.positions
    ) / row.positions * generator.uniform(0.3, 1.0)
    files = []
    for angle in angles:
        _, torque, position = measured(*simulate(box.at(angle), ramps, generator), generator)
        files.append(find_ramps(torque, position))
    flanks = find_flanks(files, RESOLUTION_RAD)
    nothing = {name: math.nan for name in COLUMNS}
    if flanks is None or not flanks.answered:
        return {**nothing, "answered": 0.0}
    widths = Widths("case", tuple(flanks.level.widths()), RESOLUTION_RAD)
    settings = SamplerSettings(ensembles=2, max_steps=STEPS, level=LEVEL)
    width = sample_play([widths], settings, sampler_seed).width_rad["case"]
    none = generator.uniform(size=width.shape) > flanks.probability_of_play
    delta = 0.5 * width * np.where(none, generator.uniform(size=width.shape), 1.0)
    (low, high), middle = interval_of(delta), float(np.median(delta))
    found = {**nothing, "answered": 1.0, "none": 1.0 - flanks.probability_of_play}
    if row.kind != "play":
        return found
    turn = np.linspace(0.0, 2.0 * np.pi, TURN_POSITIONS, endpoint=False)
    places = turn if row.positions > 1 else angles
    truth = float(
        np.mean(
            [
                reading(
                    box.at(a),
                    ramps.torque_nm[0],
                    generator,
                    TURN_CYCLES * (TURN_POSITIONS // len(places)),
                )
                for a in places
            ]
        )
    )
    return {
        **found,
        "covered": float(low <= truth <= high),
        "dead_zone_covered": float(low <= box.play_rad <= high),
        "relative_error": middle / truth - 1.0,
        "relative_width": (high - low) / truth,
        "held_ratio": (truth - box.play_rad) / _held(files, flanks),
    }


def _held(files: Sequence[Found], flanks: Flanks) -> float:
    """``held_windup_rad`` of a snapshot."""
    found = of_every_cycle(flanks, 0.0)
    draws = described(found, flanks, np.zeros(1), np.random.default_rng(1))
    return float(draws["held_windup_rad"].item())


def summarise(row: Row, cases: xr.Dataset) -> dict[str, float]:
    number = cases.sizes["case"]
    answered = cases["answered"].values > 0.5
    none = cases["none"].values[answered]
    result = {
        "answered": float(answered.sum()),
        "called_no_play": float(np.mean(none > 0.5)) if none.size else math.nan,
    }
    covered = cases["covered"].values[answered]
    if not np.isfinite(covered).any():
        measures = "coverage band_low band_high dead_zone_coverage error width"
        empty = f"{measures} held_ratio held_ratio_3_of_4".split()
        return {**result, **dict.fromkeys(empty, math.nan)}
    low, high = binom.ppf((0.005, 0.995), covered.size, LEVEL) / covered.size
    assert number >= covered.size
    return {
        **result,
        "coverage": float(covered.mean()),
        "band_low": float(low),
        "band_high": float(high),
        "dead_zone_coverage": float(cases["dead_zone_covered"].values[answered].mean()),
        "error": float(np.median(cases["relative_error"].values[answered])),
        "width": float(np.median(cases["relative_width"].values[answered])),
        "held_ratio": float(np.median(cases["held_ratio"].values[answered])),
        "held_ratio_3_of_4": float(np.quantile(cases["held_ratio"].values[answered], 0.75)),
    }
