"""A first configuration for recordings, or a bench file, that nobody has described yet."""

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
from bayesbl.errors import ConfigError
from bayesbl.recording.formats import FORMATS
from bayesbl.recording.guessing import UNKNOWN, Guess, guess_columns
from bayesbl.recording.input_bytes import stem_of, suffix_of
from bayesbl.recording.readers import read_table
from bayesbl.results.folder import require_apart
from bayesbl.results.store import write_text


def require_new(path: Path, what: str, force: bool) -> None:
    """A file to be written has a name of its own, and is not there yet or may be replaced.

    Raises
    ------
    ConfigError
        If not; ``what`` says what was to be written.
    """
    if suffix_of(path) in FORMATS:
        raise ConfigError(
            f"A {what} under this name would be taken for a recording.",
            file=path,
            expected="a name ending in .toml",
        )
    if path.exists() and not force:
        raise ConfigError(
            f"The {what} is there already, and is not written over.",
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
    """Write a commented configuration: ``fit`` of one recording, ``compare`` of several.

    Parameters
    ----------
    recordings
        Files with the same columns; the first one is looked at.
    out
        The file to write; named after the first recording, in the working directory, by default.
    joint
        Which one, where a file holds several.
    force
        Write over an existing file.

    Raises
    ------
    UserError
        If a recording cannot be read, the first holds no time, or the file is there or is a
        recording.
    """
    first = Path(recordings[0])
    path = Path(out) if out is not None else Path(f"{name_of(stem_of(first))}.toml")
    files = [Path(file) for file in recordings]
    require_text_names(files)
    require_apart([path], files)
    require_new(path, "configuration", force)
    table, *_ = [read_table(file) for file in recordings]
    guess = guess_columns(table, joint)
    write_text(config_text(files, path, guess), path)
    return path, guess


def config_text(recordings: Sequence[Path], path: Path, guess: Guess) -> str:
    """The configuration as TOML with comments; recordings relative to ``path``'s folder."""
    kind = "fit" if len(recordings) == 1 else "compare"
    ramps = guess.route == "torque_ramp"
    names = names_of(recordings)
    before = (
        "# decide_before = 2027-01-01   # asks how probably the gap passes the limit by then; "
        "needs dates\n"
    )
    dates = [_date_in(file.name) for file in recordings]
    repaired = "# repaired = true              # if this is the first one after a repair\n"
    entry, why = "# date = 2026-07-01", "when it was taken; for every recording, or for none"
    dated = [
        (f"{f'date = {day}':<31}# from its name\n" if all(dates) else f"{entry:<31}# {why}\n")
        + repaired
        for day in dates
    ]
    entries = "\n".join(
        f"[[recordings]]\nname = {quoted(name)}\nfile = {quoted(relative(file, path))}\n"
        + (_MORE_FILES if ramps else "" if guess.route else _ASKED_SPEED)
        + (day if kind == "compare" else "")
        for name, file, day in zip(names, recordings, dated, strict=True)
    )
    return f"""\
# Check the columns, then:   bayesbl run {shlex.quote(path.name)}

schema = 1
kind = "{kind}"

[run]
seed = 1                # same seed, same numbers
output = {quoted(f"results/{name_of(path.stem)}")}

[joint]
{_RAMPS_JOINT.format('"?"' if guess.of_motor else "1.0") if ramps else _JOINT}\
# limit = "1.2 mrad delta"   # when to repair: δ, which is half the play; or the whole play, as in
                             # "8 arcmin play" or "0.5 mm play at 0.4 m"
{before if kind == "compare" else ""}
# Each channel with the column that holds it. These are guesses: names and units decide the answer.
# Fill in each "?", or take its line out.
[columns]
{column_lines(guess)}
{entries}
[interval]
level = 0.9             # of the credible intervals

{_ESTIMATORS[guess.route]}"""


def _date_in(name: str) -> str:
    """The date in a file's name, 2026-03-01; empty without one."""
    found = re.search(r"(?<!\d)(20\d\d)-(\d\d)-(\d\d)(?!\d)", name)
    try:
        return "" if found is None else date.fromisoformat(found[0]).isoformat()
    except ValueError:
        return ""


_JOINT = "# gear_ratio = 120.0    # motor turns per turn of the load\n"

_RAMPS_JOINT = """\
gear_ratio = {}        # motor turns per turn of the output; 1.0 where position and torque are of
                        # the output already
# rated_torque_nm = 50  # at the output: lost motion is stated at 3 % of it
"""

_ASKED_SPEED = "# reference_speed_rpm = 2000   # the speed asked of the drive: shows a wrong unit\n"

_MORE_FILES = (
    '# files = ["…", "…"]          # in place of file: ramps at several positions around the turn\n'
)

_ESTIMATORS = {
    "": """\
# The gap needs a description of the joint; without one only the ringing is compared.
[estimator]
# bench = "bench.toml"  # a data sheet (bayesbl init --bench writes one to fill in), or the folder
                        # of an identify
""",
    "torque_ramp": """\
# These look like ramps of torque to and fro with one side held.
[estimator]
route = "torque_ramp"
""",
    "two_encoders": """\
# Motor and load have an encoder each, and the motor goes to and fro: the play shows in them.
[estimator]
route = "two_encoders"
""",
}
"""By the route that a recording is for."""


def column_lines(guess: Guess) -> str:
    """The entries of ``[columns]``, each with its reason, and the columns that have none."""
    lines = [
        f"{'# ' if column.unit == UNKNOWN and not column.needed else ''}{column.channel} = "
        f"{{name = {quoted(column.name)}, unit = {quoted(column.unit)}}}    # {column.reason}\n"
        for column in guess.columns
    ]
    if guess.unused:
        lines.append(f"# Not used: {', '.join(quoted(name) for name in guess.unused)}\n")
    return "".join(lines)


def quoted(text: str) -> str:
    """Text as TOML has it."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def relative(file: Path, path: Path) -> str:
    """A file as the configuration at ``path`` names it."""
    return Path(os.path.relpath(file, path.parent)).as_posix()


FIRST_BENCH = "joint.toml"
"""Beside this module: a bench file to fill in, under the name that it speaks of itself by."""


def write_first_bench(out: str | Path | None = None, *, force: bool = False) -> Path:
    """Write the commented bench file; the path.

    Raises
    ------
    UserError
        If the file is there and ``force`` is not given, or cannot be written.
    """
    path = Path(out) if out is not None else Path(FIRST_BENCH)
    require_new(path, "bench file", force)
    text = resources.files("bayesbl.runs").joinpath(FIRST_BENCH).read_text("utf-8")
    write_text(text.replace(FIRST_BENCH, path.name), path)
    return path
