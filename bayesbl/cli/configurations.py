"""Commands on a configuration: write a first one, check it, run it whatever its kind."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bayesbl.cli.options import Before, ConfigPath, Force, Json, Out, Scheduler, Seed, Workers
from bayesbl.cli.running import run_file
from bayesbl.cli.statuses import WRONG
from bayesbl.errors import ConfigError

if TYPE_CHECKING:
    from bayesbl.runs.workflow import Plan


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
    from bayesbl.runs.kinds import kind_of

    kind = kind_of(config)
    if scheduler is not None and kind not in ("study", "fleet", ""):
        raise ConfigError(
            "Only studies and fleets run on a cluster.",
            file=config,
            where="--scheduler",
            found=f'kind = "{kind}"',
            expected='kind = "study" or "fleet"',
        )
    options: dict[str, Any] = {"out": out, "seed": seed, "workers": workers}
    run_file(config, force, json, **options, scheduler=scheduler, before=before)


def fleet_command(
    config: ConfigPath,
    out: Out = None,
    seed: Seed = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Measure what is new of many joints, and write their tables and pages."""
    options: dict[str, Any] = {"out": out, "seed": seed, "workers": workers}
    run_file(config, force, json, kind="fleet", **options, scheduler=scheduler)


def check_command(config: ConfigPath) -> None:
    """Check everything that can be checked without running."""
    from bayesbl.presentation.terminal import say
    from bayesbl.runs.kinds import check

    plan = check(config)
    for label, text in plan.lines:
        say(f"{label}: {text}")
    _print_findings(plan)
    say("Ready to run.")


def init_command(
    recordings: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="RECORDING",
            help="One to fit, several to compare; with --diagnose, the bench's file before them.",
        ),
    ] = None,
    bench: Annotated[
        bool,
        typer.Option("--bench", help="Write a joint's data sheet to fill in, joint.toml, instead."),
    ] = False,
    diagnose: Annotated[
        bool,
        typer.Option(
            "--diagnose",
            help="Write a diagnosis: what does the bench lack that the recordings show?",
        ),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="FILE",
            help="The file to write. [default: RECORDING.toml, or diagnose.toml]",
        ),
    ] = None,
    joint: Annotated[
        str | None,
        typer.Option("--joint", metavar="NAME", help="Which one, where a file holds several."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the file.")] = False,
) -> None:
    """Write a first configuration for recordings, or a joint's data sheet to fill in."""
    if bench:
        _init_bench(recordings, out, force)
        return
    if diagnose:
        _init_diagnosis(recordings or [], out, joint, force)
        return
    if not recordings:
        raise ConfigError(
            "There is nothing to write a configuration for.",
            where="RECORDING",
            found="nothing",
            expected="one or more recordings; or --bench for a joint's data sheet to fill in",
        )
    from bayesbl.presentation.first_configuration import guessed, what_next
    from bayesbl.presentation.terminal import make_console, print_blocks, say
    from bayesbl.runs.first_configuration import start_config
    from bayesbl.runs.kinds import check

    path, guess = start_config(recordings, out, joint=joint, force=force)
    plan = check(path)
    print_blocks(guessed(guess), make_console())
    told = what_next(
        path,
        sound=not plan.problems,
        torque_ramps=guess.torque_ramps,
        two_encoders=guess.two_encoders,
    )
    say(told)
    _print_findings(plan)


def _init_diagnosis(given: list[Path], out: Path | None, joint: str | None, force: bool) -> None:
    from bayesbl.presentation.first_configuration import chosen, guessed
    from bayesbl.presentation.terminal import make_console, print_blocks, say
    from bayesbl.runs.first_diagnosis import start_diagnosis
    from bayesbl.runs.kinds import check

    if len(given) < 2:
        raise ConfigError(
            "A diagnosis is guessed from a bench and recordings.",
            where="--diagnose",
            found=", ".join(map(str, given)) or "nothing",
            expected="bayesbl init --diagnose BENCH RECORDING …, best forward, reverse and at "
            "another speed; `bayesbl init --bench` writes a bench to fill in",
        )
    path, columns, guess = start_diagnosis(given[0], given[1:], out, joint=joint, force=force)
    plan = check(path)
    print_blocks(guessed(columns), make_console())
    print_blocks(chosen(guess), make_console())
    next_step = f"Correct it there, then: bayesbl run {shlex.quote(str(path))}"
    say(f"Written to {path}. " + ("It cannot run yet:" if plan.problems else next_step))
    _print_findings(plan)


def _init_bench(recordings: list[Path] | None, out: Path | None, force: bool) -> None:
    from bayesbl.presentation.terminal import say
    from bayesbl.runs.first_configuration import write_first_bench

    if recordings:
        raise ConfigError(
            "A data sheet is written without recordings.",
            where="--bench",
            found=", ".join(map(str, recordings)),
            expected="bayesbl init --bench, and bayesbl init RECORDING for their columns",
        )
    path = write_first_bench(out, force=force)
    say(f"Written to {path}. Fill in your numbers, then: bayesbl check {path}")


def _print_findings(plan: Plan) -> None:
    """Warnings and problems; with a problem the command ends here."""
    from bayesbl.presentation.terminal import error, make_console, say

    for warning in plan.warnings:
        say(f"warning: {warning}")
    for problem in plan.problems:
        error(make_console(stderr=True), problem)
    if plan.problems:
        raise typer.Exit(WRONG)
