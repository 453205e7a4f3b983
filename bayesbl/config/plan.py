"""``kind = "plan"``: a bench, and what its joint may do to show its gap."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, field_validator

from bayesbl.config.fields import BenchSource, Positive, Section, as_tuple
from bayesbl.config.motion import two_angles
from bayesbl.config.sections import RunConfig


class Limits(Section):
    """``[limits]``: load angles, speed and acceleration of the motor, rests, length."""

    range_rad: Annotated[tuple[float, ...], BeforeValidator(as_tuple)] = (-0.5, 0.5)
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
