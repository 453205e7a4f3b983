"""Every kind of file, and the model of those that describe a run; the short ones are here."""

from __future__ import annotations

import os
from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator

from bayesbl.config.diagnose import DiagnoseConfig, bench_parameter, effect_name, word_or_names
from bayesbl.config.fleet import FleetConfig
from bayesbl.config.measurement import CompareConfig, FitConfig
from bayesbl.config.sections import (
    BenchSource,
    ClusterRun,
    GapBounds,
    InputPath,
    Interval,
    Items,
    Model,
    Positive,
    RecordedConfig,
    RunConfig,
    Section,
    SnapshotRecording,
    differently_named,
    refuse,
    require_different,
    resolve,
    two_angles,
)


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

    @field_validator("degree")
    @classmethod
    def _fewer_than_gaps(cls, degree: int, info: ValidationInfo) -> int:
        gap_rad = info.data.get("gap_rad")  # absent if it was refused itself
        if gap_rad is not None and gap_rad.count < degree + 3:
            refuse(
                "The sweep has too few gaps for this degree.",
                found=f"degree = {degree} with gap_rad.count = {gap_rad.count}",
                expected=f"gap_rad.count of at least {degree + 3}, or a degree of at most "
                f"{gap_rad.count - 3}",
            )
        return degree


class SweepEstimator(Section):
    """``[estimator]`` of a sweep: what decides the meaning of A."""

    model: Model = Field(default_factory=Model)


class SweepConfig(RunConfig):
    """``kind = "sweep"``: the gap curve of a bench."""

    kind: Literal["sweep"]
    bench: BenchSource
    sweep: Sweep = Field(default_factory=Sweep)
    estimator: SweepEstimator = Field(default_factory=SweepEstimator)
    interval: Interval = Field(default_factory=Interval)


class Limits(Section):
    """``[limits]``: load angles, speed and acceleration of the motor, rests, length."""

    range_rad: Items[float] = (-0.5, 0.5)
    speed_rpm: Positive = 1500.0
    acceleration_rpm_per_s: Positive = 6000.0
    dwell_s: float = Field(default=0.15, ge=0.0)
    duration_s: float = Field(default=20.0, ge=1.0, le=600.0)

    _range = field_validator("range_rad")(two_angles)


class PlanConfig(RunConfig):
    """``kind = "plan"``: motions ranked by the width of δ that they promise at ``gap_rad``."""

    kind: Literal["plan"]
    bench: BenchSource
    limits: Limits = Field(default_factory=Limits)
    gap_rad: Positive = 8e-4
    sampling_hz: float = Field(default=1000.0, ge=100.0)


def _resolve_row(row: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
    """Text that names a file beside the configuration becomes its full path."""
    return {
        key: str(resolve(value, info))
        if key != "name" and isinstance(value, str) and os.path.isfile(resolve(value, info))
        else value
        for key, value in row.items()
    }


class StudyConfig(RunConfig):
    """``kind = "study"``: an experiment from a file of its own, row by row.

    A row is a free table that the study itself validates; only its ``name`` is required here.
    """

    kind: Literal["study"]
    run: ClusterRun
    study: InputPath
    rows: Items[Annotated[dict[str, Any], AfterValidator(_resolve_row)]]

    @field_validator("rows")
    @classmethod
    def _named(cls, rows: tuple[dict[str, Any], ...]) -> tuple[dict[str, Any], ...]:
        names = [row.get("name") for row in rows]
        if not rows:
            refuse("A study needs rows.", expected="at least one [[rows]]")
        if not all(isinstance(name, str) and name.strip() for name in names):
            refuse("A row has no name.", found=names, expected="a name as text in every row")
        require_different(list(map(str, names)), "Two rows have the same name.")
        return rows


class IdentifiedRecording(SnapshotRecording):
    """An entry of ``[[recordings]]``; one that is held out is predicted, not fitted."""

    use: Literal["fit", "hold_out"] = "fit"


_Parameters = Annotated[
    Literal["toleranced"] | tuple[str, ...],
    word_or_names("toleranced", "bench parameters", bench_parameter),
]
_Effects = Annotated[
    Literal["catalogue"] | tuple[str, ...],
    word_or_names("catalogue", "effects", effect_name, fewest=0),
]


class Identify(Section):
    """``[identify]``: what is free beside gap and start angles.

    ``parameters``: those with a tolerance in the bench, or some of these by name. ``effects``:
    names of the catalogue, free from the start; ``"catalogue"``: those that the recordings name,
    if the bench cannot explain them. ``gap_rad``: range of the gap's log-uniform prior.
    """

    parameters: _Parameters = "toleranced"
    effects: _Effects = ()
    gap_rad: GapBounds = (1e-4, 1e-2)


class IdentifyConfig(RecordedConfig):
    """``kind = "identify"``.

    Recordings share one gap; if their dates differ, each has a gap of its own.
    """

    kind: Literal["identify"]
    bench: InputPath
    identify: Identify = Field(default_factory=Identify)
    recordings: Annotated[Items[IdentifiedRecording], AfterValidator(differently_named)]
    interval: Interval = Field(default_factory=Interval)

    @property
    def shares_gap(self) -> bool:
        """Whether all recordings are of one date, or of none."""
        return len({entry.date for entry in self.recordings}) == 1

    @model_validator(mode="after")
    def _something_to_fit_and_to_hold_out(self) -> Self:
        if all(recording.use == "hold_out" for recording in self.recordings):
            refuse(
                "There is no recording to identify the bench from.",
                found="no recordings" if not self.recordings else 'use = "hold_out" in all',
                expected='[[recordings]] with use = "fit", best at two speeds in both directions',
            )
        held = [recording.name for recording in self.recordings if recording.use == "hold_out"]
        if held and not self.shares_gap:
            refuse(
                "A recording that is held out is predicted with the gap of the others.",
                found=f"{', '.join(held)} held out, and dates that differ",
                expected='one date for all recordings, or use = "fit"',
            )
        return self


KINDS: Mapping[str, type[RunConfig]] = MappingProxyType(
    {
        "fit": FitConfig,
        "compare": CompareConfig,
        "sweep": SweepConfig,
        "plan": PlanConfig,
        "diagnose": DiagnoseConfig,
        "identify": IdentifyConfig,
        "study": StudyConfig,
        "fleet": FleetConfig,
    }
)
"""Kind to the model of its configuration."""

FILES: Mapping[str, str] = MappingProxyType(
    {
        "fit": "one recording to be measured",
        "compare": "recordings to be measured and compared",
        "simulate": "recordings to be made on a bench",
        "sweep": "a bench to be swept over its gap",
        "plan": "a bench whose motions are to be ranked",
        "diagnose": "recordings, and the bench that should describe them",
        "identify": "recordings, and the data sheet that a bench is identified from",
        "study": "an experiment and its rows",
        "fleet": "an inventory of joints, and where their recordings are",
        "bench": "a virtual bench",
    }
)
"""Kind to what a file of this kind holds, in words."""

RUNNABLE = tuple(kind for kind in FILES if kind != "bench")
"""The kinds that ``bayesbl run`` takes."""
