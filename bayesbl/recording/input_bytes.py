"""Read input files: regular files only, and none above a stated size."""

from __future__ import annotations

import errno
import gzip
import io
import os
import stat
import zlib
from pathlib import Path

from bayesbl.errors import RecordingError, UnavailableError, UserError
from bayesbl.recording.channels import did_you_mean_file

LIMIT_VARIABLE = "BAYESBL_RECORDING_MEMORY_MB"  # environment variable that replaces MEMORY_MB
MEMORY_MB = 2000.0  # memory that reading one recording may take: its bytes, and what they unpack to
PACKED = ".gz"


def read_input(path: Path) -> bytes:
    """Bytes of a regular file; anything else might block or never end.

    Raises OSError, with a ``strerror``, if the file cannot be read, is not regular or above the
    limit, and ValueError if the path contains a NUL.
    """
    mode = os.stat(path).st_mode
    if not stat.S_ISREG(mode):  # not even opened: a socket cannot be, a pipe waits for its writer
        kind = "a folder" if stat.S_ISDIR(mode) else "a device, a socket or a pipe"
        raise OSError(errno.EINVAL, f"{kind}, not a file")
    flags = os.O_RDONLY | os.O_NONBLOCK
    with open(os.open(path, flags), "rb") as stream:
        largest, size = memory_bytes(), os.fstat(stream.fileno()).st_size
        data = stream.read(largest + 1) if size <= largest else b""
    if max(size, len(data)) > largest:
        raise OSError(
            errno.EFBIG,
            f"{max(size, len(data)) / 1e6:.5g} MB, above the limit of {largest / 1e6:g} MB; the "
            f"environment variable {LIMIT_VARIABLE} raises it",
        )
    return data


def input_or_refusal(path: Path, refusal: type[UserError], expected: str) -> bytes:
    """Bytes of a file that a user names; else ``refusal`` is raised, with ``expected``."""
    try:
        return read_input(path)
    except (FileNotFoundError, NotADirectoryError):
        problem, actual = "There is no such file." + did_you_mean_file(path), None
    except (OSError, ValueError) as error:
        problem, actual = "The file cannot be read.", getattr(error, "strerror", None) or str(error)
    raise refusal(problem, file=path, found=actual, expected=expected)


def require_memory(size: float, what: str = "its content, unpacked") -> None:
    """Refuse a recording above the limit before anything is allocated.

    ``size`` is in bytes, as the file declares it; ``what`` names the content in the message. Raises
    RecordingError.
    """
    if size > memory_bytes():
        raise beyond_memory(f"{size / 1e6:.5g} MB ({what})")


def beyond_memory(actual: str) -> UnavailableError:
    """The error for a recording that takes more memory than the limit."""
    return UnavailableError(
        "Reading this file takes too much memory.",
        found=actual,
        expected=f"at most {memory_bytes() / 1e6:g} MB; record fewer channels or a shorter time, "
        f"or raise the limit by the environment variable {LIMIT_VARIABLE}",
    )


def memory_bytes() -> int:
    """The limit in bytes. Raises OSError if the environment variable is not a number."""
    stated = os.environ.get(LIMIT_VARIABLE, "")
    try:
        limit = float(stated) if stated else MEMORY_MB
    except ValueError:
        limit = 0.0
    if not 0.0 < limit < 1e12:
        raise OSError(errno.EINVAL, f"{LIMIT_VARIABLE} = {stated!r}, which is not a number of MB")
    return int(1e6 * limit)


def suffix_of(path: Path) -> str:
    """Suffix of the content in small letters: ``.csv`` for ``ramps.csv.gz``."""
    packed = path.suffix.lower() == PACKED
    return (Path(path.stem) if packed else path).suffix.lower()


def stem_of(path: Path) -> str:
    """File name without the suffixes of content and packing."""
    return Path(path.stem).stem if path.suffix.lower() == PACKED else path.stem


def unpacked(path: Path, data: bytes) -> bytes:
    """The bytes, unpacked if the file name ends in ``.gz``.

    Raises RecordingError if they are damaged, or unpack to more than the limit.
    """
    if path.suffix.lower() != PACKED:
        return data
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as stream:
            whole = stream.read(memory_bytes() + 1)
    except (OSError, EOFError, zlib.error):
        raise RecordingError(
            "This file cannot be unpacked: it is damaged, or not packed by gzip.",
            found=f"{len(data)} bytes",
            expected="a file packed by gzip",
        ) from None
    require_memory(len(whole), "unpacked, or more")
    return whole


def of_two(data: bytes, other: bytes) -> bytes:
    """The bytes of two files, with the length of the first at the end."""
    return data + other + len(data).to_bytes(8, "big")


def two_of(joined: bytes) -> tuple[bytes, bytes]:
    """Split what :func:`of_two` joined."""
    end = int.from_bytes(joined[-8:], "big")
    return joined[:end], joined[end:-8]
