"""What the configurations of several kinds share: one frozen model per section.

Defaults are in these models and nowhere else. Paths are resolved against the folder that the
validation context names, and must exist. A new kind is one module beside this one with an entry
in ``kinds.KINDS``, and one in ``bayesbl/runs`` with an entry in ``run.WORKFLOWS``. Only pydantic is
imported, so that ``bayesbl check`` answers at once.
"""

from __future__ import annotations

import os
import re
from datetime import date as Date
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    field_validator,
    model_validator,
)

from bayesbl.config.fields import (
    ChannelName,
    InputPath,
    Name,
    OutputPath,
    Range,
    Section,
    SymbolName,
    as_tuple,
    column_entry,
    name_of,
    refuse,
    require_different,
)
from bayesbl.recording.channels import TIME, ColumnSpec
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

_POSITIVE_SYMBOLS = frozenset({AMPLITUDE, DECAY, FREQUENCY, WINDOW_END, SEPARATION, ROTATION})


class Run(Section):
    """``[run]``: the seed, and what does not change the problem."""

    seed: int = Field(default=1, ge=0, lt=2**63)
    workers: int = Field(default_factory=lambda: os.cpu_count() or 1, ge=1, le=1024)
    output: OutputPath


def _scheduler(address: str) -> str:
    if not re.fullmatch(r"(tcp|tls|ws|wss)://\S+:\d+", address):
        refuse(
            "This is not the address of a Dask scheduler.", expected="one such as tcp://host:8786"
        )
    return address


class ClusterRun(Run):
    """``[run]`` of a study or a fleet: with a scheduler, work is done on its Dask cluster."""

    scheduler: Annotated[str, AfterValidator(_scheduler)] | None = None


class RunConfig(Section):
    """What every kind of run shares."""

    schema_version: Literal[1] = Field(alias="schema")
    kind: str
    run: Run


class Column(Section):
    """An entry of ``[columns]``: a column's name in the file, its unit, and whether forwards is
    negative there."""

    name: str = Field(min_length=1)
    unit: Annotated[str, AfterValidator(spelled)] | None = None
    reversed: bool = False


ColumnEntry = Annotated[Column, BeforeValidator(column_entry)]


def _file_or_files(schema: dict[str, Any]) -> None:
    """What a validator adds of itself is not asked for."""
    del schema["required"]
    schema["anyOf"] = [{"required": ["file"]}, {"required": ["files"]}]


class SnapshotRecording(Section):
    """An entry of ``[[recordings]]`` that was measured; its default name is made of the file's.

    ``files``: the positions round the turn at which ramps of torque were made, one file each;
    ``file`` is then the first of them. ``repaired`` marks the first one after a repair. ``bench``:
    what is known to have been another value than the bench file's when it was made, a bench
    parameter or ``"effect.parameter"``.
    """

    model_config = ConfigDict(json_schema_extra=_file_or_files)

    name: Name
    file: InputPath
    files: Annotated[tuple[InputPath, ...], BeforeValidator(as_tuple)] | None = Field(
        default=None, min_length=1
    )
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

    @model_validator(mode="after")
    def _file_is_the_first(self) -> Self:
        if self.files is not None and self.file != self.files[0]:
            refuse(
                "A snapshot has either one file or a list of files.",
                found=f"file = {self.file} beside files",
                expected="file, or files",
                at=("file",),
            )
        if self.files is not None:
            require_different([str(file) for file in self.files], "A file is named twice.")
        return self

    @property
    def every_file(self) -> tuple[Path, ...]:
        """All files of the snapshot."""
        return self.files or (self.file,)


R = TypeVar("R", bound=SnapshotRecording)


def differently_named(recordings: tuple[R, ...]) -> tuple[R, ...]:
    """Refuse recordings of which two have the same name."""
    names = [recording.name for recording in recordings]
    require_different(names, "Two recordings have the same name.")
    return recordings


class RecordedConfig(RunConfig):
    """A run over recordings whose columns may have other names and units."""

    columns: dict[ChannelName, ColumnEntry] = Field(default_factory=dict)

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

    A symbol is free unless it is in ``fixed``.
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

    @model_validator(mode="after")
    def _fixed_or_ranged(self) -> Self:
        both = [name for name in SYMBOLS if name in self.fixed and name in self.ranges]
        if both:
            refuse(
                f"{' and '.join(both)} cannot have a range while fixed.",
                found=f"{', '.join(both)} in fixed and in ranges",
                expected="each symbol in one of the two",
            )
        return self


class Interval(Section):
    """``[interval]``: which credible interval is reported."""

    level: float = Field(default=0.9, gt=0.0, lt=1.0)
    kind: Literal["equal_tailed", "hdi"] = "equal_tailed"
