"""Files of named arrays: MATLAB v4 and v5 (scipy), v7.3 and other HDF5 (h5py), ``.npz``, NetCDF.

Vectors of either orientation become columns, named as MATLAB names them: ``rec.speed`` for the
field of a structure, ``data(:,2)`` for a column of a matrix. The name of an only structure is left
out. A signal stored by Simulink's scope has the name of its label, one stored by dSPACE that of its
name, and its unit.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

import h5py
import numpy as np
from scipy.io import loadmat

from bayesbl.errors import RecordingError
from bayesbl.recording.array_table import SCALES, AnyArray, ArrayTable, is_bare_number
from bayesbl.recording.formats import RESULT_MARK
from bayesbl.recording.hdf5 import SIGNATURE, SIGNATURES, require_whole

_MOST_COLUMNS = 64
_DEEPEST = 5
_NUMERIC = frozenset(
    {"double", "single", "logical", *(f"{s}int{b}" for s in ("", "u") for b in (8, 16, 32, 64))}
)


def read(data: bytes) -> ArrayTable:
    """Numeric vectors, columns of matrices and fields of structures.

    Raises RecordingError if there is no vector, or an HDF5 file refers to values outside of it.
    """

    units: dict[str, str] = {}
    if any(data[at : at + len(mark)] == mark for at, mark in SIGNATURES):
        variables = _hdf5_variables(data, units)
    elif data.startswith(b"PK"):
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            variables = dict(archive)
    else:
        stored = loadmat(io.BytesIO(data), simplify_cells=True)
        variables = {name: value for name, value in stored.items() if not name.startswith("__")}
    if len(variables) == 1 and isinstance(only := next(iter(variables.values())), dict):
        units = {name.partition(".")[2]: unit for name, unit in units.items()}
        variables = only
    arrays = dict(_columns(variables, units))
    if not arrays:
        raise RecordingError(
            "The file holds no vector of numbers.",
            found=", ".join(f'"{name}"' for name in variables) or "nothing",
            expected="a vector for each channel; save the columns of tables and timetables as such",
        )
    return ArrayTable(arrays, {name: u for name, u in units.items() if u and name in arrays})


def _columns(
    variables: Mapping[str, Any], units: dict[str, str], prefix: str = "", depth: int = 0
) -> Iterator[tuple[str, AnyArray]]:
    for name, value in variables.items():
        if isinstance(value, dict):
            parts = {key.lower(): part for key, part in value.items()}
            data, label = (
                next((parts[key] for key in keys if key in parts), None)
                for keys in (("values", "data"), ("label", "name"))
            )
            path = f"{prefix}{name}."
            if isinstance(data, np.ndarray) and isinstance(label, str) and label:
                if isinstance(unit := parts.get("unit", parts.get("units")), str):
                    units[path + label] = unit
                yield from _columns({label: data}, units, path)
            elif depth < _DEEPEST:
                yield from _columns(value, units, path, depth + 1)
        elif isinstance(value, list):  # of structures
            places = enumerate(value[:_MOST_COLUMNS], start=1)
            structures = {f"{name}({i})": each for i, each in places if isinstance(each, dict)}
            yield from _columns(structures, units, prefix, depth)
        elif not isinstance(value, np.ndarray) or (value.dtype.kind == "V" and value.size < 2):
            continue  # a single value, or an object of a class
        elif value.dtype.names is not None:
            yield from _columns(
                {key: value[key] for key in value.dtype.names}, units, prefix, depth
            )
        elif value.dtype.kind == "O":
            if all(isinstance(cell, str) or np.size(cell) == 0 for cell in value.flat):
                # A cell array of text: time stamps, perhaps.
                yield prefix + name, np.array([c if isinstance(c, str) else "" for c in value.flat])
        elif value.ndim <= 2 and value.size == max(value.shape, default=0):
            yield prefix + name, value.ravel()
        elif value.ndim == 2 and value.shape[1] <= _MOST_COLUMNS:
            for column in range(value.shape[1]):
                yield f"{prefix}{name}(:,{column + 1})", value[:, column]


def _hdf5_variables(data: bytes, units: dict[str, str]) -> dict[str, Any]:
    require_whole(data, partial(RecordingError))

    def variables(group: Any, depth: int, prefix: str = "") -> dict[str, Any]:
        by_name: dict[str, Any] = {}
        for name in group:
            item = group.get(name)
            if name.startswith("#") or item is None:
                continue
            if isinstance(item, h5py.Group):
                if depth < _DEEPEST:
                    by_name[name] = variables(item, depth + 1, f"{prefix}{name}.")
                continue
            kind = item.attrs.get("MATLAB_class")
            kind = kind.decode() if isinstance(kind, bytes) else kind
            empty = bool(item.attrs.get("MATLAB_empty", 0))
            fields = [item.dtype[field] for field in item.dtype.names or ()] or [item.dtype]
            are_numbers = {field.kind for field in fields} <= {*"biuf"}
            if kind in (None, *_NUMERIC) and are_numbers and not empty:
                # MATLAB stores by columns, others by rows.
                by_name[name] = np.asarray(item[()]) if kind is None else np.asarray(item[()]).T
                units[prefix + name] = _unit_of(item.attrs)
        return by_name

    with h5py.File(io.BytesIO(data), "r") as stored:
        return variables(stored, 0)


def _unit_of(attributes: Mapping[str, Any]) -> str:
    """The unit that attributes state. A scale makes it a question, as it may have been applied."""
    names = [n for n in attributes if re.fullmatch(f"(?i)units?|.*(?:{SCALES}).*", n)]
    text = {name.lower(): str(np.asarray(attributes[name]).astype("U")) for name in names}
    unit = text.pop("unit", text.pop("units", ""))
    scales = [f"{n} {v}" for n, v in text.items() if is_bare_number(v) and float(v) not in (0, 1)]
    return f"{unit} ({', '.join(scales)})".strip() if scales else unit


def read_netcdf(data: bytes) -> ArrayTable:
    """One-dimensional variables of the root group, with units and decoded calendar times.

    Raises RecordingError if the file refers to values outside of it, or is a result of ours.
    """
    import netCDF4
    import xarray as xr

    if SIGNATURE in data[:2056]:
        require_whole(data, partial(RecordingError))
    stored = netCDF4.Dataset("recording", memory=data)
    if RESULT_MARK in stored.ncattrs():
        raise RecordingError(
            "This is a result of bayesbl, not a recording.",
            expected="a file of measured channels; `bayesbl inspect` prints a result",
        )
    store = xr.backends.NetCDF4DataStore(stored)  # type: ignore[no-untyped-call]
    with xr.open_dataset(store, decode_timedelta=False) as dataset:
        chosen = {str(k): v for k, v in dataset.variables.items() if v.ndim == 1}
        arrays = {name: np.asarray(variable.values) for name, variable in chosen.items()}
        units = {
            name: str(variable.attrs["units"])
            for name, variable in chosen.items()
            if "units" in variable.attrs
        }
    return ArrayTable(arrays, units)
