"""Does the limit come when a forecast says, whatever the law of wear?

    bayesbl run configs/forecasts.toml

A case is a joint that wears by a known law from new until its gap reaches the limit, at the end of
its *life*. Snapshots are taken at irregular intervals from a random age on; the last is at 0.3 to
0.8 of the life, in turn. The measured gaps are off as those of the package are: by a factor that
all share (the curve's or the bench's, sd 0.5, 2 or 4 %, as direct route, narrow and wide tolerances
leave it) and each by its own (0.3, 1 or 2 %, as noise of 0.3 and 1.5 rpm leave it; see
``wear_detection.csv``). The joint draws go through :func:`bayesbl.measurement.wear.wear`, which
knows neither law nor age. Hardly a law is exactly one of its family: running in is hyperbolic, the
S-shape starts from rest, steps are jumps of random size.

Besides coverage the table has what the prognostics field asks for (Saxena et al. 2010): the share
of forecasts at half the life whose draws lie within ``ALPHA`` of the true remaining life more often
than not (α-λ accuracy), and the prognostic horizon, the remaining share of life from which on at
least half of the forecasts have most of their draws within ``HORIZON_ALPHA`` of the life around its
true end.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np
import xarray as xr
from pydantic import Field
from study_tools import StudyRow, listed, mean

from bayesbl.config.sections import Items
from bayesbl.measurement.wear import wear
from bayesbl.recording.types import FloatArray

ALPHA = 0.2
"""Error of the remaining life, relative to it, that α-λ accuracy allows."""

HORIZON_ALPHA = 0.1
"""Error of the end of life, relative to the whole life, that the prognostic horizon allows."""

LEVEL = 0.9
DRAWS = 2000
LAST_AT = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
"""Where the last snapshot is, in lives."""

SHARED_SD = (0.005, 0.02, 0.04)
OWN_SD = (0.003, 0.01, 0.02)

Growth = Callable[[FloatArray], FloatArray]
"""Share of the way to the limit, 0 when new, against the age in (expected) lives."""


class Row(StudyRow):
    """A row: one law of wear, ``cases`` joints with each number of ``dates``."""

    law: Literal[
        "linear", "running_in", "quadratic", "power", "exponential", "logistic", "gamma", "steps",
        "square_root", "power_0.6", "kink", "bathtub", "slowing",
    ]  # fmt: skip
    dates: Items[int] = Field(min_length=1)


COLUMNS = {
    "dates": ("1", "number of snapshots"),
    "last_at": ("1", "age at the last snapshot in expected lives"),
    "remaining": ("1", "true time from the last snapshot to the limit in expected lives"),
    "low": ("1", "low end of the interval of that time in expected lives"),
    "median": ("1", "its median"),
    "high": ("1", "high end of the interval"),
    "not_before": ("1", "one-sided bound of the time"),
    "near_remaining": ("1", "share of draws within ALPHA of the true time"),
    "near_life": ("1", "share of draws within HORIZON_ALPHA of the life around its end"),
    "withheld": ("1", "1 where there is no forecast"),
}


def count(row: Row) -> int:
    """Number of joints, over all numbers of dates."""
    return row.cases * len(row.dates)


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One joint; numbers of dates, places of the last one and errors take turns."""
    truth_seed, wear_seed = seed.spawn(2)
    generator = np.random.default_rng(truth_seed)
    round_, which = divmod(index, len(row.dates))
    dates, last = row.dates[which], LAST_AT[round_ % len(LAST_AT)]
    grown = law_of(row.law, generator)
    while grown(np.array(last)) >= 1.0:  # irregular wear can be ahead of its time
        grown = law_of(row.law, generator)
    new_rad, life_years = generator.uniform(4e-4, 8e-4), generator.uniform(2.0, 6.0)
    way_rad = generator.uniform(3e-4, 8e-4)
    if row.law == "quadratic":  # 0.6 + 0.05 t + 0.07 t² mrad, doubled at the end
        new_rad = way_rad = 6e-4
    ages = np.linspace(generator.uniform(0.0, 0.2), last, dates)
    ages[1:-1] += generator.uniform(-0.25, 0.25, dates - 2) * (ages[1] - ages[0])
    draws = measured(new_rad + way_rad * grown(ages), generator)
    found = wear(draws, life_years * ages, wear_seed, limit_rad=new_rad + way_rad)
    remaining = reached(grown, last) - last
    case = {"dates": float(dates), "last_at": last, "remaining": remaining}
    if found is None:
        return case | dict.fromkeys(set(COLUMNS) - set(case), np.nan) | {"withheld": 1.0}
    times = found["years_to_limit"].values.ravel() / life_years
    low, median, high = np.quantile(times, [0.5 - 0.5 * LEVEL, 0.5, 0.5 + 0.5 * LEVEL])
    error = np.abs(times - remaining)
    return case | {
        "low": float(low),
        "median": float(median),
        "high": float(high),
        "not_before": float(np.quantile(times, 1.0 - LEVEL)),
        "near_remaining": float(np.mean(error < ALPHA * remaining)),
        "near_life": float(np.mean(error < HORIZON_ALPHA * (last + remaining))),
        "withheld": 0.0,
    }


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """Coverage, width and accuracy, over all numbers of dates and by each of them."""
    line: dict[str, float | str] = {
        "law": row.law,
        "withheld": float(cases["withheld"].mean()),
        "dates": " ".join(str(n) for n in row.dates),
    }
    given = cases.isel(case=np.flatnonzero(cases["withheld"].values == 0.0))
    truth = given["remaining"]
    shares = {
        "covered": (given["low"] <= truth) & (truth <= given["high"]),
        "not_before_right": truth >= given["not_before"],
        "limit_earlier": truth < given["low"],
        "limit_later": truth > given["high"],
    }
    of = [np.flatnonzero(given["dates"].values == n) for n in row.dates]
    for name, holds in shares.items():
        line[name] = float(holds.mean())
        line[f"{name}_by_dates"] = listed((float(holds.values[each].mean()) for each in of), 3)
    width, error = (given["high"] - given["low"]) / truth, given["median"] / truth
    line["width_by_dates"] = listed((float(np.median(width.values[each])) for each in of), 3)
    line["median_by_dates"] = listed((float(np.median(error.values[each])) for each in of), 3)
    near, at_half = given["near_remaining"].values > 0.5, given["last_at"].values == 0.5
    line["alpha_lambda_by_dates"] = listed((mean(near[each][at_half[each]]) for each in of), 3)
    line["horizon_by_dates"] = listed((_horizon(given.isel(case=each)) for each in of), 3)
    return line


def _horizon(cases: xr.Dataset) -> float:
    """Remaining share of life from which on at least half of the forecasts are near its end."""
    horizon = 0.0
    for last in reversed(LAST_AT):
        near = cases["near_life"].values[cases["last_at"].values == last]
        if not near.size or np.mean(near > 0.5) < 0.5:
            break
        horizon = 1.0 - last
    return horizon


def measured(gaps_rad: FloatArray, generator: np.random.Generator) -> FloatArray:
    """Joint draws of the gaps as a measurement gives them, shape (date, chain, draw)."""
    shared, own = generator.choice(SHARED_SD), generator.choice(OWN_SD)
    dates = gaps_rad.size
    off = shared * generator.standard_normal() + own * generator.standard_normal(dates)
    draws = shared * generator.standard_normal((2, DRAWS // 2))
    draws = draws + own * generator.standard_normal((dates, 2, DRAWS // 2))
    return np.asarray(gaps_rad[:, None, None] * np.exp(off[:, None, None] + draws))


def reached(grown: Growth, last: float) -> float:
    """Age at which the limit is reached, in expected lives."""
    ages = np.linspace(last, 5.0, 200_001)
    return float(ages[np.argmax(grown(ages) >= 1.0 - 1e-12)])


def law_of(law: str, generator: np.random.Generator) -> Growth:
    """Growth of one joint by a law; those without chance are 1 at the age 1."""
    if law == "running_in":
        share, duration = generator.uniform(0.3, 0.8), generator.uniform(0.02, 0.3)
        return lambda t: share * (1.0 + duration) * t / (t + duration) + (1.0 - share) * t
    if law == "quadratic":
        life = (-0.05 + np.sqrt(0.05**2 + 4.0 * 0.07 * 0.6)) / (2.0 * 0.07)
        return lambda t: (0.05 * life * t + 0.07 * (life * t) ** 2) / 0.6
    if law == "power":
        exponent = generator.choice([1.5, 3.0])
        return lambda t: t**exponent
    if law == "exponential":
        growth = np.log(2.0) * generator.uniform(1.0, 5.0)  # doublings of the rate in a life
        return lambda t: np.expm1(growth * t) / np.expm1(growth)
    if law == "logistic":  # levels off; the limit is at 70 to 95 % of its rise
        width, at = generator.uniform(0.08, 0.2), generator.uniform(0.7, 0.95)
        middle = 1.0 - width * np.log(at / (1.0 - at))

        def risen(t: FloatArray | float) -> FloatArray:
            return np.asarray(1.0 / (1.0 + np.exp(-(t - middle) / width)))

        return lambda t: (risen(t) - risen(0.0)) / (risen(1.0) - risen(0.0))
    if law == "gamma":
        jumps, ages = generator.uniform(10.0, 40.0), np.linspace(0.0, 5.0, 5001)
        steps = generator.gamma(np.diff(ages) * jumps, 1.0 / jumps)
        path = np.concatenate([[0.0], np.cumsum(steps)])
        return lambda t: np.interp(t, ages, path)
    if law == "steps":  # 8 to 20 in a life, at any time, of random size
        jumps = generator.uniform(8.0, 20.0)
        times = np.cumsum(generator.exponential(1.0 / jumps, 300))
        size = generator.lognormal(-0.125, 0.5, 300) / jumps
        risen_to = np.concatenate([[0.0], np.cumsum(size)])
        return lambda t: np.asarray(risen_to[np.searchsorted(times, t, side="right")])
    if law in ("square_root", "power_0.6"):
        exponent = 0.5 if law == "square_root" else 0.6
        return lambda t: t**exponent
    if law in ("kink", "slowing"):  # the rate changes once, at 20 to 90 % of the life
        at = generator.uniform(0.2, 0.9)
        factor = generator.uniform(2.0, 4.0) if law == "kink" else 0.4
        whole = at + factor * (1.0 - at)
        return lambda t: (np.minimum(t, at) + factor * np.maximum(t - at, 0.0)) / whole
    if law == "bathtub":  # runs in, wears evenly, and wears out with the fourth power of age
        early, out = generator.uniform(0.1, 0.3), generator.uniform(0.3, 0.6)
        duration = generator.uniform(0.03, 0.1)
        even = 1.0 - early - out
        return lambda t: -early * np.expm1(-t / duration) + even * t + out * t**4
    return lambda t: t
