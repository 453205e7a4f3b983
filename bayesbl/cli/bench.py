"""Commands around a virtual bench: what it records, its curve, what it lacks, effects."""

from __future__ import annotations

from typing import Annotated

import typer

from bayesbl.cli.options import ConfigPath, Force, Json, Out, Seed, Workers
from bayesbl.cli.running import run_config, simulate


def simulate_command(
    config: ConfigPath,
    out: Out = None,
    seed: Seed = None,
    workers: Workers = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Make recordings on a virtual bench."""
    simulate(config, out, seed, workers, force, json)


def sweep_command(
    config: ConfigPath,
    out: Out = None,
    seed: Seed = None,
    workers: Workers = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Sweep a virtual bench over its gap, for a gap curve of its own."""
    from bayesbl.runs.run import load_run

    loaded = load_run(config, kind="sweep", out=out, seed=seed, workers=workers)
    run_config(loaded, force, json)


def diagnose_command(
    config: ConfigPath,
    out: Out = None,
    seed: Seed = None,
    workers: Workers = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Find what a bench lacks that recordings show."""
    from bayesbl.runs.run import load_run

    loaded = load_run(config, kind="diagnose", out=out, seed=seed, workers=workers)
    run_config(loaded, force, json)


def effects_command(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="An effect to show in full.")
    ] = None,
) -> None:
    """Print the catalogue of physical effects, or one entry in full."""
    from bayesbl.bench.effects import EFFECTS, effect_named
    from bayesbl.presentation.catalogue import print_catalogue, print_effect
    from bayesbl.presentation.console import make_console

    if name is None:
        print_catalogue(EFFECTS, make_console())
    else:
        print_effect(effect_named(name), make_console())
