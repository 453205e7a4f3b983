"""NetCDF files (version 3 and 4) as a table: the one-dimensional variables of the root group."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import netCDF4
import numpy as np
import xarray as xr

from bayesbl.errors import RecordingError
from bayesbl.recording.array_table import ArrayTable
from bayesbl.recording.formats import RESULT_MARK
from bayesbl.recording.hdf5 import SIGNATURE, require_whole


def read(file: Path, data: bytes) -> ArrayTable:
    """Variables and coordinates with one dimension; calendar times decoded, units kept.

    Raises
    ------
    RecordingError
        If it is no NetCDF file, not all in itself, or one of our own results.
    """
    if SIGNATURE in data[:2056]:
        require_whole(data, partial(RecordingError, file=file))
    stored = netCDF4.Dataset("recording", memory=data)
    if RESULT_MARK in stored.ncattrs():
        raise RecordingError(
            "This is a result of bayesbl, not a recording.",
            file=file,
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
    return ArrayTable(str(file), arrays, units)
