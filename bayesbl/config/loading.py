"""From a TOML file or command-line options to a validated configuration, and back to TOML.

A configuration is validated whole: everything that is wrong with it is reported at once.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date as Date
from pathlib import Path
from types import MappingProxyType
from typing import Any

import tomli_w

from bayesbl.arguments import File, checked
from bayesbl.config.files import Location, place_of_kind, read_toml, require_kind, validated
from bayesbl.config.kinds import KINDS, RUNNABLE
from bayesbl.config.measurement import SnapshotConfig
from bayesbl.config.sections import PUBLISHED, RunConfig, name_of, names_of
from bayesbl.errors import ConfigError
from bayesbl.recording.channels import did_you_mean
from bayesbl.recording.input_bytes import stem_of

OPTIONS: Mapping[str, Location] = MappingProxyType(
    {
        "curve": ("curve", "source"),
        "bench": ("estimator", "bench"),
        "effects": ("identify", "effects"),
        "route": ("estimator", "route"),
        "level": ("interval", "level"),
        "limit": ("joint", "limit"),
        "limit_rad": ("joint", "limit_rad"),
        "before": ("joint", "decide_before"),
        "gear_ratio": ("joint", "gear_ratio"),
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
)
"""Command-line option to the field it sets."""

_PATH_OPTIONS = frozenset({"curve", "bench", "start_from", "out"})

_LIMITS = ("limit", "limit_rad")

_OF_KIND: Mapping[str, Mapping[str, Location]] = MappingProxyType(
    {kind: {"bench": ("bench",)} for kind in ("identify", "plan", "diagnose")}
)
"""Options that set another field in some kinds."""

_COMMON_SECTIONS = ("schema", "run", "columns", "interval")
"""Sections that identification and diagnosis take from the configuration of a measurement."""

_OF_A_BENCH = ("identify", "diagnose")
"""Kinds that ask about the bench, whose files have sections of their own."""

_LONGEST_OUTPUT = 200
"""Bytes in the name of an output folder; file systems take 255, and hidden siblings need some."""

_Tables = dict[str, Any]


@dataclass(frozen=True, slots=True)
class _Document:
    """A configuration as it was written, before validation.

    ``origins`` names what an option set, by location: such problems are not the file's.
    """

    tables: _Tables
    directory: Path
    file: Path | None = None
    text: str = ""
    origins: Mapping[Location, str] = field(default_factory=dict)


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
    document = _read(Path(path))
    require_kind(document.tables, KINDS if kind is None else [kind], document.file, document.text)
    _set_default_output(document.tables, Path(path).stem)
    return _validate(document)


def config_from_options(
    kind: str,
    recordings: Sequence[str | Path] = (),
    config: str | Path | None = None,
    dates: Sequence[Date] = (),
    **options: object,
) -> RunConfig:
    """The configuration of a command: options override the file, which overrides the defaults.

    Parameters
    ----------
    kind
        That of ``config``; ``"fit"`` or ``"compare"`` where there are ``recordings``.
    recordings
        Files relative to the working directory; they replace those of ``config``.
    config
        A configuration to start from, of any kind that shares the sections.
    dates
        When each of ``recordings`` was taken; none by default.
    options
        Keys of :data:`OPTIONS`; ``None`` means not given. Paths are relative to the working
        directory.

    Raises
    ------
    ConfigError
        As :func:`load_config`; problems of options are named by the option.
    """
    document = _Document({}, Path.cwd()) if config is None else _read(Path(config))
    require_kind(document.tables, _sharing(kind), document.file, document.text)
    tables = {"schema": 1, **document.tables, "kind": kind}
    if kind in _OF_A_BENCH and _kind_of(document) not in ("", kind):
        tables = {name: tables[name] for name in _COMMON_SECTIONS if name in tables}
        tables["kind"] = kind
        tables["run"] = {k: v for k, v in tables.get("run", {}).items() if k != "output"}
    origins: dict[Location, str] = {("kind",): "command"}
    if dates and len(dates) != len(recordings):
        raise ConfigError(
            "There must be one date for each recording.",
            where="--date",
            found=f"{len(dates)} for {len(recordings)} recordings",
            expected="one for each recording, in the same order, or none",
        )
    if recordings:
        tables["recordings"] = _entries(recordings, dates)
        if kind == "diagnose":  # one half of each to fit on, as long as nobody says better
            tables["recordings"] = [{**entry, "use": "split"} for entry in tables["recordings"]]
        origins[("recordings",)] = "recordings"
    if any(options.get(limit) is not None for limit in _LIMITS):
        # An option goes before a limit of either form in the file.
        joint = tables.get("joint", {})
        tables["joint"] = {key: one for key, one in joint.items() if key not in _LIMITS}
    for option, value in options.items():
        if value is not None:
            path_like = option in _PATH_OPTIONS and value != PUBLISHED
            plain = str(Path(str(value)).absolute()) if path_like else value
            location = _OF_KIND.get(kind, OPTIONS).get(option, OPTIONS[option])
            _set(tables, location, plain)
            origins[location] = "--" + option.replace("_", "-")
    _set_default_output(tables, _default_output(kind, recordings, config))
    return _validate(replace(document, tables=tables, origins=origins))


def _sharing(kind: str) -> list[str]:
    """The kinds whose files a run of this kind can start from: those with the same sections."""
    measured = [other for other, model in KINDS.items() if issubclass(model, SnapshotConfig)]
    if kind in _OF_A_BENCH:
        return [kind, *measured]
    return measured if kind in measured else [kind]


def dump_config(config: RunConfig) -> str:
    """The configuration as TOML, defaults filled in; it loads back to an equal one."""
    return tomli_w.dumps(_plain(config.model_dump(by_alias=True, exclude_none=True)))


def files_of(value: Any) -> list[Path]:
    """Every path in a configuration's tables, as text in the rows of a study too."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list | tuple):
        return [path for item in value for path in files_of(item)]
    # A study's rows hold full paths where text names a file.
    text = isinstance(value, str) and os.path.isabs(value) and os.path.isfile(value)
    return [Path(value)] if text or isinstance(value, Path) else []


def _read(path: Path) -> _Document:
    init = f"bayesbl init {shlex.quote(str(path))}"
    hint = f"a configuration in TOML; `{init}` writes one for a recording"
    text, tables = read_toml(path, "a configuration in TOML", instead_of_recording=hint)
    return _Document(tables, Path(os.path.abspath(path)).parent, path, text)


def _validate(document: _Document) -> RunConfig:
    model = KINDS.get(_kind_of(document))
    if model is None:
        raise _wrong_kind(document)
    found = document
    return validated(model, found.tables, found.directory, found.file, found.text, found.origins)


def _kind_of(document: _Document) -> str:
    kind = document.tables.get("kind")
    return kind if isinstance(kind, str) else ""


def _wrong_kind(document: _Document) -> ConfigError:
    problem, found = "The kind of run is missing.", "nothing"
    if "kind" in document.tables:
        problem = "There is no such kind of run." + did_you_mean(_kind_of(document), RUNNABLE)
        found = repr(document.tables["kind"])
    return ConfigError(
        problem,
        file=document.file,
        where=place_of_kind(document.text),
        found=found,
        expected="one of " + ", ".join(f'"{name}"' for name in RUNNABLE),
    )


def _entries(recordings: Sequence[str | Path], dates: Sequence[Date]) -> list[_Tables]:
    """Entries for recordings given by path, each with a name of its own."""
    return [
        {
            "name": name,
            "file": str(Path(path).absolute()),
            **({"date": dates[number]} if dates else {}),
        }
        for number, (path, name) in enumerate(zip(recordings, names_of(recordings), strict=True))
    ]


def _default_output(kind: str, recordings: Sequence[str | Path], config: str | Path | None) -> str:
    """Name below ``results``: of recordings with the command, of a configuration its own."""
    if not recordings:
        return Path(config or "run").stem
    stems = dict.fromkeys(name_of(stem_of(Path(p))) for p in (recordings[0], recordings[-1]))
    return "_".join((kind, *stems)).encode()[:_LONGEST_OUTPUT].decode(errors="ignore")


def _set_default_output(tables: _Tables, name: str) -> None:
    run = tables.get("run", {})
    if isinstance(run, dict) and run.get("output") is None:
        tables["run"] = {**run, "output": str(Path("results", name).absolute())}


def _set(tables: _Tables, location: Location, value: object) -> None:
    """Put a value into a section of its own copy; a section that is no table stays as it is."""
    key = str(location[0])
    if len(location) == 1:
        tables[key] = value
        return
    section = tables.get(key, {})
    if isinstance(section, dict):
        tables[key] = dict(section)
        _set(tables[key], location[1:], value)


def _plain(value: Any) -> Any:
    """Paths as text, tuples as lists, all the way down."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value
