"""Import libraries without the optional extras that they would import too.

pandas imports pyarrow, xarray dask, cma matplotlib and emcee h5py: together most of a second and
110 MB, which a command does not use, or only later. They look for an extra at their import and
remember the answer. So only our own processes (a command or its worker) may do this, before they
have other threads. Whoever imports bayesbl into another program finds pandas and xarray unchanged.
"""

from __future__ import annotations

import gc
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def absent(*names: str) -> Iterator[None]:
    """Within the block, modules that are not loaded yet appear as not installed."""
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
    """Import what every run needs without extras; the block has no dask unless asked for.

    xarray looks for dask at its import, at its first variable and for each file.
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
    """Exclude imported objects from garbage collection, which would take 0.2 s."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()
