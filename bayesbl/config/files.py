"""From a file to its tables and its model: all that is wrong is reported at once.

Problems are sentences that name line and field.
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar, get_args, get_origin

from pydantic import BaseModel, ValidationError

from bayesbl.config.kinds import FILES
from bayesbl.config.sections import BASE_DIRECTORY, Section
from bayesbl.errors import ConfigError
from bayesbl.recording.channels import did_you_mean, did_you_mean_file
from bayesbl.recording.formats import formats
from bayesbl.recording.input_bytes import read_input, suffix_of
from bayesbl.units import unit_of

Location = tuple[str | int, ...]
"""Keys and list positions from the top of a configuration down to a value."""

_TABLE = re.compile(r"^\s*(\[\[?)\s*([^\[\]]+?)\s*\]")
_KEY = re.compile(r"""^\s*("[^"]*"|'[^']*'|[A-Za-z0-9_.-]+)\s*=""")
_PREAMBLE = re.compile(r"^(Input should be (an instance of )?|(String|Value) should (have|be) )")
_EXPECTED = {
    "model_type": "a table",
    "dict_type": "a table",
    "tuple_type": "a list",
    "string_type": "text in quotes",
    "bool_type": "true or false",
    "int_type": "a whole number",
    "float_type": "a number",
    "date_type": "a date, e.g. 2026-03-01",
}
_OUT_OF_RANGE = frozenset(
    {"greater_than", "greater_than_equal", "less_than", "less_than_equal", "multiple_of"}
)


def config_error(problems: Sequence[ConfigError], file: Path | None) -> ConfigError:
    """All problems as one error."""
    if len(problems) == 1:
        return problems[0].at(ConfigError, file=file)
    lines = "".join(f"\n  {problem}" for problem in problems)
    return ConfigError(f"{len(problems)} problems:{lines}", file=file)


def problems_of(
    error: ValidationError,
    model: type[BaseModel],
    text: str = "",
    origins: Mapping[Location, str] = MappingProxyType({}),
) -> list[ConfigError]:
    """The problems that pydantic found in tables of this model, in the order of ``text``."""
    lines = line_numbers(text)
    found = []
    for item in _items_of(error):
        location = _location_of(item)
        where, line = _origin_of(location, origins), 0
        if where is None:
            known = (lines.get(location[:n]) for n in range(len(location), 0, -1))
            line = next(filter(None, known), 0)
            where = _field_name(model, location)
            where = f"line {line}, {where}".removesuffix(", ") if line else where
        found.append((line, ConfigError(where=where or None, **_problem(item, model, location))))
    return [problem for _, problem in sorted(found, key=lambda pair: pair[0])]


def _origin_of(location: Location, origins: Mapping[Location, str]) -> str | None:
    """What a value came from in place of the text: an option, or one of the recordings."""
    known = (origins.get(location[:n]) for n in range(len(location), 0, -1))
    origin = next(filter(None, known), None)
    if origin != "recordings":
        return origin
    return f"recording {int(location[1]) + 1}" if len(location) > 1 else origin


def _items_of(error: ValidationError) -> list[dict[str, Any]]:
    """What pydantic found, except a list called too short only because its items are wrong."""
    items: list[dict[str, Any]] = [dict(item) for item in error.errors(include_url=False)]
    places: list[Location] = [item["loc"] for item in items]

    def has_wrong_items(place: Location) -> bool:
        return any(other[: len(place)] == place != other for other in places)

    return [i for i in items if i["type"] != "too_short" or not has_wrong_items(i["loc"])]


def _location_of(item: Mapping[str, Any]) -> Location:
    """Where an error is: where pydantic found it, and on to the part that was refused.

    pydantic's mark for a mapping's key is left out.
    """
    refused: Location = (item.get("ctx") or {}).get("at", ())
    return (*(part for part in item["loc"] if part != "[key]"), *refused)


def _field_name(model: type[BaseModel], location: Location) -> str:
    """A location as users write it: ``[estimator.model] fixed.window_end_s``."""
    tables: list[str] = []
    rest = list(location)
    current, opening, closing = model, "[", "]"
    while rest and (section := _section_of(current, rest[0])) is not None:
        if get_origin(_fields(current)[str(rest[0])]) is tuple:
            opening, closing = "[[", "]]"
        current = section
        tables.append(str(rest.pop(0)))
    if not tables:
        return ".".join(map(str, rest))
    position = str(int(rest.pop(0)) + 1) if rest and isinstance(rest[0], int) else ""
    parts = (f"{opening}{'.'.join(tables)}{closing}", position, ".".join(map(str, rest)))
    return " ".join(part for part in parts if part)


def line_numbers(text: str) -> dict[Location, int]:
    """Line of each table header and key of a TOML text, if they are at the start of a line."""
    lines: dict[Location, int] = {}
    entries: dict[Location, int] = {}
    table: Location = ()
    for number, line in enumerate(text.splitlines(), start=1):
        if header := _TABLE.match(line):
            table = _keys(header[2])
            if header[1] == "[[":
                entries[table] = entries.get(table, -1) + 1
                lines.setdefault(table, number)
                table = (*table, entries[table])
            for depth in range(1, len(table) + 1):
                lines.setdefault(table[:depth], number)
        elif key := _KEY.match(line):
            lines.setdefault((*table, *_keys(key[1])), number)
    return lines


def _keys(dotted: str) -> Location:
    if dotted[0] in "\"'":
        return (dotted[1:-1],)
    return tuple(part.strip(" \t\"'") for part in dotted.split("."))


def _problem(item: Mapping[str, Any], model: type[BaseModel], location: Location) -> dict[str, Any]:
    """What is wrong, what was there, and what should be, as an error takes them."""
    context = item.get("ctx") or {}
    match item["type"]:
        case "extra_forbidden":
            known = _keys_at(model, location[:-1])
            hint = did_you_mean(str(location[-1]), known)
            expected = f"one of {', '.join(known)}" if known else "no key here"
            return {"problem": f"This key is not known.{hint}", "expected": expected}
        case "missing":
            return {"problem": "A required key is missing.", "expected": f'"{location[-1]}"'}
        case "refused":
            found = context.get("found")
            shown = _shown(item["input"]) if found is None else str(found)
            problem = str(item["msg"])
            return {"problem": problem, "found": shown, "expected": context.get("expected")}
        case kind:
            expected = _EXPECTED.get(kind) or _PREAMBLE.sub("", str(item["msg"]))
            unit = unit_of(str(location[-1])) if location else ""
            if kind == "float_type" and unit:
                expected = f"a number in {unit}, without quotes"
            if kind == "model_type" and "value" in _keys_at(model, location):
                expected = f"a table, such as {{value = {_shown(item['input'])}}}"
            shown = _shown(item["input"])
            return {"problem": _sentence(kind), "found": shown, "expected": expected}


def _sentence(kind: str) -> str:
    if kind in _OUT_OF_RANGE:
        return "The value is out of range."
    if kind == "literal_error":
        return "This is not one of the choices."
    return "This value cannot be used."


def _shown(value: object) -> str:
    """A value roughly as TOML writes it."""
    if isinstance(value, bool):
        return str(value).lower()
    text = str(value) if isinstance(value, Path) else repr(value)
    return text if len(text) <= 200 else text[:199] + "…"


def _keys_at(model: type[BaseModel], location: Location) -> list[str]:
    """Keys that the table at a location may have."""
    for part in location:
        # A position in a list, or a free key of a mapping, leads to the same section.
        model = _section_of(model, part) or model
    return list(_fields(model))


def _section_of(model: type[BaseModel], key: str | int) -> type[BaseModel] | None:
    """The section that a key of a section leads to, ``None`` where it leads to a plain value."""
    return _model_in(_fields(model).get(str(key)))


def _fields(model: type[BaseModel]) -> dict[str, Any]:
    return {field.alias or name: field.annotation for name, field in model.model_fields.items()}


def _model_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    models = (_model_in(argument) for argument in get_args(annotation))
    return next((model for model in models if model is not None), None)


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
    return validated(model, tables, path.absolute().parent, path, text)


def validated(
    model: type[_Model],
    tables: Mapping[str, Any],
    directory: Path,
    file: Path | None,
    text: str,
    origins: Mapping[Location, str] = MappingProxyType({}),
) -> _Model:
    """Tables as a configuration; its paths start from ``directory``.

    ``origins`` names what did not come from the text, such as an option: the place of its problems.

    Raises
    ------
    ConfigError
        With everything that is wrong; it names the file where all of it is in the text.
    """
    try:
        return model.model_validate(tables, context={BASE_DIRECTORY: directory})
    except ValidationError as error:
        problems = problems_of(error, model, text, origins)
        places = [_origin_of(_location_of(item), origins) for item in _items_of(error)]
        raise config_error(problems, file if None in places else None) from None


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
    raise ConfigError(
        "This file is of another kind.",
        file=file,
        where=place_of_kind(text),
        found=_told(kind),
        expected=" or ".join(map(_told, wanted)),
    )


def place_of_kind(text: str) -> str:
    """The line in which a file says its kind, and the key."""
    line = line_numbers(text).get(("kind",))
    return "kind" if line is None else f"line {line}, kind"


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
