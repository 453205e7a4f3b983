"""What a configuration may say: one frozen model per section, one per kind of run.

Defaults stand here and nowhere else. Paths are resolved against the folder that the validation
context names, and must exist. A new kind is one class in ``kinds.KINDS``. Only pydantic is
imported, so that ``bayesbl check`` answers at once.
"""

from __future__ import annotations

import os
from datetime import date as Date
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)

from bayesbl.config.fields import (
    PUBLISHED,
    ChannelName,
    CurveSource,
    InputPath,
    Name,
    OutputPath,
    Positive,
    Range,
    ResultFile,
    Section,
    SymbolName,
    as_tuple,
    column_entry,
    refuse,
    resolve,
)
from bayesbl.recording.channels import ColumnSpec
from bayesbl.signal.parameters import (
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
from bayesbl.units import accepted_units

_POSITIVE_SYMBOLS = frozenset({AMPLITUDE, DECAY, FREQUENCY, WINDOW_END, SEPARATION, ROTATION})


class Run(Section):
    """``[run]``: what does not change the problem, besides the seed."""

    seed: int = Field(default=1, ge=0, lt=2**63)
    workers: int = Field(default_factory=lambda: os.cpu_count() or 1, ge=1, le=1024)
    output: OutputPath


class Joint(Section):
    """``[joint]``: what is known of the joint itself."""

    gear_ratio: Positive | None = None
    limit_rad: Positive | None = None
    decide_before: Date | None = None

    @model_validator(mode="after")
    def _date_of_a_limit(self) -> Self:
        if self.decide_before is not None and self.limit_rad is None:
            refuse(
                "A date to decide before needs a limit that the gap may pass.",
                found="decide_before without limit_rad",
                expected="limit_rad beside it, e.g. limit_rad = 1.2e-3",
            )
        return self


class Column(Section):
    """An entry of ``[columns]``: a column's name in the file, and its unit."""

    name: str = Field(min_length=1)
    unit: str | None = None


ColumnEntry = Annotated[Column, BeforeValidator(column_entry)]


class SnapshotRecording(Section):
    """An entry of ``[[recordings]]`` that was measured; its name is the file's by default.

    ``repaired`` marks the first one after a repair.
    """

    name: Name
    file: InputPath
    date: Date | None = None
    repaired: bool = False
    reference_speed_rpm: float | None = None

    @model_validator(mode="before")
    @classmethod
    def _name_after_file(cls, value: Any) -> Any:
        if isinstance(value, dict) and "name" not in value and isinstance(value.get("file"), str):
            return {"name": Path(value["file"]).stem, **value}
        return value


class Model(Section):
    """``[estimator.model]``: which symbols of eq. 6 are held, and the baseline under the pulses.

    A symbol is free unless it stands in ``fixed``.
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


class Search(Section):
    """``[estimator.search]``: how the optimum is found; ``start_from`` an earlier result first."""

    method: Literal["guess", "paper"] = "guess"
    start_from: ResultFile | None = None


class Noise(Section):
    """``[estimator.noise]``: what is assumed of the noise; ``order`` belongs to ``ar``."""

    kind: Literal["auto", "white", "ar", "student_t"] = "auto"
    order: int | None = Field(default=None, ge=1, le=15)

    @model_validator(mode="after")
    def _order_of_ar(self) -> Self:
        if self.order is not None and self.kind != "ar":
            refuse(
                "An order belongs to autoregressive noise.",
                found=f'order = {self.order} with kind = "{self.kind}"',
                expected='kind = "ar", or no order',
            )
        return self


class Estimator(Section):
    """``[estimator]``: from a recording to the symbols of the model, or straight to the gap.

    ``bench`` and ``gap_rad``, the range of its log-uniform prior, belong to the direct route; the
    rest to the amplitude route, which the direct one shows beside its own answer.
    """

    route: Literal["amplitude", "direct"] = "amplitude"
    bench: InputPath | None = None
    gap_rad: Range = (1e-4, 1e-2)
    model: Model = Field(default_factory=Model)
    search: Search = Field(default_factory=Search)
    noise: Noise = Field(default_factory=Noise)

    @field_validator("gap_rad")
    @classmethod
    def _positive_gaps(cls, gap_rad: tuple[float, float]) -> tuple[float, float]:
        if gap_rad[0] <= 0.0:
            refuse("A gap must be positive.", found=gap_rad[0], expected="greater than 0")
        return gap_rad

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.route == "direct" and self.bench is None:
            refuse(
                "The direct route needs a bench.",
                found='route = "direct" without a bench',
                expected='bench = "bench.toml"',
            )
        if self.search.method == "paper" and self.model.baseline_harmonics != 0:
            refuse(
                "The paper's search has no baseline.",
                found=f'method = "paper" with {self.model.baseline_harmonics} harmonics',
                expected="baseline_harmonics = 0 in [estimator.model]",
            )
        return self


class Posterior(Section):
    """``[posterior]``: independent ensembles, and when to stop them."""

    ensembles: int = Field(default=4, ge=2, le=64)
    max_steps: int = Field(default=20_000, ge=100)
    check_sampler: bool = False


class Interval(Section):
    """``[interval]``: which credible interval is reported."""

    level: float = Field(default=0.9, gt=0.0, lt=1.0)
    kind: Literal["equal_tailed", "hdi"] = "equal_tailed"


class Curve(Section):
    """``[curve]``: from amplitude to gap; ``published`` or the result of a sweep."""

    source: CurveSource = PUBLISHED
    allow_extrapolation: bool = False


class RunConfig(Section):
    """What every kind of run shares."""

    schema_version: Literal[1] = Field(alias="schema")
    kind: str
    run: Run


class RecordedConfig(RunConfig):
    """A run over recordings whose columns may have other names and units."""

    columns: dict[ChannelName, ColumnEntry] = Field(default_factory=dict)

    @property
    def column_specs(self) -> dict[str, ColumnSpec]:
        """``[columns]`` as the readers take it."""
        return {key: ColumnSpec(column.name, column.unit) for key, column in self.columns.items()}

    @field_validator("columns")
    @classmethod
    def _columns_make_sense(cls, columns: dict[str, Column]) -> dict[str, Column]:
        for channel, column in columns.items():
            if column.unit is not None and column.unit not in accepted_units(channel):
                refuse(
                    f"The unit of {channel} is not known.",
                    found=f'"{column.unit}"',
                    expected=" or ".join(f'"{unit}"' for unit in accepted_units(channel)),
                )
        names = [column.name for column in columns.values()]
        if len(set(names)) < len(names):
            refuse(
                "A column is mapped to two channels.",
                found=", ".join(
                    f'"{name}"' for name in sorted(set(names)) if names.count(name) > 1
                ),
                expected="a column for each channel",
            )
        return columns


class SnapshotConfig(RecordedConfig):
    """A run over measured recordings of one joint."""

    least_recordings: ClassVar[int] = 1
    most_recordings: ClassVar[int | None] = None

    joint: Joint = Field(default_factory=Joint)
    recordings: Annotated[tuple[SnapshotRecording, ...], BeforeValidator(as_tuple)]
    estimator: Estimator = Field(default_factory=Estimator)
    posterior: Posterior = Field(default_factory=Posterior)
    interval: Interval = Field(default_factory=Interval)
    curve: Curve = Field(default_factory=Curve)

    @field_validator("recordings")
    @classmethod
    def _right_number(
        cls, recordings: tuple[SnapshotRecording, ...]
    ) -> tuple[SnapshotRecording, ...]:
        count, least, most = len(recordings), cls.least_recordings, cls.most_recordings
        if count < least or (most is not None and count > most):
            refuse(
                "This is not the number of recordings that this kind of run takes.",
                found=f"{count} recording{'' if count == 1 else 's'}",
                expected=f"exactly {least}" if least == most else f"at least {least}",
            )
        names = [recording.name for recording in recordings]
        if len(set(names)) < len(names):
            refuse(
                "Two recordings have the same name.",
                found=", ".join(f'"{name}"' for name in names),
                expected="a different name for each",
            )
        return recordings


class FitConfig(SnapshotConfig):
    """``kind = "fit"``: one recording."""

    least_recordings = 1
    most_recordings = 1

    kind: Literal["fit"]

    @model_validator(mode="after")
    def _decides_nothing(self) -> Self:
        if self.joint.decide_before is not None:
            refuse(
                "One recording tells no rate of wear, so nothing about a later date.",
                found=f"decide_before = {self.joint.decide_before}",
                expected='kind = "compare" with two dated recordings or more',
            )
        return self


class CompareConfig(SnapshotConfig):
    """``kind = "compare"``: snapshots of one joint in the order they were taken.

    Where all have a date, the dates give the order.
    """

    least_recordings = 2

    kind: Literal["compare"]

    @property
    def dates(self) -> tuple[Date, ...] | None:
        """When each recording was taken; ``None`` unless all are dated."""
        return _dates(self.recordings)

    @field_validator("recordings")
    @classmethod
    def _by_date(cls, recordings: tuple[SnapshotRecording, ...]) -> tuple[SnapshotRecording, ...]:
        dates = _dates(recordings)
        if dates is None:
            return recordings
        order = sorted(range(len(dates)), key=dates.__getitem__)
        return tuple(recordings[number] for number in order)

    @model_validator(mode="after")
    def _decides_on_the_future(self) -> Self:
        before = self.joint.decide_before
        if before is None:
            return self
        if self.dates is None:
            refuse(
                "A date to decide before needs recordings that are dated.",
                found="a recording without a date",
                expected="date = 2026-03-01 in every [[recordings]], or --date for each",
            )
        if before <= self.dates[-1]:
            refuse(
                "The date to decide before is not after the last recording.",
                found=f"decide_before = {before}, last recording {self.dates[-1]}",
                expected="a later date",
            )
        return self


def _dates(recordings: tuple[SnapshotRecording, ...]) -> tuple[Date, ...] | None:
    dates = [recording.date for recording in recordings]
    return tuple(d for d in dates if d is not None) if None not in dates else None


class GapRange(Section):
    """``[sweep] gap_rad``: the gaps over which a bench is swept."""

    low: Positive = 1e-4
    high: Positive = 4e-3
    count: int = Field(default=40, ge=6, le=1000)
    spacing: Literal["log", "linear"] = "log"

    @model_validator(mode="after")
    def _not_empty(self) -> Self:
        if not self.low < self.high:
            refuse(
                "The range of gaps is empty.",
                found=f"low = {self.low:g}, high = {self.high:g}",
                expected="low < high",
            )
        return self


class Sweep(Section):
    """``[sweep]``: which recordings are simulated, and the polynomial through them."""

    gap_rad: GapRange = Field(default_factory=GapRange)
    start_angles: int = Field(default=4, ge=2, le=100)
    rotations: float = Field(default=5.0, ge=2.0, le=100.0)
    sampling_hz: float = Field(default=1000.0, ge=100.0)
    bench_draws: int = Field(default=0, ge=0, le=10_000)
    degree: int = Field(default=3, ge=1, le=8)


class SweepEstimator(Section):
    """``[estimator]`` of a sweep: what decides the meaning of A."""

    model: Model = Field(default_factory=Model)


class SweepConfig(RunConfig):
    """``kind = "sweep"``: the gap curve of a bench."""

    kind: Literal["sweep"]
    bench: InputPath
    sweep: Sweep = Field(default_factory=Sweep)
    estimator: SweepEstimator = Field(default_factory=SweepEstimator)
    interval: Interval = Field(default_factory=Interval)


def _resolve_row(row: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
    """Text that names a file beside the configuration becomes its full path."""
    return {
        key: str(resolve(value, info))
        if key != "name" and isinstance(value, str) and _names_file(value, info)
        else value
        for key, value in row.items()
    }


def _names_file(text: str, info: ValidationInfo) -> bool:
    return "\0" not in text and len(text) < 1024 and resolve(text, info).is_file()


class StudyConfig(RunConfig):
    """``kind = "study"``: an experiment from a file of its own, row by row.

    A row is a free table that the study itself validates; only its ``name`` is asked for here.
    """

    kind: Literal["study"]
    study: InputPath
    rows: Annotated[
        tuple[Annotated[dict[str, Any], AfterValidator(_resolve_row)], ...],
        BeforeValidator(as_tuple),
    ]

    @field_validator("rows")
    @classmethod
    def _named(cls, rows: tuple[dict[str, Any], ...]) -> tuple[dict[str, Any], ...]:
        names = [row.get("name") for row in rows]
        if not rows:
            refuse("A study needs rows.", expected="at least one [[rows]]")
        if not all(isinstance(name, str) and name.strip() for name in names):
            refuse("A row has no name.", found=names, expected="a name as text in every row")
        if len(set(names)) < len(names):
            refuse("Two rows have the same name.", found=names, expected="different names")
        return rows
