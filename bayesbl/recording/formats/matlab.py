"""MATLAB files as a table: v5 (and v4) by scipy, v7.3, which is HDF5, by h5py.

Vectors of either orientation become columns. Fields of a structure are named as MATLAB names them,
``rec.speed``, columns of a matrix ``data(:,2)``; if the file holds nothing but one structure, its
name is left off.
"""

from __future__ import annotations

import io
import math
import struct
import zlib
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesbl.errors import RecordingError
from bayesbl.recording.formats import Format
from bayesbl.recording.hdf5 import SIGNATURES, require_whole
from bayesbl.recording.input_bytes import memory_bytes, require_memory

if TYPE_CHECKING:
    from bayesbl.recording.array_table import AnyArray, ArrayTable

_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _SPARSE = 1, 2, 5
_ELEMENTS = frozenset({*range(1, 8), 9, *range(12, 19)})
_MOST_COLUMNS = 64
_DEEPEST = 5
_NUMERIC = frozenset(
    {"double", "single", "logical", *(f"{s}int{b}" for s in ("", "u") for b in (8, 16, 32, 64))}
)
_BYTES_OF_CLASS = {1: 64.0, 2: 64.0, 4: 4.0, 7: 4.0}
"""In memory: of cells and structures what Python's objects take, of text and single 4, else 8."""

_OTHERWISE = "save the columns of tables and timetables as plain vectors"


def read_matlab(file: Path, data: bytes) -> ArrayTable:
    """Numeric vectors, columns of matrices and fields of structures.

    Raises
    ------
    RecordingError
        If it is no MATLAB file, holds no vector, or is v7.3 and shows what it does not hold itself.
    """
    from bayesbl.recording.array_table import ArrayTable

    if any(data[at : at + len(mark)] == mark for at, mark in SIGNATURES):
        variables = _hdf5_variables(file, data)
    else:
        variables = _mat5_variables(file, data)
    if len(variables) == 1 and isinstance(only := next(iter(variables.values())), dict):
        variables = only
    arrays = dict(_columns(variables))
    if not arrays:
        raise RecordingError(
            "The file holds no vector of numbers.",
            file=file,
            found=", ".join(f'"{name}"' for name in variables) or "nothing",
            expected=f"a vector for each channel, or {_OTHERWISE}",
        )
    return ArrayTable(str(file), arrays)


def _columns(
    variables: Mapping[str, Any], prefix: str = "", depth: int = 0
) -> Iterator[tuple[str, AnyArray]]:
    for name, value in variables.items():
        if isinstance(value, dict):
            if depth < _DEEPEST:
                yield from _columns(value, f"{prefix}{name}.", depth + 1)
        elif value.ndim <= 2 and value.size == max(value.shape, default=0):
            yield prefix + name, value.ravel()
        elif value.ndim == 2 and value.shape[1] <= _MOST_COLUMNS:
            for column in range(value.shape[1]):
                yield f"{prefix}{name}(:,{column + 1})", value[:, column]


def _mat5_variables(file: Path, data: bytes) -> dict[str, Any]:
    from scipy.io import loadmat

    require_memory(file, 2.0 * _Walk(file, data).bytes, "its variables, unpacked")
    stored = loadmat(io.BytesIO(data), squeeze_me=False, simplify_cells=False)
    return _plain({k: v for k, v in stored.items() if not k.startswith("__")})


class _Walk:
    """The elements of a v5 file: each has a known type and ends within its parent.

    scipy's compiled reader looks types up in a table without asking, and a damaged one ends the
    whole process. ``bytes`` is what the matrices take in memory, by the sizes that they declare.
    """

    def __init__(self, file: Path, data: bytes) -> None:
        self._file = file
        self.bytes = 0.0
        if len(data) < 128 or 0 in data[:4]:
            return  # v4, which has neither this header nor these tags, and packs nothing
        orders = {b"IM": "<", b"MI": ">"}
        if data[126:128] not in orders:
            raise ValueError("neither a MATLAB header nor HDF5")
        self._walk(data, 128, len(data), orders[data[126:128]])

    def _walk(self, data: bytes, begin: int, end: int, order: str, depth: int = 0) -> None:
        children: list[tuple[int, int]] = []
        first = begin
        while begin < end:
            kind, size = struct.unpack_from(order + "II", data, begin)
            start, step = begin + 8, -(-size // 8) * 8
            if kind >> 16:
                # A small element: type and size share the first word, four bytes of content follow.
                kind, size, start, step = kind & 0xFFFF, kind >> 16, begin + 4, 4
            elif kind == _COMPRESSED:
                step = size
            if kind not in _ELEMENTS or start + size > end or (start == begin + 4 and size > 4):
                raise ValueError(f"a damaged element at byte {begin}")
            if kind == _COMPRESSED and depth == 0:
                inner = self._unpacked(data[start : start + size])
                self._walk(inner, 0, len(inner), order, 1)
            elif kind == _MATRIX and depth < 4 * _DEEPEST:
                self._walk(data, start, start + size, order, depth + 2)
            elif kind in (_MATRIX, _COMPRESSED):
                raise ValueError(f"elements nested too deeply at byte {begin}")
            children.append((start, size))
            begin = start + step
        if depth > 1 and children:
            self.bytes += _memory(data, children, order)
            if len(children) < _parts(data, children, order):
                raise ValueError(f"a matrix that lacks a part at byte {first}")

    def _unpacked(self, packed: bytes) -> bytes:
        most = memory_bytes() - int(self.bytes)
        whole = zlib.decompressobj().decompress(packed, max(most, 1))
        require_memory(self._file, self.bytes + len(whole) + 1, "a variable, unpacked, or more")
        return whole


def _memory(data: bytes, children: list[tuple[int, int]], order: str) -> float:
    """Bytes that a matrix takes, by its flags and dimensions."""
    if len(children) < 2 or children[0][1] < 4:
        return 0.0
    (flags,) = struct.unpack_from(order + "I", data, children[0][0])
    start, size = children[1]
    cells = math.prod(map(float, struct.unpack_from(f"{order}{size // 4}i", data, start)))
    width = _BYTES_OF_CLASS.get(flags & 0xFF, 8.0)
    return (2.0 if flags & 0x800 else 1.0) * width * abs(cells)


def _parts(data: bytes, children: list[tuple[int, int]], order: str) -> int:
    """How many elements a matrix must have, by its flags, dimensions and field names."""
    if len(children) < 3 or children[0][1] < 8:
        return 3 + len(children)
    (flags,) = struct.unpack_from(order + "I", data, children[0][0])
    start, size = children[1]
    cells = int(math.prod(struct.unpack_from(f"{order}{size // 4}i", data, start)))
    kind, is_complex = flags & 0xFF, bool(flags & 0x800)
    if kind == _CELL:
        return 3 + cells
    if kind == _STRUCT and len(children) > 4:
        (length,) = struct.unpack_from(order + "i", data, children[3][0])
        return 5 + cells * int(children[4][1] // max(length, 1))
    if kind == _SPARSE:
        return 6 + is_complex
    return 4 + is_complex


def _plain(values: Mapping[str, Any], depth: int = 0) -> dict[str, Any]:
    """Structures as dictionaries, arrays of numbers and text as they are, all else left out."""
    import numpy as np

    plain: dict[str, Any] = {}
    for name, value in values.items():
        if not isinstance(value, np.ndarray) or type(value).__name__ == "MatlabOpaque":
            continue
        if value.dtype.names is not None:
            if value.size == 1 and depth < _DEEPEST:
                record = value.flat[0]
                plain[name] = _plain({n: record[n] for n in value.dtype.names}, depth + 1)
        elif value.dtype.kind in "biufc":
            plain[name] = value
        elif value.dtype.kind == "O" and all(_is_text(cell) for cell in value.flat):
            # A cell array of text: time stamps, perhaps.
            plain[name] = np.array([str(c.flat[0]) if c.size else "" for c in value.flat])
        elif value.dtype.kind == "U":
            plain[name] = value
    return plain


def _is_text(cell: Any) -> bool:
    """Whether a cell holds one text or none."""
    return getattr(cell, "dtype", None) is not None and cell.dtype.kind == "U" and cell.size <= 1


def _hdf5_variables(file: Path, data: bytes) -> dict[str, Any]:
    import h5py
    import numpy as np

    size = require_whole(data, partial(RecordingError, file=file), lambda dataset: True)
    require_memory(file, 2.0 * size, "its variables, unpacked")

    def variables(group: Any, depth: int) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for name in group:
            item = group.get(name)
            if name.startswith("#") or item is None:
                continue
            if isinstance(item, h5py.Group):
                if depth < _DEEPEST:
                    found[name] = variables(item, depth + 1)
                continue
            kind = item.attrs.get("MATLAB_class", b"double")
            kind = kind.decode() if isinstance(kind, bytes) else str(kind)
            empty = bool(item.attrs.get("MATLAB_empty", 0))
            if kind in _NUMERIC and item.dtype.kind in "biuf" and not empty:
                # MATLAB stores by columns, HDF5 by rows.
                found[name] = np.asarray(item[()]).T
        return found

    with h5py.File(io.BytesIO(data), "r") as stored:
        return variables(stored, 0)


_V4 = tuple((0, bytes([kind, 0, 0, 0])) for kind in range(0, 60, 10))
"""Version 4 has no signature but the type of its first variable."""

FORMAT = Format(
    "MATLAB",
    (".mat",),
    read_matlab,
    signatures=((126, b"IM"), (126, b"MI"), *SIGNATURES, *_V4, (0, b"\x00\x00\x03\xe8")),
    otherwise=_OTHERWISE,
)
