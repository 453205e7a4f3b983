"""Options and arguments that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from datetime import date
from pathlib import Path
from typing import Annotated, TypeVar

import typer

_Value = TypeVar("_Value")


def _parser(read: Callable[[str], _Value], expected: str) -> Callable[[str], _Value]:
    """An option's value by ``read``; its range is the configuration's to check."""

    def parse(text: str) -> _Value:
        try:
            return read(text)
        except ValueError:
            raise typer.BadParameter(f"Found: {text}. Expected: {expected}.") from None

    return parse


_whole_number = _parser(int, "a whole number")
_number = _parser(float, "a number, with a decimal point")
_gap = _parser(float, "a number in rad, with a decimal point, e.g. 1.2e-3 for 1.2 mrad")
_day = _parser(date.fromisoformat, "a date, e.g. 2026-03-01")

ConfigPath = Annotated[Path, typer.Argument(metavar="CONFIG", help="Configuration in TOML.")]
ResultPath = Annotated[
    Path, typer.Argument(metavar="RESULT", help="Output folder of a run, or its result.nc.")
]
BaseConfig = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE", help="Configuration; options override it."),
]
Out = Annotated[
    Path | None,
    typer.Option("--out", metavar="FOLDER", help="Output folder. [default: results/<name>]"),
]
Seed = Annotated[
    int | None,
    typer.Option(
        "--seed",
        parser=_whole_number,
        metavar="N",
        help="Seed of all random numbers. [default: 1]",
    ),
]
Workers = Annotated[
    int | None,
    typer.Option(
        "--workers",
        parser=_whole_number,
        metavar="N",
        help="Largest number of processes; results do not depend on it. [default: all cores]",
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        help="Run a study on the Dask cluster of this scheduler, e.g. tcp://host:8786.",
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Replace a finished result, or start over.")]
Json = Annotated[bool, typer.Option("--json", help="Print the summary as JSON, nothing else.")]
Curve = Annotated[
    str | None,
    typer.Option(
        "--curve",
        metavar="published|RESULT",
        help="Gap curve: the result of a sweep, its folder or result.nc. [default: published]",
    ),
]
BenchFile = Annotated[
    Path | None,
    typer.Option("--bench", metavar="FILE", help="Bench of the joint, for the direct route."),
]
Route = Annotated[
    str | None,
    typer.Option(
        "--route",
        metavar="amplitude|direct",
        help="By the ringing's amplitude and a curve, or by simulations of the bench. "
        "[default: amplitude]",
    ),
]
StartFrom = Annotated[
    Path | None,
    typer.Option(
        "--start-from",
        metavar="RESULT",
        help="Earlier result of this joint: the search starts from its optimum.",
    ),
]
CheckSampler = Annotated[
    bool,
    typer.Option(
        "--check-sampler", help="Sample again with a nested sampler, and report differences."
    ),
]
LimitRad = Annotated[
    float | None,
    typer.Option(
        "--limit-rad",
        parser=_gap,
        metavar="RAD",
        help="Repair limit for the gap δ, in rad at the load (1.2e-3 = 1.2 mrad); δ is half the "
        "total play.",
    ),
]
Before = Annotated[
    date | None,
    typer.Option(
        "--before",
        parser=_day,
        metavar="DATE",
        help="Also report the probability that the gap passes its limit before this date.",
    ),
]
Dates = Annotated[
    list[date] | None,
    typer.Option(
        "--date",
        parser=_day,
        metavar="DATE",
        help="When a recording was taken; once per recording, in the same order.",
    ),
]
GearRatio = Annotated[
    float | None,
    typer.Option(
        "--gear-ratio", parser=_number, metavar="N", help="Motor turns per turn of the load."
    ),
]
Level = Annotated[
    float | None,
    typer.Option(
        "--level",
        parser=_number,
        metavar="P",
        help="Level of the credible intervals. [default: 0.9]",
    ),
]
