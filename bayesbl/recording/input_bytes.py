"""The content of input files: of regular files only, and of none above a stated size."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

LIMIT_VARIABLE = "BAYESBL_LARGEST_FILE_MB"
"""Environment variable that raises or lowers :data:`LARGEST_FILE_MB`."""

LARGEST_FILE_MB = 1000.0
"""Reading a text file takes up to six times its size in memory."""

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
