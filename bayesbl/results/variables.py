"""Variables of ``result.nc``, each declared once, and the one writer of all groups.

A :class:`Group` is declared in the module of its physics, as a table of name, dimensions, unit and
meaning. Callers pass plain arrays by name to :func:`dataset`. Variables whose names depend on the
measurement (symbols, channels) are declared by a function of the name, :attr:`Group.named`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from textwrap import dedent

import numpy as np
import xarray as xr
from numpy.typing import NDArray

STACKED = "snapshot"  # leading dimension if several snapshots are stored in one group


@dataclass(frozen=True, slots=True)
class Variable:
    """Declaration of a stored variable or coordinate.

    ``unit``: ``"1"`` for a pure number, ``"text"`` for a text. ``meaning``: its long name.
    ``optional``: whether a group may be stored without it. ``told``: whether it is a key of
    ``summary.json`` too.
    """

    name: str
    dims: tuple[str, ...]
    unit: str
    meaning: str
    optional: bool = False
    told: bool = False


@dataclass(frozen=True, slots=True)
class Group:
    """Declaration of a group.

    ``variables``: variables with fixed names. ``coordinates``: labels of its dimensions. ``named``:
    function that declares a variable from a name that depends on the measurement; ``None`` for a
    name that does not belong here.
    """

    name: str
    variables: tuple[Variable, ...] = ()
    coordinates: tuple[Variable, ...] = ()
    named: Callable[[str], Variable | None] | None = None

    def variable(self, name: str) -> Variable:
        """The declaration of a variable or coordinate; raises :class:`KeyError` without one."""
        for declared in (*self.variables, *self.coordinates):
            if declared.name == name:
                return declared
        declaration = None if self.named is None or name == STACKED else self.named(name)
        if declaration is None:
            raise KeyError(f"group {self.name} declares no variable {name}")
        return declaration


def table(text: str) -> tuple[Variable, ...]:
    """Declare variables by the lines of a table.

    A line reads ``name (dimensions) | unit | meaning``, without brackets for a scalar. Behind the
    name, ``?`` marks what is optional and ``!`` what is told; the unit ``text`` marks texts. Lines
    that are indented more than the first one continue the line above.
    """
    rows: list[str] = []
    for line in filter(None, dedent(text).splitlines()):
        if line.startswith(" "):
            rows[-1] += f" {line.strip()}"
        else:
            rows.append(line.strip())
    declared = []
    for head, unit, meaning in ((cell.strip() for cell in row.split("|")) for row in rows):
        name, _, dims = head.partition(" (")
        axes = tuple(dims.removesuffix(")").split(", ")) if dims else ()
        marks = {"optional": "?" in name, "told": "!" in name}
        declared.append(Variable(name.rstrip("?!"), axes, unit, meaning, **marks))
    return tuple(declared)


def labels(name: str, meaning: str) -> Variable:
    """A coordinate of texts along its own dimension."""
    return Variable(name, (name,), "text", meaning)


def columns(group: Group, sources: Sequence[object]) -> dict[str, object]:
    """Values for :func:`dataset` from several objects, one value each, NaN for ``None``."""
    names = _attributes(group, sources[0]) if sources else ()
    values = {name: [getattr(source, name) for source in sources] for name in names}
    return {n: [np.nan if v is None else v for v in column] for n, column in values.items()}


def datasets(groups: Mapping[Group, object]) -> dict[str, xr.Dataset]:
    """Groups by name, each from its source or a tuple of sources, as by :func:`dataset`."""
    return {
        group.name: dataset(group, *(source if isinstance(source, tuple) else (source,)))
        for group, source in groups.items()
    }


def dataset(group: Group, *sources: object) -> xr.Dataset:
    """Make a group from plain arrays, with dimensions, units and long names as declared.

    Numeric coordinates that no source provides count from 0.

    ``sources``: mappings from name to array, number or text, where ``None`` leaves an optional
    variable out; objects, of which attributes with declared names are taken; or ``None``. Later
    sources override earlier ones. Raises KeyError for a name that is not declared, or a declared
    one that is missing, and ValueError if an array does not have the declared number of dimensions.
    """
    values: dict[str, object] = {}
    for source in sources:
        if source is not None:
            values |= source if isinstance(source, Mapping) else _attributes(group, source)
    stored = {n: _stored(group, n, value) for n, value in values.items() if value is not None}
    sizes = {dim: size for variable in stored.values() for dim, size in variable.sizes.items()}
    for declared in group.coordinates:
        if declared.name in sizes and declared.name not in stored and declared.unit != "text":
            count = np.arange(sizes[declared.name])
            stored[declared.name] = _stored(group, declared.name, count)
    for declared in (*group.variables, *group.coordinates):
        if not (declared.optional or declared.name in stored):
            raise KeyError(f"group {group.name} is given no {declared.name}")
    labelled = {declared.name for declared in group.coordinates}
    return xr.Dataset(
        {name: variable for name, variable in stored.items() if name not in labelled},
        {name: variable for name, variable in stored.items() if name in labelled},
    )


def _attributes(group: Group, source: object) -> dict[str, object]:
    """Attributes of an object that have declared names."""
    names = [declared.name for declared in (*group.variables, *group.coordinates)]
    return {name: getattr(source, name) for name in names if hasattr(source, name)}


def _stored(group: Group, name: str, value: object) -> xr.Variable:
    declared, array = group.variable(name), np.asarray(value)
    is_text = declared.unit == "text"
    if is_text:
        array = array.astype(np.str_)
    elif array.ndim == 0:
        array = array.astype(np.float64)
    if array.ndim != len(declared.dims):
        raise ValueError(
            f"{group.name}/{declared.name} has the shape {array.shape}, not {declared.dims}"
        )
    unit = "" if is_text else declared.unit
    return xr.Variable(declared.dims, array, {"units": unit, "long_name": declared.meaning})


def stack_snapshots(groups: Mapping[str, Mapping[str, xr.Dataset]]) -> dict[str, xr.Dataset]:
    """Stack groups of several fits, by snapshot name, along :data:`STACKED`, padded with NaN.

    A group that is missing in any fit is left out. Dimensions without labels have the greatest
    length of all.
    """
    names = list(groups)
    stacked = {}
    for group in next(iter(groups.values())):
        if not all(group in fit_groups for fit_groups in groups.values()):
            continue
        parts = [groups[name][group] for name in names]
        sizes = [(str(d), n) for p in parts for d, n in p.sizes.items() if d not in p.coords]
        longest = {dim: max(n for d, n in sizes if d == dim) for dim, _ in sizes}
        parts = [
            p.pad({dim: (0, n - p.sizes[dim]) for dim, n in longest.items() if dim in p.sizes})
            for p in parts
        ]
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


def padded(rows: Sequence[object], width: int) -> NDArray[np.float64]:
    """Stack rows of different lengths, shape (row, width), padded with NaN at the end."""
    table = np.full((len(rows), width), np.nan)
    for target, row in zip(table, map(np.asarray, rows), strict=True):
        target[: row.size] = row
    return table
