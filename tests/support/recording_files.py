"""Recordings written in every format, for tests."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

Columns = Mapping[str, Any]
"""Column name to values, shape (n,)."""


def write_csv(path: Path, columns: Columns) -> Path:
    """Numbers with all their digits, NaN as an empty cell, text as it is."""
    cells = [[_cell(value) for value in values] for values in columns.values()]
    lines = [",".join(columns), *(",".join(row) for row in zip(*cells, strict=True))]
    path.write_text("\n".join(lines) + "\n")
    return path


def write_netcdf(path: Path, columns: Columns, kind: str = "NETCDF4", **units: str) -> Path:
    import xarray as xr

    data = xr.Dataset({name: ("sample", np.asarray(v)) for name, v in columns.items()})
    for name, unit in units.items():
        data[name].attrs["units"] = unit
    data.to_netcdf(path, format=kind)
    return path


def write_mat5(path: Path, variables: Mapping[str, Any], orientation: str = "column") -> Path:
    from scipy.io import savemat

    savemat(path, dict(variables), oned_as=orientation)
    return path


def write_mat73(path: Path, variables: Mapping[str, Any]) -> Path:
    """As MATLAB writes it: a header block, its class on every dataset, columns before rows."""
    import h5py

    def store(group: Any, values: Mapping[str, Any]) -> None:
        for name, value in values.items():
            if isinstance(value, Mapping):
                inner = group.create_group(name)
                inner.attrs["MATLAB_class"] = np.bytes_("struct")
                store(inner, value)
            else:
                dataset = group.create_dataset(name, data=np.atleast_2d(value))
                dataset.attrs["MATLAB_class"] = np.bytes_("double")

    with h5py.File(path, "w", userblock_size=512) as file:
        store(file, variables)
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Sun Mar  1 12:00:00 2026"
    with open(path, "r+b") as raw:
        raw.write(head.ljust(124) + b"\x00\x02IM")
    return path


def write_parquet(path: Path, columns: Columns) -> Path:
    import pandas as pd

    pd.DataFrame(dict(columns)).to_parquet(path, engine="pyarrow")
    return path


def _cell(value: Any) -> str:
    if isinstance(value, str):
        return value
    return "" if value != value else repr(float(value))
