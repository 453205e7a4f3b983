"""The seal of a result file: its last bytes are the SHA-256 of all before them.

It is asked before a library opens the file, since HDF5 may crash or hang on damaged bytes. HDF5 and
NetCDF readers ignore what follows the end that a file states, and drop it when they change a file.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import BinaryIO

_MARK = b"\nbayesbl SHA-256 "
_HEX_DIGITS = 64
_BYTES = len(_MARK) + _HEX_DIGITS + 1
_CHUNK_BYTES = 1 << 20


def seal(path: Path) -> None:
    """Append the seal to a file that has none."""
    with open(path, "r+b") as file:
        file.write(_seal_of(file, path.stat().st_size))


def has_seal(path: Path) -> bool:
    """Whether a file ends in a seal, right or wrong."""
    with open(path, "rb") as file:
        return len(_end(file)) == _BYTES and _end(file).startswith(_MARK)


def is_intact(path: Path) -> bool:
    """Whether a file ends in the seal of what it holds."""
    with open(path, "rb") as file:
        end = _end(file)
        file.seek(0)
        return end == _seal_of(file, path.stat().st_size - len(end))


def _end(file: BinaryIO) -> bytes:
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - _BYTES))
    return file.read()


def _seal_of(file: BinaryIO, size: int) -> bytes:
    """Seal of the next ``size`` bytes."""
    digest = hashlib.sha256()
    while size > 0 and (chunk := file.read(min(size, _CHUNK_BYTES))):
        digest.update(chunk)
        size -= len(chunk)
    return _MARK + digest.hexdigest().encode() + b"\n"
