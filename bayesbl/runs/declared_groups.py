"""The catalogue of all groups of a stored result, whatever its kind."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import xarray as xr

    from bayesbl.results.variables import Group

_MODULES = {
    "fit": "bayesbl.measurement.routes",
    "compare": "bayesbl.measurement.routes",
    "sweep": "bayesbl.runs.sweep_groups",
}
"""Kind to the module whose ``declared_groups`` lists its groups."""


def declared_groups(tree: xr.DataTree) -> tuple[Group, ...]:
    """Groups that a result declares; empty for kinds that declare none."""
    module = _MODULES.get(tree.attrs["kind"])
    if module is None:
        return ()
    groups: tuple[Group, ...] = import_module(module).declared_groups(tree)
    return groups
