"""A first configuration for recordings, or a bench file, that nobody has described yet."""

from __future__ import annotations

import json
import os
import shlex
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bayesbl.bench.parameters import PARAMETER_INFO
from bayesbl.config.files import require_text_names
from bayesbl.config.sections import name_of, names_of
from bayesbl.errors import ConfigError
from bayesbl.recording.formats import formats
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
    if suffix_of(path) in formats():
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


def require_writable(path: Path, inputs: Sequence[Path], force: bool) -> None:
    """A configuration can be written to ``path``, over none of its inputs.

    Raises
    ------
    UserError
        If not.
    """
    require_text_names(inputs)
    require_apart([path], inputs)
    require_new(path, "configuration", force)


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
        If a recording cannot be read, the first holds no speed, or the file is there or is a
        recording.
    """
    first = Path(recordings[0])
    path = Path(out) if out is not None else Path(f"{name_of(stem_of(first))}.toml")
    require_writable(path, [Path(file) for file in recordings], force)
    table, *_ = [read_table(file) for file in recordings]
    guess = guess_columns(first, table, joint)
    write_text(config_text([Path(file) for file in recordings], path, guess), path)
    return path, guess


def config_text(recordings: Sequence[Path], path: Path, guess: Guess) -> str:
    """The configuration as TOML with comments; recordings relative to ``path``'s folder."""
    kind = "fit" if len(recordings) == 1 else "compare"
    ramps = guess.torque_ramps
    names = names_of(recordings)
    before = (
        "# decide_before = 2027-01-01   # asks how probably the gap passes the limit by then; "
        "needs dates\n"
    )
    dated = (
        "# date = 2026-07-01            # when it was taken; for every recording, or for none\n"
        "# repaired = true              # if this is the first one after a repair\n"
    )
    entries = "\n".join(
        f"[[recordings]]\nname = {quoted(name)}\nfile = {quoted(relative(file, path))}\n"
        + (_MORE_FILES if ramps else "" if guess.two_encoders else _ASKED_SPEED)
        + (dated if kind == "compare" else "")
        for name, file in zip(names, recordings, strict=True)
    )
    return f"""\
# Check the columns, then:   bayesbl run {shlex.quote(path.name)}

schema = 1
kind = "{kind}"

[run]
seed = 1                # same seed, same numbers
output = {quoted(f"results/{name_of(path.stem)}")}

[joint]
{_RAMPS_JOINT if ramps else _JOINT}\
# limit = "1.2 mrad delta"   # when to repair: δ, which is half the play; or the whole play, as in
                             # "8 arcmin play" or "0.5 mm play at 0.4 m"
{before if kind == "compare" else ""}
# Each channel with the column that holds it. These are guesses: names and units decide the answer.
[columns]
{column_lines(guess)}
{entries}
[interval]
level = 0.9             # of the credible intervals

{_RAMPS_ESTIMATOR if ramps else _ENCODERS_ESTIMATOR if guess.two_encoders else _ESTIMATOR}"""


_JOINT = "# gear_ratio = 120.0    # motor turns per turn of the load\n"

_RAMPS_JOINT = """\
gear_ratio = 1.0        # motor turns per turn of the output; 1.0 where position and torque are of
                        # the output already
# rated_torque_nm = 50  # at the output: lost motion is stated at 3 % of it
"""

_ASKED_SPEED = "# reference_speed_rpm = 2000   # the speed asked of the drive: shows a wrong unit\n"

_MORE_FILES = (
    '# files = ["…", "…"]          # in place of file: ramps at several positions around the turn\n'
)

_ESTIMATOR = """\
# The gap needs a description of the joint; without one only the ringing is compared.
[estimator]
# bench = "bench.toml"  # a data sheet (bayesbl init --bench writes one to fill in), or the folder
                        # of an identify
"""

_RAMPS_ESTIMATOR = """\
# Without a speed, these look like ramps of torque to and fro with the output held.
[estimator]
route = "torque_ramp"
"""


_ENCODERS_ESTIMATOR = """\
# Motor and load have an encoder each, and the motor goes to and fro: the play shows in them.
[estimator]
route = "two_encoders"
"""


def column_lines(guess: Guess) -> str:
    """The entries of ``[columns]``, each with its reason, and the columns that have none."""
    lines = [
        f"{'# ' if column.unit == UNKNOWN else ''}"
        f"{column.channel} = {{name = {quoted(column.name)}, unit = {quoted(column.unit)}}}"
        f"    # {column.reason}\n"
        for column in guess.columns
    ]
    if guess.unused:
        lines.append(f"# Not used: {', '.join(quoted(name) for name in guess.unused)}\n")
    return "".join(lines)


def commented(text: str) -> str:
    """Text as a comment of a TOML file, in lines of its usual width."""
    return textwrap.fill(text, 98, initial_indent="# ", subsequent_indent="# ")


def quoted(text: str) -> str:
    """Text as TOML has it."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def relative(file: Path, path: Path) -> str:
    """A file as the configuration at ``path`` names it."""
    return Path(os.path.relpath(file, path.parent)).as_posix()


@dataclass(frozen=True, slots=True)
class Source:
    """Where a parameter comes from.

    Attributes
    ----------
    told
        Where it stands, or how to weigh or estimate it.
    usual
        By size of robot; empty where it has none.
    example
        The entry, in a unit as it is printed.
    given
        Whether the entry stands as it is: most joints need no other.
    """

    told: str
    usual: str
    example: str
    given: bool = False


SOURCES: Mapping[str, Source] = {
    "gear_ratio": Source(
        "Gear ratio N: on the gearbox's type plate, times any belt or bevel stage in front of it. "
        "Exact: no tolerance.",
        "50 to 200",
        "{value = 120}",
    ),
    "motor_inertia_kg_m2": Source(
        "J_m: the motor's data sheet (rotor inertia), plus brake, coupling, and the gearbox's own "
        "inertia at its input, which its data sheet gives.",
        "small arm 0.1 to 1 kg cm2, 10 kg payload 1 to 10, 200 kg payload 10 to 100",
        '{value = 12.1, unit = "kg cm2", relative_tolerance = 0.15}',
    ),
    "load_inertia_kg_m2": Source(
        "J_l: everything that turns behind the gear, arm and payload included: CAD, or Σ m r² of "
        "its parts. It depends on the pose of the joints behind: keep that in all recordings.",
        "small arm 0.1 to 2 kg m2, 10 kg payload 1 to 20, 200 kg payload 50 to 1500",
        '{value = 20.0, unit = "kg m2", relative_tolerance = 0.25}',
    ),
    "shaft_stiffness_nm_per_rad": Source(
        "K_s, seen at the load: the gearbox's data sheet (torsional stiffness, N m/arcmin; or "
        "its inverse, arcmin/N m). Bearings and castings in series make the joint softer, by a "
        "fifth to a half.",
        "small arm 2 to 10 N m/arcmin, 10 kg payload 10 to 50, 200 kg payload 100 to 1000",
        '{value = 35.0, unit = "N m/arcmin", relative_tolerance = 0.25}',
    ),
    "shaft_damping_nm_s_per_rad": Source(
        "D_s, seen at the load: on no data sheet, and smaller at a light touch. Leave its "
        "tolerance wide: recordings show it well, and a narrow one biases the gap.",
        "damping ratio 0.005 to 0.2",
        '{value = 0.1, unit = "damping ratio", relative_tolerance = 0.95}',
    ),
    "gravity_torque_nm": Source(
        "m g l: gravity's torque about the axis with the arm level. Mass times lever arm (unit "
        "kg m) from CAD; or torque_constant × current × gear ratio near level, the mean of moving "
        "up and down slowly, so that friction cancels.",
        "small arm 2 to 30 N m, 10 kg payload 20 to 300, 200 kg payload 500 to 10000",
        '{value = 43.0, unit = "kg m", relative_tolerance = 0.2}',
    ),
    "torque_constant_nm_per_a": Source(
        "K_t: the motor's data sheet, for the current that is recorded. If the drive records peak "
        "current and the data sheet means effective current, it is off by a factor of 1.41.",
        "0.1 to 1.5 N m/A",
        '{value = 0.5, unit = "N m/A", relative_tolerance = 0.1}',
    ),
    "speed_gain_nm_s_per_rad": Source(
        "K_p of the speed controller: the drive's parameter list (speed controller gain). In "
        'N m s/rad; "A s/rad" or "A/rpm" are multiplied by the torque constant; "1/s" is a '
        "bandwidth, multiplied by all inertia at the motor. Read it from the drive: no other value "
        "affects the gap as much.",
        "small arm 0.005 to 0.05 N m s/rad, 10 kg payload 0.05 to 0.5, 200 kg payload 0.5 to 5",
        '{value = 0.185, unit = "N m s/rad", relative_tolerance = 0.1}',
    ),
    "integral_gain_nm_per_rad": Source(
        'K_i of the speed controller. Drives give the reset time instead (unit "ms"): K_i is K_p '
        "over it.",
        "reset time 5 to 50 ms",
        '{value = 23.0, unit = "ms", relative_tolerance = 0.1}',
    ),
    "position_gain_per_s": Source(
        'Gain of the position controller around it (Kv; "1/s", or "m/min/mm"): 0 where the '
        "joint is run in speed control.",
        "10 to 50 1/s",
        "{value = 0.0}",
        given=True,
    ),
    "current_limit_a": Source(
        "i_max: the drive's largest current, in the same measure as the recorded one. The "
        "recordings must stay below it.",
        "",
        '{value = 30.0, unit = "A"}',
    ),
    "reference_speed_rpm": Source(
        "The motor's speed in most recordings; of others, the mean speed counts unless the "
        "recording states one. For strokes, the speed that they reach.",
        "500 to 3000 rpm",
        "{value = 2000.0}",
    ),
}

HEAD = """\
# Data sheet of a joint. In each line under [parameters], enter your number, its printed unit and
# how far it may be off, and delete the # in front. Friction needs no line: it is always fitted.
# Then
#
#     bayesbl check {file}
#     bayesbl identify FORWARD REVERSE SLOWER --bench {file}
#
# relative_tolerance = 0.25 is ± 25 %: values beyond it count as impossible, so be generous. A value
# without a tolerance counts as exact.

schema = 1
kind = "bench"
drive = "two_mass"

[parameters]
"""


def write_first_bench(out: str | Path | None = None, *, force: bool = False) -> Path:
    """Write the commented bench file; the path.

    Raises
    ------
    UserError
        If the file is there and ``force`` is not given, or cannot be written.
    """
    path = Path(out) if out is not None else Path("joint.toml")
    require_new(path, "bench file", force)
    write_text(first_bench(path.name), path)
    return path


DRIVE = """\
# Sampling time of the drive's speed controller (its manual: 62.5 µs to 4 ms). It matters above
# 100 µs. If a bus or torque filter adds dead time, state delay_periods too: the periods from
# reading the encoder to the torque (1 by default).
# [[effects]]
# name = "sampled_control"
# parameters = {period_s = {value = 250e-6}}

# A belt between motor and gear: its stiffness at the motor (N m/rad: the belt's data sheet, or
# (2 π f)² J of its frequency f), and how much of J_m is behind it (driven pulley, reducer's input).
# [belt]
# stiffness_nm_per_rad = {value = 80.0, relative_tolerance = 0.5}
# damping_nm_s_per_rad = {value = 0.02, relative_tolerance = 0.9}
# reducer_inertia_kg_m2 = {value = 4e-4, relative_tolerance = 0.3}

# An arm or payload that bends: the part of J_l and m g l behind its spring. [base] is the same for
# what the joint is mounted on, without gravity_share.
# [arm]
# stiffness_nm_per_rad = {value = 4e4, relative_tolerance = 0.5}
# damping_nm_s_per_rad = {value = 60.0, relative_tolerance = 0.9}
# inertia_kg_m2 = {value = 5.0, relative_tolerance = 0.3}
# gravity_share = {value = 0.5, tolerance = 0.3}

# If the recorded speed is not the one that the controller uses: a mean over speed_filter_s, or the
# encoder's position, differentiated from sample to sample (speed_source = "encoder").
# [measurement]
# encoder_counts = 16384
# speed_filter_s = 4e-3
"""


def first_bench(file: str) -> str:
    """The bench file as text; ``file`` is its name."""
    entries = "\n".join(_entry(name, source) for name, source in SOURCES.items())
    return HEAD.format(file=file) + "\n" + entries + "\n" + DRIVE


def _entry(name: str, source: Source) -> str:
    told = f"{source.told} Usual: {source.usual}." if source.usual else source.told
    unit = PARAMETER_INFO[name].unit
    without = "" if "unit" in source.example or not unit else f"    # {unit}"
    sign = "" if source.given else "# "
    return f"{commented(told)}\n{sign}{name} = {source.example}{without}\n"
