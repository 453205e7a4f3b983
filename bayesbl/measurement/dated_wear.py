"""Wear in time, as ``result.nc`` and ``summary.json`` of a comparison hold it.

Group :data:`WEAR` of ``result.nc``: ``date`` of every snapshot, whether it is ``used`` (taken since
the last repair), and the draws of :class:`bayesbl.measurement.wear.Wear`. Attributes: ``reason``
where the answer is withheld, ``decide_before`` where that was asked, and with three snapshots or
more those of :class:`bayesbl.measurement.wear.Straightness`, ``line_`` before their names.

``wear`` of ``summary.json`` is ``null`` where no snapshot is dated; its keys are those of
:class:`bayesbl.measurement.summary_types.WearSummary`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, fields
from datetime import date as Date
from datetime import timedelta

import numpy as np
import xarray as xr

from bayesbl.config.measurement import CompareConfig
from bayesbl.measurement.measurement import Snapshot
from bayesbl.measurement.summary_types import (
    DateInterval,
    LineSummary,
    WearSummary,
    WithheldWearSummary,
)
from bayesbl.measurement.wear import (
    FEWEST_FOR_SCATTER,
    LEAST_SHARE_GROWING,
    LONGEST_YEARS,
    Straightness,
    Wear,
    probability_before,
    since_repair,
    straightness,
    wear,
)
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
        rate_rad_per_year? (chain, draw) | rad/year | growth of the gap, of either sign
        current_rad? (chain, draw) | rad | gap at the last snapshot, from all of them
        scatter_rad_per_root_year? (chain, draw) | rad/year^0.5 | irregular wear
        years_to_limit? (chain, draw) | year | time from the last snapshot to the limit; none where
            the gap would heal
    """),
    optional=True,
)


def wear_of(
    config: CompareConfig, snapshots: Sequence[Snapshot], seed: np.random.SeedSequence
) -> xr.Dataset | None:
    """Group :data:`WEAR` of a comparison; ``None`` where not every recording has a date."""
    dates = config.dates
    if dates is None:
        return None
    used = since_repair([recording.repaired for recording in config.recordings])
    since, chosen = dates[used], snapshots[used]
    before = config.joint.decide_before
    if since[0] == since[-1]:
        count = "one snapshot" if len(since) == 1 else "snapshots of one day"
        reason = f"There is only {count} since the repair: a rate needs two, at different dates."
        if used.start == 0 and not config.recordings[0].repaired:
            reason = f"There are only {count}: a rate needs two, at different dates."
        return wear_group(dates, used, None, reason=reason, decide_before=before)
    years = np.array([years_between(since[0], day) for day in since])
    drawn = np.stack([s.delta_rad for s in chosen if s.delta_rad is not None])
    result = wear(drawn, years, seed, limit_rad=config.joint.limit_rad)
    withheld = [snapshot.name for snapshot in chosen if snapshot.verdict.reason]
    reason = ""
    if withheld:
        reason = f"The gap is withheld for {', '.join(withheld)}."
    elif 1.0 - result.heals.mean() < LEAST_SHARE_GROWING:
        reason = (
            "The gap shrank, and wear does not heal. If the joint was repaired, mark the first "
            "recording after it (repaired = true)."
        )
    line = None if reason else straightness(drawn, years)
    return wear_group(dates, used, result, reason=reason, decide_before=before, line=line)


def wear_group(
    dates: Sequence[Date],
    used: slice,
    found: Wear | None,
    *,
    reason: str,
    decide_before: Date | None,
    line: Straightness | None = None,
) -> xr.Dataset:
    """Group :data:`WEAR`; ``found`` is ``None`` where nothing could be computed."""
    chosen = np.zeros(len(dates))
    chosen[used] = 1.0
    draws = attributes(WEAR, found)
    group = dataset(WEAR, {"date": [d.isoformat() for d in dates], "used": chosen, **draws})
    group.attrs = {"reason": reason}
    if decide_before is not None:
        group.attrs["decide_before"] = decide_before.isoformat()
    if line is not None:
        group.attrs |= {f"line_{name}": value for name, value in asdict(line).items()}
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
        "rate_rad_per_year": None,
        "rate_at_most_rad_per_year": None,
        "probability_wear": None,
        "scatter_rad_per_root_year": None,
        "line": None,
        "limit_rad": None if limit is None else float(limit),
        "years_to_limit": None,
        "limit_date": None,
        "limit_not_before": None,
        "decide_before": before,
        "probability_limit_before": None,
        "reason": group.attrs["reason"],
    }
    if withheld["reason"]:
        return withheld
    every = group["rate_rad_per_year"].values
    grows = every >= 0.0
    rate = every[grows]
    result: WearSummary = {
        **withheld,
        "rate_rad_per_year": interval(rate, level, kind),
        "rate_at_most_rad_per_year": float(np.quantile(rate, level)),
        "probability_wear": float(np.mean(every > 0.0)),
        "reason": None,
    }
    if len(dates) >= FEWEST_FOR_SCATTER:
        scatter = group["scatter_rad_per_root_year"].values[grows]
        result["scatter_rad_per_root_year"] = interval(scatter, level, kind)
    if "line_probability" in group.attrs:
        result["line"] = _line(group, result["snapshots"])
    if "years_to_limit" in group:
        years = group["years_to_limit"].values[grows]
        found = interval(years, level, kind)
        result["years_to_limit"] = found
        result["limit_date"] = _dates(dates[-1], found)
        result["limit_not_before"] = _iso(dates[-1], float(np.quantile(years, 1.0 - level)))
        if before is not None:
            ahead = years_between(dates[-1], Date.fromisoformat(before))
            result["probability_limit_before"] = probability_before(years, ahead)
    return result


def _line(group: xr.Dataset, names: Sequence[str]) -> LineSummary:
    line = Straightness(**{f.name: group.attrs[f"line_{f.name}"] for f in fields(Straightness)})
    return {
        "is_straight": bool(line.is_straight),
        "probability": float(line.probability),
        "snapshot": names[int(line.snapshot)],
        "excess_rad": float(line.excess_rad),
        "standard_deviations": float(line.standard_deviations),
    }


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
