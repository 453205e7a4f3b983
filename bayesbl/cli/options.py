"""Options and arguments that several commands share."""

from __future__ import annotations

from datetime import date
from pathlib import Path
from typing import Annotated

import typer


def _whole_number(text: str) -> int:
    """An option's value; what it may be is the configuration's to say."""
    try:
        return int(text)
    except ValueError:
        raise typer.BadParameter(f"Found: {text}. Expected: a whole number.") from None


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        point = ", with a decimal point and no comma" if "," in text else ""
        raise typer.BadParameter(f"Found: {text}. Expected: a number{point}.") from None


def _gap(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise typer.BadParameter(
            f"Found: {text}. Expected: a number in rad, with a decimal point, e.g. 1.2e-3 for "
            "1.2 mrad."
        ) from None


def _day(text: str) -> date:
    try:
        return date.fromisoformat(text)
    except ValueError:
        raise typer.BadParameter(f"Found: {text}. Expected: a date, e.g. 2026-03-01.") from None


ConfigPath = Annotated[Path, typer.Argument(metavar="CONFIG", help="Configuration in TOML.")]
ResultPath = Annotated[
    Path, typer.Argument(metavar="RESULT", help="Output folder of a run, or its result.nc.")
]
BaseConfig = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE", help="Configuration that the options go over."),
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
        help="Most processes at a time, where there is work for them; the numbers do not "
        "depend on it. [default: all cores]",
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        help="Run a study on the Dask cluster of this scheduler, e.g. tcp://host:8786, in place of "
        "processes.",
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
        help="From the ringing's amplitude by a curve, or from the simulated bench. "
        "[default: amplitude]",
    ),
]
StartFrom = Annotated[
    Path | None,
    typer.Option(
        "--start-from",
        metavar="RESULT",
        help="Earlier result of this joint, from whose optimum the search starts.",
    ),
]
CheckSampler = Annotated[
    bool,
    typer.Option(
        "--check-sampler", help="Sample again by a nested sampler, and tell where both differ."
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
        help="Also tell how probably the gap passes its limit before this date.",
    ),
]
Dates = Annotated[
    list[date] | None,
    typer.Option(
        "--date",
        parser=_day,
        metavar="DATE",
        help="When a recording was taken; once for each, in their order.",
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
