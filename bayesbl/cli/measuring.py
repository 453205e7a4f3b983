"""Commands that measure: a gap in one recording, its change over several."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from bayesbl.cli import options
from bayesbl.cli.running import given_files, guessing_columns, run_config
from bayesbl.errors import ConfigError
from bayesbl.recording import formats

FORMATS = formats.names()


def fit_command(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help=f"A recording: {FORMATS}.")
    ],
    config: options.BaseConfig = None,
    out: options.Out = None,
    seed: options.Seed = None,
    force: options.Force = False,
    json: options.Json = False,
    curve: options.Curve = None,
    route: options.Route = None,
    bench: options.BenchFile = None,
    limit: options.Limit = None,
    limit_rad: options.LimitRad = None,
    gear_ratio: options.GearRatio = None,
    level: options.Level = None,
    workers: options.Workers = None,
    start_from: options.StartFrom = None,
    check_sampler: options.CheckSampler = False,
) -> None:
    """Measure the gap in one recording."""
    given = {"out": out, "seed": seed, "curve": curve, "limit": limit, "limit_rad": limit_rad}
    given |= {"route": route, "bench": bench}
    given |= {"gear_ratio": gear_ratio, "level": level, "workers": workers}
    given |= {"start_from": start_from, "check_sampler": check_sampler or None}
    _measure("fit", [recording], config, given, force, json)


def compare_command(
    first: Annotated[
        Path, typer.Argument(metavar="FIRST", help=f"The oldest recording: {FORMATS}.")
    ],
    later: Annotated[
        list[Path] | None,
        typer.Argument(metavar="SECOND", help="Later ones of the same joint, in order."),
    ] = None,
    config: options.BaseConfig = None,
    out: options.Out = None,
    seed: options.Seed = None,
    force: options.Force = False,
    json: options.Json = False,
    curve: options.Curve = None,
    route: options.Route = None,
    bench: options.BenchFile = None,
    dates: options.Dates = None,
    limit: options.Limit = None,
    limit_rad: options.LimitRad = None,
    before: options.Before = None,
    gear_ratio: options.GearRatio = None,
    level: options.Level = None,
    workers: options.Workers = None,
    start_from: options.StartFrom = None,
    check_sampler: options.CheckSampler = False,
) -> None:
    """Measure each gap, the change from first to last, and with dates how fast it grows."""
    if not later:
        quoted = shlex.quote(str(first))
        raise ConfigError(
            "A comparison needs two recordings or more.",
            where="SECOND",
            found=f"{first} alone",
            expected=f"bayesbl compare {quoted} SECOND; for one recording: bayesbl fit {quoted}",
        )
    given: dict[str, Any] = {"out": out, "seed": seed, "curve": curve}
    given |= {"limit": limit, "limit_rad": limit_rad, "route": route, "bench": bench}
    given |= {"gear_ratio": gear_ratio, "level": level, "workers": workers}
    given |= {"start_from": start_from, "check_sampler": check_sampler or None}
    given |= {"before": before, "dates": dates or ()}
    _measure("compare", [first, *later], config, given, force, json)


def _measure(
    kind: str,
    recordings: Sequence[Path],
    config: Path | None,
    given: dict[str, Any],
    force: bool,
    json: bool,
) -> None:
    from bayesbl.config.loading import config_from_options

    loaded = config_from_options(kind, recordings, config, **given)
    with guessing_columns(f"init {given_files(recordings)}", config):
        run_config(loaded, force, json, config)
