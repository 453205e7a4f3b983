"""Write files whole or not at all, and lock hidden folders for one process at a time.

A file is written under another name and renamed when it is complete. The intermediate results of a
run are kept in a hidden folder beside its output. The folder is locked; the system releases the
lock when the process ends, and the next run into the same output takes the folder over.

Other users may be able to write beside an output folder. A hidden folder is therefore created for
this user alone, and an existing one is used only if nobody else can write to it.
"""

from __future__ import annotations

import fcntl
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from bayesbl.errors import ResultError

STAGING = ".staging"  # suffix of the hidden folder in which an output is made
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


@contextmanager
def replacing(path: str | Path, *, durable: bool = False) -> Iterator[Path]:
    """Yield a temporary file that is renamed to ``path`` when the block ends without exception.

    ``durable``: flush the file and its name to disk before the block ends, so that a power cut
    leaves it whole. Raises ResultError if nothing can be written there, ``path`` is not a file, or
    another process writes it, and OSError: a system error in the block, such as a full disk,
    reported for ``path``.
    """
    path = Path(path)
    require_replaceable(path)
    with locked_sibling(path, STAGING) as folder:
        new = folder / path.name
        new.unlink(missing_ok=True)  # left by a killed writer
        try:
            yield new
            if durable:
                _to_disk(new)
            os.replace(new, path)
            if durable:
                _to_disk(path.parent)
        except OSError as error:
            if error.errno is not None:
                error.filename = str(path)
            raise
        finally:
            new.unlink(missing_ok=True)


def require_replaceable(path: Path) -> None:
    """Require a file or nothing: as root, replacing could destroy a device. ResultError else."""
    if os.path.lexists(path) and not path.is_file():
        raise ResultError(
            "This is not a file, and is not replaced by one.",
            file=path,
            expected="a new file, or one to replace with --force",
        )


@contextmanager
def locked_sibling(output: Path, suffix: str) -> Iterator[Path]:
    """Create and lock the hidden folder ``.<name><suffix>`` beside an output; keep it if not empty.

    Raises ResultError if another process holds the lock, no folder can be made there, or the folder
    there may belong to somebody else.
    """
    folder = sibling(output, suffix)
    new_parents = [parent for parent in folder.parents if not parent.exists()]
    try:
        handle = _locked(folder, output)
    except OSError as error:
        raise unwritable(output, error) from None
    try:
        yield folder
    finally:
        with suppress(OSError):
            for empty in (folder, *new_parents):
                empty.rmdir()  # a run that failed leaves no empty folders
        os.close(handle)


def sibling(output: Path, suffix: str) -> Path:
    """Path of the hidden folder ``.<name><suffix>`` beside an output."""
    return output.with_name(f".{output.name}{suffix}")


def make_own(folder: Path) -> None:
    """Make a folder for this user alone if there is none.

    Raises ResultError if the folder there may belong to somebody else, and OSError if no folder can
    be made.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    with suppress(FileExistsError):
        folder.mkdir(0o700)
    require_own(folder)


def require_own(folder: Path) -> None:
    """Require that only this user can write to a folder, or those who could replace it anyway.

    These are the owner of the parent folder, and those who may write to the parent unless it is
    sticky.

    Raises FileNotFoundError if nothing is there, and ResultError if it is no folder, or others can
    write to it.
    """
    status, above = os.lstat(folder), os.stat(folder.parent)
    exchange = 0 if above.st_mode & stat.S_ISVTX else above.st_mode
    writers = status.st_mode & _OTHERS_WRITE & ~exchange
    is_ours = status.st_uid in (os.geteuid(), above.st_uid) and not writers
    if not stat.S_ISDIR(status.st_mode) or not is_ours:
        raise ResultError(
            "This folder may belong to somebody else, and is not used.",
            file=folder,
            found="a link, another user's, or one that others can write",
            expected=f"nothing, or a folder of yours alone: move it away, or chmod 700 {folder}",
        )


def _locked(folder: Path, output: Path) -> int:
    """Make a folder and lock it; return the handle that holds the lock."""
    while True:
        try:
            make_own(folder)
            handle = os.open(folder, os.O_RDONLY)
        except FileNotFoundError:
            continue  # the previous holder of the lock has removed the folder
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            raise ResultError(
                "Another run is writing to this output.", file=output, expected="one at a time"
            ) from None
        except OSError:
            pass  # some network file systems have no locks
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(handle), os.lstat(folder)):
                return handle
        os.close(handle)


def _to_disk(path: Path) -> None:
    """Flush a file, or the names in a folder, to disk."""
    handle = os.open(path, os.O_RDWR if path.is_file() else os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def unwritable(path: str | Path, error: OSError | ValueError) -> ResultError:
    """The error for a place where nothing can be written."""
    return ResultError(
        "Nothing can be written here.",
        file=path,
        found=getattr(error, "strerror", None) or str(error),
        expected="a place that can be written to",
    )
