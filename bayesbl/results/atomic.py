"""Files and folders that appear whole or not at all, by one writer at a time, and are ours alone.

What is being written is in a hidden folder beside its place and is renamed when it is whole. A
process that is killed leaves at most such a folder, which the next writer of the same place clears
away: one that is still in use is known by a lock, which the system drops with the process.

Others may be able to write beside an output folder. So each hidden folder is made exclusively, for
this user alone; one that is there already is opened without following a link and used only if it is
a folder of this user that nobody else can write. What is in it is reached through that open folder.
"""

from __future__ import annotations

import fcntl
import os
import secrets
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from bayesbl.errors import ResultError

_STAGING = ".staging"
_PART = ".part"
_DEAD_AFTER_S = 3600.0
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_READ = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK
_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW


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
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        clear_away(path)
        folder, handle = _locked_new(path)
    except OSError as error:
        raise unwritable(path, error) from None
    try:
        yield folder
    except OSError as error:
        if error.errno is not None:
            error.filename = str(path)
        raise
    finally:
        if _is_still(folder, handle):
            shutil.rmtree(folder, ignore_errors=True)
        os.close(handle)


def clear_away(path: Path) -> None:
    """Delete what killed writers of this path left, and nothing of living ones."""
    for left in left_behind(path, _STAGING):
        shutil.rmtree(left, ignore_errors=True)


def left_behind(path: Path, suffix: str) -> Iterator[Path]:
    """Folders ``.<name>.<anything><suffix>`` of this user whose process has ended; each locked."""
    try:
        names = os.listdir(path.parent)
    except OSError:
        return
    for name in names:
        if name.startswith(f".{path.name}.") and name.endswith(suffix):
            folder = path.with_name(name)
            with suppress(OSError, ResultError), _own(folder) as handle:
                if _lock(handle):
                    yield folder


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """A folder that is locked, where it can be: it is not left behind by a process that ended."""
    handle = os.open(folder, os.O_RDONLY | os.O_NOFOLLOW)
    try:
        _lock(handle)
        yield
    finally:
        os.close(handle)


def make_readable(folder: Path) -> None:
    """As readable as any folder that is made here: one that is being written is private."""
    mask = os.umask(0)
    os.umask(mask)
    with _own(folder) as handle:
        os.chmod(handle, 0o777 & ~mask)


@contextmanager
def locked_sibling(output: Path, suffix: str) -> Iterator[Path]:
    """The hidden folder ``.<name><suffix>`` beside an output folder, made, locked and kept.

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
    """The hidden folder ``.<name><suffix>`` beside an output folder."""
    return output.with_name(f".{output.name}{suffix}")


@dataclass(frozen=True, slots=True)
class PrivateFolder:
    """Small files in a folder of this user alone, each whole or absent; made when it is written.

    Every method opens the folder anew and raises :class:`~bayesbl.errors.ResultError` if it is a
    link, or others own it or can write it.
    """

    path: Path

    @property
    def is_usable(self) -> bool:
        """Whether it is this user's alone, or there is none yet."""
        try:
            with _own(self.path):
                return True
        except FileNotFoundError:
            return True
        except (OSError, ResultError):
            return False

    def entries(self) -> dict[str, os.stat_result]:
        """What is in it, by name, none if there is no folder; not what is being written."""
        found = {}
        with suppress(FileNotFoundError), _own(self.path) as handle:
            for name in os.listdir(handle):
                with suppress(FileNotFoundError):
                    if not name.endswith(_PART):
                        found[name] = os.stat(name, dir_fd=handle, follow_symlinks=False)
        return found

    def read(self, name: str) -> bytes:
        """The content of a file; raises ``OSError`` where there is none."""
        with (
            _own(self.path) as handle,
            open(os.open(name, _READ, dir_fd=handle), "rb") as stream,
        ):
            return stream.read()

    def write(
        self, name: str, content: bytes, *, replace: bool = True, durable: bool = False
    ) -> None:
        """A file, readable by this user alone; ``FileExistsError`` unless it may ``replace`` one.

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
        with _own(self.path) as handle:
            part = f"{secrets.token_hex(8)}{_PART}"
            move = os.replace if replace else os.link
            try:
                with open(os.open(part, _NEW, 0o600, dir_fd=handle), "wb") as stream:
                    stream.write(content)
                    if durable:
                        stream.flush()
                        os.fsync(stream.fileno())
                move(part, name, src_dir_fd=handle, dst_dir_fd=handle)
            except OSError as error:
                error.filename = str(self.path / name)
                raise
            finally:
                with suppress(OSError):
                    os.unlink(part, dir_fd=handle)
            if durable:
                os.fsync(handle)

    def delete(self, name: str) -> None:
        """A file, or a folder with all that is in it; what is gone already is no error."""
        with suppress(FileNotFoundError), _own(self.path) as handle:
            if stat.S_ISDIR(os.stat(name, dir_fd=handle, follow_symlinks=False).st_mode):
                shutil.rmtree(name, ignore_errors=True, dir_fd=handle)
            else:
                os.unlink(name, dir_fd=handle)

    def tidy(self) -> None:
        """Delete what writers that were killed have left: nobody writes for so long."""
        with suppress(FileNotFoundError), _own(self.path) as handle:
            for name in os.listdir(handle):
                if name.endswith(_PART):
                    with suppress(OSError):
                        status = os.stat(name, dir_fd=handle, follow_symlinks=False)
                        if time.time() - status.st_mtime > _DEAD_AFTER_S:
                            os.unlink(name, dir_fd=handle)

    def clear(self) -> None:
        """Delete everything, what a killed writer left too."""
        with suppress(FileNotFoundError), _own(self.path) as handle:
            for name in os.listdir(handle):
                self.delete(name)


@contextmanager
def _own(folder: Path) -> Iterator[int]:
    """An open handle on a folder of this user alone.

    Raises
    ------
    FileNotFoundError
        If nothing is there.
    ResultError
        If it is no folder, or one that others own or can write.
    """
    handle = _open_own(folder)
    try:
        yield handle
    finally:
        os.close(handle)


def _open_own(folder: Path) -> int:
    try:
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except FileNotFoundError:
        raise
    except OSError:
        raise _not_own(folder) from None
    status = os.fstat(handle)
    private = status.st_uid == os.geteuid() and not status.st_mode & _OTHERS_WRITE
    if not private and not _is_as_made_here(folder, status):
        os.close(handle)
        raise _not_own(folder)
    return handle


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


def _not_own(folder: Path) -> ResultError:
    return ResultError(
        "This folder may be of somebody else, and is not used.",
        file=folder,
        found="a link, another user's, or one that others can write",
        expected=f"nothing, or a folder of yours alone: move it away, or chmod 700 {folder}",
    )


def _locked(folder: Path, output: Path) -> int:
    """A handle that holds the lock of a folder, which is made."""
    while True:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileExistsError):
            folder.mkdir(0o700)
        try:
            handle = _open_own(folder)
        except FileNotFoundError:
            continue  # the run that held the lock has removed the folder
        locked = _lock(handle)
        if _is_still(folder, handle):
            if locked is not False:
                return handle
            os.close(handle)
            raise ResultError(
                "Another run into this output folder is under way.",
                file=output,
                expected="one at a time",
            )
        os.close(handle)


def _locked_new(path: Path) -> tuple[Path, int]:
    """A new folder, locked before another writer of this path takes it for a leftover."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=_STAGING, dir=path.parent))
        try:
            handle = _open_own(folder)
        except FileNotFoundError:
            continue
        if _lock(handle) is not False and _is_still(folder, handle):
            return folder, handle
        os.close(handle)


def _lock(handle: int) -> bool | None:
    """Whether a folder is locked now, not by another process; ``None`` where there are no locks."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # some network file systems
        return None
    return True


def _is_still(folder: Path, handle: int) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), os.lstat(folder))
    except FileNotFoundError:
        return False


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
