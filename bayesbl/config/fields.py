"""The kinds of value that configurations hold, each with the message for a wrong one."""

from __future__ import annotations

import math
import os
import re
import unicodedata
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NoReturn

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo
from pydantic_core import PydanticCustomError

from bayesbl.recording.channels import (
    CHANNELS,
    TIME,
    did_you_mean,
    did_you_mean_file,
    is_mappable,
)
from bayesbl.recording.input_bytes import stem_of
from bayesbl.ringing.symbols import SYMBOLS

RESULT_FILE = "result.nc"
"""Name of a result in its output folder."""

BASE_DIRECTORY = "base_directory"
"""Key of the validation context: the folder that relative paths start from."""

LONGEST_NAME = 60
"""Letters in the name of a recording."""

PUBLISHED = "published"
"""The curve of the paper's eq. 4."""


def refuse(
    problem: str,
    *,
    found: object = None,
    expected: str | None = None,
    at: tuple[str | int, ...] = (),
) -> NoReturn:
    """Refuse a value with a sentence; ``found`` replaces the whole value in the message.

    ``at`` leads from the value to the part of it that is wrong, to find its line or option.
    """
    context = {
        "problem": problem.replace("{", "{{"),
        "found": found,
        "expected": expected,
        "at": at,
    }
    raise PydanticCustomError("refused", "{problem}", context)


def require_different(values: Sequence[str], problem: str) -> None:
    """Refuse texts of which two are the same, with this sentence."""
    twice = sorted(value for value, count in Counter(values).items() if count > 1)
    if twice:
        named = ", ".join(f'"{value}"' for value in twice)
        refuse(problem, found=named, expected="a different one for each")


def resolve(path: str | Path, info: ValidationInfo) -> Path:
    """A path taken relative to the folder of the configuration, symbolic steps removed."""
    base = (info.context or {}).get(BASE_DIRECTORY, Path.cwd())
    return Path(os.path.normpath(os.path.join(base, os.path.expanduser(path))))


def _output_path(value: object, info: ValidationInfo) -> Path:
    if not isinstance(value, str | Path) or not str(value).strip() or "\0" in str(value):
        refuse("This is not a path.", expected="a path as text")
    return resolve(value, info)


def _input_path(value: object, info: ValidationInfo) -> Path:
    path = _output_path(value, info)
    if os.path.isdir(path):
        refuse("This is a folder.", found=path, expected="a file")
    if not os.path.exists(path):
        hint = did_you_mean_file(path)
        refuse(f"There is no such file.{hint}", found=path, expected="an existing file")
    return path


def _curve_source(value: object, info: ValidationInfo) -> Path | str:
    return PUBLISHED if value == PUBLISHED else _result_file(value, info)


def _result_file(value: object, info: ValidationInfo) -> Path:
    path = _output_path(value, info)
    return _input_path(path / RESULT_FILE if os.path.isdir(path) else path, info)


def as_tuple(value: object) -> object:
    """A list of the file as the immutable kind."""
    return tuple(value) if isinstance(value, list) else value


def _increasing(bounds: tuple[float, float]) -> tuple[float, float]:
    if not bounds[0] < bounds[1]:
        refuse("The range is empty.", expected="[low, high] with low < high")
    return bounds


def _positive(bounds: tuple[float, float]) -> tuple[float, float]:
    if bounds[0] <= 0.0:
        refuse("A gap must be positive.", found=bounds[0], expected="greater than 0")
    if bounds[1] > math.pi:
        refuse("A gap is less than half a turn.", found=bounds[1], expected="at most π")
    return bounds


def _symbol(name: str) -> str:
    if name not in SYMBOLS:
        refuse(
            "This is not a symbol of the disturbance model." + did_you_mean(name, SYMBOLS),
            expected=f"one of {', '.join(SYMBOLS)}",
        )
    return name


def _channel(name: str) -> str:
    if not is_mappable(name):
        refuse(
            "There is no such channel." + did_you_mean(name, (TIME, *CHANNELS)),
            expected=f"one of {', '.join((TIME, *CHANNELS))}, or a torque's name ending in _nm",
        )
    return name


def _name(name: str) -> str:
    if not re.fullmatch(rf"\w[\w .,+-]{{0,{LONGEST_NAME - 1}}}", name):
        refuse(
            "This cannot be a name.",
            expected=f"at most {LONGEST_NAME} letters, digits, spaces and . , + - _, "
            "a letter or digit first",
        )
    return name


def names_of(files: Sequence[str | Path]) -> list[str]:
    """A different name for each file, made from what it is called."""
    names = [name_of(stem_of(Path(file))) for file in files]
    numbered = [f"{name[: LONGEST_NAME - 4]}-{n}" for n, name in enumerate(names, start=1)]
    mixed = [
        name if names.count(name) == 1 else other
        for name, other in zip(names, numbered, strict=True)
    ]
    # A file may be called as another is numbered; numbers for all are always different.
    return mixed if len(set(mixed)) == len(mixed) else numbered


def name_of(stem: str) -> str:
    """The nearest text that is allowed as a name."""
    allowed = re.sub(r"[^\w .,+-]", "_", unicodedata.normalize("NFC", stem))
    return (allowed if re.match(r"\w", allowed) else f"r{allowed}")[:LONGEST_NAME]


def column_entry(value: object) -> object:
    """``"Speed"`` is short for ``{name = "Speed"}``."""
    return {"name": value} if isinstance(value, str) else value


OutputPath = Annotated[Path, BeforeValidator(_output_path)]
InputPath = Annotated[Path, BeforeValidator(_input_path)]
CurveSource = Annotated[Path | str, BeforeValidator(_curve_source)]
ResultFile = Annotated[Path, BeforeValidator(_result_file)]
"""A ``result.nc``, or the output folder that holds it."""
BenchSource = ResultFile
"""A bench file, or the result of an identification: its folder or ``result.nc``."""
Range = Annotated[tuple[float, float], BeforeValidator(as_tuple), AfterValidator(_increasing)]
GapBounds = Annotated[Range, AfterValidator(_positive)]
SymbolName = Annotated[str, AfterValidator(_symbol)]
ChannelName = Annotated[str, AfterValidator(_channel)]
Name = Annotated[str, AfterValidator(_name)]
Positive = Annotated[float, Field(gt=0.0)]


def _not_percent(given: object) -> object:
    share = re.fullmatch(r"\s*(\d+\.?\d*|\.\d+)\s*%\s*", given) if isinstance(given, str) else None
    if share is not None:
        refuse(
            "A tolerance is a number.",
            expected=f"a share of the value as relative_tolerance = {float(share[1]) / 100.0:g}",
        )
    return given


Tolerance = Annotated[float | None, BeforeValidator(_not_percent)]
"""Half-width of a uniform prior, in the parameter's unit or as a share; ``None`` if not given."""


class Section(BaseModel):
    """A table of the configuration: no unknown key, no silent conversion, no change later."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)
