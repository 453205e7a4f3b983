"""Find what the modules of a package declare, so that a new file needs no other edit."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType
from typing import TypeVar

_Declared = TypeVar("_Declared")


def declared(package: ModuleType, kind: type[_Declared]) -> list[_Declared]:
    """Every object of one type in the modules of a package, by module name."""
    modules = iter_modules(package.__path__, f"{package.__name__}.")
    held = [value for module in modules for value in vars(import_module(module.name)).values()]
    # A module may import what another declares.
    return list({id(value): value for value in held if isinstance(value, kind)}.values())
