"""Functions that numba compiles, with a cache on disk wherever one can be written."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorate a function as ``numba.njit`` does, with its cache.

    numba keeps the cache beside the source, in the user's home or in ``NUMBA_CACHE_DIR``. Where it
    can write to none of them, as in some containers, every process compiles anew.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        try:
            return numba.njit(cache=True, **options)(function)
        except RuntimeError:
            return numba.njit(**options)(function)

    return decorate
