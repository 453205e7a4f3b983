"""What a study is: a Python file that says how one independent case of a row is run.

A study file defines three functions::

    def count(row) -> int: ...
        # How many independent cases the row has.

    def run_case(row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]: ...
        # One case: named numbers. ``seed`` belongs to this case alone. A UserError that leaves
        # it is recorded as a failed case; anything else stops the study, as an error of its file.

    def summarise(row, cases: xr.Dataset) -> Mapping[str, float | str]: ...
        # The row's line of the table, from its cases that did not fail (dimension ``case``).

and may define::

    class Row(pydantic.BaseModel): ...
        # What a row may say; the functions then get it in place of the plain table.

    COLUMNS: Mapping[str, tuple[str, str]]
        # Unit and long name of what the cases return.

    def figure(table, cases) -> matplotlib.figure.Figure: ...
        # From the table's lines and the cases of each row by name.

Cases run in other processes, maybe on other machines, on one thread each, in any order. What is
costly and shared by the cases of a row goes into a function under ``functools.cache``.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import json
import os
import sys
import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import BaseModel, ValidationError

from bayesbl.config.problems import config_error, problems_of
from bayesbl.errors import ConfigError, UserError

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

Table = Mapping[str, Any]
"""A row as the configuration has it."""

REQUIRED = ("count", "run_case", "summarise")
RESERVED = ("failed", "message", "seconds", "commit")
"""What the runner keeps of every case beside the study's own numbers."""

AFTER_THE_CASES = frozenset({"summarise", "figure", "COLUMNS"})
"""What a study file may change without its cases being run again."""


@dataclass(frozen=True)
class Study:
    """A study file that was loaded."""

    path: Path
    module: ModuleType

    @property
    def name(self) -> str:
        """The file's name without suffix."""
        return self.path.stem

    @property
    def columns(self) -> Mapping[str, tuple[str, str]]:
        """Unit and long name of the cases' numbers, as far as the study gives them."""
        return getattr(self.module, "COLUMNS", {})

    @property
    def has_figure(self) -> bool:
        """Whether the study draws one of its own."""
        return hasattr(self.module, "figure")

    def figure(self, table: Sequence[Table], cases: Mapping[str, xr.Dataset]) -> Figure:
        """The study's own figure."""
        with error_of(self.path, "in figure"):
            found: Figure = self.module.figure(table, cases)
        return found

    def row(self, table: Table) -> Any:
        """A row as the study's functions take it.

        Raises
        ------
        ConfigError
            With everything that the study's ``Row`` finds wrong.
        """
        model: type[BaseModel] | None = getattr(self.module, "Row", None)
        if model is None:
            return dict(table)
        known = {k: v for k, v in table.items() if k != "name" or "name" in model.model_fields}
        try:
            return model.model_validate(known)
        except ValidationError as error:
            problems = [
                replace(problem, where=f'[[rows]] "{table["name"]}" {problem.where or ""}'.rstrip())
                for problem in problems_of(error, model, "")
            ]
            raise config_error(problems, None) from None

    def count(self, table: Table) -> int:
        """How many cases a row has."""
        with error_of(self.path, f'in count, row "{table["name"]}"'):
            count = self.module.count(self.row(table))
        if not isinstance(count, int) or count < 1:
            raise ConfigError(
                "A row needs cases.",
                file=self.path,
                where=f'count, row "{table["name"]}"',
                found=repr(count),
                expected="a whole number, 1 or more",
            )
        return count

    def run_case(self, table: Table, index: int, seed: np.random.SeedSequence) -> dict[str, float]:
        """Run one case."""
        values = self.module.run_case(self.row(table), index, seed)
        if taken := sorted(values.keys() & set(RESERVED)):
            raise ValueError(f"run_case returns names that are the runner's: {', '.join(taken)}")
        return {str(name): float(value) for name, value in values.items()}

    def summarise(self, table: Table, cases: xr.Dataset) -> dict[str, float | int | str]:
        """The row's line of the table, in plain Python values."""
        with error_of(self.path, f'in summarise, row "{table["name"]}"'):
            line = {
                str(name): value.item() if isinstance(value, np.generic) else value
                for name, value in self.module.summarise(self.row(table), cases).items()
            }
            json.dumps(line)  # as it is stored
        return line

    def files(self, table: Table) -> list[str]:
        """Paths of the files that a row names."""
        return [value for value in table.values() if _is_file(value)]

    def definition(self, table: Table, seed: int) -> str:
        """SHA-256 of what decides a row's cases: its table, the code that runs them, the seed.

        Files that a row names count with their content, wherever they are; comments, docstrings
        and what is done with finished cases do not count.
        """
        said = {key: _content(value) for key, value in table.items()}
        parts = [said, self._code_of_cases, seed]
        return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()

    @cached_property
    def sha256(self) -> str:
        """Of the whole file."""
        return hashlib.sha256(self.path.read_bytes()).hexdigest()

    @cached_property
    def _code_of_cases(self) -> str:
        tree = ast.parse(self.path.read_text(encoding="utf-8"))
        tree.body = [node for node in tree.body if not _names(node) & AFTER_THE_CASES]
        for node in ast.walk(tree):
            body = getattr(node, "body", None)
            if isinstance(body, list):
                # Strings on their own are docstrings; a body needs something in their place.
                node.body = [item for item in body if not _is_text(item)] or [ast.Pass()]  # type: ignore[attr-defined]
        return ast.unparse(tree)


def load_study(path: str | Path) -> Study:
    """Load a study file.

    Raises
    ------
    ConfigError
        If it cannot be imported, whatever it does instead, or lacks one of the three functions.
    """
    path = Path(path)
    # Registered under a name of its own: pydantic and pickle look modules up there.
    name = f"bayesbl_study_{path.stem}"
    specification = importlib.util.spec_from_file_location(name, path)
    if specification is None or specification.loader is None:
        raise ConfigError("This is not a study.", file=path, expected="a Python file, .py")
    module = importlib.util.module_from_spec(specification)
    sys.modules[name] = module
    with error_of(path, "while it was loaded"):
        specification.loader.exec_module(module)
    lacking = [f for f in REQUIRED if not callable(getattr(module, f, None))]
    if lacking:
        raise ConfigError(
            "The study file lacks a function.",
            file=path,
            found=f"no {' and no '.join(lacking)}",
            expected=f"functions {', '.join(REQUIRED)}",
        )
    return Study(path, module)


@contextmanager
def error_of(path: Path, when: str) -> Iterator[None]:
    """Whatever leaves the code of a study file, ``sys.exit`` too, is an error of this file.

    But for a :class:`UserError`, which the file raises in words of its own.
    """
    try:
        yield
    except (UserError, KeyboardInterrupt):
        raise
    except BaseException as error:
        raise ConfigError(
            f"The study file failed {when}.",
            file=path,
            where=_line_of(error, path),
            found=f"{type(error).__name__}: {error}",
        ) from error


def seed_of_case(seed: int, row: str, index: int) -> np.random.SeedSequence:
    """The seed of one case, from the run's seed and the row's name: other rows do not matter."""
    words = hashlib.sha256(row.encode()).digest()[:16]
    return np.random.SeedSequence([seed, int.from_bytes(words, "little")], spawn_key=(index,))


def _content(value: Any) -> Any:
    """A file's name and hash in place of its path."""
    if _is_file(value):
        return [Path(value).name, hashlib.sha256(Path(value).read_bytes()).hexdigest()]
    return value


def _is_file(value: Any) -> bool:
    return isinstance(value, str) and os.path.isfile(value)


def _names(node: ast.stmt) -> set[str]:
    """What a statement at the top of a module defines."""
    match node:
        case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
            return {name}
        case ast.Assign(targets=[ast.Name(id=name)]) | ast.AnnAssign(target=ast.Name(id=name)):
            return {name}
    return set()


def _is_text(node: ast.stmt) -> bool:
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


def _line_of(error: BaseException, path: Path) -> str | None:
    """The last line of the study file that an exception passed through."""
    if isinstance(error, SyntaxError) and error.lineno is not None:
        return f"line {error.lineno}"
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if frame.filename == str(path)]
    return f"line {lines[-1]}" if lines else None
