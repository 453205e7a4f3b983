"""Commands on a configuration: write a first one, check it, run it whatever its kind."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayesbl.cli.options import Before, ConfigPath, Force, Json, Out, Scheduler, Seed, Workers
from bayesbl.cli.running import run_config, simulate
from bayesbl.cli.statuses import WRONG
from bayesbl.errors import ConfigError


def run_command(
    config: ConfigPath,
    out: Out = None,
    seed: Seed = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    before: Before = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Run a configuration, whatever its kind."""
    from bayesbl.runs.run import kind_of, load_run

    kind = kind_of(config)
    if scheduler is not None and kind not in ("study", ""):
        raise ConfigError(
            "Only studies run on a cluster.",
            file=config,
            where="--scheduler",
            found=f'kind = "{kind}"',
            expected='kind = "study"',
        )
    if kind == "simulate":
        simulate(config, out, seed, workers, force, json)
    else:
        loaded = load_run(
            config, out=out, seed=seed, workers=workers, scheduler=scheduler, before=before
        )
        run_config(loaded, force, json)


def check_command(config: ConfigPath) -> None:
    """Check all that can be checked without running."""
    from bayesbl.presentation.console import error, make_console
    from bayesbl.runs.run import check

    plan = check(config)
    for label, text in plan.lines:
        typer.echo(f"{label}: {text}")
    for warning in plan.warnings:
        typer.echo(f"warning: {warning}")
    for problem in plan.problems:
        error(make_console(stderr=True), problem)
    if plan.problems:
        raise typer.Exit(WRONG)
    typer.echo("Nothing stands against a run.")


def init_command(
    recordings: Annotated[
        list[Path],
        typer.Argument(metavar="RECORDING", help="One to be fitted, several to be compared."),
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help="The file to write. [default: RECORDING.toml]"),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the file.")] = False,
) -> None:
    """Write a first configuration for recordings, columns and units guessed."""
    from bayesbl.presentation.console import error, make_console
    from bayesbl.presentation.first_configuration import print_guess
    from bayesbl.runs.first_configuration import start_config
    from bayesbl.runs.run import check

    path, guess = start_config(recordings, out, force=force)
    plan = check(path)
    print_guess(guess, path, make_console(), sound=not plan.problems)
    for warning in plan.warnings:
        typer.echo(f"warning: {warning}")
    for problem in plan.problems:
        error(make_console(stderr=True), problem)
    if plan.problems:
        raise typer.Exit(WRONG)
