"""The gate of every HDF5 file (MATLAB v7.3, NetCDF 4, our results): it holds all that it shows.

HDF5 may name other files (links, raw storage, virtual datasets), lead in circles, ask for filters
from a folder of plug-ins, and declare any size without storing it. Libraries follow all that as
they open or read a file, so its structure is walked first, with calls that follow nothing.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

SIGNATURE = b"\x89HDF\r\n\x1a\n"
SIGNATURES = tuple((at, SIGNATURE) for at in (0, 512, 1024, 2048))
"""At which bytes it may stand, after a block of the writer's own."""

_OWN_FILTERS = range(1, 7)
"""HDF5's own (deflate, shuffle, fletcher32, szip, nbit, scaleoffset); all others are libraries that
it looks for in a folder and runs."""

_DEEPEST = 32


def require_whole(
    content: bytes | Path,
    refusal: Callable[..., Exception],
) -> float:
    """Bytes that reading a file takes, by what it declares.

    Of every dataset all values, or one chunk where that is larger: either is allocated whole.

    ``refusal``: makes the error for the first object that is not stored in the file itself, once,
    without foreign filters; takes what a :class:`bayesbl.errors.UserError` takes. Raises OSError,
    RuntimeError, ValueError: h5py's, for a damaged file.
    """
    import h5py

    def outside(path: str, actual: str) -> Exception:
        return refusal(
            "This file shows what it does not hold itself.",
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
