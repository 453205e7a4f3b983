"""An output folder appears whole or not at all, and what a user put there is never deleted."""

from __future__ import annotations

import os
import shutil
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from urllib.parse import quote

from bayesbl.config.fields import RESULT_FILE
from bayesbl.errors import ResultError
from bayesbl.results.atomic import sibling, staging

SUMMARY_FILE = "summary.json"
CONFIG_FILE = "config.toml"
FIGURES = "figures"
AUGMENTED_BENCH = "augmented_bench.toml"
IDENTIFIED_BENCH = "bench.toml"

OWN_NAMES = frozenset(
    {RESULT_FILE, SUMMARY_FILE, CONFIG_FILE, FIGURES, AUGMENTED_BENCH, "report.html"}
)
"""What a result consists of; anything else in its folder is the user's."""

_REPLACED = ".replaced"


def is_finished(path: str | Path) -> bool:
    """Whether a folder holds a result; as folders appear whole, its files are proof enough."""
    return any(os.path.isfile(Path(path) / name) for name in (SUMMARY_FILE, RESULT_FILE))


def require_free(path: str | Path, *, force: bool = False, also: Collection[str] = ()) -> None:
    """The folder may be written: it is absent, empty, or a result that ``force`` gives up.

    ``also`` names what this kind of result holds beside :data:`OWN_NAMES`. Asking before a long run
    starts spares the user the disappointment after it.

    Raises
    ------
    ResultError
        If it holds a finished result and ``force`` is not given, if it holds anything that is not
        part of a result (which is never deleted), or if there is a file at this path or above it.
    """
    path = _absolute(path)
    _undo_half_replacement(path)
    require_no_file(path)
    if not os.path.exists(path):  # Path.exists raises for a name that is too long
        return
    names = {entry.name for entry in path.iterdir()}
    if is_finished(path) and not force:
        raise ResultError(
            "This folder holds a finished result, which is not written over.",
            file=path,
            found=_listed(names),
            expected="another folder (--out), or --force to replace the result",
        )
    foreign = names
    if is_finished(path):
        foreign = names - OWN_NAMES - set(also) | _foreign_figures(path / FIGURES)
    if foreign:
        raise ResultError(
            "This folder holds files that are not part of a result, and is left as it is.",
            file=path,
            found=_listed(foreign),
            expected="a new or empty folder",
        )


def require_no_file(folder: Path) -> None:
    """There is no file at the place of a folder, nor at one above it.

    Raises
    ------
    ResultError
        Naming the file.
    """
    for place in (folder, *folder.parents):
        if os.path.lexists(place) and not place.is_dir():
            raise ResultError(
                "There is a file where the output folder should be.",
                file=place,
                expected="a folder",
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
    if path.exists():
        shutil.rmtree(_aside(path), ignore_errors=True)
    with staging(path) as folder:
        yield folder
        require_free(path, force=force, also=also)
        _put_in_place(folder, path)


def _foreign_figures(folder: Path) -> set[str]:
    """What a user put among the figures: each of ours holds its own name as its title."""
    files = list(folder.iterdir()) if folder.is_dir() else []
    return {f"{FIGURES}/{file.name}" for file in files if not _holds_its_name(file)}


def figure_title(name: str) -> str:
    """What a figure's file holds as its title, by which it is told from a user's: in ASCII."""
    return quote(name)


def _holds_its_name(file: Path) -> bool:
    return file.is_file() and figure_title(file.stem).encode() in file.read_bytes()


def _listed(names: Collection[str]) -> str:
    return ", ".join(sorted(names)[:5]) + (", …" if len(names) > 5 else "")


def _absolute(path: str | Path) -> Path:
    return Path(os.path.abspath(path))


def _put_in_place(folder: Path, path: Path) -> None:
    """Rename; a folder that is in the way steps aside first, and back if that fails."""
    if not path.exists():
        folder.rename(path)
        return
    aside = _aside(path)
    shutil.rmtree(aside, ignore_errors=True)
    path.rename(aside)
    try:
        folder.rename(path)
    except BaseException:
        aside.rename(path)
        raise
    shutil.rmtree(aside, ignore_errors=True)


def _aside(path: Path) -> Path:
    return sibling(path, _REPLACED)


def _undo_half_replacement(path: Path) -> None:
    """Put the earlier result back if a run was killed between the two renames."""
    if not os.path.lexists(path) and os.path.isdir(_aside(path)):
        with suppress(OSError):
            _aside(path).rename(path)
