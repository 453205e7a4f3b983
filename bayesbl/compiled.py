"""Functions that numba compiles, with a cache on disk wherever one can be written."""

from __future__ import annotations

import os
import stat
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numba


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorate a function as ``numba.njit`` does, with its cache.

    numba keeps the cache beside the source or in the user's home, and raises where it can write to
    neither, as in a container. The cache is then in a temporary folder, or there is none.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        for elsewhere in (False, True):
            if elsewhere:
                _use_temporary_folder()
            try:
                return _forgiving(numba.njit(cache=True, **options)(function))
            except RuntimeError as error:
                if "cannot cache" not in str(error):
                    raise
        return numba.njit(**options)(function)

    return decorate


def _forgiving(function: Any) -> Any:
    """The function does without a cache on a full disk, where numba ends in the error."""
    cache = function._cache
    save = cache.save_overload

    def attempt(*compiled: Any) -> None:
        with suppress(OSError):
            save(*compiled)

    cache.save_overload = attempt
    return function


def _use_temporary_folder() -> None:
    """Point numba to a folder of this user alone: whoever writes a cache decides what is run."""
    try:
        folder = Path(tempfile.gettempdir(), f"bayesbl-compiled-{os.getuid()}")
        folder.mkdir(mode=0o700, exist_ok=True)
        if _is_private(folder):
            numba.config.CACHE_DIR = str(folder)
    except OSError:
        pass


def _is_private(folder: Path) -> bool:
    found = folder.lstat()
    private = found.st_uid == os.getuid() and not found.st_mode & 0o077
    return stat.S_ISDIR(found.st_mode) and private
