"""How much of the bench's uncertainty cancels in the change of the gap?

Pairs of recordings of a bench drawn within its tolerances, before and after a known change, are
read through the curve that knows of these tolerances: both through the same draws of the curve, as
the product does, and each through draws of its own. The posterior of A is taken normal around the
optimum, with the covariance that emcee samples.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import xarray as xr
from pydantic import Field
from study_tools import (
    TurningRow,
    bench_of,
    curve_of,
    held,
    interval_of,
    listed,
    normal_ringing,
    turned,
)

from bayesbl.config.sections import Items
from bayesbl.measurement.gap_by_curve import gaps

WAYS = ("shared", "apart")


class Row(TurningRow):
    """A row: a bench with tolerances, its curve, the gap before and the changes, in turn."""

    bench: Path
    curve: Path
    gap_rad: float = Field(gt=0.0)
    changes_rad: Items[float] = Field(min_length=1)


COLUMNS = {
    "change_rad": ("rad", "change simulated"),
    **{f"{way}_width_rad": ("rad", f"width of the 90 % interval, curve {way}") for way in WAYS},
    **{f"{way}_holds": ("1", "1 where that interval holds the change") for way in WAYS},
}  # fmt: skip


def count(row: Row) -> int:
    """Number of pairs, over all changes."""
    return row.cases * len(row.changes_rad)


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One pair, read in both ways."""
    truth_seed, gap_seed, *fit_seeds = seed.spawn(4)
    generator = np.random.default_rng(truth_seed)
    change = row.changes_rad[index % len(row.changes_rad)]
    true, curve = bench_of(row.bench).draw(generator), curve_of(row.curve)
    ringing = [
        normal_ringing(curve, turned(true, gap, row, generator), own, generator)
        for gap, own in zip((row.gap_rad, row.gap_rad + change), fit_seeds, strict=True)
    ]
    together_seed, *own_seeds = gap_seed.spawn(3)
    shared = [gap.delta_rad for gap in gaps([curve] * len(ringing), ringing, together_seed)]
    apart = [
        gaps([curve], [one], own)[0].delta_rad for one, own in zip(ringing, own_seeds, strict=True)
    ]
    result = {"change_rad": change}
    for way, (before, after) in zip(WAYS, (shared, apart), strict=True):
        low, high = interval_of(after - before)
        result[f"{way}_width_rad"] = high - low
        result[f"{way}_holds"] = held(after - before, change)
    return result


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """Median widths at each change in mrad, and the share of intervals that hold the change."""
    change = cases["change_rad"].values
    line: dict[str, float | str] = {
        "gap_mrad": 1e3 * row.gap_rad,
        "changes_mrad": listed(1e3 * c for c in row.changes_rad),
    }
    for way in WAYS:
        width = 1e3 * cases[f"{way}_width_rad"].values
        line[f"{way}_width_mrad"] = listed(np.median(width[change == c]) for c in row.changes_rad)
        line[f"{way}_90%"] = float(cases[f"{way}_holds"].values.mean())
    return line
