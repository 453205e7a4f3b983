"""The content of input files: of regular files only, and of none above a stated size."""

from __future__ import annotations

import errno
import gzip
import io
import os
import stat
import zlib
from pathlib import Path

from bayesbl.errors import RecordingError

LIMIT_VARIABLE = "BAYESBL_LARGEST_FILE_MB"
"""Environment variable that raises or lowers :data:`LARGEST_FILE_MB`."""

LARGEST_FILE_MB = 1000.0
"""Reading a text file takes up to six times its size in memory."""

PACKED = ".gz"

_KINDS = (
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def read_input(path: Path) -> bytes:
    """The bytes of a regular file; nothing else is read, as it may wait or have no end.

    Raises
    ------
    OSError
        If it cannot be read, with a ``strerror`` that says why: also what is no regular file, and
        what is larger than the limit.
    ValueError
        If the path has a NUL.
    """
    kind = _kind(os.stat(path).st_mode)
    if kind:  # not even opened: a socket cannot be, and a pipe may wait for its writer
        raise OSError(errno.EINVAL, f"{kind}, not a file")
    flags = os.O_RDONLY | getattr(os, "O_BINARY", 0) | getattr(os, "O_NONBLOCK", 0)
    with open(os.open(path, flags), "rb") as stream:
        status = os.fstat(stream.fileno())
        if stat.S_ISDIR(status.st_mode):
            raise IsADirectoryError(errno.EISDIR, "a folder")
        largest = int(1e6 * _largest_mb())
        if status.st_size > largest:
            raise _too_large(f"{status.st_size / 1e6:.5g} MB")
        data = stream.read(largest + 1)
    if len(data) > largest:
        raise _too_large("more")
    return data


def require_size(size: int | None) -> None:
    """Raise ``OSError`` for what is larger than the limit, in bytes, or does not say."""
    if size is None:
        raise _too_large("a size that is not told")
    if size > 1e6 * _largest_mb():
        raise _too_large(f"{size / 1e6:.5g} MB")


def suffix_of(path: Path) -> str:
    """The suffix that says what a file holds, in small letters: ``.csv`` of ``ramps.csv.gz``."""
    packed = path.suffix.lower() == PACKED
    return (Path(path.stem) if packed else path).suffix.lower()


def stem_of(path: Path) -> str:
    """The file's name without the suffixes of what it holds and how it is packed."""
    return Path(path.stem).stem if path.suffix.lower() == PACKED else path.stem


def unpacked(path: Path, data: bytes) -> bytes:
    """The bytes of a file as they were before gzip, where its name says that it is packed.

    Raises
    ------
    RecordingError
        If it is damaged, or larger than the limit once unpacked.
    """
    if path.suffix.lower() != PACKED:
        return data
    largest = int(1e6 * _largest_mb())
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as stream:
            whole = stream.read(largest + 1)
    except (OSError, EOFError, zlib.error):
        raise RecordingError(
            "This file cannot be unpacked: it is damaged, or not packed by gzip.",
            file=path,
            found=f"{len(data)} bytes",
            expected="a file packed by gzip",
        ) from None
    if len(whole) > largest:
        raise RecordingError(
            "The unpacked file is too large.",
            file=path,
            found=f"more than {_largest_mb():g} MB",
            expected=f"less; the environment variable {LIMIT_VARIABLE} raises the limit",
        )
    return whole


def _kind(mode: int) -> str | None:
    """What a path leads to, where that is neither file nor folder."""
    return next((name for is_kind, name in _KINDS if is_kind(mode)), None)


def _largest_mb() -> float:
    given = os.environ.get(LIMIT_VARIABLE, "")
    try:
        limit = float(given) if given else LARGEST_FILE_MB
    except ValueError:
        limit = 0.0
    if not 0.0 < limit < 1e12:
        raise OSError(errno.EINVAL, f"{LIMIT_VARIABLE} = {given!r}, which is no number of MB")
    return limit


def _too_large(size: str) -> OSError:
    return OSError(
        errno.EFBIG,
        f"{size}, above the limit of {_largest_mb():g} MB; the environment variable "
        f"{LIMIT_VARIABLE} raises it, and six times the size is needed in memory",
    )
