"""What a run has finished, kept under the address of its content until the result is stored.

The address is the SHA-256 of all that decides the numbers: the inputs, and the code that makes
them. An entry is one file that appears whole or not at all, so a run that is killed loses the work
in flight and nothing else, and the same command goes on to the same numbers. What is damaged, of
another address, or cannot be read counts as not finished. Whoever writes an entry decides numbers,
so the folder is this user's alone.

What is kept are frozen dataclasses. A value is numbers, texts, ``None``, arrays, and tuples,
mappings and dataclasses of these. Its JSON and its arrays are stored in one ``.npz``, nothing that
could be executed; it is read as the type that the reader asks for, and refused if it is not of that
type.

A field that cannot be given on construction (``init=False``) or is no part of what the value is
(``compare=False``) is left out; the dataclass itself makes it again.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
import platform
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, fields, is_dataclass
from datetime import date
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import ConfigDict, TypeAdapter

from bayesbl.errors import ResultError
from bayesbl.results.atomic import locked_sibling, make_own, require_own, unwritable
from bayesbl.results.provenance import code_sha256, dependency_versions

T = TypeVar("T")

Array = np.ndarray[Any, np.dtype[Any]]

_ARRAY = "array number"
_TEXT = "text"


def encoded(value: object) -> bytes:
    """A value as the bytes of an ``.npz``.

    Raises
    ------
    TypeError
        If the value holds anything but numbers, texts, arrays and what is made of them.
    """
    arrays: dict[str, Array] = {}

    def put(array: Array) -> object:
        name = str(len(arrays))
        arrays[name] = array
        return {_ARRAY: name}

    text = json.dumps(_plain(value, put))
    stream = io.BytesIO()
    arrays[_TEXT] = np.frombuffer(text.encode(), dtype=np.uint8)
    np.savez(stream, **arrays)  # type: ignore[arg-type]
    return stream.getvalue()


@cache
def decoder(kind: type[T]) -> Callable[[bytes], T]:
    """A function from the bytes that :func:`encoded` made to the value, bit for bit the same.

    It raises exceptions of many kinds for bytes that do not hold a value of this type.
    """
    # Dataclasses take the configuration of what is around them, here a tuple.
    adapter = TypeAdapter(
        tuple[kind],  # type: ignore[valid-type]
        config=ConfigDict(arbitrary_types_allowed=True, extra="forbid"),
    )

    def decoded(content: bytes) -> T:
        with np.load(io.BytesIO(content), allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        text = arrays.pop(_TEXT).tobytes().decode()
        (value,) = adapter.validate_python([_restored(json.loads(text), arrays)])
        return value

    return decoded


def address(value: object) -> str:
    """SHA-256 of the content of a value: equal values have equal addresses."""

    def put(array: Array) -> object:
        return [array.dtype.str, array.shape, hashlib.sha256(array.tobytes()).hexdigest()]

    text = json.dumps(_plain(value, put), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _plain(value: object, put: Callable[[Array], object]) -> Any:
    """JSON of a value, with what ``put`` gives in place of each array."""
    if is_dataclass(value) and not isinstance(value, type):
        kept = [f.name for f in fields(value) if f.init and f.compare]
        return {name: _plain(getattr(value, name), put) for name in kept}
    match value:
        case None | bool() | int() | float() | str():
            return value
        case np.generic():
            return value.item()
        case Path():
            return str(value)
        case date():
            return value.isoformat()
        case Mapping():
            return {str(key): _plain(item, put) for key, item in value.items()}
        case list() | tuple():
            return [_plain(item, put) for item in value]
        case frozenset() | set():
            return sorted(_plain(item, put) for item in value)
        case np.random.SeedSequence():
            return [_plain(value.entropy, put), list(value.spawn_key)]
        case np.ndarray() if not value.dtype.hasobject:
            return put(value)
    raise TypeError(f"{type(value).__name__} cannot be stored")


def _restored(plain: Any, arrays: Mapping[str, Array]) -> Any:
    match plain:
        case {"array number": name, **others} if not others:
            return arrays[name]
        case dict():
            return {key: _restored(item, arrays) for key, item in plain.items()}
        case list():
            return [_restored(item, arrays) for item in plain]
    return plain


_UNFINISHED = ".unfinished"

_PART = ".part"
"""Of what is being written; a writer that is killed leaves it."""


def code_identity() -> str:
    """All code that numbers come from: this package's, Python's, the dependencies'."""
    return address([code_sha256(), platform.python_version(), dependency_versions()])


@dataclass(frozen=True, slots=True)
class WorkStore:
    """Finished work in one folder, which is this user's alone.

    Attributes
    ----------
    folder
        ``None`` keeps nothing: the run is made in one go.
    fresh
        Work is made anew, and kept, whatever is there.
    code
        Part of every address: what other code made is not recalled.
    """

    folder: Path | None = None
    fresh: bool = False
    code: str = field(default_factory=code_identity)

    @classmethod
    @contextmanager
    def beside(cls, output: Path, *, fresh: bool = False) -> Iterator[WorkStore]:
        """The finished work of an unfinished run into a folder, locked; ``fresh`` forgets it.

        Raises
        ------
        ResultError
            If another run into the same output folder is under way, or no folder can be made.
        """
        with locked_sibling(output, _UNFINISHED) as folder:
            store = cls(folder)
            if fresh:
                store.clear()
            yield store

    @classmethod
    def shared(cls, folder: Path, *, fresh: bool = False) -> WorkStore:
        """What may be made again at any time; nothing is kept where it is not this user's alone."""
        try:
            require_own(folder)
        except FileNotFoundError:
            pass  # it is made when it is written
        except (OSError, ResultError):
            return cls(None, fresh)
        return cls(folder, fresh)

    @property
    def holds_work(self) -> bool:
        """Whether there is anything that a later run could go on from."""
        return bool(self._files())

    def get(self, what: str, inputs: object, make: Callable[[], T], kind: type[T]) -> T:
        """Finished work: recalled, or made and kept.

        Parameters
        ----------
        what
            Name of the work: the same inputs may decide several.
        inputs
            All that decides the numbers, as :func:`bayesbl.results.work.address` takes it.
        kind
            Type of the work, as :func:`bayesbl.results.work.decoder` takes it.
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
            require_own(self.folder)
            head, _, content = (self.folder / key).read_bytes().partition(b"\n")
            return decoded(content) if head == _head(key, content) else None
        except Exception:
            # What is damaged fails in any way; then the work is made again.
            return None

    def keep(self, what: str, inputs: object, value: object) -> None:
        """Keep finished work, whole or not at all.

        Raises
        ------
        ResultError
            If the folder is not this user's alone, or cannot be made.
        OSError
            If the disk is full, say.
        """
        if self.folder is None:
            return
        try:
            make_own(self.folder)
        except OSError as error:
            raise unwritable(self.folder, error) from None
        key, content = self.address_of(what, inputs), encoded(value)
        # Several processes may keep the same work.
        handle, part = tempfile.mkstemp(_PART, dir=self.folder)
        try:
            with open(handle, "wb") as file:
                file.write(_head(key, content) + b"\n" + content)
            os.replace(part, self.folder / key)
        except OSError as error:
            error.filename = str(self.folder / key)
            with suppress(OSError):
                os.unlink(part)
            raise

    def clear(self) -> None:
        """Forget all."""
        self._delete(self._files())

    def keep_latest(self, *, size_bytes: float = math.inf, count: float = math.inf) -> None:
        """Delete the oldest entries until the others are no more, and take no more, than this."""
        latest = sorted(self._files().items(), key=lambda entry: -entry[1].st_mtime_ns)
        taken, old = 0, []
        for number, (name, status) in enumerate(latest, start=1):
            taken += status.st_size
            if taken > size_bytes or number > count:
                old.append(name)
        self._delete(old)

    def keep_only(self, addresses: Collection[str]) -> None:
        """Forget all but what is under these addresses, or is being written."""
        names = self._files().keys() - set(addresses)
        self._delete(name for name in names if not name.endswith(_PART))

    def _delete(self, names: Iterable[str]) -> None:
        if self.folder is not None:
            for name in names:
                (self.folder / name).unlink(missing_ok=True)

    def _files(self) -> dict[str, os.stat_result]:
        """Files in the folder, by name."""
        by_name = {}
        with suppress(FileNotFoundError):
            if self.folder is not None:
                require_own(self.folder)
                for entry in os.scandir(self.folder):
                    with suppress(FileNotFoundError):
                        if entry.is_file(follow_symlinks=False):
                            by_name[entry.name] = entry.stat()
        return by_name

    def address_of(self, what: str, inputs: object) -> str:
        """Where finished work of these inputs is kept."""
        return address([what, self.code, inputs])


NOTHING_KEPT = WorkStore(code="")
"""For work that is not worth keeping, or has no folder to be kept in."""


def _head(key: str, content: bytes) -> bytes:
    """First line of an entry: shows damage, and that it is of another address."""
    return hashlib.sha256(key.encode() + content).hexdigest().encode()
