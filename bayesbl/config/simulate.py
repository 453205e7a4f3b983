"""``kind = "simulate"``: recordings to be made on a bench."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, field_validator, model_validator

from bayesbl.config.fields import (
    BenchSource,
    Name,
    OutputPath,
    Positive,
    Section,
    as_tuple,
    refuse,
    require_different,
)
from bayesbl.config.files import load_file
from bayesbl.config.motion import MotionSection


class SimulatedRecording(Section):
    """An entry of ``[[recordings]]`` to be simulated.

    In steady rotation, from a start angle that is drawn unless given; or in a motion, which begins
    where it begins.
    """

    name: Name
    file: str = Field(min_length=1)
    gap_rad: float = Field(ge=0.0)
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
    recordings: Annotated[
        tuple[SimulatedRecording, ...], Field(min_length=1), BeforeValidator(as_tuple)
    ]

    @field_validator("recordings")
    @classmethod
    def _different_files(
        cls, recordings: tuple[SimulatedRecording, ...]
    ) -> tuple[SimulatedRecording, ...]:
        for kind in ("name", "file"):
            values = [getattr(recording, kind) for recording in recordings]
            require_different(values, f"Two recordings have the same {kind}.")
        return recordings


def load_simulation(path: str | Path) -> SimulateFile:
    """A simulate file, validated.

    Raises
    ------
    ConfigError
        Naming file and field: no such file, not TOML, unknown keys, values out of range.
    """
    return load_file(Path(path), SimulateFile)
