"""Files and folders that appear whole or not at all, by one writer at a time.

What is being written is in a hidden folder beside its place and is renamed when it is whole. A
process that is killed leaves at most such a folder, which the next writer of the same place clears
away: one that is still in use is known by a lock, which the system drops with the process.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from bayesbl.errors import ResultError

if sys.platform != "win32":
    import fcntl

_STAGING = ".staging"


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
        If nothing can be written there, or what is there is no file.
    """
    path = Path(path)
    require_replaceable(path)
    with staging(path) as folder:
        yield folder / path.name
        if durable:
            _to_disk(folder / path.name)
        os.replace(folder / path.name, path)
    if durable:
        _to_disk(path.parent)


def require_replaceable(path: Path) -> None:
    """There is a file or nothing at a place: root could replace a device, which nobody wants.

    Raises
    ------
    ResultError
        If there is anything else.
    """
    if os.path.lexists(path) and not path.is_file():
        raise ResultError(
            "What is here is no file, and is not replaced by one.",
            file=path,
            expected="a new file, or one to replace with --force",
        )


@contextmanager
def staging(path: Path) -> Iterator[Path]:
    """A hidden folder beside ``path`` to write into; what is still in it at the end is deleted.

    Raises
    ------
    ResultError
        If no folder can be made there.
    OSError
        What the system said in the block, a full disk say, of ``path``: the hidden folder is gone.
    """
    folder, handle = _new_staging(path)
    try:
        yield folder
    except OSError as error:
        if error.errno is not None:
            error.filename = str(path)
        raise
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        if handle is not None:
            os.close(handle)


@contextmanager
def locked_sibling(output: Path, suffix: str) -> Iterator[Path]:
    """The hidden folder ``.<name><suffix>`` beside an output folder, made, locked and kept.

    Raises
    ------
    ResultError
        If another process holds the lock, or no folder can be made there.
    """
    folder = sibling(output, suffix)
    made = [parent for parent in folder.parents if not parent.exists()]
    try:
        handle = _locked(folder, output)
    except OSError as error:
        raise _unwritable(output, error) from None
    try:
        yield folder
    finally:
        with suppress(OSError):
            for empty in (folder, *made):
                empty.rmdir()  # a run that failed leaves no empty folders
        if handle is not None:
            os.close(handle)


def sibling(output: Path, suffix: str) -> Path:
    """The hidden folder ``.<name><suffix>`` beside an output folder."""
    return output.with_name(f".{output.name}{suffix}")


def _locked(folder: Path, output: Path) -> int | None:
    """A handle that holds the lock of a folder, which is made; ``None`` where there are none."""
    while True:
        folder.mkdir(parents=True, exist_ok=True)
        if sys.platform == "win32":
            return None
        handle = _lock(folder)
        if handle is None and folder.exists() and _cannot_lock(folder):
            return None
        if handle is None and folder.exists():
            raise ResultError(
                "Another run into this output folder is under way.",
                file=output,
                expected="one at a time",
            )
        if handle is not None and _is_still(folder, handle):
            return handle
        if handle is not None:
            os.close(handle)  # the run that held the lock has removed the folder


def _new_staging(path: Path) -> tuple[Path, int | None]:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _clear_leftovers(path)
        folder, handle = _locked_new(path)
        # mkdtemp keeps its folders private; a result is as readable as any folder made here.
        folder.chmod(0o777 & ~_umask())
    except OSError as error:
        raise _unwritable(path, error) from None
    return folder, handle


def _locked_new(path: Path) -> tuple[Path, int | None]:
    """A new folder, locked before another writer of this path takes it for a leftover."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=_STAGING, dir=path.parent))
        handle = _lock(folder)
        if handle is None and (sys.platform == "win32" or _cannot_lock(folder)):
            return folder, None
        if handle is not None and _is_still(folder, handle):
            return folder, handle
        if handle is not None:
            os.close(handle)


def _clear_leftovers(path: Path) -> None:
    """Delete what killed writers of this path left, and nothing of living ones."""
    for entry in path.parent.iterdir():
        if entry.name.startswith(f".{path.name}.") and entry.name.endswith(_STAGING):
            handle = _lock(entry)
            if handle is not None:
                shutil.rmtree(entry, ignore_errors=True)
                os.close(handle)


def _lock(folder: Path) -> int | None:
    """An open, locked handle on a folder; ``None`` if another process holds it, or cannot tell."""
    if sys.platform == "win32":
        return None  # folders cannot be locked there: leftovers stay, and do no harm
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        return None
    return handle


def _cannot_lock(folder: Path) -> bool:
    """Whether the file system has no locks, as some network ones; not whether one is held."""
    try:
        handle = os.open(folder, os.O_RDONLY)
    except FileNotFoundError:  # removed just now by whoever held the lock
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    finally:
        os.close(handle)
    return False


def _is_still(folder: Path, handle: int) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), os.stat(folder))
    except FileNotFoundError:
        return False


def _to_disk(path: Path) -> None:
    """Have the system write what it holds of a file, or the names in a folder."""
    if sys.platform == "win32" and path.is_dir():
        return  # folders cannot be opened there
    handle = os.open(path, os.O_RDWR if path.is_file() else os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _unwritable(path: Path, error: OSError) -> ResultError:
    return ResultError(
        "Nothing can be written here.",
        file=path,
        found=error.strerror,
        expected="a place that can be written to",
    )
