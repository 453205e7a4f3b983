"""Wear in time, as ``result.nc`` and ``summary.json`` of a comparison hold it.

Group :data:`WEAR` of ``result.nc``: ``date`` of every snapshot, whether it is ``used`` (taken since
the last repair), and the draws of :class:`bayesbl.measurement.wear.Wear`. Attributes: ``reason``
where the answer is withheld, ``decide_before`` where that was asked, ``relative_sd_per_date`` with
``drift_widens`` where the gaps drift, ``width_over_prior`` of the date.

``wear`` of ``summary.json`` is ``null`` where no snapshot is dated; its keys are those of
:class:`bayesbl.measurement.summary_types.WearSummary`.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date as Date
from datetime import timedelta

import numpy as np
import xarray as xr

from bayesbl.config.measurement import CompareConfig
from bayesbl.measurement.compatibility import limit_rad_of
from bayesbl.measurement.measurement import Snapshot
from bayesbl.measurement.summary_types import (
    DateInterval,
    RateInterval,
    WearSummary,
    WithheldWearSummary,
)
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
from bayesbl.units import number

DAYS_PER_YEAR = 365.25


def years_between(first: Date, last: Date) -> float:
    """Time from one date to another."""
    return (last - first).days / DAYS_PER_YEAR


def date_after(first: Date, years: float) -> Date | None:
    """The day so many years later; ``None`` where that is beyond what is computed."""
    if years >= LONGEST_YEARS:
        return None
    return first + timedelta(days=round(years * DAYS_PER_YEAR))


UNLESS_REPAIRED = (
    "If the joint was repaired, mark the first recording after it (repaired = true); if not, are "
    "files or dates swapped? What temperature and grease move each date's gap by belongs under "
    "[wear]: relative_sd_per_date = 0.02 is 2 %."
)

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
    snapshots: Sequence[Snapshot],
    seed: np.random.SeedSequence,
    change_reason: str | None = None,
) -> xr.Dataset | None:
    """Group :data:`WEAR` of a comparison; ``None`` where not every recording has a date.

    ``change_reason`` is why the change of the gap is withheld, which withholds its rate too.
    """
    dates = config.dates
    if dates is None:
        return None
    used = since_repair([recording.repaired for recording in config.recordings])
    since, chosen = dates[used], snapshots[used]
    group = wear_group(dates, used)
    if config.joint.decide_before is not None:
        group.attrs["decide_before"] = config.joint.decide_before.isoformat()
    if since[0] == since[-1]:
        count = "one snapshot" if len(since) == 1 else "snapshots of one day"
        begin = "There is only" if len(since) == 1 else "There are only"
        repair = " since the repair" if config.recordings[used.start].repaired else ""
        group.attrs["reason"] = f"{begin} {count}{repair}: a rate needs two, at different dates."
        return group
    withheld = [snapshot.name for snapshot in chosen if snapshot.verdict.reason]
    if withheld:
        group.attrs["reason"] = f"The gap is withheld for {', '.join(withheld)}."
        return group
    if change_reason:
        group.attrs["reason"] = change_reason
        return group
    years = np.array([years_between(since[0], day) for day in since])
    drift_seed, wear_seed = seed.spawn(2)
    measured = np.stack([s.delta_rad for s in chosen if s.delta_rad is not None])
    drawn = _drifting(measured, config.wear.relative_sd_per_date, drift_seed)
    start, limit = config.wear.in_service_since, limit_rad_of(config)
    age = None if start is None else max(years_between(start, since[0]), 0.0)
    fell = fall(drawn)
    if fell.is_fall:
        group.attrs["reason"] = (
            f"{chosen[fell.snapshot].name} lies {number(1e3 * fell.fall_rad, 3)} mrad below the "
            f"snapshot before it ({fell.standard_deviations:.1f} standard deviations), and wear "
            f"does not heal. {UNLESS_REPAIRED}"
        )
        return group
    found = wear(drawn, years, wear_seed, limit_rad=limit, age_years=age)
    if found is None:
        group.attrs["reason"] = f"The gap shrank, and wear does not heal. {UNLESS_REPAIRED}"
        return group
    slope = trend(drawn, years)
    group = wear_group(dates, used, found, slope).assign_attrs(group.attrs)
    if found.width_over_prior is not None:
        group.attrs["width_over_prior"] = found.width_over_prior
    if config.wear.relative_sd_per_date > 0.0:
        group.attrs["relative_sd_per_date"] = config.wear.relative_sd_per_date
        group.attrs["drift_widens"] = float(slope.std() / trend(measured, years).std())
    return group


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
    """Group :data:`WEAR`; without ``found`` there is no answer, and ``reason`` has to say why."""
    chosen = np.zeros(len(dates))
    chosen[used] = 1.0
    values = {"date": [d.isoformat() for d in dates], "used": chosen, **attributes(WEAR, found)}
    group = dataset(WEAR, values | {"trend_rad_per_year": slope_rad_per_year})
    group.attrs = {"reason": ""}
    return group


def used_dates(group: xr.Dataset) -> list[Date]:
    """Dates of the snapshots since the last repair."""
    stored = zip(group["date"].values, group["used"].values, strict=True)
    return [Date.fromisoformat(str(day)) for day, used in stored if used]


def summarise_wear(
    tree: xr.DataTree, names: Sequence[str]
) -> WearSummary | WithheldWearSummary | None:
    """``wear`` of the summary of a comparison (see the module)."""
    if WEAR.name not in tree.children:
        return None
    group = tree[WEAR.name].to_dataset()
    level, kind = float(tree.attrs["interval_level"]), tree.attrs["interval_kind"]
    limit, before = tree.attrs.get("limit_rad"), group.attrs.get("decide_before")
    dates = used_dates(group)
    withheld: WithheldWearSummary = {
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
        "limit_rad": None if limit is None else float(limit),
        "limit": tree.attrs.get("limit"),
        "years_to_limit": None,
        "date_of_limit": None,
        "not_before": None,
        "decide_before": before,
        "probability_before": None,
        "forecast_from_prior": None,
        "reason": group.attrs["reason"],
    }
    if withheld["reason"]:
        return withheld
    grown = group["current_rad"].values - group["first_rad"].values
    rate = grown / years_between(dates[0], dates[-1])
    result: WearSummary = {
        **withheld,
        "probability_wear": float(np.mean(group["trend_rad_per_year"].values > 0.0)),
        "law": shares(group["law"].values),
        "rate": _rate(interval(rate, level, kind)),
        "rate_now": _rate(interval(group["rate_now_rad_per_year"].values, level, kind)),
        "rate_at_most_rad_per_year": float(np.quantile(rate, level)),
        "reason": None,
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
