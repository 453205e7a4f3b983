"""Files that appear whole or not at all, and hidden folders that one process at a time holds.

What is being written has another name and is renamed when it is whole. What a run keeps until it
ends is in a hidden folder beside its output: it is locked, which the system ends with the process,
and the next run into the same output takes it over.

Others may be able to write beside an output folder. So a hidden folder is made for this user alone,
and one that is there already is used only if nobody else can write it.
"""

from __future__ import annotations

import fcntl
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from bayesbl.errors import ResultError

STAGING = ".staging"
"""Suffix of the hidden folder in which an output is made."""

_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


@contextmanager
def replacing(path: str | Path, *, durable: bool = False) -> Iterator[Path]:
    """A temporary file that takes the name ``path`` when the block ends without exception.

    Parameters
    ----------
    durable
        It is on the disk, under its name, when the block has ended: a power cut leaves it whole.

    Raises
    ------
    ResultError
        If nothing can be written there, what is there is no file, or another process writes it.
    OSError
        What the system said in the block, a full disk say, of ``path``.
    """
    path = Path(path)
    require_replaceable(path)
    with locked_sibling(path, STAGING) as folder:
        new = folder / path.name
        new.unlink(missing_ok=True)  # of a writer that was killed
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
    """There is a file or nothing at a place: root could replace a device, which nobody wants.

    Raises
    ------
    ResultError
        If there is anything else.
    """
    if os.path.lexists(path) and not path.is_file():
        raise ResultError(
            "This is not a file, and is not replaced by one.",
            file=path,
            expected="a new file, or one to replace with --force",
        )


@contextmanager
def locked_sibling(output: Path, suffix: str) -> Iterator[Path]:
    """The hidden folder ``.<name><suffix>`` beside an output, made, locked and kept if not empty.

    Raises
    ------
    ResultError
        If another process holds the lock, no folder can be made there, or what is there may be of
        somebody else.
    """
    folder = sibling(output, suffix)
    made = [parent for parent in folder.parents if not parent.exists()]
    try:
        handle = _locked(folder, output)
    except OSError as error:
        raise unwritable(output, error) from None
    try:
        yield folder
    finally:
        with suppress(OSError):
            for empty in (folder, *made):
                empty.rmdir()  # a run that failed leaves no empty folders
        os.close(handle)


def sibling(output: Path, suffix: str) -> Path:
    """The hidden folder ``.<name><suffix>`` beside an output."""
    return output.with_name(f".{output.name}{suffix}")


def make_own(folder: Path) -> None:
    """A folder of this user alone, made where there is none.

    Raises
    ------
    ResultError
        If what is there may be of somebody else.
    OSError
        If no folder can be made.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    with suppress(FileExistsError):
        folder.mkdir(0o700)
    require_own(folder)


def require_own(folder: Path) -> None:
    """Nobody can write in a folder but this user, and whoever could exchange it as a whole.

    That is the owner of the folder above it, and those who may write there unless it is sticky.

    Raises
    ------
    FileNotFoundError
        If nothing is there.
    ResultError
        If it is no folder, or others can write in it.
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
    """A handle that holds the lock of a folder, which is made."""
    while True:
        try:
            make_own(folder)
            handle = os.open(folder, os.O_RDONLY)
        except FileNotFoundError:
            continue  # the run that held the lock has removed the folder
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            raise ResultError(
                "Another run is writing to this output.",
                file=output,
                expected="one at a time",
            ) from None
        except OSError:
            pass  # some network file systems have no locks
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(handle), os.lstat(folder)):
                return handle
        os.close(handle)


def _to_disk(path: Path) -> None:
    """Have the system write what it holds of a file, or the names in a folder."""
    handle = os.open(path, os.O_RDWR if path.is_file() else os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def unwritable(path: str | Path, error: OSError | ValueError) -> ResultError:
    """Why nothing can be written at a place."""
    return ResultError(
        "Nothing can be written here.",
        file=path,
        found=getattr(error, "strerror", None) or str(error),
        expected="a place that can be written to",
    )
