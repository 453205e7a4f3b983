"""Snapshots of a stored fit or comparison, alike for both."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr

from bayesbl.config.fields import PUBLISHED
from bayesbl.measurement.joint_check import NOTHING_COMPARED, as_stored
from bayesbl.measurement.summary_types import DiagnosticsSummary, JointCheckSummary
from bayesbl.measurement.verdict import Verdict
from bayesbl.recording.types import FloatArray
from bayesbl.results.intervals import Interval, IntervalKind, interval
from bayesbl.results.store import texts
from bayesbl.results.variables import STACKED
from bayesbl.ringing.symbols import SYMBOLS

ALONE = "fit"
"""Key of the one snapshot of a fit in attributes that hold something of each snapshot."""


@dataclass(frozen=True, slots=True)
class StoredSnapshot:
    """One recording of a stored result.

    Attributes
    ----------
    groups
        Group name to its dataset, without the dimension ``snapshot``.
    group_reasons
        Group to why what it holds is no answer; ``None`` where it is one.
    route
        That its gap comes from.
    curve
        Name of the gap curve; empty without one.
    limit_rad
        Gap at which the joint is to be repaired, if given.
    model_check
        The recording against what the bench predicts.
    """

    name: str
    groups: Mapping[str, xr.Dataset]
    verdict: Verdict
    group_reasons: Mapping[str, str | None]
    route: str
    curve: str
    level: float
    interval_kind: IntervalKind
    limit_rad: float | None
    model_check: JointCheckSummary

    def interval(self, group: str, variable: str) -> Interval:
        """Interval of stored draws, at the level and of the kind of the result."""
        return interval(self.groups[group][variable].values, self.level, self.interval_kind)

    def number(self, group: str, variable: str) -> float:
        """A stored scalar."""
        return float(self.groups[group][variable])

    def values(self, group: str, variable: str) -> FloatArray:
        """A stored variable, any shape, with the NaN padding of shorter snapshots taken off."""
        stored = np.asarray(self.groups[group][variable].values, dtype=float)
        if stored.ndim == 0:
            return stored
        for axis in range(stored.ndim):
            others = tuple(a for a in range(stored.ndim) if a != axis)
            filled = np.flatnonzero(~np.isnan(stored).all(axis=others))
            stop = filled[-1] + 1 if filled.size else 0
            stored = np.take(stored, np.arange(stop), axis=axis)
        return stored

    @property
    def symbols(self) -> tuple[str, ...]:
        """Free symbols in the paper's order, δ behind them: all that has draws."""
        return tuple(n for n in (*SYMBOLS, "delta_rad") if n in self.groups["posterior"])

    @property
    def reason(self) -> str | None:
        """Why δ is withheld; ``None`` where it is not."""
        return self.verdict.reason

    @property
    def withheld(self) -> bool:
        """Whether δ must not be read, or there is none."""
        return self.reason is not None or "delta_rad" not in self.groups["posterior"]

    @property
    def delta_rad(self) -> Interval | None:
        """Interval of δ; ``None`` where it is withheld."""
        return None if self.withheld else self.interval("posterior", "delta_rad")

    @property
    def probability_above_limit(self) -> float | None:
        """Share of draws of δ above the limit; ``None`` without either, or by the paper's bench."""
        if self.limit_rad is None or self.withheld or self.by_other_joint:
            return None
        return float(np.mean(self.groups["posterior"]["delta_rad"].values > self.limit_rad))

    @property
    def by_other_joint(self) -> bool:
        """Whether the gap is read from the curve of the paper's test bench."""
        return self.route == "amplitude" and self.curve == PUBLISHED

    @property
    def budget(self) -> dict[str, float]:
        """Share of each source in the variance of ln δ."""
        gap = self.groups["gap"]
        shares = zip(gap["source"].values, gap["budget"].values, strict=True)
        return {str(source): float(share) for source, share in shares if np.isfinite(share)}

    @property
    def excluded_samples(self) -> int:
        """Samples that were lost or cannot be trusted."""
        observed = self.groups["observed_data"]
        return int(np.nansum(observed["excluded"].values)) if "excluded" in observed else 0

    @property
    def diagnostics(self) -> DiagnosticsSummary:
        """How the sampling ended, by the worst of all symbols."""
        found = self.groups["diagnostics"]
        return {
            "r_hat": float(found["r_hat"].max()),
            "ess_bulk": float(found["ess_bulk"].min()),
            "outcome": self.verdict.outcome,
            "reasons": list(self.verdict.reasons),
        }


def stored_snapshots(tree: xr.DataTree) -> list[StoredSnapshot]:
    """Every snapshot of a fit or a comparison, in order."""
    whole = {name: node.to_dataset() for name, node in tree.children.items()}
    if STACKED not in whole["posterior"].dims:
        (name,) = texts(tree.attrs["recordings"])
        return [_snapshot(tree, name, ALONE, whole)]
    return [
        _snapshot(
            tree,
            name,
            name,
            {k: d.sel({STACKED: name}) if STACKED in d.dims else d for k, d in whole.items()},
        )
        for name in map(str, whole["posterior"][STACKED].values)
    ]


def _snapshot(
    tree: xr.DataTree, name: str, key: str, groups: Mapping[str, xr.Dataset]
) -> StoredSnapshot:
    verdict = json.loads(tree["diagnostics"].attrs["verdicts"])[key]
    checks = json.loads(tree["diagnostics"].attrs.get("model_checks", "{}"))
    reasons = {
        group: json.loads(data.attrs["reasons"])[key]
        for group, data in groups.items()
        if "reasons" in data.attrs
    }
    limit = tree.attrs.get("limit_rad")
    return StoredSnapshot(
        name,
        groups,
        Verdict(verdict["outcome"], tuple(verdict["reasons"]), verdict["reason"] or None),
        reasons,
        tree.attrs.get("route", "amplitude"),
        # Figures are also drawn from parts of a result, without it.
        tree["curve"].attrs["name"] if "curve" in tree.children else "",
        float(tree.attrs["interval_level"]),
        tree.attrs["interval_kind"],
        None if limit is None else float(limit),
        # Version 0.2 had no check.
        checks.get(key) or as_stored(NOTHING_COMPARED),
    )
