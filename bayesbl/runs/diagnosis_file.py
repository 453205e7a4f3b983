"""A diagnosis from recordings and a bench alone: run at once, or written down to be corrected."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import cast

from bayesbl.config.diagnose import DiagnoseConfig
from bayesbl.config.fields import RESULT_FILE, names_of
from bayesbl.config.loading import config_from_options
from bayesbl.recording.channels import ColumnSpec
from bayesbl.recording.guessing import Guess, guess_columns
from bayesbl.recording.readers import read_recording, read_table
from bayesbl.results.identified import bench_from
from bayesbl.results.store import write_text
from bayesbl.runs.first_configuration import (
    column_lines,
    commented,
    quoted,
    relative,
    require_writable,
)
from bayesbl.runs.first_diagnosis import Choice, completed, guess_diagnosis, toml

DEFAULT_FILE = "diagnose.toml"


def diagnosis_of(
    recordings: Sequence[str | Path], config: str | Path | None = None, **options: object
) -> tuple[DiagnoseConfig, list[Choice]]:
    """The configuration that recordings and options make, and what of it was guessed.

    Parameters
    ----------
    config
        A configuration to start from: of a diagnosis, or of a measurement with its columns.
    options
        As :func:`bayesbl.config.loading.config_from_options` takes them, ``bench`` among them.

    Raises
    ------
    UserError
        If anything given cannot be used, or no method suits recordings and bench.
    """
    made = cast(DiagnoseConfig, config_from_options("diagnose", recordings, config, (), **options))
    read = [
        read_recording(entry.file, name=entry.name, columns=made.column_specs)
        for entry in made.recordings
    ]
    guess = guess_diagnosis(bench_from(made.bench), read, made)
    return completed(made, guess), guess


def start_diagnosis(
    bench: Path,
    recordings: Sequence[Path],
    out: Path | None = None,
    *,
    joint: str | None = None,
    force: bool = False,
) -> tuple[Path, Guess, list[Choice]]:
    """Write a commented configuration of a diagnosis; its path, and what was guessed.

    Parameters
    ----------
    bench
        A bench file, or the result of an identification.
    recordings
        Files with the same columns; the first one is looked at for these.
    joint
        Which one, where a file holds several.

    Raises
    ------
    UserError
        If bench or recordings cannot be used, or the file is there or is one of them.
    """
    path = out or Path(DEFAULT_FILE)
    bench = bench / RESULT_FILE if bench.is_dir() else bench
    require_writable(path, [*recordings, bench], force)
    table = read_table(recordings[0])
    columns = guess_columns(recordings[0], table, joint, position_will_do=True)
    specs = {c.channel: ColumnSpec(c.name, c.unit) for c in columns.columns}
    names = names_of(recordings)
    read = [
        read_recording(file, name=name, columns=specs)
        for file, name in zip(recordings, names, strict=True)
    ]
    guess = guess_diagnosis(bench_from(bench), read)
    files = dict(zip(names, recordings, strict=True))
    write_text(_text(path, bench, files, columns, guess), path)
    return path, columns, guess


def _text(
    path: Path, bench: Path, files: dict[str, Path], columns: Guess, guess: Sequence[Choice]
) -> str:
    entries = "\n".join(
        f"[[recordings]]\nname = {quoted(name)}\nfile = {quoted(relative(file, path))}\n"
        + _lines(guess, name)
        for name, file in files.items()
    )
    return f"""\
# What does the bench lack that these recordings show? All of this is guessed: check it, then
#
#     bayesbl run {shlex.quote(path.name)}

schema = 1
kind = "diagnose"
bench = {quoted(relative(bench, path))}

[run]
seed = 1                # same seed, same numbers
output = {quoted(f"results/{path.stem}")}

# Each channel with the column that holds it. Names and units decide the answer.
[columns]
{column_lines(columns)}
[comparison]
{_lines(guess, "comparison")}\
# load_angle_known = true    # if a position of 0 means that the link hangs straight down
# motor_angle_known = true   # if the motor's encoder is absolute: its ripple then has one phase
# known_torque = ["…_nm"]    # columns of torques that the bench does not hold, N m at the motor

[unknowns]
{_lines(guess, "unknowns")}
{entries}"""


def _lines(guess: Sequence[Choice], section: str) -> str:
    """Every value of a section below its reason."""
    return "".join(
        f"{commented(choice.reason)}\n{choice.place[1]} = {toml(choice.value)}\n"
        for choice in guess
        if choice.place[0] == section
    )
