"""Write a first configuration for new recordings, or a bench file to fill in."""

from __future__ import annotations

import json
import os
import re
import shlex
from collections.abc import Sequence
from datetime import date
from importlib import resources
from pathlib import Path

from bayesbl.config.loading import require_text_names
from bayesbl.config.sections import name_of, names_of
from bayesbl.errors import ConfigError, naming
from bayesbl.recording.formats import FORMATS
from bayesbl.recording.guessing import Guess, guess_columns
from bayesbl.recording.input_bytes import stem_of, suffix_of
from bayesbl.recording.readers import read_table
from bayesbl.results.folder import require_apart
from bayesbl.results.store import write_text


def require_new(path: Path, what: str, force: bool) -> None:
    """Require a new file, or one to replace, and no recording's name; ``what`` it is."""
    if suffix_of(path) in FORMATS:
        raise ConfigError(
            f"A {what} under this name would be taken for a recording.",
            file=path,
            expected="a name ending in .toml",
        )
    if path.exists() and not force:
        raise ConfigError(
            f"The {what} exists already, and is not overwritten.",
            file=path,
            expected="another file (--out), or --force to replace it",
        )


def start_config(
    recordings: Sequence[str | Path],
    out: str | Path | None = None,
    *,
    joint: str | None = None,
    force: bool = False,
) -> tuple[Path, Guess]:
    """Write a commented configuration: ``fit`` for one recording, ``compare`` for several.

    The first recording is examined; all have its columns. ``out`` is named after it by default, in
    the working directory; ``joint`` chooses one of several; ``force`` replaces a file. Raises
    UserError if a recording cannot be read, the first has no time, or ``out`` exists or is a
    recording.
    """
    first = Path(recordings[0])
    path = Path(out) if out is not None else Path(f"{name_of(stem_of(first))}.toml")
    files = [Path(file) for file in recordings]
    require_text_names(files)
    require_apart([path], files)
    require_new(path, "configuration", force)
    table, *_ = [read_table(file) for file in recordings]
    with naming(first):
        guess = guess_columns(table, joint)
    write_text(config_text(files, path, guess), path)
    return path, guess


def config_text(recordings: Sequence[Path], path: Path, guess: Guess) -> str:
    """The configuration as TOML with comments; paths are relative to that of ``path``."""
    from jinja2 import Environment, StrictUndefined

    form = Environment(
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True, undefined=StrictUndefined
    )
    form.filters["quoted"] = lambda text: json.dumps(text, ensure_ascii=False).replace(
        "\x7f", "\\u007f"
    )
    names, dates = names_of(recordings), [_date_in(file.name) for file in recordings]
    files = [Path(os.path.relpath(file, path.parent)).as_posix() for file in recordings]
    return form.from_string(_beside(FIRST_CONFIGURATION)).render(
        command=shlex.quote(path.name),
        kind="fit" if len(recordings) == 1 else "compare",
        output=f"results/{name_of(path.stem)}",
        guess=guess,
        recordings=list(zip(names, files, dates, strict=True)),
        are_dated=all(dates),
    )


def _date_in(name: str) -> str:
    """The date in a file's name, 2026-03-01; empty without one."""
    match = re.search(r"(?<!\d)(20\d\d)-(\d\d)-(\d\d)(?!\d)", name)
    try:
        return "" if match is None else date.fromisoformat(match[0]).isoformat()
    except ValueError:
        return ""


FIRST_CONFIGURATION, FIRST_BENCH = "first_configuration.toml.jinja", "joint.toml"
"""Template of a configuration and a bench file, beside this module. The latter refers to itself by
this name."""


def _beside(name: str) -> str:
    return resources.files("bayesbl.runs").joinpath(name).read_text("utf-8")


def write_first_bench(out: str | Path | None = None, *, force: bool = False) -> Path:
    """Write the commented bench file; return its path.

    Raises UserError if it exists and ``force`` is not given, or if it cannot be written.
    """
    path = Path(out) if out is not None else Path(FIRST_BENCH)
    require_new(path, "bench file", force)
    write_text(_beside(FIRST_BENCH).replace(FIRST_BENCH, path.name), path)
    return path
