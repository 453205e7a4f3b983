"""A stored comparison as far as figures and words read it, without measuring anything."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import xarray as xr

from bayesbl.results.store import interval


def stored_comparison(
    names: Sequence[str],
    routes: Mapping[str, Mapping[str, xr.Dataset]],
    withheld: Sequence[str] = (),
    **beside: xr.Dataset,
) -> xr.DataTree:
    """The tree of a comparison; the first of ``routes`` answers, ``beside`` are groups at the root.

    Each route's ``posterior`` has ``delta_rad`` over (snapshot, chain, draw).
    """
    first = next(iter(routes))
    groups = {f"{r}/{g}": data for r, each in routes.items() for g, data in each.items()}
    gap = routes[first]["posterior"][["delta_rad"]]
    tree = xr.DataTree.from_dict({**groups, "gap": gap, **beside})
    tree.attrs = {
        "kind": "compare",
        "outcome": "withheld" if withheld else "converged",
        "route": first,
        "routes": list(routes),
        "recordings": list(names),
        "interval_level": 0.9,
        "interval_kind": "equal_tailed",
    }
    changes = {r: _change(each["posterior"]["delta_rad"].values) for r, each in routes.items()}
    summary = {
        "reason": None,
        "snapshots": [
            {"name": n, "routes": {r: _part(each, n, n in withheld) for r, each in routes.items()}}
            for n in names
        ],
        "change_rad": None if withheld else changes[first],
        "changes": [{"from": a, "to": b, "change_rad": changes[first]} for a, b in pairwise(names)],
        "routes": {r: {"change_rad": None if withheld else c} for r, c in changes.items()},
    }
    tree.attrs["summary"] = json.dumps(summary)
    return tree


def judged(tree: xr.DataTree, *withheld: str) -> xr.DataTree:
    """The tree with the gaps of these snapshots withheld, and every other one converged."""
    copy = tree.copy()
    summary: dict[str, Any] = json.loads(tree.attrs["summary"])
    reason = {"code": "sampling", "text": "The sampler did not converge."}
    draws = tree["gap"].to_dataset()["delta_rad"]
    for part in summary["snapshots"]:
        hidden = part["name"] in withheld
        gap = interval(draws.sel(snapshot=part["name"]).values, 0.9, "equal_tailed")
        for one in (part, *part["routes"].values()):
            one |= {"delta_rad": None if hidden else gap, "reason": reason if hidden else None}
            one["diagnostics"] |= {
                "outcome": "withheld" if hidden else "converged",
                "reasons": [{**reason, "withholds": True}] if hidden else [],
            }
    change = _change(draws.values)
    found = {
        "change_rad": None if withheld else change,
        "probability_increase": None if withheld else 1.0,
    }
    summary |= {**found, "outcome": "withheld" if withheld else "converged"}
    summary["reason"] = reason if withheld else None
    for step in (*summary["changes"], *summary["routes"].values()):
        step |= found
    copy.attrs["summary"] = json.dumps(summary)
    return copy


def _part(groups: Mapping[str, xr.Dataset], name: str, withheld: bool) -> dict[str, Any]:
    draws = groups["posterior"]["delta_rad"].sel(snapshot=name).values
    return {"delta_rad": None if withheld else interval(draws, 0.9, "equal_tailed")}


def _change(draws: Any) -> Any:
    return interval(draws[-1] - draws[0], 0.9, "equal_tailed")
