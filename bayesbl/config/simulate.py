"""``kind = "simulate"``: recordings to be made on a bench."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from bayesbl.config.sections import (
    SHORTEST_WAY_RAD,
    BenchSource,
    Gap,
    Items,
    Name,
    OutputPath,
    Positive,
    Section,
    refuse,
    require_different,
    two_angles,
)

Angles = Items[float]


class _PointToPoint(Section):
    """What motions from point to point share: the motor's speed, acceleration and rests.

    Trapezoids in speed; S-curves where the jerk is limited.
    """

    speed_rpm: Positive
    acceleration_rpm_per_s: Positive
    jerk_rpm_per_s2: Positive | None = None
    dwell_s: float = Field(default=0.15, ge=0.0)
    duration_s: Positive


class StrokesMotion(_PointToPoint):
    """Between two load angles and back."""

    kind: Literal["strokes"]
    range_rad: Angles

    _range = field_validator("range_rad")(two_angles)


class CycleMotion(_PointToPoint):
    """Through some load angles in turn, over and over."""

    kind: Literal["cycle"]
    points_rad: Angles

    @field_validator("points_rad")
    @classmethod
    def _that_move(cls, points: tuple[float, ...]) -> tuple[float, ...]:
        following = points[1:] + points[:1]
        if len(points) < 2 or any(
            abs(b - a) < SHORTEST_WAY_RAD for a, b in zip(points, following, strict=True)
        ):
            refuse(
                "A cycle goes from each point to another.",
                found=list(points),
                expected="two load angles or more in rad, each different from the one before",
            )
        return points


class SineMotion(Section):
    """To and fro between two load angles, the angle a sine over time."""

    kind: Literal["sine"]
    range_rad: Angles
    period_s: Positive
    duration_s: Positive

    _range = field_validator("range_rad")(two_angles)


class TorqueRampMotion(Section):
    """The motor's torque to and fro with the output held: some cycles at each amplitude."""

    kind: Literal["torque_ramp"]
    torque_nm: Annotated[Items[Positive], Field(min_length=1)]
    cycles: int = Field(default=5, ge=1)
    period_s: Positive = 4.0
    start_angle_rad: float = 0.0

    @property
    def duration_s(self) -> float:
        """Of all cycles."""
        return len(self.torque_nm) * self.cycles * self.period_s


MotionSection = Annotated[
    StrokesMotion | CycleMotion | SineMotion | TorqueRampMotion, Field(discriminator="kind")
]


class SimulatedRecording(Section):
    """An entry of ``[[recordings]]`` to be simulated.

    In steady rotation, from a start angle that is drawn unless given; or in a motion.
    """

    name: Name
    file: str = Field(min_length=1)
    gap_rad: Gap
    reference_speed_rpm: float | None = None
    rotations: Positive = 5.0
    sampling_hz: Positive = 1000.0
    start_angle_rad: float | None = None
    motor_start_angle_rad: float | None = None
    motion: MotionSection | None = None

    @model_validator(mode="after")
    def _either_turns_or_moves(self) -> Self:
        steady = {"rotations", "reference_speed_rpm", "start_angle_rad"} & self.model_fields_set
        if self.motion is not None and steady:
            refuse(
                "A motion has its own speed, length and start.",
                found=f"motion and {', '.join(sorted(steady))}",
                expected="motion alone, or steady rotation without it",
            )
        return self


class SimulateRun(Section):
    """``[run]`` of a simulation; without an output the files go beside the configuration."""

    seed: int = Field(default=1, ge=0, lt=2**63)
    workers: int = Field(default=1, ge=1, le=1024)
    output: OutputPath | None = None


class SimulateFile(Section):
    """``kind = "simulate"``."""

    schema_version: Literal[1] = Field(alias="schema")
    kind: Literal["simulate"]
    run: SimulateRun = SimulateRun()
    bench: BenchSource
    truth_file: str | None = Field(default=None, min_length=1)
    recordings: Annotated[Items[SimulatedRecording], Field(min_length=1)]

    @field_validator("recordings")
    @classmethod
    def _different_files(
        cls, recordings: tuple[SimulatedRecording, ...]
    ) -> tuple[SimulatedRecording, ...]:
        for kind in ("name", "file"):
            values = [getattr(recording, kind) for recording in recordings]
            require_different(values, f"Two recordings have the same {kind}.")
        return recordings
