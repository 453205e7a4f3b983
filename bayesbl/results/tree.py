"""The former writer of groups, for the groups that are not declared yet."""

from __future__ import annotations

from collections.abc import Mapping

import xarray as xr

from bayesbl.recording.types import FloatArray

Variables = Mapping[str, tuple[tuple[str, ...], FloatArray, str, str]]
"""Name to (dimensions, values, unit, long name)."""


def dataset(variables: Variables, coordinates: Mapping[str, object] | None = None) -> xr.Dataset:
    """A dataset in which every variable carries its unit and long name."""
    return xr.Dataset(
        {
            name: (dims, values, {"units": unit, "long_name": long_name})
            for name, (dims, values, unit, long_name) in variables.items()
        },
        coords=None if coordinates is None else dict(coordinates),
    )
