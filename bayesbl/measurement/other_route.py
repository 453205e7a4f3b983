"""The answer of the route that did not answer, stored and summarised beside the one that did."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

from bayesbl.measurement.measurement import Snapshot
from bayesbl.measurement.shared_groups import DELTA
from bayesbl.measurement.stored_snapshot import StoredSnapshot
from bayesbl.measurement.summary_types import RouteSummary
from bayesbl.results.intervals import Interval, interval
from bayesbl.results.variables import Group, dataset, table
from bayesbl.ringing.symbols import AMPLITUDE

AMPLITUDE_ROUTE = Group(
    "amplitude_route",
    table("""
        delta_rad (amplitude_chain, amplitude_draw) | rad
            | backlash gap by the amplitude and the gap curve
        amplitude_rpm (amplitude_chain, amplitude_draw) | rpm | amplitude of the impact ringing
    """),
    optional=True,
)

DIRECT_ROUTE = Group(
    "direct_route",
    table("""
        delta_rad (direct_chain, direct_draw) | rad | backlash gap by simulations of the bench
    """),
    optional=True,
)

OTHER: Mapping[str, Group] = {"direct": AMPLITUDE_ROUTE, "amplitude": DIRECT_ROUTE}
"""Route that answers to the group of the other one."""

NEITHER = np.full((1, 1), np.nan)
"""Draws of a route that has none."""


def other_route(answering: str, other: Snapshot | None) -> xr.Dataset:
    """The draws of the route that does not answer."""
    group = OTHER[answering]
    values = {variable.name: NEITHER for variable in group.variables}
    if other is not None:
        stored = {name: other.groups["posterior"].get(name) for name in values}
        values |= {name: draws.values for name, draws in stored.items() if draws is not None}
    return dataset(group, values)


def summarised_routes(stored: StoredSnapshot) -> dict[str, RouteSummary]:
    """The answer of each route that was run, by its name."""
    found = {stored.route: _answer(stored, "posterior", stored.reason)}
    group = OTHER[stored.route]
    if group.name in stored.groups:
        name = group.name.removesuffix("_route")
        found[name] = _answer(stored, group.name, stored.group_reasons[group.name])
    if "amplitude" in found and stored.curve:
        found["amplitude"]["curve"] = stored.curve
    return found


def _answer(stored: StoredSnapshot, group: str, reason: str | None) -> RouteSummary:
    delta = None if reason else _interval(stored, group, DELTA.name)
    result: RouteSummary = {"delta_rad": delta, "reason": reason}
    if AMPLITUDE in stored.groups[group]:
        result["amplitude_rpm"] = _interval(stored, group, AMPLITUDE)
    return result


def _interval(stored: StoredSnapshot, group: str, name: str) -> Interval | None:
    """Of stored draws; ``None`` where there are none."""
    if name not in stored.groups[group]:
        return None
    draws = stored.groups[group][name].values
    draws = draws[np.isfinite(draws)]
    return interval(draws, stored.level, stored.interval_kind) if draws.size else None
