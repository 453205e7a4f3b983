"""Libraries without the extras that they import where these happen to be installed.

pandas imports pyarrow, xarray dask, cma matplotlib and emcee h5py: together most of a second and
110 MB, of which a command uses nothing, or only later and by itself. They ask whether an extra is
there as they are imported, and remember the answer for the life of the process. So only a process
of ours may do this, a command or its worker, before it has other threads: whoever imports bayesbl
into a program of their own finds pandas and xarray as they know them.
"""

from __future__ import annotations

import gc
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def absent(*names: str) -> Iterator[None]:
    """Modules that are not loaded yet look within the block as if they were not installed."""
    hidden = [name for name in names if name not in sys.modules]
    for name in hidden:
        sys.modules[name] = None  # type: ignore[assignment]  # how Python marks them
    try:
        yield
    finally:
        for name in hidden:
            sys.modules.pop(name, None)


@contextmanager
def bare(*, dask: bool = False) -> Iterator[None]:
    """What every run needs is imported without its extras; the block has no dask unless asked for.

    xarray looks for dask as it is imported, at its first variable and for each file.
    """
    # Loaded before, it would insist on the dask that it found.
    spared = () if dask or "xarray" in sys.modules else ("dask",)
    with absent(*spared):
        with _never_collected():
            with absent("pyarrow"):
                import xarray  # noqa: F401  # imports pandas
            with absent("matplotlib"), warnings.catch_warnings():
                warnings.filterwarnings("ignore", "Could not import matplotlib")
                import cma  # noqa: F401
            with absent("h5py"):
                import emcee  # noqa: F401
            import numba  # noqa: F401
        yield


@contextmanager
def _never_collected() -> Iterator[None]:
    """What is imported stays as long as the process: to look through it for garbage takes 0.2 s."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()
