"""Options and arguments that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from datetime import date
from pathlib import Path
from typing import Annotated, Any, TypeVar

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


def _option(name: str, metavar: str, what: str, parser: Callable[[str], Any] | None = None) -> Any:
    """An option with a value; ``what`` is its help."""
    return typer.Option(name, metavar=metavar, help=what, parser=parser)


ConfigPath = Annotated[Path, typer.Argument(metavar="CONFIG", help="Configuration in TOML.")]
ResultPath = Annotated[
    Path, typer.Argument(metavar="RESULT", help="Output folder of a run, or its result.nc.")
]
BaseConfig = Annotated[
    Path | None, _option("--config", "FILE", "Configuration; options override it.")
]
Out = Annotated[
    Path | None,
    _option(
        "--out",
        "FOLDER",
        "Output folder. [default: results/NAME, or results/COMMAND_NAME]",
    ),
]
Seed = Annotated[
    int | None,
    _option("--seed", "N", "Seed of all random numbers. [default: 1]", _whole_number),
]
Workers = Annotated[
    int | None,
    _option(
        "--workers",
        "N",
        "Largest number of processes; results do not depend on it. [default: all cores]",
        _whole_number,
    ),
]
Scheduler = Annotated[
    str | None,
    _option(
        "--scheduler",
        "ADDRESS",
        "Run a study or a fleet on the Dask cluster of this scheduler, e.g. tcp://host:8786.",
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Replace a finished result, or start over.")]
Json = Annotated[bool, typer.Option("--json", help="Print the summary as JSON, nothing else.")]
Curve = Annotated[
    str | None,
    _option(
        "--curve",
        "published|RESULT",
        "Gap curve: the result of a sweep, its folder or result.nc; or the paper's, by name. "
        "[default: swept from the bench; none without one]",
    ),
]
BenchFile = Annotated[
    Path | None,
    _option(
        "--bench",
        "FILE|RESULT",
        "Bench of the joint, its file or what identify found: simulated, and swept for curves.",
    ),
]
Route = Annotated[
    str | None,
    _option(
        "--route",
        "auto|amplitude|direct|torque_ramp|two_encoders",
        "By simulations of the bench (direct), by the ringing's amplitude and a curve, or both; "
        "by ramps of torque with the output held; or by encoders of motor and load. [default: auto "
        "with a bench]",
    ),
]
StartFrom = Annotated[
    Path | None,
    _option(
        "--start-from",
        "RESULT",
        "Earlier result of this joint: the search starts from its optimum.",
    ),
]
CheckSampler = Annotated[
    bool,
    typer.Option(
        "--check-sampler", help="Sample again with a nested sampler, and report differences."
    ),
]
Limit = Annotated[
    str | None,
    _option(
        "--limit",
        "LIMIT",
        'Repair limit as data sheets state it: "3 arcmin play", "0.5 mm play at 0.4 m", '
        '"1 arcmin lost_motion at 3 %" (of the rated torque).',
    ),
]
LimitRad = Annotated[
    float | None,
    _option(
        "--limit-rad",
        "RAD",
        "Repair limit for the gap δ, in rad at the load (1.2e-3 = 1.2 mrad); δ is half the total "
        "play.",
        _gap,
    ),
]
Before = Annotated[
    date | None,
    _option(
        "--before",
        "DATE",
        "Also report the probability that the gap passes its limit before this date.",
        _day,
    ),
]
Dates = Annotated[
    list[date] | None,
    _option(
        "--date",
        "DATE",
        "When a recording was taken; once per recording, in the same order.",
        _day,
    ),
]
GearRatio = Annotated[
    float | None, _option("--gear-ratio", "N", "Motor turns per turn of the load.", _number)
]
Level = Annotated[
    float | None,
    _option("--level", "P", "Level of the credible intervals. [default: 0.9]", _number),
]
RangeRad = Annotated[
    tuple[float, float] | None,
    typer.Option(
        "--range-rad",
        metavar="LOW HIGH",
        help="Load angles that a planned motion may reach, in rad; 0 hangs straight down. "
        "[default: -0.5 0.5]",
    ),
]
SpeedRpm = Annotated[
    float | None,
    _option("--speed-rpm", "RPM", "Largest speed of the motor. [default: 1500]", _number),
]
Acceleration = Annotated[
    float | None,
    _option(
        "--acceleration-rpm-per-s",
        "RPM/S",
        "Largest acceleration of the motor. [default: 6000]",
        _number,
    ),
]
Duration = Annotated[
    float | None, _option("--duration-s", "S", "Length of the recording. [default: 20]", _number)
]
GapRad = Annotated[
    float | None,
    _option("--gap-rad", "RAD", "Gap that a plan is reckoned at. [default: 0.0008]", _gap),
]
