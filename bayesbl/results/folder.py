"""Output folders that appear whole or not at all; files of the user are never deleted.

``manifest.json`` lists the files of a run. A later run replaces these and nothing else.

No output may be an input. Every writer checks this before it starts, with or without ``--force``.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from urllib.parse import quote

from bayesbl.config.sections import RESULT_FILE
from bayesbl.errors import ResultError, shortened
from bayesbl.results.atomic import STAGING, locked_sibling, sibling, unwritable


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
