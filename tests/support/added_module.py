"""A package with one more module in it, as if a file had been put into its folder."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType


@contextmanager
def added_module(package: ModuleType, file: Path) -> Iterator[None]:
    """``file`` is a module of the package until the block ends."""
    folders = package.__path__
    folders.append(str(file.parent))
    importlib.invalidate_caches()
    try:
        yield
    finally:
        folders.remove(str(file.parent))
        sys.modules.pop(f"{package.__name__}.{file.stem}", None)
        vars(package).pop(file.stem, None)
