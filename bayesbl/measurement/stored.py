"""Convert a measurement to the tree of ``result.nc`` and back, for every route.

The tree has a group for each route that ran (see :mod:`bayesbl.measurement.shared_groups`), the
draws of the answer at its root, and the whole summary as the attribute ``summary``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr

from bayesbl.config.measurement import CompareConfig, SnapshotConfig
from bayesbl.measurement.compatibility import limit_rad_of, windup_rad_of
from bayesbl.measurement.measurement import NO_CURVE, Answer, Measurement, Reason, Task
from bayesbl.measurement.shared_groups import CHANGE, GAP
from bayesbl.measurement.wear import summarise_wear, wear_of
from bayesbl.recording.types import FloatArray
from bayesbl.results.provenance import provenance_of
from bayesbl.results.store import Interval, interval, json_text, summary_of
from bayesbl.results.variables import STACKED, dataset, datasets, stack_snapshots


def measurement_tree(measured: Measurement, task: Task) -> xr.DataTree:
    """The whole result of a fit or a comparison, with its provenance."""
    config = task.config
    routes = (measured, *measured.beside)
    groups: dict[str, xr.Dataset] = {}
    for result in routes:
        stacked = _stacked({a.name: a.groups for a in result.answers}, config)
        groups |= {f"{result.route}/{n}": data for n, data in {**stacked, **result.shared}.items()}
    gap_draws = {a.name: a.delta_rad for a in measured.answers if a.delta_rad is not None}
    if gap_draws:
        gaps = {name: datasets({GAP: {"delta_rad": draws}}) for name, draws in gap_draws.items()}
        groups |= _stacked(gaps, config)
    ringing = next((r for r in routes if r.ringing_change is not None), measured)
    wear, wear_reason = None, None
    if isinstance(config, CompareConfig):
        groups["change"] = change_group(gap_draws, ringing.ringing_change)
        if not (measured.without_gap or measured.by_other_joint):
            wear, wear_reason = wear_of(
                config, measured.answers, task.seeds.wear, measured.change_reason
            )
        if wear is not None:
            groups["wear"] = wear
    tree = xr.DataTree.from_dict(groups)
    tree.attrs = {
        "kind": config.kind,
        "route": measured.route,
        "route_code": measured.why.code,
        "routes": [result.route for result in routes],
        "recordings": task.names,
        "interval_level": config.interval.level,
        "interval_kind": config.interval.kind,
        "outcome": measured.outcome,
        **measured.attributes,
        **provenance_of(config),
    }
    if (limit_rad := limit_rad_of(config)) is not None:
        tree.attrs["limit_rad"] = limit_rad
    if config.joint.limit is not None:
        tree.attrs["limit"] = str(config.joint.limit)
    tree.attrs["warnings"] = list(measured.warnings)
    summary = {
        "curve": next((result.curve for result in routes if result.curve), None),
        "answer": {"route": measured.route, **measured.why.stored},
    }
    if isinstance(config, CompareConfig):
        summary |= {"reason": _reason_of_all(measured), **_compared(measured, ringing, config)}
        summary["wear"] = None
        if wear is not None:
            of_joint = task.names, config.interval, limit_rad, tree.attrs.get("limit")
            reason = None if wear_reason is None else wear_reason.stored
            summary["wear"] = {**summarise_wear(wear, *of_joint), "reason": reason}
    else:
        summary |= _answered(measured, 0, config)
        summary["reason"] = summary["reason"] or _reason_of_all(measured)
    tree.attrs["summary"] = json_text(summary)
    return tree


def _stacked(
    groups: Mapping[str, Mapping[str, xr.Dataset]], config: SnapshotConfig
) -> dict[str, xr.Dataset]:
    if isinstance(config, CompareConfig):
        return stack_snapshots(groups)
    (only_recording,) = groups.values()
    return dict(only_recording)


def change_group(drawn: Mapping[str, FloatArray], ringing: FloatArray | None) -> xr.Dataset:
    """Draws of the change from first to last and of each step; missing ones are left out.

    ``drawn``: draws of δ by snapshot in order of time, each (chain, draw), paired by draw.
    """
    values: dict[str, object] = {"ringing_change": ringing}
    if drawn:
        names, gaps = list(drawn), np.stack(list(drawn.values()))
        values |= {
            "change_rad": gaps[-1] - gaps[0],
            "step_change_rad": np.diff(gaps, axis=0),
            "step_from": names[:-1],
            "step_to": names[1:],
        }
    return dataset(CHANGE, values)


# The summary.


def one_of(reasons: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """The first of some stored reasons, with the others as its ``also``; ``None`` for none."""
    if not reasons:
        return None
    first, *others = reasons
    also = [*first.get("also", ()), *others]
    return {**first, **({"also": also} if also else {})}


def _reason_of_all(measured: Measurement) -> dict[str, Any] | None:
    """Why answers are withheld: each reason once, with the recordings that it concerns."""
    by_text: dict[str, tuple[Reason, list[str]]] = {}
    for answer in measured.answers:
        for reason in answer.withholding:
            by_text.setdefault(json_text(reason.stored), (reason, []))[1].append(answer.name)
    reasons = [
        reason.stored | ({} if len(names) == len(measured.answers) else {"recordings": names})
        for reason, names in by_text.values()
    ]
    if measured.without_gap:
        reasons.append(NO_CURVE.stored)
    if measured.change_reason is not None:
        reasons.append(measured.change_reason.stored)
    return one_of(reasons)


def _answered(measured: Measurement, number: int, config: SnapshotConfig) -> dict[str, Any]:
    """Keys of the answer for one recording, with those of every route under ``routes``."""
    results = [measured, *measured.beside]
    routes = {result.route: _of_route(result, result.answers[number], config) for result in results}
    routes |= {
        name: {"route": name, "delta_rad": None, "reason": reason.stored}
        for name, reason in measured.refused.items()
    }
    answer = routes[measured.route]
    ringing = next((r["amplitude_rpm"] for r in routes.values() if r.get("amplitude_rpm")), None)
    return {**answer, "amplitude_rpm": ringing, "routes": routes}


def _of_route(result: Measurement, answer: Answer, config: SnapshotConfig) -> dict[str, Any]:
    draws = None if answer.is_withheld else answer.delta_rad
    summary = {
        "route": result.route,
        "curve": result.curve or None,
        "amplitude_rpm": None,
        "optimum": {},
        **answer.numbers,
        "delta_rad": None if draws is None else _interval(draws, config),
        "delta_upper_bound_rad": answer.upper_bound_rad,
        "diagnostics": {
            **answer.numbers["diagnostics"],
            "outcome": answer.outcome,
            "reasons": [
                {**reason.stored, "withholds": reason.withholds} for reason in answer.reasons
            ],
        },
        "reason": one_of([reason.stored for reason in answer.withholding]),
        "model_check": answer.model_check,
    }
    if (limit_rad := limit_rad_of(config)) is not None:
        summary["limit_rad"] = limit_rad
        summary["probability_above_limit"] = (
            None if draws is None or result.by_other_joint else float(np.mean(draws > limit_rad))
        )
    if (limit := config.joint.limit) is not None:
        windup_rad, measured = windup_rad_of(config), None
        if (delta := summary["delta_rad"]) is not None:
            ends = {key: limit.stated(delta[key], windup_rad) for key in ("median", "low", "high")}
            measured = {**delta, **ends}
        summary["limit"] = {"text": str(limit), "unit": limit.name, "measured": measured}
    return summary


def _compared(measured: Measurement, ringing: Measurement, config: CompareConfig) -> dict[str, Any]:
    """Keys of a comparison; ``ringing``: the route that measured the change of the ringing."""
    last = len(measured.answers) - 1
    snapshots = [
        {"name": answer.name, "probability_above_limit": None, **_answered(measured, n, config)}
        for n, answer in enumerate(measured.answers)
    ]
    # With a curve, it is δ that is withheld, perhaps for the curve alone: report the ringing.
    is_told = ringing.curve or not any(ringing.answers[end].is_withheld for end in (0, -1))
    ringing_change = ringing.ringing_change if is_told else None
    grew = None if ringing_change is None else float(np.mean(ringing_change > 0.0))
    return {
        "snapshots": snapshots,
        **_change(measured, 0, last, config),
        "changes": [
            {"from": before, "to": after, **_change(measured, n, n + 1, config)}
            for n, (before, after) in enumerate(pairwise(a.name for a in measured.answers))
        ],
        "ringing_change": None if ringing_change is None else _interval(ringing_change, config),
        "probability_ringing_grew": grew,
        "same_joint": measured.same_joint,
        "routes": {
            result.route: {
                **_change(result, 0, last, config),
                "outcome": result.outcome,
                "reason": _reason_of_all(result),
                "same_joint": result.same_joint,
            }
            for result in (measured, *measured.beside)
        },
    }


def _change(measured: Measurement, first: int, last: int, config: CompareConfig) -> dict[str, Any]:
    """Change of δ between two recordings, unless an answer or the change itself is withheld."""
    ends = [measured.answers[number] for number in (first, last)]
    before, after = (None if end.is_withheld else end.delta_rad for end in ends)
    if before is None or after is None or measured.change_reason is not None:
        return {"change_rad": None, "probability_increase": None}
    change = after - before
    return {
        "change_rad": _interval(change, config),
        "probability_increase": float(np.mean(change > 0.0)),
    }


def _interval(draws: FloatArray, config: SnapshotConfig) -> Interval:
    return interval(draws, config.interval.level, config.interval.kind)


# From the tree back to answers.


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The stored answer of one route for one recording.

    ``route``: tree of the route, with the groups of all recordings. ``summary``: part of the
    summary for this route and recording, without sentences.
    """

    name: str
    route: xr.DataTree
    summary: Mapping[str, Any]

    def group(self, name: str) -> xr.Dataset:
        """A group of the route, as of :func:`of_snapshot`."""
        return of_snapshot(self.route.children[name], self.name)

    def number(self, group: str, variable: str) -> float:
        """A stored scalar."""
        return float(self.group(group)[variable])

    def values(self, group: str, variable: str) -> FloatArray:
        """A stored variable of any shape."""
        return np.asarray(self.group(group)[variable].values, dtype=float)

    @property
    def time_s(self) -> FloatArray:
        """Sampling times of the recording, shape (n,)."""
        return self.values("constant_data", "time_s")

    def channel(self, name: str) -> FloatArray:
        """A channel of the recording, whether the route used it or not, shape (n,)."""
        is_observed = name in self.group("observed_data")
        return self.values("observed_data" if is_observed else "constant_data", name)

    @property
    def withheld(self) -> bool:
        """Whether δ is withheld or missing."""
        return self.summary["delta_rad"] is None


def routes_of(tree: xr.DataTree) -> list[str]:
    """Names of the routes that a result stores in full, the one that answers first."""
    return [str(name) for name in np.atleast_1d(tree.attrs.get("routes", []))]


def stored_answers(tree: xr.DataTree, route: str | None = None) -> list[Snapshot]:
    """Stored answers of a route (by default the one that answers) for every recording, in order."""
    summary = summary_of(tree)
    route = route or tree.attrs["route"]
    names = [str(name) for name in np.atleast_1d(tree.attrs["recordings"])]
    return [
        Snapshot(name, tree.children[route], part["routes"][route])
        for name, part in zip(names, summary.get("snapshots", [summary]), strict=True)
    ]


def of_snapshot(group: xr.DataTree, name: str) -> xr.Dataset:
    """The data of one recording, without dimension ``snapshot`` or padding from longer ones."""
    data = group.to_dataset()
    if STACKED in data.dims:
        data = data.sel({STACKED: name}, drop=True)
        for dim in set(data.dims) - {"chain", "draw"}:
            data = data.dropna(dim, how="all")
    return data
