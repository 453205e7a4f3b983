"""How much of the bench's uncertainty cancels in the change of the gap?

Pairs of recordings of a bench drawn within its tolerances, before and after a known change, are
read through the curve that knows of these tolerances: both through the same draws of the curve, as
the product does, and each through draws of its own. The posterior of A is taken normal around the
optimum, with the covariance that emcee samples.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path

import numpy as np
import xarray as xr
from pydantic import BaseModel, ConfigDict, Field, PositiveInt

from bayesbl.bench.bench import Bench
from bayesbl.config.bench import load_bench
from bayesbl.config.sections import Items
from bayesbl.curve.gap_curve import GapCurve, likeliest_branch
from bayesbl.measurement.curves import read_curve
from bayesbl.measurement.gap_by_curve import MeasuredRinging, gaps
from bayesbl.recording.types import FloatArray
from bayesbl.ringing.estimator import Estimator

WAYS = ("shared", "apart")


class Row(BaseModel):
    """A row: a bench with tolerances, its curve, the gap before and the changes, in turn."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    bench: Path
    curve: Path
    gap_rad: float = Field(gt=0.0)
    changes_rad: Items[float] = Field(min_length=1)
    pairs: PositiveInt
    rotations: float = 5.0
    sampling_hz: float = 1000.0


COLUMNS = {
    "change_rad": ("rad", "change simulated"),
    **{f"{way}_width_rad": ("rad", f"width of the 90 % interval, curve {way}") for way in WAYS},
    **{f"{way}_holds": ("1", "1 where that interval holds the change") for way in WAYS},
}  # fmt: skip


def count(row: Row) -> int:
    """Number of pairs, over all changes."""
    return row.pairs * len(row.changes_rad)


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One pair, read in both ways."""
    truth_seed, gap_seed, *fit_seeds = seed.spawn(4)
    generator = np.random.default_rng(truth_seed)
    change = row.changes_rad[index % len(row.changes_rad)]
    true, curve = _bench(row.bench).draw(generator), _curve(row.curve)
    ringing = [
        _fit(row, true, gap, generator, own)
        for gap, own in zip((row.gap_rad, row.gap_rad + change), fit_seeds, strict=True)
    ]
    together_seed, *own_seeds = gap_seed.spawn(3)
    shared = [gap.delta_rad for gap in gaps([curve] * len(ringing), ringing, together_seed)]
    apart = [
        gaps([curve], [one], own)[0].delta_rad for one, own in zip(ringing, own_seeds, strict=True)
    ]
    result = {"change_rad": change}
    for way, (before, after) in zip(WAYS, (shared, apart), strict=True):
        low, high = np.quantile(after - before, [0.05, 0.95])
        result[f"{way}_width_rad"] = float(high - low)
        result[f"{way}_holds"] = float(low <= change <= high)
    return result


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """Median widths at each change in mrad, and the share of intervals that hold the change."""
    change = cases["change_rad"].values
    line: dict[str, float | str] = {
        "gap_mrad": 1e3 * row.gap_rad,
        "changes_mrad": _listed(1e3 * c for c in row.changes_rad),
    }
    for way in WAYS:
        width = 1e3 * cases[f"{way}_width_rad"].values
        line[f"{way}_width_mrad"] = _listed(np.median(width[change == c]) for c in row.changes_rad)
        line[f"{way}_90%"] = float(cases[f"{way}_holds"].values.mean())
    return line


def _fit(
    row: Row,
    bench: Bench,
    gap_rad: float,
    generator: np.random.Generator,
    seed: np.random.SeedSequence,
) -> MeasuredRinging:
    recording = bench.simulate(
        gap_rad,
        rotations=row.rotations,
        sampling_hz=row.sampling_hz,
        start_angle_rad=generator.uniform(0.0, 2.0 * math.pi),
        seed=generator,
    )
    estimator = Estimator()
    point = likeliest_branch(_curve(row.curve), estimator, estimator.estimate(recording, seed))
    centre, covariance = point.ringing
    draws: FloatArray = generator.normal(centre[0], math.sqrt(covariance[0, 0]), (2, 2000))
    return MeasuredRinging(draws, centre, covariance)


def _listed(numbers: Iterable[float]) -> str:
    return " ".join(f"{x:.5g}" for x in numbers)


@cache
def _bench(path: Path) -> Bench:
    return load_bench(path)


@cache
def _curve(path: Path) -> GapCurve:
    return read_curve(path)
