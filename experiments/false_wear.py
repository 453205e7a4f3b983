"""Is a change of the joint that is not wear called wear?

    bayesbl sweep configs/sweep.toml
    bayesbl run configs/false_wear.toml

A case is a pair of recordings of one joint with the same gap, made by the simulator of
``independent_bench.py``; before the second something else changes: gains, payload, stiffness. Each
pair is answered three times: directly with the current, directly by the speed alone, and by the
amplitude through a swept curve, whose check is that of the direct match with the current. An
increase is *called* if its probability is at least ``CALLED_AT`` and the answer is not withheld.
A row that changes nothing counts how many sound pairs are withheld.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import xarray as xr
from calibration_statistics import coverage_band
from independent_bench import plant, simulate, values_of
from pydantic import Field, NonNegativeFloat
from scipy.signal import lfilter
from study_tools import (
    LEVEL,
    SNAPSHOTS,
    StudyRow,
    bench_of,
    curve_of,
    fit_pair,
    is_withheld,
    random_start,
    without_current,
)
from wear_detection import gaps_by_amplitude

from bayesbl.measurement.direct_route import DirectMatch, check_of_comparison
from bayesbl.recording.types import MOTOR_SPEED, FloatArray, Recording

CALLED_AT = 0.95
"""Probability of an increase from which on it is called wear."""

GAP_RANGE_RAD = (1e-4, 1e-2)
ANSWERS = ("direct", "speed", "amplitude")


class Row(StudyRow):
    """A row: what changes in the joint before its second recording.

    ``multiplied``: bench parameters by a factor. ``added``: parameters of effects, as
    ``effect.parameter``. ``recorder_lag_s``: time constant of a filter in what records the speed,
    outside the loop.
    """

    bench: Path
    curve: Path
    multiplied: dict[str, float] = Field(default_factory=dict)
    added: dict[str, float] = Field(default_factory=dict)
    recorder_lag_s: NonNegativeFloat = 0.0
    gap_rad: float = Field(gt=0.0)


COLUMNS = {
    f"{answer}_{name}": (unit, f"{meaning}, {answer}")
    for answer in ANSWERS
    for name, unit, meaning in (
        ("probability_increase", "1", "posterior probability that the gap grew"),
        ("change_median_rad", "rad", "posterior median of the change"),
        ("withheld", "1", "1 where the change is withheld"),
        ("listed", "1", "1 where what changed is named or among the blind spots"),
    )
}


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One pair, answered in all three ways."""
    truth_seed, fit_seed = seed.spawn(2)
    generator = np.random.default_rng(truth_seed)
    recordings = [_recorded(row, name, generator) for name in SNAPSHOTS]
    bench = bench_of(row.bench)
    full = fit_pair(bench, recordings, GAP_RANGE_RAD, fit_seed)
    alone = fit_pair(bench, [*map(without_current, recordings)], GAP_RANGE_RAD, fit_seed)
    before, after, extreme = gaps_by_amplitude(curve_of(row.curve), recordings, fit_seed)
    changed = {*row.multiplied, *row.added}
    return {
        **_columns("direct", full.change_rad, is_withheld(full), _listed(full, changed)),
        **_columns("speed", alone.change_rad, is_withheld(alone), _listed(alone, changed)),
        **_columns(
            "amplitude",
            after - before,
            extreme or not full.joint.agrees,
            _listed(full, changed),
        ),
    }


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """Share called wear, share withheld, and whether what was called had been warned of."""
    line: dict[str, float | str] = {
        "pairs": float(cases.sizes["case"]),
        "nominal": 1.0 - CALLED_AT,
        # What a nominal rate leaves in at most 1 of 200 such rows.
        "nominal_at_most": coverage_band(cases.sizes["case"], 1.0 - CALLED_AT)[1],
    }
    for answer in ANSWERS:
        sure = cases[f"{answer}_probability_increase"].values >= CALLED_AT
        withheld = cases[f"{answer}_withheld"].values > 0.0
        called = sure & ~withheld
        listed = cases[f"{answer}_listed"].values > 0.0
        line |= {
            f"{answer}_called": float(called.mean()),
            f"{answer}_called_unwarned": float((called & ~listed).mean()),
            f"{answer}_withheld": float(withheld.mean()),
            f"{answer}_change_mrad": 1e3
            * float(np.median(cases[f"{answer}_change_median_rad"].values)),
        }
    return line


def _columns(answer: str, change_rad: FloatArray, withheld: bool, listed: bool) -> dict[str, float]:
    return {
        f"{answer}_probability_increase": float(np.mean(change_rad > 0.0)),
        f"{answer}_change_median_rad": float(np.median(change_rad)),
        f"{answer}_withheld": float(withheld),
        f"{answer}_listed": float(listed),
    }


def _recorded(row: Row, snapshot: str, generator: np.random.Generator) -> Recording:
    """A recording from a random start; the second one of the changed joint."""
    values = values_of(bench_of(row.bench))
    later = snapshot == SNAPSHOTS[1]
    if later:
        values |= {name: factor * values[name] for name, factor in row.multiplied.items()}
        values |= row.added
    truth = plant(values, gap_rad=row.gap_rad, **random_start(generator))
    recording = simulate(truth, generator, name=snapshot).recording
    if later and row.recorder_lag_s > 0.0:
        keep = math.exp(-recording.sampling_period_s / row.recorder_lag_s)
        speed = recording.channels[MOTOR_SPEED]
        slow, _ = lfilter([1.0 - keep], [1.0, -keep], speed, zi=[keep * speed[0]])
        recording = replace(recording, channels={**recording.channels, MOTOR_SPEED: slow})
    return recording


def _listed(found: DirectMatch, changed: set[str]) -> bool:
    """Whether something that changed is named, or listed as what would pass unseen."""
    named = {c.name for c in found.joint.changed}
    spots = check_of_comparison(found.joint, found.change_rad, LEVEL, is_given=True)["blind_spots"]
    return bool(changed & named) or any(s["name"] in changed for s in spots)
