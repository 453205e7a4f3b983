"""SHA-256 over all that a result tree holds, so that a changed result is known before it is used.

Canonical: groups, variables and attributes by name; numbers as little-endian bytes with their kind
and shape; texts as JSON, since NetCDF gives them back in several types.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

CONTENT = "content_sha256"
"""Root attribute that holds the digest of everything else."""

Array = np.ndarray[Any, np.dtype[Any]]


def content_sha256(tree: xr.DataTree) -> str:
    """Digest of every group, dimension, variable and attribute of a tree that was read."""
    digest = hashlib.sha256()

    def add(*words: object, array: Array | None = None) -> None:
        content = b"" if array is None else _plain(array)
        head = json.dumps([*words, len(content)])
        digest.update(head.encode() + b"\n" + content)

    def add_attributes(attributes: Mapping[Any, Any]) -> None:
        for name in sorted(attributes, key=str):
            value = np.ravel(np.asarray(attributes[name]))
            add("attribute", str(name), _kind(value), value.shape, array=value)

    for node in sorted(tree.subtree, key=lambda node: node.path):
        held = node.to_dataset(inherit=False)
        add("group", node.path, sorted(map(str, held.coords)))
        add_attributes({k: v for k, v in held.attrs.items() if (node.path, k) != ("/", CONTENT)})
        for name in sorted(held.variables, key=str):
            variable = held.variables[name]
            dims, values = [str(dim) for dim in variable.dims], variable.values
            add("variable", str(name), dims, _kind(values), values.shape, array=values)
            add_attributes(variable.attrs)
    return digest.hexdigest()


def _kind(array: Array) -> str:
    return array.dtype.newbyteorder("<").str if array.dtype.kind in "biufcmM" else "text"


def _plain(array: Array) -> bytes:
    if _kind(array) == "text":
        return json.dumps([str(text) for text in array.ravel().tolist()]).encode()
    return array.astype(array.dtype.newbyteorder("<")).tobytes()
