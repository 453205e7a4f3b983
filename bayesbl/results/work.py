"""Finished steps of runs, stored under the hash of their inputs.

The address is the SHA-256 of everything that determines the numbers: the inputs and the code. An
entry is one file that appears whole or not at all. A killed run therefore loses only the step in
progress, the same command continues to the same numbers, and a run in which little has changed
makes only that. An entry that is damaged, has another address, or cannot be read counts as missing.
Whoever can write an entry can change the numbers, so only this user may write to the folder.

Values are frozen dataclasses of numbers, texts, ``None``, arrays, and tuples, mappings and
dataclasses of these. JSON and arrays of a value are stored in one ``.npz``, with nothing that could
be executed. It is read as the type that the reader asks for, and refused if it does not match.

A field that cannot be given on construction (``init=False``) or is not part of the value
(``compare=False``) is left out. The dataclass itself makes it again.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import platform
import re
import tempfile
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields, is_dataclass
from datetime import date
from functools import cache
from itertools import accumulate
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import ConfigDict, TypeAdapter

from bayesbl.errors import ResultError
from bayesbl.results.folder import make_own, require_own, unwritable
from bayesbl.results.provenance import code_sha256, dependency_versions

T = TypeVar("T")

Array = np.ndarray[Any, np.dtype[Any]]

_ARRAY = "array number"
_TEXT = "text"


def encoded(value: object) -> bytes:
    """Encode a value as the bytes of an ``.npz``.

    Raises TypeError if the value contains anything but numbers, texts, arrays and containers of
    them.
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
    """Return a function that decodes the bytes of :func:`encoded`, bit for bit.

    It raises exceptions of many kinds for bytes that do not hold a value of this type.
    """
    # Dataclasses take the configuration of their container, here a tuple.
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
    """JSON of a value, with the result of ``put`` in place of each array."""
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
    if isinstance(plain, dict):
        if plain.keys() == {_ARRAY}:
            return arrays[plain[_ARRAY]]
        return {key: _restored(item, arrays) for key, item in plain.items()}
    return [_restored(item, arrays) for item in plain] if isinstance(plain, list) else plain


STORE = ".finished"  # folder beside results, for all of them
LARGEST_STORE_BYTES = 2_000_000_000  # of that folder; the oldest entries are deleted first
_PART = ".part"  # suffix of a file being written; a killed writer leaves it
_ENTRY = re.compile(rf"[0-9a-f]{{64}}|tmp\w+{re.escape(_PART)}")


def code_identity() -> str:
    """Hash of all code that determines numbers: this package's, Python's, the dependencies'."""
    return address([code_sha256(), platform.python_version(), dependency_versions()])


@dataclass(frozen=True, slots=True)
class WorkStore:
    """Finished work in one folder that only this user can write to.

    ``folder``: ``None`` stores nothing: the run is made in one go. ``code``: part of every address,
    so that results of other code are not recalled.
    """

    folder: Path | None = None
    code: str = field(default_factory=code_identity)

    @classmethod
    def shared(cls, folder: Path) -> WorkStore:
        """A store of repeatable work; stores nothing if others can write to the folder."""
        try:
            require_own(folder)
        except FileNotFoundError:
            pass  # the folder is made by the first write
        except (OSError, ResultError):
            return cls()
        return cls(folder)

    def get(self, what: str, inputs: object, make: Callable[[], T], kind: type[T]) -> T:
        """Recall finished work, or make and store it.

        ``what``: name of the work: the same inputs may determine several. ``inputs``: all that
        determines the numbers, as :func:`bayesbl.results.work.address` takes it. ``kind``: type of
        the work, as :func:`bayesbl.results.work.decoder` takes it.
        """
        stored = self.recall(what, inputs, kind)
        if stored is not None:
            return stored
        result = make()
        self.keep(what, inputs, result)
        return result

    def recall(self, what: str, inputs: object, kind: type[T]) -> T | None:
        """Finished work; ``None`` if there is no valid entry."""
        if self.folder is None:
            return None
        key, decoded = self.address_of(what, inputs), decoder(kind)  # type: ignore[arg-type]
        try:
            require_own(self.folder)
            head, _, content = (self.folder / key).read_bytes().partition(b"\n")
            return decoded(content) if head == _head(key, content) else None
        except Exception:
            # A damaged entry may fail in any way; the work is then made again.
            return None

    def keep(self, what: str, inputs: object, value: object) -> None:
        """Store finished work, whole or not at all.

        Raises ResultError if others can write to the folder, or it cannot be made, and OSError if
        the file cannot be written, for example because the disk is full.
        """
        if self.folder is None:
            return
        try:
            make_own(self.folder)
        except OSError as error:
            raise unwritable(self.folder, error) from None
        key, content = self.address_of(what, inputs), encoded(value)
        # Several processes may store the same work.
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

    def keep_latest(self, *, size_bytes: float) -> None:
        """Delete the oldest entries until the others are within this total size."""
        latest = sorted(self._files().items(), key=lambda entry: -entry[1].st_mtime_ns)
        sizes = accumulate(status.st_size for _, status in latest)
        for (file, _), size in zip(latest, sizes, strict=True):
            if size > size_bytes:
                file.unlink(missing_ok=True)

    def keep_only(self, addresses: Collection[str]) -> None:
        """Delete all entries but those at these addresses or being written."""
        for file in self._files():
            if file.name not in addresses and file.suffix != _PART:
                file.unlink(missing_ok=True)

    def _files(self) -> dict[Path, os.stat_result]:
        """Entries in the folder, also unfinished ones, with their status; no other file."""
        files = {}
        with suppress(FileNotFoundError):
            if self.folder is not None:
                require_own(self.folder)
                for entry in os.scandir(self.folder):
                    with suppress(FileNotFoundError):
                        is_ours = _ENTRY.fullmatch(entry.name) is not None
                        if is_ours and entry.is_file(follow_symlinks=False):
                            files[Path(entry.path)] = entry.stat()
        return files

    def address_of(self, what: str, inputs: object) -> str:
        """Address of finished work with these inputs."""
        return address([what, self.code, inputs])


NOTHING_KEPT = WorkStore(code="")  # A store for work that is not worth keeping, or has no folder


def _head(key: str, content: bytes) -> bytes:
    """First line of an entry; reveals damage and a wrong address."""
    return hashlib.sha256(key.encode() + content).hexdigest().encode()
