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


def test_a_cache_in_a_temporary_folder_is_the_users_alone(tmp_path, monkeypatch) -> None:
    import tempfile

    import numba

    from bayesbl import compiled

    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    compiled._use_temporary_folder()
    (folder,) = tmp_path.iterdir()
    assert str(folder) == numba.config.CACHE_DIR
    folder.chmod(0o777)
    numba.config.CACHE_DIR = ""
    compiled._use_temporary_folder()
    assert not numba.config.CACHE_DIR


def test_a_full_disk_costs_the_cache_and_not_the_answer(tmp_path, monkeypatch) -> None:
    import errno

    import numba
    from numba.core.caching import IndexDataCacheFile

    from bayesbl.compiled import compiled

    def full(*_: object) -> None:
        raise OSError(errno.EFBIG, "File too large")

    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(IndexDataCacheFile, "save", full)

    @compiled()
    def more(x):
        return x + 1.0

    assert more(1.0) == 2.0
