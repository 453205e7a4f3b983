"""Commands that measure: a gap in one recording, its change over several."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from bayesbl.cli.options import (
    BaseConfig,
    Before,
    BenchFile,
    CheckSampler,
    Curve,
    Dates,
    Force,
    GearRatio,
    Json,
    Level,
    LimitRad,
    Out,
    Route,
    Seed,
    StartFrom,
    Workers,
)
from bayesbl.cli.running import run_config
from bayesbl.errors import ConfigError, RecordingError
from bayesbl.recording import formats

FORMATS = formats.names()


def fit_command(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help=f"A recording: {FORMATS}.")
    ],
    config: BaseConfig = None,
    out: Out = None,
    seed: Seed = None,
    force: Force = False,
    json: Json = False,
    curve: Curve = None,
    route: Route = None,
    bench: BenchFile = None,
    limit_rad: LimitRad = None,
    gear_ratio: GearRatio = None,
    level: Level = None,
    workers: Workers = None,
    start_from: StartFrom = None,
    check_sampler: CheckSampler = False,
) -> None:
    """Measure the gap in one recording."""
    options = {"out": out, "seed": seed, "curve": curve, "limit_rad": limit_rad}
    options |= {"route": route, "bench": bench}
    options |= {"gear_ratio": gear_ratio, "level": level, "workers": workers}
    options |= {"start_from": start_from, "check_sampler": check_sampler or None}
    _measure("fit", [recording], config, options, force, json)


def compare_command(
    first: Annotated[
        Path, typer.Argument(metavar="FIRST", help=f"The oldest recording: {FORMATS}.")
    ],
    later: Annotated[
        list[Path] | None,
        typer.Argument(metavar="SECOND", help="Later ones of the same joint, in order."),
    ] = None,
    config: BaseConfig = None,
    out: Out = None,
    seed: Seed = None,
    force: Force = False,
    json: Json = False,
    curve: Curve = None,
    route: Route = None,
    bench: BenchFile = None,
    dates: Dates = None,
    limit_rad: LimitRad = None,
    before: Before = None,
    gear_ratio: GearRatio = None,
    level: Level = None,
    workers: Workers = None,
    start_from: StartFrom = None,
    check_sampler: CheckSampler = False,
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
    options: dict[str, Any] = {"out": out, "seed": seed, "curve": curve, "limit_rad": limit_rad}
    options |= {"route": route, "bench": bench}
    options |= {"gear_ratio": gear_ratio, "level": level, "workers": workers}
    options |= {"start_from": start_from, "check_sampler": check_sampler or None}
    options |= {"before": before, "dates": dates or ()}
    _measure("compare", [first, *later], config, options, force, json)


def _measure(
    kind: str,
    recordings: Sequence[Path],
    config: Path | None,
    options: dict[str, Any],
    force: bool,
    json: bool,
) -> None:
    from bayesbl.config.loading import config_from_options

    loaded = config_from_options(kind, recordings, config, **options)
    try:
        run_config(loaded, force, json)
    except RecordingError as error:
        if config is not None or error.where != "header":
            raise
        files = " ".join(shlex.quote(str(recording)) for recording in recordings)
        raise RecordingError(
            error.problem,
            file=error.file,
            where=error.where,
            found=error.found,
            expected=f"{error.expected}; `bayesbl init {files}` writes a configuration with the "
            "columns guessed",
        ) from None
