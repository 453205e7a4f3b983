"""Commands around a virtual bench: what it records, its curve, what it lacks, effects."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import typer

from bayesbl.cli.options import ConfigPath, Force, Json, Out, Seed, Workers
from bayesbl.cli.running import run_file


def _command(kind: str, what: str) -> Callable[..., None]:
    """The command that runs configurations of one kind; ``what`` is its help."""

    def command(
        config: ConfigPath,
        out: Out = None,
        seed: Seed = None,
        workers: Workers = None,
        force: Force = False,
        json: Json = False,
    ) -> None:
        run_file(config, force, json, kind=kind, out=out, seed=seed, workers=workers)

    command.__doc__ = what
    return command


simulate_command = _command("simulate", "Make recordings on a virtual bench.")
sweep_command = _command("sweep", "Sweep a virtual bench over its gap, for a gap curve of its own.")
diagnose_command = _command("diagnose", "Find what a bench lacks that recordings show.")


def effects_command(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="An effect to show in full.")
    ] = None,
) -> None:
    """Print the catalogue of physical effects, or one entry in full."""
    from bayesbl.bench.effects import EFFECTS, effect_named
    from bayesbl.presentation.catalogue import catalogue, entry
    from bayesbl.presentation.terminal import make_console, print_blocks

    print_blocks(catalogue(EFFECTS) if name is None else entry(effect_named(name)), make_console())
