"""``summary.json`` of a fit and of a comparison, from the stored result alone."""

from __future__ import annotations

import json
from itertools import pairwise

import numpy as np
import xarray as xr

from bayesbl.measurement.dated_wear import summarise_wear
from bayesbl.measurement.joint_check import NOTHING_COMPARED, as_stored
from bayesbl.measurement.routes import route_of_result
from bayesbl.measurement.stored_snapshot import StoredSnapshot, stored_snapshots
from bayesbl.measurement.summary_types import (
    ComparisonSummary,
    FitSummary,
    JointCheckSummary,
    SnapshotSummary,
    StepSummary,
)
from bayesbl.recording.types import FloatArray
from bayesbl.results.intervals import Interval, interval
from bayesbl.results.summary_types import head
from bayesbl.units import Limit


def summarise_fit(tree: xr.DataTree) -> FitSummary:
    """δ is ``None`` where it is withheld; ``reason`` says why."""
    (stored,) = stored_snapshots(tree)
    return {
        "kind": "fit",
        **head(tree),
        "curve": stored.curve or None,
        **_snapshot(tree, stored),
        # Why there is no δ for want of a curve is a reason of the whole result.
        "reason": stored.reason or head(tree)["reason"],
    }


def summarise_comparison(tree: xr.DataTree) -> ComparisonSummary:
    """Changes are ``None`` where one of their gaps is withheld."""
    stored = stored_snapshots(tree)
    change = tree["change"].to_dataset()
    names = [snapshot.name for snapshot in stored]
    given = "change_rad" in change and not change.attrs.get("reason")
    total = _step(change["change_rad"].values if given else None, stored[0], stored[-1])
    steps = change["step_change_rad"].values if given else [None] * (len(names) - 1)
    ringing = change["ringing_change"].values if "ringing_change" in change else None
    # With a curve it is δ that is withheld, which the curve alone may be the reason for.
    if any(end.reason is not None and not end.curve for end in (stored[0], stored[-1])):
        ringing = None
    of_ringing = _described(ringing, stored[0])
    return {
        "kind": "compare",
        **head(tree),
        "curve": stored[0].curve or None,
        "snapshots": [
            {
                "name": s.name,
                "probability_above_limit": None,
                **_snapshot(tree, s),
            }
            for s in stored
        ],
        "change_rad": total["change_rad"],
        "changes": [
            _step(draws, *pair) for draws, pair in zip(steps, pairwise(stored), strict=True)
        ],
        "probability_increase": total["probability_increase"],
        "ringing_change": of_ringing[0],
        "probability_ringing_grew": of_ringing[1],
        "same_joint": _same_joint(change),
        "wear": summarise_wear(tree, names),
    }


def _snapshot(tree: xr.DataTree, stored: StoredSnapshot) -> SnapshotSummary:
    result = route_of_result(tree).summarise(stored)
    if stored.limit_rad is not None:
        result["limit_rad"] = stored.limit_rad
        result["probability_above_limit"] = stored.probability_above_limit
    if "limit" in tree.attrs:
        limit, windup = Limit.parse(tree.attrs["limit"]), float(tree.attrs["limit_windup_rad"])
        delta, measured = result["delta_rad"], None
        if delta is not None:
            low, median, high = (
                limit.stated(end, windup) for end in (delta["low"], delta["median"], delta["high"])
            )
            measured = Interval({**delta, "low": low, "median": median, "high": high})
        result["limit"] = {"text": str(limit), "unit": limit.name, "measured": measured}
    return result


def _same_joint(change: xr.Dataset) -> JointCheckSummary:
    stored = change.attrs.get("same_joint")  # version 0.2 had no check
    found: JointCheckSummary = json.loads(stored) if stored else as_stored(NOTHING_COMPARED)
    return found


def _step(draws: FloatArray | None, first: StoredSnapshot, last: StoredSnapshot) -> StepSummary:
    given = None if first.withheld or last.withheld else draws
    change, probability = _described(given, first)
    return {
        "from": first.name,
        "to": last.name,
        "change_rad": change,
        "probability_increase": probability,
    }


def _described(
    draws: FloatArray | None, like: StoredSnapshot
) -> tuple[Interval | None, float | None]:
    """Interval of draws of a change, and the probability that it is positive."""
    if draws is None:
        return None, None
    return interval(draws, like.level, like.interval_kind), float(np.mean(draws > 0.0))
