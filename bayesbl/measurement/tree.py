"""A measurement as the tree of ``result.nc``, whatever its route."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict

import xarray as xr

from bayesbl.config.measurement import CompareConfig
from bayesbl.measurement.change import changes
from bayesbl.measurement.compatibility import limit_rad_of, same_files, windup_rad_of
from bayesbl.measurement.dated_wear import wear_of
from bayesbl.measurement.joint_check import as_stored
from bayesbl.measurement.measurement import Measurement
from bayesbl.measurement.shared_groups import change_group
from bayesbl.measurement.stored_curve import curve_group
from bayesbl.measurement.stored_snapshot import ALONE
from bayesbl.measurement.task import Task
from bayesbl.results.provenance import provenance_of
from bayesbl.results.stacking import stack_snapshots
from bayesbl.ringing.symbols import AMPLITUDE


def measurement_tree(measured: Measurement, task: Task) -> xr.DataTree:
    """The whole result of a fit or a comparison, with its origin."""
    config, snapshots = task.config, measured.snapshots
    level = config.interval.level
    keys = [snapshot.name for snapshot in snapshots]
    if isinstance(config, CompareConfig):
        groups = stack_snapshots({s.name: s.groups for s in snapshots})
        groups["change"] = _change(measured)
        groups["change"].attrs["same_joint"] = _json(as_stored(measured.same_joint))
        groups["change"].attrs["reason"] = measured.change_reason or ""
        wear = None
        if not (measured.without_gap or measured.by_other_joint):
            wear = wear_of(config, snapshots, task.seeds.wear, measured.change_reason)
        if wear is not None:
            groups["wear"] = wear
    else:
        groups = dict(snapshots[0].groups)
        keys = [ALONE]
    verdicts = {key: asdict(s.verdict) for key, s in zip(keys, snapshots, strict=True)}
    groups["diagnostics"].attrs["verdicts"] = _json(verdicts)
    checks = {key: as_stored(s.model_check) for key, s in zip(keys, snapshots, strict=True)}
    groups["diagnostics"].attrs["model_checks"] = _json(checks)
    for group in snapshots[0].group_reasons:
        reasons = {key: s.group_reasons[group] for key, s in zip(keys, snapshots, strict=True)}
        groups[group].attrs["reasons"] = _json(reasons)
    if measured.curves:
        curves = dict(zip(keys, measured.curves, strict=True))
        groups["curve"] = curve_group(curves, level, task.seeds.curve)
    tree = xr.DataTree.from_dict(groups)
    tree.attrs = {
        "kind": config.kind,
        "route": measured.route,
        "recordings": task.names,
        "interval_level": level,
        "interval_kind": config.interval.kind,
        "outcome": measured.outcome,
        "reason": measured.reason,
        "warnings": [*same_files(task.recordings), *measured.warnings],
        **measured.attributes,
        **provenance_of(config),
    }
    if (limit_rad := limit_rad_of(config)) is not None:
        tree.attrs["limit_rad"] = limit_rad
    if config.joint.limit is not None:
        tree.attrs["limit"] = str(config.joint.limit.stated())
        tree.attrs["limit_windup_rad"] = windup_rad_of(config)
    return tree


def _change(measured: Measurement) -> xr.Dataset:
    """Of the gaps where there are any, and of the ringing where it was fitted at one speed."""
    snapshots = measured.snapshots
    gaps = {s.name: s.delta_rad for s in snapshots if s.delta_rad is not None}
    ringing = None
    if measured.route == "amplitude" and len({id(curve) for curve in measured.curves}) <= 1:
        first, last = (
            s.groups["posterior"][AMPLITUDE].values for s in (snapshots[0], snapshots[-1])
        )
        ringing = last / first - 1.0
    total, steps = changes(gaps) if gaps else (None, [])
    return change_group(total, steps, ringing)


def _json(content: Mapping[str, object]) -> str:
    return json.dumps(content, ensure_ascii=False)
