"""Groups of several snapshots, and rows of different lengths, stacked into one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayesbl.results.variables import STACKED


def stack_snapshots(groups: Mapping[str, Mapping[str, xr.Dataset]]) -> dict[str, xr.Dataset]:
    """Groups of several fits by snapshot name, stacked along :data:`STACKED`, padded with NaN."""
    names = list(groups)
    stacked = {}
    for group in next(iter(groups.values())):
        parts = _of_one_size([groups[name][group] for name in names])
        stacked[group] = xr.concat(
            parts,
            dim=xr.Variable(STACKED, names),
            data_vars="all",
            coords="minimal",
            compat="override",
            join="outer",
            combine_attrs="drop_conflicts",
        )
    return stacked


def padded(rows: Sequence[object], width: int, text: bool = False) -> NDArray[np.generic]:
    """Rows of different lengths as (row, width), NaN or empty text behind."""
    table = np.full((len(rows), width), "" if text else np.nan, dtype="U16" if text else float)
    for place, row in zip(table, map(np.asarray, rows), strict=True):
        place[: row.size] = row
    return table


def _of_one_size(parts: Sequence[xr.Dataset]) -> list[xr.Dataset]:
    """All dimensions without labels brought to their longest, NaN behind."""
    longest: dict[str, int] = {}
    for part in parts:
        for dim, size in part.sizes.items():
            if dim not in part.coords:
                longest[str(dim)] = max(longest.get(str(dim), 0), size)
    return [
        part.pad(
            {dim: (0, size - part.sizes[dim]) for dim, size in longest.items() if dim in part.sizes}
        )
        for part in parts
    ]
