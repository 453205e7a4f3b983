"""From a TOML file or command-line options to a validated configuration, and back to TOML.

A configuration is validated as a whole. All problems are reported at once, in sentences with line
and field.
"""

from __future__ import annotations

import os
import re
import shlex
import tomllib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date as Date
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar, get_args, get_origin

import tomli_w
from pydantic import BaseModel, ValidationError

from bayesbl.arguments import File, checked
from bayesbl.config.kinds import FILES, KINDS, RUNNABLE
from bayesbl.config.measurement import SnapshotConfig
from bayesbl.config.sections import BASE_DIRECTORY, PUBLISHED, RunConfig, Section, name_of, names_of
from bayesbl.errors import ConfigError
from bayesbl.recording.channels import did_you_mean
from bayesbl.recording.formats import FORMATS
from bayesbl.recording.input_bytes import input_or_refusal, stem_of, suffix_of
from bayesbl.units import unit_of

Location = tuple[str | int, ...]  # keys and list positions from the top to a value
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
_OUT_OF_RANGE = [
    "greater_than",
    "greater_than_equal",
    "less_than",
    "less_than_equal",
    "multiple_of",
]
_PROBLEMS = dict.fromkeys(_OUT_OF_RANGE, "The value is out of range.")
_PROBLEMS["literal_error"] = "This is not one of the choices."


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
    problems = []
    for item in _items_of(error):
        location = _location_of(item)
        where, line = _origin_of(location, origins), 0
        if where is None:
            known = (lines.get(location[:n]) for n in range(len(location), 0, -1))
            line = next(filter(None, known), 0)
            where = _field_name(model, location)
            where = f"line {line}, {where}".removesuffix(", ") if line else where
        details = _problem(item, model, location)
        if where and where.startswith("--") and item["type"] == "extra_forbidden":
            details = {"problem": "This option is not for this kind of run."}
        problems.append((line, ConfigError(where=where or None, **details)))
    return [problem for _, problem in sorted(problems, key=lambda pair: pair[0])]


def _origin_of(location: Location, origins: Mapping[Location, str]) -> str | None:
    """The option or recording that a value came from, instead of the text."""
    known = (origins.get(location[:n]) for n in range(len(location), 0, -1))
    origin = next(filter(None, known), None)
    if origin != "recordings":
        return origin
    return f"recording {int(location[1]) + 1}" if len(location) > 1 else origin


def _items_of(error: ValidationError) -> list[dict[str, Any]]:
    """What pydantic found, except lists called too short only because their items are wrong."""
    items: list[dict[str, Any]] = [dict(item) for item in error.errors(include_url=False)]
    places: list[Location] = [item["loc"] for item in items]

    def has_wrong_items(place: Location) -> bool:
        return any(other[: len(place)] == place != other for other in places)

    return [i for i in items if i["type"] != "too_short" or not has_wrong_items(i["loc"])]


def _location_of(item: Mapping[str, Any]) -> Location:
    """Location of an error, down to the part that was refused, without pydantic's mark for keys."""
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
    """Line of each table header and key of a TOML text, if it starts a line."""
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
    """What is wrong, found and expected, as keywords of an error."""
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
            actual = context.get("found")
            shown = _shown(item["input"]) if actual is None else str(actual)
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
            problem = _PROBLEMS.get(kind, "This value cannot be used.")
            return {"problem": problem, "found": shown, "expected": expected}


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
    """The section at a key of a section; ``None`` for a plain value."""
    return _model_in(_fields(model).get(str(key)))


def _fields(model: type[BaseModel]) -> dict[str, Any]:
    return {field.alias or name: field.annotation for name, field in model.model_fields.items()}


def _model_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    models = (_model_in(argument) for argument in get_args(annotation))
    return next((model for model in models if model is not None), None)


_Model = TypeVar("_Model", bound=Section)
_Tables = dict[str, Any]
DEEPEST = 30  # largest depth of tables and lists in a file; the package writes seven at most


@dataclass(frozen=True, slots=True)
class _Document:
    """A configuration before validation; its paths start from ``directory``.

    ``origins`` names the option that set a value, by location: such problems are not the file's.
    """

    tables: _Tables
    directory: Path
    file: Path | None = None
    text: str = ""
    origins: Mapping[Location, str] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path, expected: str, instead_of_recording: str = "") -> _Document:
        """The tables of a file.

        ``expected`` says what the file should be, ``instead_of_recording`` the same for a
        recording. Raises ConfigError if there is no such file, or it is not TOML.
        """
        if suffix_of(path) in FORMATS and os.path.isfile(path):
            raise ConfigError(
                "This is a recording, or not a configuration at all.",
                file=path,
                found=f"a file ending in {path.suffix}",
                expected=instead_of_recording or expected,
            )
        data = input_or_refusal(path, ConfigError, expected)
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            raise ConfigError(
                "This is not a text file.", file=path, found="binary data", expected="TOML in UTF-8"
            ) from None
        return cls(_parse(text, path), Path(os.path.abspath(path)).parent, path, text)

    @property
    def kind(self) -> str:
        """The kind that it states; empty if that is no text."""
        kind = self.tables.get("kind")
        return kind if isinstance(kind, str) else ""

    def of_kind(self, wanted: Collection[str]) -> _Document:
        """The document itself. Another kind is refused, because all its keys would be unknown."""
        if self.kind not in FILES or self.kind in wanted:
            return self
        if self.kind == "bench":
            name = "bench.toml" if self.file is None else self.file.name
            raise self._wrong_kind(
                "A bench file describes a joint; it cannot be run by itself.",
                _in_words(self.kind),
                f'a configuration that names it (bench = "{name}"), or recordings with '
                f"--bench {shlex.quote(name)}",
            )
        expected = " or ".join(map(_in_words, wanted))
        raise self._wrong_kind("This file is of another kind.", _in_words(self.kind), expected)

    def validated(self, model: type[_Model]) -> _Model:
        """The configuration. Raises ConfigError with all problems, and the file if all are in
        it."""
        try:
            return model.model_validate(self.tables, context={BASE_DIRECTORY: self.directory})
        except ValidationError as error:
            problems = problems_of(error, model, self.text, self.origins)
            places = [_origin_of(_location_of(item), self.origins) for item in _items_of(error)]
            raise config_error(problems, self.file if None in places else None) from None

    def run_config(self) -> RunConfig:
        """The configuration of a run of its kind; ConfigError also if there is no such kind."""
        if self.kind in KINDS:
            return self.validated(KINDS[self.kind])
        problem, actual = "The kind of run is missing.", "nothing"
        if "kind" in self.tables:
            problem = "There is no such kind of run." + did_you_mean(self.kind, RUNNABLE)
            actual = repr(self.tables["kind"])
        expected = "one of " + ", ".join(f'"{name}"' for name in RUNNABLE)
        raise self._wrong_kind(problem, actual, expected)

    def _wrong_kind(self, problem: str, actual: str, expected: str) -> ConfigError:
        line = line_numbers(self.text).get(("kind",))
        where = "kind" if line is None else f"line {line}, kind"
        return ConfigError(problem, file=self.file, where=where, found=actual, expected=expected)


def load_file(path: Path, model: type[_Model]) -> _Model:
    """The validated file; its paths start from its own folder.

    Raises ConfigError with file and field: no such file, not TOML, another kind, or refused values.
    """
    (kind,) = get_args(model.model_fields["kind"].annotation)
    document = _Document.read(path, f"a file of kind {_in_words(kind)} in TOML")
    return document.of_kind([kind]).validated(model)


def _in_words(kind: str) -> str:
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
    """Whether anything is deeper than :data:`DEEPEST`, by levels, because recursion may fail."""
    level: list[Any] = [tables]
    for _ in range(DEEPEST):
        level = [
            item
            for holder in level
            for item in (holder.values() if isinstance(holder, Mapping) else holder)
            if isinstance(item, Mapping | list)
        ]
    return bool(level)


OPTIONS: Mapping[str, Location] = {
    "curve": ("curve", "source"),
    "bench": ("estimator", "bench"),
    "effects": ("identify", "effects"),
    "route": ("estimator", "route"),
    "level": ("interval", "level"),
    "limit": ("joint", "limit"),
    "limit_rad": ("joint", "limit_rad"),
    "before": ("joint", "decide_before"),
    "gear_ratio": ("joint", "gear_ratio"),
    "upright": ("joint", "upright"),
    "start_from": ("estimator", "search", "start_from"),
    "check_sampler": ("posterior", "check_sampler"),
    "seed": ("run", "seed"),
    "workers": ("run", "workers"),
    "scheduler": ("run", "scheduler"),
    "out": ("run", "output"),
    "range_rad": ("limits", "range_rad"),
    "speed_rpm": ("limits", "speed_rpm"),
    "acceleration_rpm_per_s": ("limits", "acceleration_rpm_per_s"),
    "duration_s": ("limits", "duration_s"),
    "gap_rad": ("gap_rad",),
}
"""The field that each command-line option sets."""

_PATH_OPTIONS = frozenset({"curve", "bench", "start_from", "out"})

_LIMITS = ("limit", "limit_rad")

_OF_OWN_BENCH = ("identify", "plan", "diagnose")  # kinds whose bench is no estimator's

_COMMON_SECTIONS = ("schema", "run", "columns", "interval")
"""Sections that identification and diagnosis take from the configuration of a measurement."""

_OF_A_FILE = ("date", "repaired")  # keys of ``[[recordings]]`` about the file, for any command
_OF_A_BENCH = ("identify", "diagnose")  # kinds that examine the bench; their files differ
_LONGEST_OUTPUT = 200  # bytes of a name; file systems take 255, and siblings add some


@checked
def load_config(path: File, *, kind: str | None = None) -> RunConfig:
    """Read and validate a configuration; relative paths start from its folder.

    Parameters
    ----------
    path
        A TOML file.
    kind
        The kind that the caller runs; any kind by default.

    Raises
    ------
    ConfigError
        With everything that is wrong: the file missing or not TOML, keys that are unknown, values
        of a wrong type or out of range, files named in it that do not exist.
    """
    document = _read(Path(path)).of_kind(KINDS if kind is None else [kind])
    _set_default_output(document.tables, Path(path).stem)
    return document.run_config()


def config_from_options(
    kind: str,
    recordings: Sequence[str | Path] = (),
    config: str | Path | None = None,
    dates: Sequence[Date] = (),
    **options: object,
) -> RunConfig:
    """The configuration of a command: options override the file, which overrides the defaults.

    ``kind``: that of ``config``, or a measurement if there are ``recordings``. These are relative
    to the working directory and replace those of ``config``, which may be of any kind that shares
    the sections; what it states about the same files is kept, but not its output folder. ``dates``:
    when each recording was taken. ``options``: keys of :data:`OPTIONS`, ``None`` if not given, with
    paths relative to the working directory. Raises ConfigError as :func:`load_config`; problems of
    options name the option.
    """
    document = _Document({}, Path.cwd()) if config is None else _read(Path(config))
    # Kinds of files that a run of this kind can start from, because they share the sections.
    sharing = measured = [k for k, model in KINDS.items() if issubclass(model, SnapshotConfig)]
    if kind not in measured:
        sharing = [kind, *(measured if kind in _OF_A_BENCH else ())]
    document.of_kind(sharing)
    tables = {"schema": 1, **document.tables, "kind": kind}
    if kind in _OF_A_BENCH and document.kind not in ("", kind):
        tables = {name: tables[name] for name in _COMMON_SECTIONS if name in tables}
        tables["kind"] = kind
    if recordings and isinstance(run := tables.get("run"), dict):
        # The output folder of the file is that of its own recordings.
        tables["run"] = {key: value for key, value in run.items() if key != "output"}
    origins: dict[Location, str] = {("kind",): "command"}
    if dates and len(dates) != len(recordings):
        raise ConfigError(
            "There must be one date for each recording.",
            where="--date",
            found=f"{len(dates)} for {len(recordings)} recordings",
            expected="one for each recording, in the same order, or none",
        )
    if recordings:
        tables["recordings"] = _entries(recordings, dates, _stated(document))
        if kind == "diagnose":  # one half of each to fit on, as long as nobody says better
            tables["recordings"] = [{**entry, "use": "split"} for entry in tables["recordings"]]
        origins[("recordings",)] = "recordings"
    if any(options.get(limit) is not None for limit in _LIMITS):
        # An option goes before a limit of either form in the file.
        joint = tables.get("joint", {})
        tables["joint"] = {key: one for key, one in joint.items() if key not in _LIMITS}
    for option, value in options.items():
        if value is not None:
            path_like = option in _PATH_OPTIONS and str(value) != PUBLISHED
            plain = str(Path(str(value)).absolute()) if path_like else value
            own = option == "bench" and kind in _OF_OWN_BENCH
            location = ("bench",) if own else OPTIONS[option]
            _set(tables, location, plain)
            origins[location] = "--" + option.replace("_", "-")
    _set_default_output(tables, _default_output(kind, recordings, config))
    return replace(document, tables=tables, origins=origins).run_config()


def require_text_names(paths: Iterable[Path]) -> None:
    """Refuse file names that are not UTF-8, which configurations and results could not hold."""
    for path in paths:
        if str(path) != str(path).encode(errors="replace").decode():
            raise ConfigError(
                "The name of this file is not UTF-8, and cannot be written into a configuration.",
                file=path,
                expected="the file under another name",
            )


def dump_config(config: RunConfig) -> str:
    """The configuration as TOML with all defaults, which loads back to an equal one."""
    return tomli_w.dumps(_plain(config.model_dump(by_alias=True, exclude_none=True)))


def files_of(value: Any) -> list[Path]:
    """Every path in a configuration's tables, also as text in the rows of a study."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list | tuple):
        return [path for item in value for path in files_of(item)]
    # A study's rows hold full paths where text names a file.
    text = isinstance(value, str) and os.path.isabs(value) and os.path.isfile(value)
    return [Path(value)] if text or isinstance(value, Path) else []


def kind_of(path: str | Path) -> str:
    """The kind that a file states; empty if it cannot be read, which loading then reports."""
    try:
        return _read(Path(path)).kind
    except ConfigError:
        return ""


def _read(path: Path) -> _Document:
    init = f"bayesbl init {shlex.quote(str(path))}"
    hint = f"a configuration in TOML; `{init}` writes one for a recording"
    return _Document.read(path, "a configuration in TOML", hint)


def _stated(document: _Document) -> dict[str, _Tables]:
    """Date and repair of recordings as a configuration states them, by file."""
    entries = document.tables.get("recordings")
    stated = {}
    for entry in entries if isinstance(entries, list) else []:
        if isinstance(entry, dict) and isinstance(entry.get("file"), str):
            place = _place(Path(document.directory, entry["file"]))
            stated[place] = {key: entry[key] for key in _OF_A_FILE if key in entry}
    return stated


def _place(path: str | Path) -> str:
    """The same text for all names of a file; an invalid path is refused when it is read."""
    try:
        return os.path.realpath(path)
    except ValueError:
        return str(path)


def _entries(
    recordings: Sequence[str | Path], dates: Sequence[Date], stated: Mapping[str, _Tables]
) -> list[_Tables]:
    """Entries for recordings given by path, each with its own name.

    They take over what is ``stated`` about their files, if that dates all of them.
    """
    entries: list[_Tables] = [
        {"name": name, "file": str(Path(path).absolute())}
        for path, name in zip(recordings, names_of(recordings), strict=True)
    ]
    if dates:
        return [{**entry, "date": day} for entry, day in zip(entries, dates, strict=True)]
    known = [stated.get(_place(path), {}) for path in recordings]
    if not all("date" in own for own in known):
        return entries
    return [{**own, **entry} for own, entry in zip(known, entries, strict=True)]


def _default_output(kind: str, recordings: Sequence[str | Path], config: str | Path | None) -> str:
    """Name below ``results``: the command with its recordings, or the configuration's own name."""
    if not recordings:
        return Path(config or "run").stem
    stems = dict.fromkeys(name_of(stem_of(Path(p))) for p in (recordings[0], recordings[-1]))
    return "_".join((kind, *stems)).encode()[:_LONGEST_OUTPUT].decode(errors="ignore")


def _set_default_output(tables: _Tables, name: str) -> None:
    run = tables.get("run", {})
    if isinstance(run, dict) and run.get("output") is None:
        tables["run"] = {**run, "output": str(Path("results", name).absolute())}


def _set(tables: _Tables, location: Location, value: object) -> None:
    """Set a value in a copy of its section; a section that is no table is left."""
    key = str(location[0])
    if len(location) == 1:
        tables[key] = value
        return
    section = tables.get(key, {})
    if isinstance(section, dict):
        tables[key] = dict(section)
        _set(tables[key], location[1:], value)


def _plain(value: Any) -> Any:
    """Paths as text and tuples as lists, recursively."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value
