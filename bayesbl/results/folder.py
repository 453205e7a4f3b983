"""Files and output folders that appear whole or not at all, and hidden folders beside them.

A file is written under another name and renamed when it is complete. The intermediate results of a
run are kept in a hidden folder beside its output. The folder is locked; the system releases the
lock when the process ends, and the next run into the same output takes the folder over.

Other users may be able to write beside an output folder. A hidden folder is therefore created for
this user alone, and an existing one is used only if nobody else can write to it.

Files of the user are never deleted: ``manifest.json`` lists the files of a run, and a later run
replaces these and nothing else. No output may be an input. Every writer checks this before it
starts, with or without ``--force``.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import stat
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from urllib.parse import quote

from bayesbl.config.sections import RESULT_FILE
from bayesbl.errors import ResultError, shortened

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


def require_apart(outputs: Sequence[Path], inputs: Sequence[Path]) -> None:
    """Require that no output is an input or a folder that contains one, and that outputs differ.

    Files are compared as the system sees them: relative paths, symbolic and hard links, and case on
    systems that ignore it. Names of two outputs must differ by more than case everywhere, because
    results are copied between systems.

    Raises ResultError with the name of the output; also if no file can have its name.
    """
    for output in outputs:
        try:
            os.lstat(output)
        except (FileNotFoundError, NotADirectoryError):
            pass  # as it should be; making the folder may still fail
        except (OSError, ValueError) as error:
            raise unwritable(shortened(str(output), 200), error) from None
        for path in inputs:
            # The file and all folders above it, both as named and after resolving links.
            named, real = Path(os.path.abspath(path)), Path(os.path.realpath(path))
            if any(_same(output, p) for p in {named, *named.parents, real, *real.parents}):
                raise ResultError(
                    "An output would replace or delete an input.",
                    file=output,
                    found=f"the input {path}",
                    expected="another place for the output",
                )
    for k, output in enumerate(outputs):
        for other in outputs[:k]:
            folded = [os.path.realpath(one).casefold() for one in (output, other)]
            if _same(output, other) or folded[0] == folded[1]:
                raise ResultError(
                    "Two outputs are the same file.",
                    file=output,
                    found=f"{other} as well",
                    expected="a different file for each",
                )


def require_inside(folder: Path, name: str) -> Path:
    """Path of a file in a folder. ResultError if a relative name leads out of it."""
    path = folder / name
    home, place = (os.path.realpath(p) for p in (folder, path.parent))
    if not os.path.isabs(name) and Path(home) not in (Path(place), *Path(place).parents):
        raise ResultError(
            "This path is outside the output folder.",
            file=name,
            found=place,
            expected="a path inside the folder, or an absolute path",
        )
    return path


def _same(one: Path, other: Path) -> bool:
    try:
        return os.path.samefile(one, other)
    except OSError:  # one is not there yet
        return os.path.realpath(one) == os.path.realpath(other)


SUMMARY_FILE = "summary.json"
CONFIG_FILE = "config.toml"
MANIFEST_FILE = "manifest.json"
FIGURES = "figures"
AUGMENTED_BENCH = "augmented_bench.toml"
IDENTIFIED_BENCH = "bench.toml"

_MADE_LATER = frozenset({MANIFEST_FILE, "report.html", FIGURES})

_REPLACED = ".replaced"


def is_finished(path: str | Path) -> bool:
    """Whether a folder holds a result; folders appear whole, so one of its files is proof."""
    return any(os.path.isfile(Path(path) / name) for name in (SUMMARY_FILE, RESULT_FILE))


def require_free(path: str | Path, *, force: bool = False) -> None:
    """Require a folder to be absent, empty, or a result that may be replaced with ``force``.

    Checked before a long run, so that it does not fail at its end.

    Raises ResultError if it holds a finished result and ``force`` is not given, if it holds
    anything that is not part of a result (which is never deleted), if it is a link or a mount
    point, or if there is a file at this path or above it.
    """
    path = Path(os.path.abspath(path))
    if path.name and os.path.lexists(sibling(path, STAGING) / _REPLACED):
        with _staging(path):
            pass  # restores the old result if a run was killed between the renames of new_result
    require_no_file(path)
    require_no_link(path)
    if not os.path.exists(path):  # Path.exists raises for a name that is too long
        return
    if os.path.ismount(path):
        raise ResultError(
            "A file system is mounted here, so no folder can take this name.",
            file=path,
            expected=f"a folder below it: --out {path / 'result'}",
        )
    if is_finished(path) and not force:
        raise ResultError(
            "This folder holds a finished result, which is not overwritten.",
            file=path,
            found=_listed(os.listdir(path)),
            expected="another folder (--out), or --force to replace the result",
        )
    foreign = _entries(path) - (_own(path) if is_finished(path) else set())
    if foreign:
        raise ResultError(
            "This folder holds files that are not part of a result, and is left as it is.",
            file=path,
            found=_listed(foreign),
            expected="a new or empty folder, by [run] output or --out",
        )


def require_no_link(folder: Path) -> None:
    """Refuse a link in place of a folder (ResultError): its target could be anybody's."""
    if os.path.islink(folder):
        raise ResultError(
            "There is a link where the output folder should be.",
            file=folder,
            found=f"a link to {os.readlink(folder)}",
            expected="the folder itself",
        )


def require_no_file(folder: Path) -> None:
    """Refuse a file in place of a folder or one above it, with a ResultError."""
    for place in (folder, *folder.parents):
        if os.path.lexists(place) and not place.is_dir():
            raise ResultError(
                "There is a file where the output folder should be.",
                file=place,
                expected="a folder",
            )


@contextmanager
def new_result(path: str | Path, *, force: bool = False) -> Iterator[Path]:
    """Yield a folder to write a result into; it gets its name when the block ends without
    exception.

    ``path`` is untouched until then, and stays so if the block raises or the process is killed.
    With ``force``, an earlier result is deleted only after the new one has taken its place.

    Yields the folder to write into. Raises ResultError as :func:`require_free`, on entering and
    again on leaving, as another run may have finished first.
    """
    path = Path(os.path.abspath(path))
    require_free(path, force=force)
    with _staging(path) as staging:
        folder = staging / path.name
        folder.mkdir()
        yield folder
        require_free(path, force=force)
        text = json.dumps({"files": sorted(_entries(folder))}, indent=1, ensure_ascii=False)
        (folder / MANIFEST_FILE).write_text(text + "\n", encoding="utf-8")
        if path.exists():
            path.rename(staging / _REPLACED)
        folder.rename(path)


@contextmanager
def _staging(path: Path) -> Iterator[Path]:
    """The hidden folder in which the result of a path is made, emptied before and after."""
    with locked_sibling(path, STAGING) as folder:
        _empty(folder, path)
        try:
            yield folder
        except OSError as error:
            if error.errno is not None:
                error.filename = str(path)
            raise
        finally:
            _empty(folder, path)


def _empty(folder: Path, path: Path) -> None:
    """Empty a hidden folder; first restore a replaced result whose successor is missing."""
    replaced = folder / _REPLACED
    if os.path.lexists(replaced) and not os.path.lexists(path):
        replaced.rename(path)
    for entry in folder.iterdir():
        shutil.rmtree(entry, ignore_errors=True)


def figure_title(name: str) -> str:
    """Title (ASCII) stored in a figure's file, which distinguishes it from a user's file."""
    return quote(name)


def _own(folder: Path) -> set[str]:
    """Files of a run in a folder: those of its manifest, and those drawn later."""
    files: Collection[str] = ()
    with suppress(OSError, ValueError, TypeError, KeyError, RecursionError):
        stored = json.loads((folder / MANIFEST_FILE).read_text(encoding="utf-8"))["files"]
        files = [name for name in stored if isinstance(name, str)]
    figures = (folder / FIGURES).iterdir() if (folder / FIGURES).is_dir() else ()
    drawn = {
        f"{FIGURES}/{file.name}"
        for file in figures
        if file.is_file() and figure_title(file.stem).encode() in file.read_bytes()
    }
    files = {name for name in files if not name.startswith(f"{FIGURES}/")} | drawn | _MADE_LATER
    return files | {str(above) for name in files for above in PurePosixPath(name).parents}


def _entries(folder: Path) -> set[str]:
    """All files and folders below a folder, without following links."""
    return {
        Path(root, name).relative_to(folder).as_posix()
        for root, folders, files in os.walk(folder)
        for name in (*folders, *files)
    }


def _listed(names: Collection[str]) -> str:
    return ", ".join(sorted(names)[:5]) + (", …" if len(names) > 5 else "")
