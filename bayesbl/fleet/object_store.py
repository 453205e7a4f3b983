"""Files in an object store (S3, Azure, HTTP …), listed and copied by fsspec."""

from __future__ import annotations

import hashlib
import os
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bayesbl.errors import ConfigError
from bayesbl.recording.input_bytes import require_size


def listed(pattern: str) -> Iterator[str]:
    """Addresses of the files that a pattern with ``*`` finds, spelled as the pattern is.

    Raises
    ------
    ConfigError
        If the store cannot be reached, or no package for it is installed.
    """
    begin = re.match(r"[a-z0-9+.-]+://[^*]*/", pattern)
    root = pattern if begin is None else begin[0]
    try:
        store, path = _opened(pattern)
        prefix = str(store._strip_protocol(root)).rstrip("/") + "/"
        for name in sorted(map(str, store.glob(path))):
            yield root + name.removeprefix(prefix)
    except Exception as error:  # each store's package has its own
        raise ConfigError(
            "The recordings in this store cannot be listed.",
            file=pattern,
            found=_told(error),
            expected="a store that fsspec can list, its package installed (s3fs, adlfs, gcsfs), "
            "and credentials where that package looks for them",
        ) from None


def copied(address: str, folder: Path) -> Path:
    """A copy of a file in ``folder``; taken again only where the store says that it has changed.

    Raises
    ------
    OSError
        If the file cannot be had, with a ``strerror`` that says why: also one that is too large.
    """
    try:
        store, path = _opened(address)
        state = hashlib.sha256(f"{address} {store.ukey(path)}".encode()).hexdigest()
        copy = folder / (state[:32] + "".join(Path(path).suffixes[-2:]))
        if not copy.exists():
            require_size(store.size(path))
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=folder) as apart:
                store.get_file(path, f"{apart}/copy")
                os.replace(f"{apart}/copy", copy)
    except Exception as error:
        raise OSError(0, f"it cannot be had from its store ({_told(error)})") from None
    return copy


def _opened(address: str) -> tuple[Any, str]:
    """The store and the path in it; raises whatever the store's package does."""
    from fsspec.core import url_to_fs

    store, path = url_to_fs(address)
    return store, str(path)


def _told(error: Exception) -> str:
    return f"{type(error).__name__}: {error}".rstrip(" .:")
