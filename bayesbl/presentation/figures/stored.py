"""Arrays of a stored result, by group and name."""

from __future__ import annotations

import numpy as np
import xarray as xr

from bayesbl.recording.types import FloatArray


def values(tree: xr.DataTree, group: str, variable: str) -> FloatArray:
    """A stored variable or coordinate of numbers, in its own shape and units."""
    return np.asarray(tree[group].to_dataset()[variable].values, dtype=float)


def curve_name(name: str) -> str:
    """What a reader calls a gap curve: ``published``, or the folder of the sweep that made it."""
    parts = [part for part in name.replace("\\", "/").split("/") if part]
    if not parts:
        return name
    return parts[-2] if parts[-1] == "result.nc" and len(parts) > 1 else parts[-1]
