"""Compiled code: what numba's cache on disk cannot see must not be there."""

from __future__ import annotations

import importlib
import pkgutil

import bayesbl


def test_no_compiled_function_uses_one_of_another_file() -> None:
    """Else the cached machine code outlives an edit of the other file: wrong numbers, unnoticed."""
    from numba.core.registry import CPUDispatcher

    compiled = 0
    for found in pkgutil.walk_packages(bayesbl.__path__, "bayesbl."):
        if found.name.endswith("__main__"):
            continue
        module = importlib.import_module(found.name)
        for function in vars(module).values():
            if not isinstance(function, CPUDispatcher) or function.__module__ != found.name:
                continue
            compiled += 1
            names = function.py_func.__code__.co_names
            used = [function.py_func.__globals__.get(name) for name in names]
            for other in used:
                if isinstance(other, CPUDispatcher):
                    assert other.__module__ == found.name, (function, other)
    assert compiled > 10


def test_what_cannot_be_cached_is_compiled_all_the_same(monkeypatch) -> None:
    from numba.core import caching

    from bayesbl.compiled import compiled

    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])

    @compiled()
    def more(x):
        return x + 1.0

    assert more(1.0) == 2.0
