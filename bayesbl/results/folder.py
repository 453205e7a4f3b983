"""An output folder appears whole or not at all.

A run writes into a hidden sibling of its output folder and renames it when everything is there. A
run that is killed leaves at most such siblings, which the next run clears away: one that is still
being written is told by a lock that the system drops with the process.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from bayesbl.errors import ResultError

if sys.platform != "win32":
    import fcntl

RESULT_FILE = "result.nc"
SUMMARY_FILE = "summary.json"
CONFIG_FILE = "config.toml"
FIGURES = "figures"
AUGMENTED_BENCH = "augmented_bench.toml"

OWN_NAMES = frozenset(
    {RESULT_FILE, SUMMARY_FILE, CONFIG_FILE, FIGURES, AUGMENTED_BENCH, "report.html"}
)
"""What a result consists of; anything else in its folder is the user's."""

_STAGING = ".staging"
_REPLACED = ".replaced"


def is_finished(path: str | Path) -> bool:
    """Whether a folder holds a result; as folders appear whole, its files are proof enough."""
    return any((Path(path) / name).is_file() for name in (SUMMARY_FILE, RESULT_FILE))


def require_free(path: str | Path, *, force: bool = False, also: Collection[str] = ()) -> None:
    """The folder may be written: it is absent, empty, or a result that ``force`` gives up.

    ``also`` names what this kind of result holds beside :data:`OWN_NAMES`. Asking before a long run
    starts spares the user the disappointment after it.

    Raises
    ------
    ResultError
        If it holds a finished result and ``force`` is not given, if it holds anything that is not
        part of a result (which is never deleted), or if a file stands there or above.
    """
    path = _absolute(path)
    _undo_half_replacement(path)
    for place in (path, *path.parents):
        if os.path.lexists(place) and not place.is_dir():
            raise ResultError(
                "A file stands where the output folder should be.", file=place, expected="a folder"
            )
    if not path.exists():
        return
    names = {entry.name for entry in path.iterdir()}
    if is_finished(path) and not force:
        raise ResultError(
            "This folder holds a finished result, which is not written over.",
            file=path,
            found=_listed(names),
            expected="another folder (--out), or --force to replace the result",
        )
    foreign = names - OWN_NAMES - set(also) if is_finished(path) else names
    if foreign:
        raise ResultError(
            "This folder holds files that are not part of a result, and is left as it is.",
            file=path,
            found=_listed(foreign),
            expected="a new or empty folder",
        )


@contextmanager
def new_result(
    path: str | Path, *, force: bool = False, also: Collection[str] = ()
) -> Iterator[Path]:
    """A folder to write a result into; it takes its name when the block ends without exception.

    ``path`` is untouched until then, and for good if the block raises or the process is killed.
    With ``force``, an earlier result is deleted only after the new one has taken its place.

    Yields
    ------
    The folder to write into.

    Raises
    ------
    ResultError
        As :func:`require_free`, on entering and again on leaving: another run may have been
        quicker.
    """
    path = _absolute(path)
    require_free(path, force=force, also=also)
    _clear_leftovers(path)
    staging, lock = _new_staging(path)
    try:
        yield staging
        require_free(path, force=force, also=also)
        _put_in_place(staging, path)
    except BaseException:
        shutil.rmtree(staging, ignore_errors=True)
        raise
    finally:
        if lock is not None:
            os.close(lock)


def _listed(names: Collection[str]) -> str:
    return ", ".join(sorted(names)[:5]) + (", …" if len(names) > 5 else "")


def _absolute(path: str | Path) -> Path:
    return Path(os.path.abspath(path))


def _new_staging(path: Path) -> tuple[Path, int | None]:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        staging = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=_STAGING, dir=path.parent))
        # mkdtemp keeps its folders private; a result is as readable as any folder made here.
        staging.chmod(0o777 & ~_umask())
    except OSError as error:
        raise ResultError(
            "The output folder cannot be made.",
            file=path,
            found=error.strerror,
            expected="a place that can be written to",
        ) from None
    return staging, _lock(staging)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


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


def _put_in_place(staging: Path, path: Path) -> None:
    """Rename; a folder that is in the way steps aside first, and back if that fails."""
    if not path.exists():
        staging.rename(path)
        return
    aside = _aside(path)
    shutil.rmtree(aside, ignore_errors=True)
    path.rename(aside)
    try:
        staging.rename(path)
    except BaseException:
        aside.rename(path)
        raise
    shutil.rmtree(aside, ignore_errors=True)


def _aside(path: Path) -> Path:
    return path.with_name(f".{path.name}{_REPLACED}")


def _undo_half_replacement(path: Path) -> None:
    """Put the earlier result back if a run was killed between the two renames."""
    if not os.path.lexists(path) and _aside(path).is_dir():
        with suppress(OSError):
            _aside(path).rename(path)


def _clear_leftovers(path: Path) -> None:
    """Delete what killed runs left beside this output folder, and nothing of living ones."""
    if not path.parent.is_dir():
        return
    if path.exists():
        shutil.rmtree(_aside(path), ignore_errors=True)
    for entry in path.parent.iterdir():
        if entry.name.startswith(f".{path.name}.") and entry.name.endswith(_STAGING):
            handle = _lock(entry)
            if handle is not None:
                shutil.rmtree(entry, ignore_errors=True)
                os.close(handle)
