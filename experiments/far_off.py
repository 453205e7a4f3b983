"""How far the gap is off where a bench that lacks an effect fits nearly down to the noise.

    bayesbl run configs/far_off.toml

Where χ² per sample exceeds ``GROSS``, diagnosis looks for the gap in its whole range again. Each
case hides one effect of the catalogue, at 0.02 to 1 of its typical strength, in recordings of the
second simulator at 2000, −2000 and 1200 rpm, and fits the bench without it.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import xarray as xr
from pydantic import BaseModel, ConfigDict, PositiveInt

sys.path.append(str(Path(__file__).parent))

import hidden_effects
from independent_bench import random_recordings

from bayesbl.config.bench import reference_bench
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.observed import observed
from bayesbl.matching.signals import GAP, gap_unknown, start_angle_unknown
from bayesbl.model_search.refit import GROSS

STRENGTH = (0.02, 1.0)
LEFT_OUT = ("backlash", "gravity_phase")
"""The gap itself, and what a start angle imitates."""
EFFECTS = tuple(name for name in hidden_effects.EFFECT_NAMES if name not in LEFT_OUT)

COLUMNS = {
    "strength": ("1", "of the effect, over a typical one"),
    "chi_square": ("1", "χ² per sample of the bench without it"),
    "gap_off": ("1", "|ln| of the fitted gap over the true one"),
}


class Row(BaseModel):
    """A row: a number of cases, the effects in turn."""

    model_config = ConfigDict(extra="forbid")

    cases: PositiveInt


def count(row: Row) -> int:
    return row.cases


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> dict[str, float]:
    generator = np.random.default_rng(seed)
    low, high = STRENGTH
    strength = math.exp(generator.uniform(math.log(low), math.log(high)))
    what = hidden_effects.Row(
        name="", cases=1, hide="effect", which=EFFECTS[index % len(EFFECTS)], strength=strength
    )
    hidden = hidden_effects.hide(what, index, generator)
    made = random_recordings(hidden.values, hidden.settings, generator)
    bench = reference_bench()
    seen = [observed(m.recording, bench, m.truth.reference_speed_rpm) for m in made]
    unknowns = [gap_unknown(*hidden_effects.GAP_RANGE_RAD)]
    unknowns += [start_angle_unknown(m.recording.name) for m in made]
    fit = fit_aligned(bench, seen, unknowns, 1)
    return {
        "strength": strength,
        "chi_square": fit.chi_square / fit.residual.size,
        "gap_off": abs(math.log(fit.value(GAP) / made[0].truth.gap_rad)),
    }


def summarise(row: Row, cases: xr.Dataset) -> dict[str, float]:
    far = cases["chi_square"].values > GROSS
    off = cases["gap_off"].values
    line = {"far_off": float(far.sum())}
    for name, chosen in (("near", off[~far]), ("far", off[far])):
        line[f"{name}_median_gap_off"] = float(np.median(chosen)) if chosen.size else math.nan
        line[f"{name}_largest_gap_off"] = float(chosen.max()) if chosen.size else math.nan
    return line
