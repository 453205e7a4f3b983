"""From a file to its tables and its model: all that is wrong is reported at once."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import ValidationError

from bayesbl.config.kinds import FILES
from bayesbl.config.problems import Problem, config_error, line_numbers, problems_of
from bayesbl.config.sections import BASE_DIRECTORY, Section
from bayesbl.errors import ConfigError
from bayesbl.recording.channels import did_you_mean_file
from bayesbl.recording.formats import formats
from bayesbl.recording.input_bytes import read_input, suffix_of

_Model = TypeVar("_Model", bound=Section)

DEEPEST = 30
"""Levels of tables and lists in a file; what the package writes has seven at most."""


def load_file(path: Path, model: type[_Model]) -> _Model:
    """The file, validated; its paths start from its own folder.

    Raises
    ------
    ConfigError
        Naming file and field: no such file, not TOML, another kind, or what the model refuses.
    """
    (kind,) = get_args(model.model_fields["kind"].annotation)
    text, tables = read_toml(path, f"a file of kind {_told(kind)} in TOML")
    require_kind(tables, [kind], path, text)
    try:
        return model.model_validate(tables, context={BASE_DIRECTORY: path.absolute().parent})
    except ValidationError as error:
        raise config_error(problems_of(error, model, text), path) from None


def require_text_names(paths: Iterable[Path]) -> None:
    """Refuse names whose bytes are no text: configurations and results could not hold them.

    Raises
    ------
    ConfigError
        Naming the file.
    """
    for path in paths:
        if str(path) != str(path).encode(errors="replace").decode():
            raise ConfigError(
                "The name of this file is not UTF-8, and cannot be written into a configuration.",
                file=path,
                expected="the file under another name",
            )


def read_toml(
    path: Path, expected: str, *, instead_of_recording: str | None = None
) -> tuple[str, dict[str, Any]]:
    """The text of a file and its tables.

    Parameters
    ----------
    expected
        What the file should be, for messages.
    instead_of_recording
        The same where the file is a recording; ``expected`` by default.

    Raises
    ------
    ConfigError
        If there is no such file, or it is not TOML.
    """
    if suffix_of(path) in formats() and os.path.isfile(path):
        raise ConfigError(
            "This is a recording, or not a configuration at all.",
            file=path,
            found=f"a file ending in {path.suffix}",
            expected=instead_of_recording or expected,
        )
    try:
        text = read_input(path).decode("utf-8-sig")
    except (FileNotFoundError, NotADirectoryError):
        raise ConfigError(
            "There is no such file." + did_you_mean_file(path), file=path, expected=expected
        ) from None
    except UnicodeDecodeError:
        raise ConfigError(
            "This is not a text file.", file=path, found="binary data", expected="TOML in UTF-8"
        ) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ConfigError(
            "The file cannot be read.", file=path, found=reason, expected="a TOML file"
        ) from None
    return text, _parse(text, path)


def require_kind(
    tables: Mapping[str, Any], wanted: Collection[str], file: Path | None, text: str
) -> None:
    """Refuse a file that says it is of another kind, whose keys would all be unknown here.

    Raises
    ------
    ConfigError
        Naming the kind found and those wanted.
    """
    kind = tables.get("kind")
    if not isinstance(kind, str) or kind not in FILES or kind in wanted:
        return
    problem = Problem(
        "This file is of another kind.",
        where="kind",
        found=_told(kind),
        expected=" or ".join(map(_told, wanted)),
        line=line_numbers(text).get(("kind",)),
    )
    raise config_error([problem], file)


def _told(kind: str) -> str:
    return f'"{kind}" ({FILES[kind]})'


def _parse(text: str, file: Path) -> dict[str, Any]:
    try:
        tables = tomllib.loads(text)
        if _is_deep(tables):
            raise RecursionError
        return tables
    except RecursionError:
        raise ConfigError(
            "The file is nested too deeply.",
            file=file,
            found=f"tables or lists in one another, more than {DEEPEST}",
            expected="sections, keys and values",
        ) from None
    except ValueError as error:
        place = re.search(r" \(at (line \d+, column \d+|end of document)\)$", str(error))
        problem = str(error)[: place.start()] if place else str(error)
        raise ConfigError(
            f"This is not valid TOML: {problem}.",
            file=file,
            where=place[1] if place else None,
            expected='key = value; text is in quotes, e.g. file = "before.csv"; numbers have a '
            "decimal point, not a comma; dates are written 2026-07-01",
        ) from None


def _is_deep(tables: Mapping[str, Any]) -> bool:
    """Whether anything lies deeper than :data:`DEEPEST`; by levels, as a descent may fail."""
    level: list[Any] = [tables]
    for _ in range(DEEPEST):
        level = [
            item
            for holder in level
            for item in (holder.values() if isinstance(holder, Mapping) else holder)
            if isinstance(item, Mapping | list)
        ]
    return bool(level)
