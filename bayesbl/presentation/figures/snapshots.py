"""A stored result as figures read it: snapshots, intervals, arrays."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr

from bayesbl.measurement.stored import StoredAnswer as Snapshot
from bayesbl.measurement.stored import routes_of, stored_answers, summary_of
from bayesbl.presentation.figures.style import WITHHELD, look
from bayesbl.recording.types import FloatArray
from bayesbl.results.intervals import Interval, interval

__all__ = ["GAP", "Snapshot", "snapshots"]

GAP = "delta_rad"


def route_holding(tree: xr.DataTree, path: str) -> str | None:
    """The route whose group holds this variable (``misfit/mean_rpm``) or group (``loop``)."""
    return next((name for name in routes_of(tree) if holds(tree.children[name], path)), None)


def holds(tree: xr.DataTree, path: str) -> bool:
    """Whether a tree has a group ``wear``, or a variable ``misfit/mean_rpm`` in its group."""
    group, _, variable = path.partition("/")
    if group not in tree.children:
        return False
    return not variable or variable in tree.children[group].variables


def snapshots(tree: xr.DataTree, holding: str | None = None) -> list[Snapshot]:
    """Answers for every recording, by the route that answers, or by that which holds this."""
    return stored_answers(tree, None if holding is None else route_holding(tree, holding))


def group_of(tree: xr.DataTree, group: str) -> xr.Dataset:
    """A group at the root, or of the route that holds it."""
    route = None if group in tree.children else route_holding(tree, group)
    node = tree.children[group] if route is None else tree.children[route].children[group]
    return node.to_dataset()


def change_is_withheld(tree: xr.DataTree) -> bool:
    """Whether the change from first to last must not be read."""
    return summary_of(tree)["change_rad"] is None


def gap_colour(snapshot: Snapshot, index: int) -> str:
    """Of what shows δ, by the snapshot's place among the others; grey where withheld."""
    return WITHHELD if snapshot.withheld else look(index).colour


def decimals(found: Interval) -> int:
    """Decimals that show an interval of a gap in mrad."""
    return max(0, 1 - math.floor(math.log10(max(found["high"] - found["low"], 1e-9))))


def credible_interval(tree: xr.DataTree, draws: FloatArray) -> Interval:
    """Median and interval of draws at the level and of the kind of this result."""
    level, kind = float(tree.attrs["interval_level"]), tree.attrs["interval_kind"]
    return interval(draws, level, kind)


def gap_interval(tree: xr.DataTree, snapshot: Snapshot) -> Interval:
    """Median and interval of a snapshot's δ, in mrad."""
    return credible_interval(tree, 1e3 * snapshot.values("posterior", GAP))


def interval_in_words(tree: xr.DataTree, found: Interval) -> str:
    """``0.246 mrad (90 % interval 0.211 to 0.281)`` of an interval in mrad."""
    places = decimals(found)
    low, middle, high = (f"{found[k]:.{places}f}" for k in ("low", "median", "high"))
    return f"{middle} mrad ({interval_name(tree)} {low} to {high})".replace("-", "−")


def gap_in_words(tree: xr.DataTree, snapshot: Snapshot) -> str:
    """``after: 0.953 mrad (90 % interval 0.927 to 0.981)``, or that δ is withheld."""
    if snapshot.withheld:
        return f"{snapshot.name}: δ withheld"
    return f"{snapshot.name}: {interval_in_words(tree, gap_interval(tree, snapshot))}"


def interval_name(tree: xr.DataTree) -> str:
    """``90 % interval``."""
    kind = "HDI" if tree.attrs["interval_kind"] == "hdi" else "interval"
    return f"{100.0 * float(tree.attrs['interval_level']):g} % {kind}"


def values(tree: xr.DataTree, group: str, variable: str) -> FloatArray:
    """A stored variable or coordinate of numbers, in its own shape and units."""
    return np.asarray(group_of(tree, group)[variable].values, dtype=float)


def curve_name(name: str) -> str:
    """What a reader calls a gap curve: ``published``, or the folder of the sweep that made it."""
    parts = [part for part in name.replace("\\", "/").split("/") if part]
    if not parts:
        return name
    return parts[-2] if parts[-1] == "result.nc" and len(parts) > 1 else parts[-1]
