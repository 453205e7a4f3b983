"""Files and folders that appear whole or not at all, by one writer at a time, and are ours alone.

What is being written is in a hidden folder beside its place and is renamed when it is whole. A
process that is killed leaves at most such a folder, which the next writer of the same place takes:
one that is still in use is known by a lock, which the system drops with the process.

Others may be able to write beside an output folder. So a hidden folder is made for this user alone,
and one that is there already is used only if it is this user's and nobody else can write it.
"""

from __future__ import annotations

import fcntl
import os
import secrets
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from bayesbl.errors import ResultError

_STAGING = ".staging"
_REPLACED = ".replaced"
_PART = ".part"
_DEAD_AFTER_S = 3600.0
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
    """
    path = Path(path)
    require_replaceable(path)
    with staging(path) as new:
        yield new
        if durable:
            _to_disk(new)
        os.replace(new, path)
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
    """A place in a hidden folder beside ``path``; what is still there at the end is deleted.

    Raises
    ------
    ResultError
        If no folder can be made there, or another process has it.
    OSError
        What the system said in the block, a full disk say, of ``path``: the hidden folder is gone.
    """
    with locked_sibling(path, _STAGING) as folder:
        _tidy(folder, path)
        try:
            yield folder / path.name
        except OSError as error:
            if error.errno is not None:
                error.filename = str(path)
            raise
        finally:
            _tidy(folder, path)


def restore(path: Path) -> None:
    """Give a folder its name back if :func:`replace_folder` was killed between its two renames."""
    if os.path.lexists(sibling(path, _STAGING) / _REPLACED) and not os.path.lexists(path):
        with staging(path):
            pass


def replace_folder(new: Path, path: Path, require: Callable[[Path], None]) -> None:
    """Give a folder that was made in :func:`staging` its name, in place of one that has it.

    ``require``: raises if the latter, once nobody finds it by its name, must be kept after all; as
    wherever this fails or is killed, it then gets its name back.
    """
    if path.exists():
        aside = new.with_name(_REPLACED)
        path.rename(aside)
        require(aside)
    new.rename(path)


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


@dataclass(frozen=True, slots=True)
class PrivateFolder:
    """Small files in a folder of this user alone, each whole or absent; made when it is written.

    Every method raises :class:`~bayesbl.errors.ResultError` if it is a link, or others own it or
    can write it.
    """

    path: Path

    def entries(self) -> dict[str, os.stat_result]:
        """Files by name, none if there is no folder; not what is being written."""
        return {name: found for name, found in self._files().items() if not name.endswith(_PART)}

    def read(self, name: str) -> bytes:
        """The content of a file; raises ``OSError`` where there is none."""
        require_own(self.path)
        return (self.path / name).read_bytes()

    def write(self, name: str, content: bytes, *, durable: bool = False) -> None:
        """A file, in place of one that is there.

        Parameters
        ----------
        durable
            As of :func:`replacing`.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with suppress(FileExistsError):
                self.path.mkdir(0o700)
        except OSError as error:
            raise unwritable(self.path, error) from None
        require_own(self.path)
        # Several processes may write the same file, each with the same content.
        part = self.path / f"{secrets.token_hex(8)}{_PART}"
        try:
            part.touch(0o600, exist_ok=False)
            part.write_bytes(content)
            if durable:
                _to_disk(part)
            os.replace(part, self.path / name)
        except OSError as error:
            error.filename = str(self.path / name)
            raise
        finally:
            part.unlink(missing_ok=True)
        if durable:
            _to_disk(self.path)

    def delete(self, name: str) -> None:
        """A file; one that is gone already is no error."""
        require_own(self.path)
        (self.path / name).unlink(missing_ok=True)

    def tidy(self) -> None:
        """Delete what writers that were killed have left: nobody writes for so long."""
        for name, status in self._files().items():
            if name.endswith(_PART) and time.time() - status.st_mtime > _DEAD_AFTER_S:
                self.delete(name)

    def clear(self) -> None:
        """Delete every file, what a killed writer left too."""
        for name in self._files():
            self.delete(name)

    def _files(self) -> dict[str, os.stat_result]:
        found = {}
        with suppress(FileNotFoundError):
            require_own(self.path)
            for entry in os.scandir(self.path):
                with suppress(FileNotFoundError):
                    if entry.is_file(follow_symlinks=False):
                        found[entry.name] = entry.stat()
        return found


def require_own(folder: Path) -> None:
    """A folder is of this user alone. Nobody else can exchange it then: its folder is sticky, or
    whoever can write there could exchange every result too.

    Raises
    ------
    FileNotFoundError
        If nothing is there.
    ResultError
        If it is no folder, or one that others own or can write.
    """
    status = os.lstat(folder)
    private = status.st_uid == os.geteuid() and not status.st_mode & _OTHERS_WRITE
    if not stat.S_ISDIR(status.st_mode) or not (private or _is_as_made_here(folder, status)):
        raise ResultError(
            "This folder may be of somebody else, and is not used.",
            file=folder,
            found="a link, another user's, or one that others can write",
            expected=f"nothing, or a folder of yours alone: move it away, or chmod 700 {folder}",
        )


def _is_as_made_here(folder: Path, status: os.stat_result) -> bool:
    """Whether a folder that is made beside this one looks the same: some file systems have no
    owners and no permissions."""
    try:
        probe = tempfile.mkdtemp(prefix=".bayesbl-", dir=folder.parent)
        made = os.lstat(probe)
        os.rmdir(probe)
    except OSError:
        return False
    return status.st_uid == made.st_uid and not status.st_mode & ~made.st_mode & _OTHERS_WRITE


def _locked(folder: Path, output: Path) -> int:
    """A handle that holds the lock of a folder, which is made."""
    while True:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileExistsError):
            folder.mkdir(0o700)
        try:
            require_own(folder)
            handle = os.open(folder, os.O_RDONLY)
        except FileNotFoundError:
            continue  # the run that held the lock has removed the folder
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            raise ResultError(
                "Another run into this output is under way.",
                file=output,
                expected="one at a time",
            ) from None
        except OSError:
            pass  # some network file systems have no locks
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(handle), os.lstat(folder)):
                return handle
        os.close(handle)


def _tidy(folder: Path, path: Path) -> None:
    """Empty the hidden folder of a path; what was replaced by nothing gets its name back."""
    aside = folder / _REPLACED
    if os.path.lexists(aside) and not os.path.lexists(path):
        aside.rename(path)
    for entry in os.scandir(folder):
        if entry.is_dir(follow_symlinks=False):
            shutil.rmtree(entry, ignore_errors=True)
        else:
            os.unlink(entry)


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
