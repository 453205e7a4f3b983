"""What validation found wrong in a configuration, in sentences that name line and field."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args, get_origin

from pydantic import BaseModel, ValidationError

from bayesbl.errors import ConfigError
from bayesbl.recording.channels import did_you_mean
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


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong: a sentence, its place, what was there, what should be."""

    problem: str
    where: str | None = None
    found: str | None = None
    expected: str | None = None
    line: int | None = None

    def __str__(self) -> str:
        return str(ConfigError(self.problem, **self.details()))

    def details(self) -> dict[str, Any]:
        """Place, found and expected, as :class:`ConfigError` takes them."""
        line = None if self.line is None else f"line {self.line}"
        where = ", ".join(part for part in (line, self.where) if part) or None
        return {"where": where, "found": self.found, "expected": self.expected}


def config_error(problems: Sequence[Problem], file: Path | None) -> ConfigError:
    """All problems as one error, in the order of the file."""
    ordered = sorted(problems, key=lambda problem: problem.line or 0)
    if len(ordered) == 1:
        return ConfigError(ordered[0].problem, file=file, **ordered[0].details())
    lines = "".join(f"\n  {problem}" for problem in ordered)
    return ConfigError(f"{len(ordered)} problems:{lines}", file=file)


def problems_of(error: ValidationError, model: type[BaseModel], text: str) -> list[Problem]:
    """The problems that pydantic found in a configuration of this model, read from ``text``."""
    lines = line_numbers(text)
    return [_problem(item, model, lines) for item in items_of(error)]


def items_of(error: ValidationError) -> list[dict[str, Any]]:
    """What pydantic found, except a list called too short only because its items are wrong."""
    items: list[dict[str, Any]] = [dict(item) for item in error.errors(include_url=False)]
    places: list[Location] = [item["loc"] for item in items]

    def has_wrong_items(place: Location) -> bool:
        return any(other[: len(place)] == place != other for other in places)

    return [i for i in items if i["type"] != "too_short" or not has_wrong_items(i["loc"])]


def location_of(item: Mapping[str, Any]) -> Location:
    """Where an error is: where pydantic found it, and on to the part that was refused.

    pydantic's mark for a mapping's key is left out.
    """
    refused: Location = (item.get("ctx") or {}).get("at", ())
    return (*(part for part in item["loc"] if part != "[key]"), *refused)


def field_name(model: type[BaseModel], location: Location) -> str:
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


def _problem(
    item: Mapping[str, Any], model: type[BaseModel], lines: Mapping[Location, int]
) -> Problem:
    location = location_of(item)
    line = next(
        (lines[location[:n]] for n in range(len(location), 0, -1) if location[:n] in lines), None
    )
    where = field_name(model, location)
    context = item.get("ctx") or {}
    match item["type"]:
        case "extra_forbidden":
            known = _keys_at(model, location[:-1])
            hint = did_you_mean(str(location[-1]), known)
            expected = f"one of {', '.join(known)}" if known else "no key here"
            return Problem(f"This key is not known.{hint}", where, None, expected, line)
        case "missing":
            return Problem("A required key is missing.", where, None, f'"{location[-1]}"', line)
        case "refused":
            found = context.get("found")
            shown = _shown(item["input"]) if found is None else str(found)
            return Problem(str(item["msg"]), where, shown, context.get("expected"), line)
        case kind:
            expected = _EXPECTED.get(kind) or _PREAMBLE.sub("", str(item["msg"]))
            unit = unit_of(str(location[-1])) if location else ""
            if kind == "float_type" and unit:
                expected = f"a number in {unit}, without quotes"
            if kind == "model_type" and "value" in _keys_at(model, location):
                expected = f"a table, such as {{value = {_shown(item['input'])}}}"
            return Problem(_sentence(kind), where, _shown(item["input"]), expected, line)


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
