"""Commands that ask about the bench: a joint's own from its data sheet, and what one lacks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from bayesbl.cli import options
from bayesbl.cli.running import given_files, guessing_columns, notes_console, run_config, run_file
from bayesbl.errors import ConfigError

DataSheet = Annotated[
    Path | None,
    typer.Option(
        "--bench",
        metavar="FILE",
        help="Data sheet of the joint: a bench file with tolerances (`bayesbl init --bench`).",
    ),
]

BelievedBench = Annotated[
    Path | None,
    typer.Option(
        "--bench",
        metavar="FILE|RESULT",
        help="The bench that should describe them: its file, or what identify found.",
    ),
]

Inputs = Annotated[
    list[Path],
    typer.Argument(
        metavar="CONFIG | RECORDING …",
        help="A configuration, or recordings: best in both directions and at two speeds.",
    ),
]

Effects = Annotated[
    str | None,
    typer.Option(
        "--effects",
        metavar="catalogue|NAME,NAME",
        help="Effects that the data sheet lacks: found where recordings show any, or free by name.",
    ),
]


def identify_command(
    inputs: Inputs,
    bench: DataSheet = None,
    effects: Effects = None,
    dates: options.Dates = None,
    config: options.BaseConfig = None,
    out: options.Out = None,
    seed: options.Seed = None,
    force: options.Force = False,
    json: options.Json = False,
    level: options.Level = None,
    workers: options.Workers = None,
) -> None:
    """Find the bench of a joint from its data sheet and recordings, with the gap."""
    given: dict[str, Any] = {"out": out, "seed": seed, "workers": workers}
    given |= {"bench": bench, "level": level}
    if effects is not None:
        given["effects"] = effects if effects == "catalogue" else effects.split(",")
    from bayesbl.config.loading import config_from_options

    if _is_configuration(inputs):
        loaded = config_from_options("identify", (), inputs[0], **given)
        run_config(loaded, force, json, inputs[0])
        return
    if bench is None and config is None:
        raise _without_bench("An identification starts from a data sheet.", "datasheet.toml")
    loaded = config_from_options("identify", inputs, config, dates or (), **given)
    run_config(loaded, force, json, config)


def diagnose_command(
    inputs: Inputs,
    bench: BelievedBench = None,
    config: options.BaseConfig = None,
    out: options.Out = None,
    seed: options.Seed = None,
    force: options.Force = False,
    json: options.Json = False,
    level: options.Level = None,
    workers: options.Workers = None,
) -> None:
    """Find what a bench lacks that recordings show."""
    given: dict[str, Any] = {"out": out, "seed": seed, "workers": workers}
    given |= {"bench": bench, "level": level}
    if _is_configuration(inputs):
        run_file(inputs[0], force, json, kind="diagnose", **given)
        return
    if bench is None and config is None:
        raise _without_bench("A diagnosis needs the bench that may lack something.", "bench.toml")
    from bayesbl.runs.first_diagnosis import diagnosis_of

    files = given_files([*([bench] if bench else []), *inputs])
    with guessing_columns(f"init --diagnose {files}", config):
        loaded, guess = diagnosis_of(inputs, config, **given)
    console = notes_console()
    for choice in guess:
        console.print(f"Guessed: {choice.told}", markup=False, highlight=False)
    run_config(loaded, force, json, config)


def _is_configuration(inputs: list[Path]) -> bool:
    return len(inputs) == 1 and inputs[0].suffix.lower() == ".toml"


def _without_bench(problem: str, example: str) -> ConfigError:
    return ConfigError(
        problem,
        where="--bench",
        found="nothing",
        expected=f"--bench {example}; `bayesbl init --bench` writes one to fill in",
    )
