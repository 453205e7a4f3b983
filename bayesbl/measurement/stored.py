"""A measurement as the tree of ``result.nc``, and back: the one place for every route.

The tree has a group for each route that ran (see :mod:`bayesbl.measurement.shared_groups`), the
draws that answer at its root, and the whole summary as the attribute ``summary``.
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
from bayesbl.measurement.shared_groups import CHANGE, GAP, common_numbers
from bayesbl.measurement.wear import summarise_wear, wear_of
from bayesbl.recording.types import FloatArray
from bayesbl.results.intervals import Interval, interval
from bayesbl.results.provenance import provenance_of
from bayesbl.results.store import json_text, summary_of
from bayesbl.results.variables import STACKED, dataset, datasets, stack_snapshots


def measurement_tree(measured: Measurement, task: Task) -> xr.DataTree:
    """The whole result of a fit or a comparison, with its origin."""
    config = task.config
    routes = (measured, *measured.beside)
    groups: dict[str, xr.Dataset] = {}
    for one in routes:
        stacked = _stacked({a.name: a.groups for a in one.answers}, config)
        groups |= {f"{one.route}/{name}": data for name, data in {**stacked, **one.shared}.items()}
    drawn = {a.name: a.delta_rad for a in measured.answers if a.delta_rad is not None}
    if drawn:
        gaps = {name: datasets({GAP: {"delta_rad": draws}}) for name, draws in drawn.items()}
        groups |= _stacked(gaps, config)
    wear, wear_reason = None, None
    if isinstance(config, CompareConfig):
        ringing = next((r.ringing_change for r in routes if r.ringing_change is not None), None)
        groups["change"] = change_group(drawn, ringing)
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
        "routes": [one.route for one in routes],
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
        "reason": _reason_of_all(measured),
        "curve": next((one.curve for one in routes if one.curve), None),
        "answer": {"route": measured.route, **measured.why.stored},
    }
    if isinstance(config, CompareConfig):
        summary |= _compared(measured, config)
        summary["wear"] = None
        if wear is not None:
            dated = summarise_wear(
                wear, task.names, config.interval, limit_rad, tree.attrs.get("limit")
            )
            reason = None if wear_reason is None else wear_reason.stored
            summary["wear"] = {**dated, "reason": reason}
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
    (alone,) = groups.values()
    return dict(alone)


def change_group(drawn: Mapping[str, FloatArray], ringing: FloatArray | None) -> xr.Dataset:
    """Draws of the change from first to last, and of each step; what there is not is left out.

    ``drawn``: of δ by snapshot in order of time, each (chain, draw), paired by draw.
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
    """The first of some stored reasons, the others beneath it as ``also``; ``None`` for none."""
    if not reasons:
        return None
    first, *others = reasons
    also = [*first.get("also", ()), *others]
    return {**first, **({"also": also} if also else {})}


def _reason_of_all(measured: Measurement) -> dict[str, Any] | None:
    """Why answers are withheld: each reason once, with the recordings that it holds for."""
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
    """Of one recording: the keys of the answer, and under ``routes`` those of every route."""
    whole = [measured, *measured.beside]
    routes = {one.route: _of_route(one, one.answers[number], config) for one in whole}
    routes |= {
        name: {"route": name, "delta_rad": None, "reason": reason.stored}
        for name, reason in measured.refused.items()
    }
    answer = routes[measured.route]
    ringing = next((r["amplitude_rpm"] for r in routes.values() if r.get("amplitude_rpm")), None)
    return {**answer, "amplitude_rpm": ringing, "routes": routes}


def _of_route(one: Measurement, answer: Answer, config: SnapshotConfig) -> dict[str, Any]:
    withholding = [reason.stored for reason in answer.withholding]
    given = None if answer.is_withheld else answer.delta_rad
    common = common_numbers(answer.groups)
    no_noise_of_speed = dict(order=0, sd_rpm=0.0, coefficients=[], degrees_of_freedom=None)
    summary = {
        "route": one.route,
        "curve": one.curve or None,
        "amplitude_rpm": None,
        "optimum": {},
        **answer.numbers,
        "noise": no_noise_of_speed | answer.numbers["noise"],
        **common,
        "delta_rad": None if given is None else _interval(given, config),
        "delta_upper_bound_rad": answer.upper_bound_rad,
        "diagnostics": {
            **common["diagnostics"],
            "outcome": answer.outcome,
            "reasons": [
                {**reason.stored, "withholds": reason.withholds} for reason in answer.reasons
            ],
        },
        "reason": one_of(withholding),
        "model_check": answer.model_check,
    }
    limit_rad = limit_rad_of(config)
    if limit_rad is not None:
        summary["limit_rad"] = limit_rad
        above = None if given is None or one.by_other_joint else float(np.mean(given > limit_rad))
        summary["probability_above_limit"] = above
    if config.joint.limit is not None:
        limit, windup_rad = config.joint.limit, windup_rad_of(config)
        measured = None
        if (delta := summary["delta_rad"]) is not None:
            ends = {key: limit.stated(delta[key], windup_rad) for key in ("median", "low", "high")}
            measured = {**delta, **ends}
        summary["limit"] = {"text": str(limit), "unit": limit.name, "measured": measured}
    return summary


def _compared(measured: Measurement, config: CompareConfig) -> dict[str, Any]:
    count = len(measured.answers)
    snapshots = [
        {
            "name": measured.answers[number].name,
            "probability_above_limit": None,
            **_answered(measured, number, config),
        }
        for number in range(count)
    ]
    ringing = next((r for r in (measured, *measured.beside) if r.ringing_change is not None), None)
    grew = None
    # With a curve it is δ that is withheld, which the curve alone may be the reason for.
    if ringing is not None and (
        ringing.curve or not (ringing.answers[0].is_withheld or ringing.answers[-1].is_withheld)
    ):
        grew = ringing.ringing_change
    return {
        "snapshots": snapshots,
        **_change(measured, 0, count - 1, config),
        "changes": [
            {"from": before, "to": after, **_change(measured, n, n + 1, config)}
            for n, (before, after) in enumerate(pairwise(a.name for a in measured.answers))
        ],
        "ringing_change": None if grew is None else _interval(grew, config),
        "probability_ringing_grew": None if grew is None else float(np.mean(grew > 0.0)),
        "same_joint": measured.same_joint,
        "routes": {
            one.route: {
                **_change(one, 0, count - 1, config),
                "outcome": one.outcome,
                "reason": _reason_of_all(one),
                "same_joint": one.same_joint,
            }
            for one in (measured, *measured.beside)
        },
    }


def _change(measured: Measurement, first: int, last: int, config: CompareConfig) -> dict[str, Any]:
    """Of δ between two recordings, where neither is withheld nor the change itself."""
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


# Back from the tree.


@dataclass(frozen=True, slots=True)
class Snapshot:
    """What one route of a stored result says of one recording.

    Attributes
    ----------
    route
        With the groups of all recordings.
    summary
        Its part of the summary; sentences are not in it.
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
        """A stored variable, any shape."""
        return np.asarray(self.group(group)[variable].values, dtype=float)

    @property
    def time_s(self) -> FloatArray:
        """Of the recording, shape (n,)."""
        return self.values("constant_data", "time_s")

    def channel(self, name: str) -> FloatArray:
        """A channel of the recording, whether the route went by it or not, shape (n,)."""
        went_by = name in self.group("observed_data")
        return self.values("observed_data" if went_by else "constant_data", name)

    @property
    def withheld(self) -> bool:
        """Whether δ must not be read, or there is none."""
        return self.summary["delta_rad"] is None


def routes_of(tree: xr.DataTree) -> list[str]:
    """Routes that a stored result holds whole, the one that answers first."""
    return [str(name) for name in np.atleast_1d(tree.attrs.get("routes", []))]


def stored_answers(tree: xr.DataTree, route: str | None = None) -> list[Snapshot]:
    """What a route says of every recording of a result, in order; that which answers by default."""
    summary = summary_of(tree)
    route = route or tree.attrs["route"]
    names = [str(name) for name in np.atleast_1d(tree.attrs["recordings"])]
    return [
        Snapshot(name, tree.children[route], part["routes"][route])
        for name, part in zip(names, summary.get("snapshots", [summary]), strict=True)
    ]


def of_snapshot(group: xr.DataTree, name: str) -> xr.Dataset:
    """Of one recording, without the dimension ``snapshot`` and others' greater lengths."""
    data = group.to_dataset()
    if STACKED in data.dims:
        data = data.sel({STACKED: name}, drop=True)
        for dim in set(data.dims) - {"chain", "draw"}:
            data = data.dropna(dim, how="all")
    return data
