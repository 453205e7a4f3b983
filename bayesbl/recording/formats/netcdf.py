"""NetCDF files (version 3 and 4) as a table: the one-dimensional variables of the root group."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from bayesbl.errors import RecordingError
from bayesbl.recording.formats import Format
from bayesbl.recording.hdf5 import SIGNATURE, SIGNATURES, require_whole

if TYPE_CHECKING:
    from bayesbl.recording.array_table import ArrayTable

RESULT_MARK = "bayesbl_format"
"""Root attribute that marks a NetCDF file as a result of ours; its value counts the layouts."""


def read_netcdf(file: Path, data: bytes) -> ArrayTable:
    """Variables and coordinates with one dimension; calendar times decoded, units kept.

    Raises
    ------
    RecordingError
        If it is no NetCDF file, not all in itself, or one of our own results.
    """
    import netCDF4
    import numpy as np
    import xarray as xr

    from bayesbl.recording.array_table import ArrayTable

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


FORMAT = Format(
    "NetCDF",
    (".nc",),
    read_netcdf,
    signatures=(*((0, b"CDF" + bytes([n])) for n in (1, 2, 5)), *SIGNATURES),
)
