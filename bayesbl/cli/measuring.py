"""Commands that measure: a gap in one recording, its change over several."""

from __future__ import annotations

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


def fit_command(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="A recording, CSV.")],
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
    first: Annotated[Path, typer.Argument(metavar="FIRST", help="The oldest recording, CSV.")],
    later: Annotated[
        list[Path], typer.Argument(metavar="SECOND", help="Later ones of the same joint, in order.")
    ],
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

    run_config(config_from_options(kind, recordings, config, **options), force, json)
