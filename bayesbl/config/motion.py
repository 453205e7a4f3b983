"""``motion = {…}``: what a joint is asked to do, where it does not turn at one speed."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, field_validator

from bayesbl.config.fields import Positive, Section, as_tuple, refuse

Angles = Annotated[tuple[float, ...], BeforeValidator(as_tuple)]

FEWEST_TURNS = 1e-3
"""rad at the load: a way shorter than this is no motion."""


def two_angles(angles: tuple[float, ...]) -> tuple[float, ...]:
    """A range of load angles, the lower first."""
    if len(angles) != 2 or not angles[1] - angles[0] >= FEWEST_TURNS:
        refuse(
            "A range has a lower and an upper load angle.",
            found=list(angles),
            expected="two angles in rad, the lower first, e.g. [-0.5, 0.5]; 0 hangs straight down",
        )
    return angles


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
            abs(b - a) < FEWEST_TURNS for a, b in zip(points, following, strict=True)
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
    torque_nm: Annotated[tuple[Positive, ...], Field(min_length=1), BeforeValidator(as_tuple)]
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
