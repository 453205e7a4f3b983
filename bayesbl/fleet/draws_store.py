"""Draws of all joints in one Zarr store, a group a joint, written and read region by region.

It is Zarr's format 2 without compression: a folder of JSON and of little-endian numbers, which
needs no library to be written. ``xarray.open_zarr(store, group="R1-J2")`` reads one joint.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

GROUP, ARRAY, ATTRIBUTES = ".zgroup", ".zarray", ".zattrs"


class DrawsStore:
    """A new store in a folder that must not exist yet."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._group(folder, {})

    def put(
        self,
        name: str,
        arrays: Mapping[str, tuple[Sequence[str], NDArray[np.generic]]],
        attributes: Mapping[str, object],
    ) -> None:
        """A group of this name; each array has the names of its dimensions before it."""
        folder = self._folder / name
        self._group(folder, attributes)
        for key, (dims, values) in arrays.items():
            _write(folder / key, values, {"_ARRAY_DIMENSIONS": list(dims)})

    def _group(self, folder: Path, attributes: Mapping[str, object]) -> None:
        folder.mkdir(parents=True)
        (folder / GROUP).write_text('{"zarr_format": 2}')
        (folder / ATTRIBUTES).write_text(json.dumps(dict(attributes), ensure_ascii=False))


def _write(folder: Path, values: NDArray[np.generic], attributes: Mapping[str, object]) -> None:
    folder.mkdir()
    dtype = values.dtype.newbyteorder("<")
    plain = np.ascontiguousarray(values, dtype=dtype)
    head = {
        "zarr_format": 2,
        "shape": list(plain.shape),
        "chunks": [max(1, size) for size in plain.shape],
        "dtype": dtype.str,
        "compressor": None,
        "fill_value": None,
        "order": "C",
        "filters": None,
    }
    (folder / ARRAY).write_text(json.dumps(head))
    (folder / ATTRIBUTES).write_text(json.dumps(attributes))
    if plain.size:
        (folder / ".".join(["0"] * plain.ndim)).write_bytes(plain.tobytes())
