"""What a run has finished, kept under the address of its content until the result is stored.

The address is the SHA-256 of all that decides the numbers: the inputs, and the code that makes
them. An entry is one file that appears whole or not at all, so a run that is killed loses the work
in flight and nothing else, and the same command goes on to the same numbers. What is damaged, is of
another address or cannot be read counts as not finished.
"""

from __future__ import annotations

import hashlib
import json
import platform
import shutil
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from itertools import accumulate
from pathlib import Path
from typing import Any, TypeVar

from bayesbl.errors import ResultError
from bayesbl.results.atomic import locked_sibling, replacing
from bayesbl.results.codec import address, decoder, encoded
from bayesbl.results.provenance import (
    code_sha256,
    code_versions,
    dependency_versions,
    digests_of,
)

T = TypeVar("T")

PROBLEM_FILE = "problem.json"

_UNFINISHED = ".unfinished"

Problem = Mapping[str, str]
"""What decides the numbers of a run, as text by what it is called."""


def code_identity() -> str:
    """All code that numbers come from: this package's, Python's, the dependencies'."""
    return address([code_sha256(), platform.python_version(), dependency_versions()])


@dataclass(frozen=True, slots=True)
class WorkStore:
    """Finished work in one folder.

    Attributes
    ----------
    folder
        ``None`` keeps nothing: the run is made in one go.
    fresh
        Work is made anew, and kept, whatever is there.
    code
        Part of every address: what other code made is not recalled.
    problem
        Written beside the first entry, so that a run of another problem can be refused in words.
    """

    folder: Path | None = None
    fresh: bool = False
    code: str = field(default_factory=code_identity)
    problem: Problem = field(default_factory=dict)

    @classmethod
    @contextmanager
    def beside(
        cls, output: Path, problem: Problem | None = None, *, fresh: bool = False
    ) -> Iterator[WorkStore]:
        """The finished work of an unfinished run, locked; ``fresh`` forgets what there is.

        Parameters
        ----------
        output
            Output folder of the run.
        problem
            The run's; work for another is refused. Without one, addresses alone decide.

        Raises
        ------
        ResultError
            If the work there is for another problem, another run into the same output folder is
            under way, or no folder can be made.
        """
        with locked_sibling(output, _UNFINISHED) as folder:
            store = cls(folder) if problem is None else cls(folder, problem=problem)
            if fresh:
                store.clear()
            elif problem is not None:
                _require_same(_stored_problem(store), problem, output)
            try:
                yield store
            finally:
                if not store.holds_work:
                    store.clear()

    @property
    def holds_work(self) -> bool:
        """Whether there is anything that a later run could go on from."""
        files = [] if self.folder is None else self.folder.iterdir()
        return not all(map(_is_problem, files))

    @property
    def resumes(self) -> bool:
        """Whether an earlier run left finished work."""
        return self.folder is not None and (self.folder / PROBLEM_FILE).is_file()

    def get(self, what: str, inputs: object, make: Callable[[], T], kind: type[T]) -> T:
        """Finished work: recalled, or made and kept.

        Parameters
        ----------
        what
            Name of the work: the same inputs may decide several.
        inputs
            All that decides the numbers, as :func:`bayesbl.results.codec.address` takes it.
        kind
            Type of the work, as :func:`bayesbl.results.codec.decoder` takes it.
        """
        kept = None if self.fresh else self.recall(what, inputs, kind)
        if kept is not None:
            return kept
        made = make()
        self.keep(what, inputs, made)
        return made

    def recall(self, what: str, inputs: object, kind: type[T]) -> T | None:
        """Finished work; ``None`` if there is none that can be believed."""
        if self.folder is None:
            return None
        key, decoded = self.address_of(what, inputs), decoder(kind)  # type: ignore[arg-type]
        try:
            head, _, content = (self.folder / key).read_bytes().partition(b"\n")
            return decoded(content) if head == _head(key, content) else None
        except Exception:
            # A file that anyone may have written fails in any way; then the work is made again.
            return None

    def keep(self, what: str, inputs: object, value: object) -> None:
        """Keep finished work, whole or not at all."""
        if self.folder is None:
            return
        if self.problem and not self.resumes:
            text = json.dumps(self.problem, indent=1, ensure_ascii=False)
            _write(self.folder / PROBLEM_FILE, text.encode())
        key, content = self.address_of(what, inputs), encoded(value)
        _write(self.folder / key, _head(key, content) + b"\n" + content)

    def clear(self) -> None:
        """Forget all, the problem last: without it, no work counts."""
        files = [] if self.folder is None else sorted(self.folder.iterdir(), key=_is_problem)
        for file in files:
            if file.is_dir():
                shutil.rmtree(file, ignore_errors=True)
            else:
                file.unlink(missing_ok=True)

    def keep_latest(self, size_bytes: int) -> None:
        """Delete the oldest entries until the others take at most this much."""
        files = [] if self.folder is None or not self.folder.is_dir() else self.folder.iterdir()
        # Another run may be writing or deleting here: what is gone takes nothing.
        with suppress(FileNotFoundError):
            found = [(file.stat(), file) for file in files if file.is_file()]
            found.sort(key=lambda entry: -entry[0].st_mtime_ns)
            taken = accumulate(status.st_size for status, _ in found)
            for (_, file), total in zip(found, taken, strict=True):
                if total > size_bytes:
                    file.unlink()

    def keep_only(self, addresses: Collection[str]) -> None:
        """Forget all but what is under these addresses."""
        for file in [] if self.folder is None else self.folder.iterdir():
            if file.is_file() and file.name not in addresses:
                file.unlink(missing_ok=True)

    def address_of(self, what: str, inputs: object) -> str:
        """Where finished work of these inputs is kept."""
        return address([what, self.code, inputs])


NOTHING_KEPT = WorkStore(code="")
"""For work that is not worth keeping, or has no folder to be kept in."""


def problem_of(config: Mapping[str, Any]) -> Problem:
    """A configuration as nested tables, the content of the files that it names, all versions."""
    return {
        **_flat(config, ""),
        **{f"content of {file}": f"SHA-256 {sha}" for file, sha in digests_of(config).items()},
        **{f"version of {package}": version for package, version in code_versions().items()},
        "content of the package": f"SHA-256 {code_sha256()}",
    }


def _head(key: str, content: bytes) -> bytes:
    """First line of an entry: damage shows, and that it belongs under another address."""
    return hashlib.sha256(key.encode() + content).hexdigest().encode()


def _write(file: Path, content: bytes) -> None:
    with replacing(file) as temporary:
        temporary.write_bytes(content)


def _is_problem(file: Path) -> bool:
    return file.name == PROBLEM_FILE


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


def _stored_problem(store: WorkStore) -> Problem | None:
    assert store.folder is not None
    try:
        stored = json.loads((store.folder / PROBLEM_FILE).read_text(encoding="utf-8"))
    except FileNotFoundError:
        store.clear()  # work without its problem belongs to nothing
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
