"""Optima of an earlier result, to start a search from."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from bayesbl.errors import ResultError
from bayesbl.measurement.amplitude_groups import OPTIMUM
from bayesbl.measurement.stored_snapshot import stored_snapshots
from bayesbl.results.store import read_tree
from bayesbl.results.variables import require_declared
from bayesbl.ringing.symbols import SYMBOLS
from bayesbl.ringing.warm_start import EarlierOptimum

KINDS = ("fit", "compare")


def read_earlier(path: str | Path) -> dict[str, EarlierOptimum]:
    """Optima of a fit or a comparison by the names of their recordings, in order.

    Raises
    ------
    ResultError
        If the result cannot be read, or is of another kind or route.
    """
    tree = read_tree(path)
    kind = tree.attrs.get("kind")
    if kind not in KINDS:
        raise ResultError(
            "This result holds no optimum to start from.",
            file=path,
            found=f'kind = "{kind}"',
            expected="the result of bayesbl fit or bayesbl compare",
        )
    route = tree.attrs.get("route", "amplitude")
    if route != "amplitude":
        raise ResultError(
            "This result holds no optimum to start from.",
            file=path,
            found=f'route = "{route}"',
            expected='a result of route = "amplitude"',
        )
    require_declared(tree, [OPTIMUM], path)
    return optima_of(tree, f" in {path}")


def optima_of(tree: xr.DataTree, where: str = "") -> dict[str, EarlierOptimum]:
    """Optima of a result of the amplitude route; ``where`` it is, in words."""
    return {
        stored.name: EarlierOptimum(
            f'the optimum of "{stored.name}"{where}',
            {symbol: stored.number("optimum", symbol) for symbol in SYMBOLS},
            stored.number("optimum", "rmse_rpm"),
            withheld=stored.verdict.outcome == "withheld",
        )
        for stored in stored_snapshots(tree)
    }
