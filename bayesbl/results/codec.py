"""Frozen dataclasses as bytes and back, and the address of their content.

A value is numbers, texts, ``None``, arrays, and tuples, mappings and dataclasses of these. Its JSON
and its arrays are stored in one ``.npz``, nothing that could be executed; it is read as the type
that the reader asks for, and refused if it is not of that type.

A field that cannot be given on construction (``init=False``) or is no part of what the value is
(``compare=False``) is left out; the dataclass itself makes it again.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from datetime import date
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import ConfigDict, TypeAdapter

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
