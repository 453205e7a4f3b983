"""Stored results of any kind, held against the catalogue of all groups."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from bayesbl.errors import ResultError

if TYPE_CHECKING:
    import xarray as xr

    from bayesbl.results.variables import Group

_MODULES = {
    "fit": "bayesbl.measurement.routes",
    "compare": "bayesbl.measurement.routes",
    "sweep": "bayesbl.runs.sweep_groups",
    "plan": "bayesbl.runs.plan",
    "diagnose": "bayesbl.diagnosis.groups",
    "identify": "bayesbl.identification.groups",
    "study": "bayesbl.runs.study",
}
"""Kind to the module whose ``declared_groups`` lists its groups."""

_MEASURED = ("outcome", "recordings", "interval_level", "interval_kind")
_ATTRIBUTES = {
    "fit": _MEASURED,
    "compare": _MEASURED,
    "sweep": ("outcome", "degree"),
    "plan": ("outcome", "gap_rad"),
    "diagnose": ("outcome", "diagnosis"),
    "identify": ("outcome", "identification", "identified_bench"),
    "study": ("outcome", "study"),
}
"""Kind to what its root says of it."""


def read_result(path: str | Path) -> xr.DataTree:
    """Read a result of any kind into memory, as :func:`bayesbl.results.store.read_tree` does.

    Raises
    ------
    ResultError
        Also if it is of no known kind, or lacks anything that its groups declare.
    """
    from bayesbl.results.store import read_tree
    from bayesbl.results.variables import require_declared

    tree = read_tree(path)
    kind = tree.attrs.get("kind")
    if not isinstance(kind, str) or kind not in _MODULES:
        raise ResultError(
            "This result is of no known kind.",
            file=path,
            found=f"kind {kind!r}",
            expected=" or ".join(_MODULES),
        )
    try:
        require_declared(tree, declared_groups(tree))
    except ResultError as problem:
        problem.name_file(path)
        raise
    missing = [name for name in _ATTRIBUTES[kind] if name not in tree.attrs]
    if missing:
        raise ResultError(
            "This result lacks what every result of its kind says of itself.",
            file=path,
            found=f"no {', '.join(missing)}",
            expected=f"attributes {', '.join(_ATTRIBUTES[kind])}",
        )
    return tree


def declared_groups(tree: xr.DataTree) -> tuple[Group, ...]:
    """Groups that a result declares."""
    module = import_module(_MODULES[tree.attrs["kind"]])
    groups: tuple[Group, ...] = module.declared_groups(tree)
    return groups
