"""A stored result as figures read it: one view per snapshot, fits and comparisons alike."""

from __future__ import annotations

import xarray as xr

from bayesbl.measurement.stored_snapshot import StoredSnapshot as Snapshot
from bayesbl.measurement.stored_snapshot import stored_snapshots as snapshots
from bayesbl.recording.types import FloatArray
from bayesbl.results.intervals import Interval, interval

__all__ = ["GAP", "Snapshot", "credible_interval", "interval_name", "snapshots"]

GAP = "delta_rad"


def credible_interval(tree: xr.DataTree, draws: FloatArray) -> Interval:
    """Median and interval of draws at the level and of the kind of this result."""
    level, kind = float(tree.attrs["interval_level"]), tree.attrs["interval_kind"]
    return interval(draws, level, kind)


def interval_name(tree: xr.DataTree) -> str:
    """``90 % interval``."""
    kind = "HDI" if tree.attrs["interval_kind"] == "hdi" else "interval"
    return f"{100.0 * float(tree.attrs['interval_level']):g} % {kind}"
