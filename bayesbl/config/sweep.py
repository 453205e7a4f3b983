"""``kind = "sweep"``: a bench, and the gaps it is swept over for a curve of its own."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from bayesbl.config.fields import BenchSource, Positive, Section, refuse
from bayesbl.config.sections import Interval, Model, RunConfig


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
