"""Commands around a virtual bench: what it records, its curve, what it lacks, effects."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from bayesbl.cli.options import (
    Acceleration,
    BenchFile,
    ConfigPath,
    Duration,
    Force,
    GapRad,
    Json,
    Out,
    RangeRad,
    Seed,
    SpeedRpm,
    Workers,
)
from bayesbl.cli.running import run_config, run_file


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


def plan_command(
    config: Annotated[
        Path | None, typer.Argument(metavar="[CONFIG]", help="Configuration in TOML.")
    ] = None,
    bench: BenchFile = None,
    range_rad: RangeRad = None,
    speed_rpm: SpeedRpm = None,
    acceleration_rpm_per_s: Acceleration = None,
    duration_s: Duration = None,
    gap_rad: GapRad = None,
    out: Out = None,
    workers: Workers = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Rank motions within limits by how well they would tell the gap."""
    from bayesbl.config.loading import config_from_options

    options: dict[str, Any] = {
        "bench": bench,
        "range_rad": range_rad,
        "speed_rpm": speed_rpm,
        "acceleration_rpm_per_s": acceleration_rpm_per_s,
        "duration_s": duration_s,
        "gap_rad": gap_rad,
        "out": Path("results", "plan") if out is None and config is None else out,
        "workers": workers,
    }
    run_config(config_from_options("plan", (), config, **options), force, json, config)


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
