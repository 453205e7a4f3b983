"""What the configurations of several kinds share: one frozen model for each section.

Defaults are in these models only. Paths start from the folder in the validation context, and must
exist. A new kind is a model with an entry in ``kinds.KINDS``, and a module of its name in
``bayesbl/runs``. Only pydantic is imported, so that ``bayesbl check`` is fast.
"""

from __future__ import annotations

import math
import os
import re
import unicodedata
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from datetime import date as Date
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn, Self, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    Strict,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from bayesbl.recording.channels import (
    CHANNELS,
    TIME,
    ColumnSpec,
    did_you_mean,
    did_you_mean_file,
    is_mappable,
)
from bayesbl.recording.input_bytes import stem_of
from bayesbl.ringing.symbols import (
    AMPLITUDE,
    DECAY,
    DEFAULT_FIXED,
    FREQUENCY,
    ROTATION,
    SEPARATION,
    START,
    SYMBOLS,
    WINDOW_END,
    WINDOW_START,
)
from bayesbl.units import choice_of_units, is_accepted, spelled

RESULT_FILE = "result.nc"  # name of a result in its output folder
BASE_DIRECTORY = "base_directory"  # key of the validation context: where relative paths start
LONGEST_NAME = 60  # letters in the name of a recording
PUBLISHED = "published"  # the curve of the paper's eq. 4.


def refuse(
    problem: str,
    *,
    found: object = None,
    expected: str | None = None,
    at: tuple[str | int, ...] = (),
) -> NoReturn:
    """Refuse a value with a sentence; ``found`` replaces the whole value in the message.

    ``at`` leads from the value to the part that is wrong, to find its line or option.
    """
    context = {
        "problem": problem.replace("{", "{{"),
        "found": found,
        "expected": expected,
        "at": at,
    }
    raise PydanticCustomError("refused", "{problem}", context)


def require_different(values: Sequence[str], problem: str) -> None:
    """Refuse equal texts with this sentence."""
    twice = sorted(value for value, count in Counter(values).items() if count > 1)
    if twice:
        named = ", ".join(f'"{value}"' for value in twice)
        refuse(problem, found=named, expected="a different one for each")


def resolve(path: str | Path, info: ValidationInfo) -> Path:
    """A path relative to the configuration's folder, normalised."""
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
    return PUBLISHED if str(value) == PUBLISHED else _result_file(value, info)


def _result_file(value: object, info: ValidationInfo) -> Path:
    path = _output_path(value, info)
    return _input_path(path / RESULT_FILE if os.path.isdir(path) else path, info)


T = TypeVar("T")
Items = Annotated[tuple[T, ...], Strict(False)]  # A list of the file as a tuple


def _increasing(bounds: tuple[float, float]) -> tuple[float, float]:
    if not bounds[0] < bounds[1]:
        refuse("The range is empty.", expected="[low, high] with low < high")
    return bounds


def known_name(name: str, known: Collection[str], what: str) -> str:
    """The name; refused unless it is known."""
    if name not in known:
        refuse(
            f"There is no such {what}." + did_you_mean(name, known),
            found=repr(name),
            expected="one of " + ", ".join(known),
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
    """Different names for files, made from their file names."""
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


OutputPath = Annotated[Path, BeforeValidator(_output_path)]
InputPath = Annotated[Path, BeforeValidator(_input_path)]
CurveSource = Annotated[Path | str, BeforeValidator(_curve_source)]
ResultFile = Annotated[Path, BeforeValidator(_result_file)]  # A ``result.nc``, or its output folder
BenchSource = ResultFile  # a bench file, or the result of an identification
Range = Annotated[tuple[float, float], Strict(False), AfterValidator(_increasing)]
Gap = Annotated[float, Field(ge=0.0, le=math.pi)]
GapBoundsFromZero = Annotated[tuple[Gap, Gap], Strict(False), AfterValidator(_increasing)]
GapBounds = Annotated[
    tuple[Annotated[float, Field(gt=0.0, le=math.pi)], Gap],
    Strict(False),
    AfterValidator(_increasing),
]
SymbolName = Annotated[
    str,
    AfterValidator(partial(known_name, known=SYMBOLS, what="symbol of the disturbance model")),
]
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
"""Half-width of a uniform prior, in the parameter's unit or as a share."""


class Section(BaseModel):
    """A table of the configuration: no unknown key, no silent conversion, no change later."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False, defer_build=True
    )

    def require_sound(self) -> None:
        """Refuse values that contradict each other."""

    @model_validator(mode="after")
    def _sound(self) -> Self:
        self.require_sound()
        return self


_POSITIVE_SYMBOLS = frozenset({AMPLITUDE, DECAY, FREQUENCY, WINDOW_END, SEPARATION, ROTATION})


Seed = Annotated[int, Field(ge=0, lt=2**63)]
Workers = Annotated[int, Field(ge=1, le=1024)]


class Run(Section):
    """``[run]``: seed, number of processes and output folder."""

    seed: Seed = 1
    workers: Workers = Field(default_factory=lambda: os.cpu_count() or 1)
    output: OutputPath


def _scheduler(address: str) -> str:
    if not re.fullmatch(r"(tcp|tls|ws|wss)://\S+:\d+", address):
        refuse(
            "This is not the address of a Dask scheduler.", expected="one such as tcp://host:8786"
        )
    return address


class ClusterRun(Run):
    """``[run]`` of a study or a fleet: with a ``scheduler``, its Dask cluster does the work."""

    scheduler: Annotated[str, AfterValidator(_scheduler)] | None = None


class RunConfig(Section):
    """What every kind of run shares."""

    schema_version: Literal[1] = Field(alias="schema")
    kind: str
    run: Run


class Column(Section):
    """A column of the file: its name and unit; ``reversed`` if it is negative for forward motion.
    ``NAME`` is the channel."""

    name: str = Field(min_length=1)
    unit: Annotated[str, AfterValidator(spelled)] | None = None
    reversed: bool = False

    @model_validator(mode="before")
    @classmethod
    def _of_name(cls, column: Any) -> Any:
        return {"name": column} if isinstance(column, str) else column


def _file_or_files(schema: dict[str, Any]) -> None:
    """Correct the JSON schema, which does not know that a validator completes ``file``."""
    del schema["required"]
    schema["anyOf"] = [{"required": ["file"]}, {"required": ["files"]}]


class SnapshotRecording(Section):
    """An entry of ``[[recordings]]`` that was measured; its default name is made of the file's."""

    model_config = ConfigDict(json_schema_extra=_file_or_files)

    name: Name
    file: InputPath
    files: Items[InputPath] | None = Field(default=None, min_length=1)
    date: Date | None = None
    repaired: bool = False
    reference_speed_rpm: float | None = None
    bench: dict[str, float] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _named_after_first_file(cls, value: Any) -> Any:
        if not isinstance(value, dict):
            return value
        files = value.get("files")
        if "file" not in value and isinstance(files, list) and files:
            value = {"file": files[0], **value}
        if "name" not in value and isinstance(value.get("file"), str):
            return {"name": name_of(stem_of(Path(value["file"]))), **value}
        return value

    def require_sound(self) -> None:
        if self.files is not None and self.file != self.files[0]:
            refuse(
                "A snapshot has either one file or a list of files.",
                found=f"file = {self.file} beside files",
                expected="file, or files",
                at=("file",),
            )
        if self.files is not None:
            require_different([str(file) for file in self.files], "A file is named twice.")

    @property
    def every_file(self) -> tuple[Path, ...]:
        """All files of the snapshot."""
        return self.files or (self.file,)


def differing_in(*keys: str) -> Callable[[tuple[T, ...]], tuple[T, ...]]:
    """A validator that refuses two recordings with the same text under one of these keys."""

    def require(recordings: tuple[T, ...]) -> tuple[T, ...]:
        for key in keys:
            texts = [getattr(recording, key) for recording in recordings]
            require_different(texts, f"Two recordings have the same {key}.")
        return recordings

    return require


class RecordedConfig(RunConfig):
    """A run over recordings whose columns may have other names and units."""

    columns: dict[ChannelName, Column] = Field(default_factory=dict)

    @property
    def column_specs(self) -> dict[str, ColumnSpec]:
        """``[columns]`` as the readers take it."""
        return {
            key: ColumnSpec(column.name, column.unit, column.reversed)
            for key, column in self.columns.items()
        }

    @field_validator("columns")
    @classmethod
    def _columns_make_sense(cls, columns: dict[str, Column]) -> dict[str, Column]:
        for channel, column in columns.items():
            if column.unit is not None and not is_accepted(channel, column.unit):
                refuse(
                    f"The unit of {channel} is not known.",
                    found=f'"{column.unit}"',
                    expected=choice_of_units(channel),
                    at=(channel, "unit"),
                )
            if column.reversed and channel == TIME:
                refuse("Time has no sign.", found="reversed = true", at=(channel, "reversed"))
        names = [column.name for column in columns.values()]
        require_different(names, "A column is mapped to two channels.")
        return columns


class Model(Section):
    """``[estimator.model]``: which symbols of eq. 6 are fixed, and the baseline under the pulses.

    Symbols that are not in ``fixed`` are fitted, within ``ranges``.
    """

    baseline_harmonics: int = Field(default=1, ge=0, le=20)
    fixed: dict[SymbolName, float] = Field(default_factory=lambda: dict(DEFAULT_FIXED))
    ranges: dict[SymbolName, Range] = Field(default_factory=dict)

    @field_validator("fixed")
    @classmethod
    def _physical(cls, fixed: dict[str, float]) -> dict[str, float]:
        for name in sorted(_POSITIVE_SYMBOLS & fixed.keys()):
            if fixed[name] <= 0.0:
                refuse(f"{name} must be positive.", found=fixed[name], expected="greater than 0")
        if fixed.get(WINDOW_START, 0.0) < 0.0:
            refuse(f"{WINDOW_START} must not be negative.", expected="0 or more")
        if START not in fixed and WINDOW_START not in fixed:
            refuse(
                f"{START} and {WINDOW_START} cannot both be free: only their sum enters the model.",
                expected=f"one of the two, e.g. {WINDOW_START} = 0.0",
            )
        if fixed.get(WINDOW_START, 0.0) >= fixed.get(WINDOW_END, float("inf")):
            refuse(
                f"{WINDOW_END} must be later than {WINDOW_START} (eq. 3).",
                expected=f"{WINDOW_START} < {WINDOW_END}",
            )
        return fixed

    def require_sound(self) -> None:
        both = [name for name in SYMBOLS if name in self.fixed and name in self.ranges]
        if both:
            refuse(
                f"{' and '.join(both)} cannot have a range while fixed.",
                found=f"{', '.join(both)} in fixed and in ranges",
                expected="each symbol in one of the two",
            )


class Interval(Section):
    """``[interval]``: which credible interval is reported."""

    level: float = Field(default=0.9, gt=0.0, lt=1.0)
    kind: Literal["equal_tailed", "hdi"] = "equal_tailed"


def _two_angles(angles: tuple[float, ...]) -> tuple[float, ...]:
    """Validate a range of load angles."""
    if len(angles) != 2 or not angles[1] - angles[0] >= SHORTEST_WAY_RAD:
        refuse(
            "A range has a lower and an upper load angle.",
            found=list(angles),
            expected="two angles in rad, the lower first, e.g. [-0.5, 0.5]; 0 hangs straight down",
        )
    return angles


SHORTEST_WAY_RAD = 1e-3  # shortest motion of the load
AngleRange = Annotated[Items[float], AfterValidator(_two_angles)]
