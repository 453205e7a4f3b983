"""Check that an HDF5 file (MATLAB v7.3, NetCDF 4, our results) holds all that it refers to.

HDF5 may refer to other files (links, external storage, virtual datasets), contain cycles, load
filters from a plug-in folder, and declare any size without storing it. Libraries follow all this
when they open or read a file. So its structure is first walked with calls that follow nothing.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

SIGNATURE = b"\x89HDF\r\n\x1a\n"
SIGNATURES = tuple((at, SIGNATURE) for at in (0, 512, 1024, 2048))
"""Possible positions of the signature, after a block of the writer's own."""

_OWN_FILTERS = range(1, 7)
"""Built-in filters (deflate, shuffle, fletcher32, szip, nbit, scaleoffset). HDF5 looks for others
in a folder and runs them."""

_DEEPEST = 32


def require_whole(content: bytes | Path, refusal: Callable[..., Exception]) -> float:
    """Number of bytes that reading the file takes, by the sizes that it declares.

    Each dataset counts with all its values, or one chunk if that is larger, as either is allocated
    whole. ``refusal`` makes the error for the first object that is not stored in the file itself,
    is stored twice, or needs a foreign filter; it takes the arguments of
    :class:`bayesbl.errors.UserError`. For damaged files, h5py raises OSError, RuntimeError or
    ValueError.
    """
    import h5py

    def outside(path: str, actual: str) -> Exception:
        return refusal(
            "This file refers to data outside itself.",
            where=f'"{path}"',
            found=actual,
            expected="a file with all its values in it, each once, packed by HDF5's own filters; "
            "save a copy of the values",
        )

    def size_of(dataset: Any, path: str) -> float:
        made = dataset.get_create_plist()
        layout = made.get_layout()
        if layout == h5py.h5d.VIRTUAL:
            raise outside(path, "a virtual dataset, whose values are elsewhere")
        if made.get_external_count():
            raise outside(path, "values in another file")
        for index in range(made.get_nfilters()):
            number = made.get_filter(index)[0]
            if number not in _OWN_FILTERS:
                raise outside(path, f"a filter that is not HDF5's own (number {number})")
        size = max(1.0, float(dataset.get_type().get_size()))
        values, chunk = float(dataset.get_space().get_simple_extent_npoints()), 0.0
        if layout == h5py.h5d.CHUNKED:
            chunk = math.prod(map(float, made.get_chunk()))
        return size * max(values, chunk)

    name = io.BytesIO(content) if isinstance(content, bytes) else str(content)
    with h5py.File(name, "r", locking=False) as opened:
        read_bytes = 0.0
        root = h5py.h5g.open(opened.id, b"/")
        groups = {h5py.h5o.get_info(root).addr}
        # What is still to be looked at; no recursion, as a file may nest as it likes.
        waiting: list[tuple[Any, str, int]] = [(root, "", 0)]
        while waiting:
            group, path, depth = waiting.pop()
            links: list[bytes] = []
            group.links.iterate(links.append)
            for link in links:
                where = f"{path}/{link.decode('utf-8', 'replace')}"
                kind = group.links.get_info(link).type
                if kind != h5py.h5l.TYPE_HARD:
                    soft = kind == h5py.h5l.TYPE_SOFT
                    raise outside(where, "a soft link" if soft else "a link to another file")
                item = h5py.h5o.open(group, link)
                if isinstance(item, h5py.h5d.DatasetID):
                    read_bytes += size_of(item, where)
                elif isinstance(item, h5py.h5g.GroupID):
                    address = h5py.h5o.get_info(item).addr
                    if address in groups:
                        raise outside(where, "a group that the file shows at two places")
                    if depth >= _DEEPEST:
                        raise outside(where, f"more than {_DEEPEST} groups in one another")
                    groups.add(address)
                    waiting.append((item, where, depth + 1))
        return read_bytes
