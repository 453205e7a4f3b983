"""Wear in time, as ``result.nc`` and ``summary.json`` of a comparison hold it.

Group :data:`WEAR` of ``result.nc``: ``date`` of every snapshot, whether it is ``used`` (taken since
the last repair), and the draws of :class:`bayesbl.measurement.wear.Wear`, where there is a rate.
Attributes: ``decide_before`` where that was asked, ``relative_sd_per_date`` with ``drift_widens``
where the gaps drift, ``width_over_prior`` of the date.

``wear`` of ``summary.json`` is ``null`` where no snapshot is dated; its keys are those of
:class:`bayesbl.measurement.summary_types.WearSummary`.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date as Date
from datetime import timedelta
from typing import Any

import numpy as np
import xarray as xr

from bayesbl.config.measurement import CompareConfig
from bayesbl.config.sections import Interval as IntervalConfig
from bayesbl.measurement.compatibility import limit_rad_of
from bayesbl.measurement.measurement import Answer, Reason
from bayesbl.measurement.summary_types import DateInterval, RateInterval
from bayesbl.measurement.wear import (
    FEWEST_FOR_SCATTER,
    LONGEST_YEARS,
    Wear,
    fall,
    probability_before,
    since_repair,
    trend,
    wear,
)
from bayesbl.measurement.wear_laws import shares
from bayesbl.recording.types import FloatArray
from bayesbl.results.intervals import Interval, interval
from bayesbl.results.variables import Group, attributes, dataset, table

DAYS_PER_YEAR = 365.25


def years_between(first: Date, last: Date) -> float:
    """Time from one date to another."""
    return (last - first).days / DAYS_PER_YEAR


def date_after(first: Date, years: float) -> Date | None:
    """The day so many years later; ``None`` where that is beyond what is computed."""
    if years >= LONGEST_YEARS:
        return None
    return first + timedelta(days=round(years * DAYS_PER_YEAR))


WEAR = Group(
    "wear",
    table("""
        date (dated) | text | date of snapshot
        used (dated) | 1 | 1 where taken since the last repair
        trend_rad_per_year? (chain, draw) | rad/year | slope of a straight line, of either sign
        law? (chain, draw) | 1 | kind of the law at the last snapshot, from 0
        law_shape? (law_parameter, chain, draw) | 1 | age, starts, exponents, factors of the law
        first_rad? (chain, draw) | rad | gap at the first snapshot in use, from all of them
        current_rad? (chain, draw) | rad | gap at the last snapshot, from all of them
        expected_growth_rad? (chain, draw) | rad | mean growth between them by the law
        rate_now_rad_per_year? (chain, draw) | rad/year | rate at the last snapshot by the law
        scatter_rad_per_root_year? (chain, draw) | rad/year^0.5 | irregular wear
        years_to_limit? (chain, draw) | year | time from the last snapshot to the limit
        changes_ahead? (chain, draw) | 1 | 1 where wear changes before the limit is reached
    """),
    optional=True,
)


def wear_of(
    config: CompareConfig,
    answers: Sequence[Answer],
    seed: np.random.SeedSequence,
    change_reason: Reason | None = None,
) -> tuple[xr.Dataset | None, Reason | None]:
    """Group :data:`WEAR` of a comparison, and why it has no rate.

    ``None`` where not every recording has a date. ``change_reason`` is why the change of the gap is
    withheld, which withholds its rate too.
    """
    dates = config.dates
    if dates is None:
        return None, None
    used = since_repair([recording.repaired for recording in config.recordings])
    since, chosen = dates[used], answers[used]
    group = wear_group(dates, used)
    if config.joint.decide_before is not None:
        group.attrs["decide_before"] = config.joint.decide_before.isoformat()
    if since[0] == since[-1]:
        repaired = config.recordings[used.start].repaired
        return group, Reason("one_date", {"count": len(since), "repaired": repaired})
    withheld = [answer.name for answer in chosen if answer.is_withheld]
    if withheld:
        return group, Reason("gap_withheld", {"names": withheld})
    if change_reason is not None:
        return group, change_reason
    years = np.array([years_between(since[0], day) for day in since])
    drift_seed, wear_seed = seed.spawn(2)
    measured = np.stack([a.delta_rad for a in chosen if a.delta_rad is not None])
    drawn = _drifting(measured, config.wear.relative_sd_per_date, drift_seed)
    start, limit = config.wear.in_service_since, limit_rad_of(config)
    age = None if start is None else max(years_between(start, since[0]), 0.0)
    fell = fall(drawn)
    if fell.is_fall:
        values = {
            "name": chosen[fell.snapshot].name,
            "fall_rad": fell.fall_rad,
            "standard_deviations": fell.standard_deviations,
        }
        return group, Reason("gap_fell", values)
    found = wear(drawn, years, wear_seed, limit_rad=limit, age_years=age)
    if found is None:
        return group, Reason("gap_shrank")
    slope = trend(drawn, years)
    group = wear_group(dates, used, found, slope).assign_attrs(group.attrs)
    if found.width_over_prior is not None:
        group.attrs["width_over_prior"] = found.width_over_prior
    if config.wear.relative_sd_per_date > 0.0:
        group.attrs["relative_sd_per_date"] = config.wear.relative_sd_per_date
        group.attrs["drift_widens"] = float(slope.std() / trend(measured, years).std())
    return group, None


def _drifting(
    delta_rad: FloatArray, relative_sd: float, seed: np.random.SeedSequence
) -> FloatArray:
    """Draws of gaps that temperature, grease and the like may have moved, each date by itself."""
    moved = np.random.default_rng(seed).standard_normal(delta_rad.shape)
    return np.asarray(delta_rad * np.exp(relative_sd * moved))


def wear_group(
    dates: Sequence[Date],
    used: slice,
    found: Wear | None = None,
    slope_rad_per_year: FloatArray | None = None,
) -> xr.Dataset:
    """Group :data:`WEAR`; without ``found`` there is no rate."""
    chosen = np.zeros(len(dates))
    chosen[used] = 1.0
    values = {"date": [d.isoformat() for d in dates], "used": chosen, **attributes(WEAR, found)}
    return dataset(WEAR, values | {"trend_rad_per_year": slope_rad_per_year})


def used_dates(group: xr.Dataset) -> list[Date]:
    """Dates of the snapshots since the last repair."""
    stored = zip(group["date"].values, group["used"].values, strict=True)
    return [Date.fromisoformat(str(day)) for day, used in stored if used]


def summarise_wear(
    group: xr.Dataset,
    names: Sequence[str],
    of: IntervalConfig,
    limit_rad: float | None,
    stated_limit: str | None = None,
) -> dict[str, Any]:
    """``wear`` of the summary of a comparison (see the module), but for its ``reason``."""
    level, kind = of.level, of.kind
    before = group.attrs.get("decide_before")
    dates = used_dates(group)
    result: dict[str, Any] = {
        "snapshots": [n for n, used in zip(names, group["used"].values, strict=True) if used],
        "first_date": dates[0].isoformat(),
        "last_date": dates[-1].isoformat(),
        "level": level,
        "probability_wear": None,
        "law": None,
        "rate": None,
        "rate_now": None,
        "rate_at_most_rad_per_year": None,
        "scatter_rad_per_root_year": None,
        "relative_sd_per_date": float(group.attrs.get("relative_sd_per_date", 0.0)),
        "drift_widens": group.attrs.get("drift_widens"),
        "limit_rad": limit_rad,
        "limit": stated_limit,
        "years_to_limit": None,
        "date_of_limit": None,
        "not_before": None,
        "decide_before": before,
        "probability_before": None,
        "forecast_from_prior": None,
    }
    if "law" not in group:
        return result
    grown = group["current_rad"].values - group["first_rad"].values
    rate = grown / years_between(dates[0], dates[-1])
    result |= {
        "probability_wear": float(np.mean(group["trend_rad_per_year"].values > 0.0)),
        "law": shares(group["law"].values),
        "rate": _rate(interval(rate, level, kind)),
        "rate_now": _rate(interval(group["rate_now_rad_per_year"].values, level, kind)),
        "rate_at_most_rad_per_year": float(np.quantile(rate, level)),
    }
    if len(dates) >= FEWEST_FOR_SCATTER:
        scatter = group["scatter_rad_per_root_year"].values
        result["scatter_rad_per_root_year"] = interval(scatter, level, kind)
    if "years_to_limit" in group:
        years = group["years_to_limit"].values
        found = interval(years, level, kind)
        result["years_to_limit"] = found
        result["date_of_limit"] = _dates(dates[-1], found)
        earliest = _iso(dates[-1], float(np.quantile(years, 1.0 - level)))
        result["not_before"] = {"date": earliest, "level": level}
        if "width_over_prior" in group.attrs:
            result["forecast_from_prior"] = {
                "width_over_prior": float(group.attrs["width_over_prior"]),
                "probability_change_ahead": float(group["changes_ahead"].mean()),
            }
        if before is not None:
            ahead = years_between(dates[-1], Date.fromisoformat(before))
            passed = probability_before(years, ahead)
            result["probability_before"] = {"date": before, "probability": passed}
    return result


def _rate(found: Interval) -> RateInterval:
    return {**found, "unit": "rad/year"}


def _dates(last: Date, years: Interval) -> DateInterval:
    return {
        "median": _iso(last, years["median"]),
        "low": _iso(last, years["low"]),
        "high": _iso(last, years["high"]),
        "level": years["level"],
        "kind": years["kind"],
    }


def _iso(first: Date, years: float) -> str | None:
    found = date_after(first, years)
    return None if found is None else found.isoformat()
