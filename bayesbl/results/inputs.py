"""No output is an input: what every writer asks before it starts, with or without ``--force``."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from bayesbl.errors import ResultError, shortened


def require_apart(outputs: Sequence[Path], inputs: Sequence[Path]) -> None:
    """No output is an input or a folder that holds one, and no two outputs are one file.

    Files are compared as the system sees them: detours, symbolic and hard links, and names that
    differ by case where the system does not tell them apart. Names of two outputs must differ by
    more than case everywhere: what one system writes is copied to another.

    Raises
    ------
    ResultError
        Naming the output, also if nothing can have its name.
    """
    for output in outputs:
        _require_possible(output)
        for path in inputs:
            if any(_same(output, place) for place in _places(path)):
                raise ResultError(
                    "An output would replace or delete an input.",
                    file=output,
                    found=f"the input {path}",
                    expected="another place for the output",
                )
    for number, output in enumerate(outputs):
        for other in outputs[:number]:
            if _same(output, other) or _folded(output) == _folded(other):
                raise ResultError(
                    "Two outputs are the same file.",
                    file=output,
                    found=f"{other} as well",
                    expected="a different file for each",
                )


def require_inside(folder: Path, name: str) -> Path:
    """The file of this name in a folder; only an absolute name may lead out of it.

    Raises
    ------
    ResultError
        If a relative name does.
    """
    path = folder / name
    home, place = (os.path.realpath(p) for p in (folder, path.parent))
    if not os.path.isabs(name) and Path(home) not in (Path(place), *Path(place).parents):
        raise ResultError(
            "This path leaves the output folder.",
            file=name,
            found=place,
            expected="a path inside the folder, or an absolute path",
        )
    return path


def _require_possible(output: Path) -> None:
    try:
        os.lstat(output)
    except (FileNotFoundError, NotADirectoryError):
        pass  # as it should be, or for whoever makes the folder to refuse
    except (OSError, ValueError) as error:
        raise ResultError(
            "Nothing can be written here.",
            file=shortened(str(output), 200),
            found=getattr(error, "strerror", None) or str(error),
            expected="a place that can be written to",
        ) from None


def _places(path: Path) -> set[Path]:
    """A file and the folders that it lies in, by its name and by where its links lead."""
    named, real = Path(os.path.abspath(path)), Path(os.path.realpath(path))
    return {named, *named.parents, real, *real.parents}


def _same(one: Path, other: Path) -> bool:
    try:
        return os.path.samefile(one, other)
    except OSError:  # one is not there yet
        return os.path.realpath(one) == os.path.realpath(other)


def _folded(path: Path) -> str:
    return os.path.realpath(path).casefold()
