"""How much must a joint wear before a comparison of two recordings reports it?

    bayesbl sweep configs/sweep.toml
    bayesbl run configs/wear_detection.toml

A case is a pair of recordings of the virtual bench, before and after a known change of the gap,
with start angles of their own. By the amplitude route each is fitted as any recording is and both
are put through one draw of a swept curve; the posterior of A is taken normal around the optimum,
with the covariance that emcee samples. By the direct route both are fitted together, with the fast
posterior. An increase is *reported* if its probability is at least ``REPORTED_AT``; reported
without a change it is a false alarm, of which there should be at most one minus that.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import xarray as xr
from calibration_statistics import coverage_band
from pydantic import Field, NonNegativeInt, Strict, model_validator
from study_tools import (
    SNAPSHOTS,
    TurningRow,
    bench_of,
    curve_of,
    fit_pair,
    is_withheld,
    normal_ringing,
    turned,
)

from bayesbl.config.sections import Items, refuse
from bayesbl.curve.gap_curve import GapCurve
from bayesbl.matching.signals import GAP
from bayesbl.measurement.gap_by_curve import gaps
from bayesbl.recording.types import FloatArray, Recording

REPORTED_AT = 0.95
"""Probability of an increase from which on it is reported."""

POWER = 0.95
"""Share of pairs in which the smallest change that counts as detectable is reported."""

REPEATS = 200
"""Tables drawn again from the fitted curve, for the standard error of the smallest change."""


class Row(TurningRow):
    """A row: one joint and one way to record it, over several true changes.

    ``cases``: pairs for each of ``changes_rad``; ``more_without_wear``: pairs with no change, which
    count false alarms. ``route`` ``amplitude`` needs a ``curve``; ``prior_rad`` is
    the range of the direct route's prior.
    """

    bench: Path
    route: Literal["amplitude", "direct"] = "amplitude"
    curve: Path | None = None
    prior_rad: Annotated[tuple[float, float], Strict(False)] = (1e-4, 1e-2)
    gap_rad: float = Field(gt=0.0)
    changes_rad: Items[float] = Field(min_length=1)
    more_without_wear: NonNegativeInt = 0
    speed_noise_sd_rpm: float = Field(gt=0.0)
    coefficients: Items[float] = (0.6,)

    @model_validator(mode="after")
    def _has_a_curve(self) -> Row:
        if self.route == "amplitude" and self.curve is None:
            refuse("The amplitude route needs a curve.", found="none", expected="a sweep's file")
        return self


COLUMNS = {
    "change_rad": ("rad", "change simulated"),
    "probability_increase": ("1", "posterior probability that the gap grew"),
    "change_median_rad": ("rad", "posterior median of the change"),
    "change_sd_rad": ("rad", "posterior standard deviation of the change"),
    "withheld": ("1", "1 where the answer would be withheld"),
}


def count(row: Row) -> int:
    """Number of pairs, over all changes."""
    return row.cases * len(row.changes_rad) + row.more_without_wear


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One pair; changes take turns, so that a study cut short has pairs of each."""
    truth_seed, fit_seed = seed.spawn(2)
    generator = np.random.default_rng(truth_seed)
    in_turn = index < row.cases * len(row.changes_rad)
    change = row.changes_rad[index % len(row.changes_rad)] if in_turn else 0.0
    bench = bench_of(row.bench, row.speed_noise_sd_rpm, *row.coefficients)
    recordings = [turned(bench, gap, row, generator) for gap in (row.gap_rad, row.gap_rad + change)]
    if row.route == "direct":
        found = fit_pair(bench, recordings, row.prior_rad, fit_seed)
        before, after = (found.posterior.values(GAP, name) for name in SNAPSHOTS)
        withheld = is_withheld(found)
    else:
        assert row.curve is not None
        before, after, withheld = gaps_by_amplitude(curve_of(row.curve), recordings, fit_seed)
    grown = after - before
    return {
        "change_rad": change,
        "probability_increase": float(np.mean(grown > 0.0)),
        "change_median_rad": float(np.median(grown)),
        "change_sd_rad": float(grown.std()),
        "withheld": float(withheld),
    }


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """False alarms, the share reported at each change, and the smallest change found."""
    change, reported = cases["change_rad"].values, _reported(cases)
    line: dict[str, float | str] = {
        "route": row.route,
        "gap_mrad": 1e3 * row.gap_rad,
        "noise_sd_rpm": row.speed_noise_sd_rpm,
        "rotations": row.rotations,
        "pairs_per_change": float(row.cases),
    }
    known = np.unique(change)
    shares = [float(reported[change == c].mean()) for c in known]
    if known[0] == 0.0:
        without = int(np.sum(change == 0.0))
        line["pairs_without_wear"] = float(without)
        line["false_alarms"] = shares[0]
        # What a nominal rate leaves in at most 1 of 200 studies.
        line["false_alarms_at_most"] = coverage_band(without, 1.0 - REPORTED_AT)[1]
    line |= {
        "changes_mrad": " ".join(f"{1e3 * c:g}" for c in known),
        "reported": " ".join(f"{share:.3f}" for share in shares),
        "change_sd_mrad": 1e3 * float(np.median(cases["change_sd_rad"].values)),
        "withheld": float(cases["withheld"].values.mean()),
    }
    if known.size == 1:
        return line
    middle, width = detection_curve(change, reported)
    smallest = smallest_change(middle, width)
    return line | {
        "half_found_mrad": 1e3 * middle,
        "curve_width_mrad": 1e3 * width,
        "smallest_mrad": 1e3 * smallest,
        "smallest_se_mrad": 1e3 * _standard_error(change, middle, width),
        "smallest_%": 100.0 * smallest / row.gap_rad,
    }


def detection_curve(change_rad: FloatArray, reported: FloatArray) -> tuple[float, float]:
    """Change at which half the pairs are reported, and the width of the curve around it, rad.

    Maximum likelihood of P(reported | change) = Φ((change − middle) / width).
    """
    from scipy.optimize import minimize
    from scipy.stats import norm

    scale = float(change_rad.max()) or 1.0
    x = change_rad / scale

    def deviance(symbols: FloatArray) -> float:
        z = (x - symbols[0]) / math.exp(symbols[1])
        return -float(np.sum(norm.logcdf(np.where(reported > 0.0, z, -z))))

    # Curves much steeper than the spacing of the changes cannot be distinguished.
    bounds = [(-2.0, 4.0), (math.log(0.02), math.log(5.0))]
    found = minimize(deviance, np.array([0.4, -1.5]), method="L-BFGS-B", bounds=bounds)
    return scale * float(found.x[0]), scale * math.exp(found.x[1])


def smallest_change(middle_rad: float, width_rad: float, power: float = POWER) -> float:
    """The change that a detection curve reports in a share ``power`` of pairs, rad."""
    from scipy.stats import norm

    return middle_rad + width_rad * float(norm.ppf(power))


def _reported(cases: xr.Dataset) -> FloatArray:
    """1 where an increase is reported; an answer that is withheld reports nothing."""
    sure = cases["probability_increase"].values >= REPORTED_AT
    return np.asarray(sure & (cases["withheld"].values == 0.0), dtype=np.float64)


def _standard_error(change_rad: FloatArray, middle_rad: float, width_rad: float) -> float:
    """Parametric bootstrap of the smallest change found."""
    from scipy.stats import norm

    generator = np.random.default_rng(11)
    chance = norm.cdf((change_rad - middle_rad) / width_rad)
    again = [
        smallest_change(
            *detection_curve(change_rad, (generator.uniform(size=chance.size) < chance) * 1.0)
        )
        for _ in range(REPEATS)
    ]
    return float(np.std(again))


def gaps_by_amplitude(
    curve: GapCurve, recordings: Sequence[Recording], seed: np.random.SeedSequence
) -> tuple[FloatArray, FloatArray, bool]:
    """Draws of two gaps by one curve, shape (2, 2000), rad, and whether either is withheld.

    The posterior of A is taken normal around the optimum.
    """
    *own, draw_seed, gap_seed = seed.spawn(len(recordings) + 2)
    generator = np.random.default_rng(draw_seed)
    ringing = [
        normal_ringing(curve, recording, search_seed, generator)
        for recording, search_seed in zip(recordings, own, strict=True)
    ]
    before, after = gaps([curve, curve], ringing, gap_seed)
    withheld = bool(before.reasons or after.reasons)
    return before.delta_rad, after.delta_rad, withheld
