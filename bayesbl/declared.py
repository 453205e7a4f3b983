"""What the modules of a package declare: a new file in it is found without another being edited."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType
from typing import Any


def declared(package: ModuleType, name: str) -> list[Any]:
    """What the modules of a package hold under ``name``, in the order of the modules' names."""
    found = iter_modules(package.__path__, f"{package.__name__}.")
    modules = [import_module(module.name) for module in found]
    return [getattr(module, name) for module in modules if hasattr(module, name)]
