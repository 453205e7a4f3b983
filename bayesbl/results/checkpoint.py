"""What an unfinished run has finished, kept beside its output folder until the result stands there.

A stage is one file, written under another name and renamed: a run that is killed loses the stage
in flight and nothing else. The problem that the stages belong to is stored with them, and another
one is refused with the difference in words.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import sys
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayesbl.errors import ResultError
from bayesbl.results.provenance import code_sha256, code_versions

PROBLEM_FILE = "problem.json"

_UNFINISHED = ".unfinished"

Problem = Mapping[str, str]
"""What decides the numbers of a run, as text by what it is called."""

Arrays = Mapping[str, np.ndarray[Any, np.dtype[Any]]]


def problem_of(config: Mapping[str, Any], inputs: Mapping[str, str]) -> Problem:
    """A configuration as nested tables, the SHA-256 of its inputs by file, and all versions."""
    return {
        **_flat(config, ""),
        **{f"content of {file}": f"SHA-256 {digest}" for file, digest in inputs.items()},
        **{f"version of {package}": version for package, version in code_versions().items()},
        "content of the package": f"SHA-256 {code_sha256()}",
    }


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """Finished stages of one unfinished run."""

    folder: Path
    problem: Problem

    @classmethod
    @contextmanager
    def beside(cls, output: Path, problem: Problem, *, fresh: bool = False) -> Iterator[Checkpoint]:
        """The stages of an output folder, locked; ``fresh`` forgets those that there are.

        Raises
        ------
        ResultError
            If the stages there belong to another problem, another run of the same output folder
            is under way, or no folder can be made.
        """
        with locked_sibling(output, _UNFINISHED) as folder:
            if fresh:
                _empty(folder)
            _require_same(_stored_problem(folder), problem, output)
            try:
                yield cls(folder, problem)
            finally:
                with suppress(OSError):
                    folder.rmdir()  # one that holds nothing

    @property
    def resumes(self) -> bool:
        """Whether an earlier run left finished stages."""
        return (self.folder / PROBLEM_FILE).is_file()

    def part(self, name: str) -> StageFiles:
        """The stages of one snapshot."""
        digest = hashlib.sha256(name.encode()).hexdigest()[:12]
        return StageFiles(self, digest)

    def clear(self) -> None:
        """Forget all; the result holds everything, or the run cannot come to one."""
        _empty(self.folder)


@dataclass(frozen=True, slots=True)
class StageFiles:
    """Finished stages of one snapshot (a :class:`bayesbl.ringing.memory.Memory`)."""

    checkpoint: Checkpoint
    prefix: str

    def recall(self, stage: str) -> Arrays | None:
        """A stage's arrays; ``None`` if it was not finished, or its file is damaged."""
        try:
            with np.load(self._file(stage), allow_pickle=False) as stored:
                return {name: stored[name] for name in stored.files}
        except (OSError, ValueError, EOFError, zipfile.BadZipFile):
            return None

    def remember(self, stage: str, arrays: Arrays) -> None:
        """Keep a stage; the problem is written before the first one."""
        folder = self.checkpoint.folder
        if not self.checkpoint.resumes:
            text = json.dumps(self.checkpoint.problem, indent=1, ensure_ascii=False)
            _put(folder / PROBLEM_FILE, text.encode())
        temporary = _temporary(self._file(stage))
        with temporary.open("wb") as stream:
            np.savez(stream, **arrays)  # type: ignore[arg-type]
        os.replace(temporary, self._file(stage))

    def _file(self, stage: str) -> Path:
        return self.checkpoint.folder / f"{self.prefix}-{stage}.npz"


def forget(output: Path) -> None:
    """Clear away what a run left that was killed after its result stood; not if one is at work."""
    if _sibling(output, _UNFINISHED).is_dir():
        with suppress(ResultError), locked_sibling(output, _UNFINISHED) as folder:
            shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def locked_sibling(output: Path, suffix: str) -> Iterator[Path]:
    """The hidden folder ``.<name><suffix>`` beside an output folder, made and locked.

    The system drops the lock with the process, however that ends.

    Raises
    ------
    ResultError
        If another process holds the lock, or no folder can be made there.
    """
    folder = _sibling(output, suffix)
    made = [parent for parent in folder.parents if not parent.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ResultError(
            "The output folder cannot be made.",
            file=output,
            found=error.strerror,
            expected="a place that can be written to",
        ) from None
    try:
        with _locked(folder, output):
            yield folder
    finally:
        with suppress(OSError):
            for parent in made:
                parent.rmdir()  # a run that failed leaves no empty folders


def _sibling(output: Path, suffix: str) -> Path:
    return output.with_name(f".{output.name}{suffix}")


@contextmanager
def _locked(folder: Path, output: Path) -> Iterator[None]:
    if sys.platform == "win32":
        yield  # folders cannot be locked there
        return
    import fcntl

    while True:
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder, os.O_RDONLY)
        try:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise ResultError(
                    "Another run into this output folder is under way.",
                    file=output,
                    expected="one at a time",
                ) from None
            if not _is_still(folder, handle):
                continue  # the run that held the lock has removed the folder
            yield
            return
        finally:
            os.close(handle)


def _is_still(folder: Path, handle: int) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), os.stat(folder))
    except FileNotFoundError:
        return False


def _flat(value: Any, name: str) -> dict[str, str]:
    """Nested tables as text by dotted key; entries of a list by their number."""
    if isinstance(value, Mapping):
        parts: Any = value.items()
    elif isinstance(value, list | tuple) and any(isinstance(x, Mapping) for x in value):
        parts = enumerate(value, start=1)
    else:
        return {name: json.dumps(value, default=str, ensure_ascii=False)}
    flat: dict[str, str] = {}
    for key, item in parts:
        flat |= _flat(item, f"{name}.{key}" if name else str(key))
    return flat


def _stored_problem(folder: Path) -> Problem | None:
    try:
        stored = json.loads((folder / PROBLEM_FILE).read_text(encoding="utf-8"))
    except FileNotFoundError:
        _empty(folder)  # stages without their problem belong to nothing
        return None
    except (OSError, ValueError):
        stored = None
    return stored if isinstance(stored, dict) else {"problem": "unreadable"}


def _require_same(stored: Problem | None, problem: Problem, output: Path) -> None:
    if stored is None or stored == problem:
        return
    different = [key for key in {**stored, **problem} if stored.get(key) != problem.get(key)]
    raise ResultError(
        "An unfinished run into this folder was for another problem, so it cannot go on.",
        file=output,
        found="; ".join(
            f"{key} was {_short(stored.get(key))}, is {_short(problem.get(key))}"
            for key in different
        ),
        expected="the same as then, another folder (--out), or --force to start over",
    )


def _short(value: str | None) -> str:
    if value is None:
        return "not given"
    return value if len(value) <= 60 else f"{value[:24]}…"


def _empty(folder: Path) -> None:
    """The problem last: without it, nothing that is left counts."""
    for file in sorted(folder.iterdir(), key=lambda file: file.name == PROBLEM_FILE):
        file.unlink(missing_ok=True)


def _put(file: Path, content: bytes) -> None:
    temporary = _temporary(file)
    temporary.write_bytes(content)
    os.replace(temporary, file)


def _temporary(file: Path) -> Path:
    """A name of this process's own: workers may write the same file at once."""
    return file.with_name(f"{file.name}.{os.getpid()}")
