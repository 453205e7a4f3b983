"""``kind = "diagnose"``: recordings, the bench believed to describe them, what is unknown."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, field_validator, model_validator

from bayesbl.config.sections import (
    BenchSource,
    ChannelName,
    GapBounds,
    Interval,
    Items,
    Positive,
    RecordedConfig,
    Section,
    SnapshotRecording,
    differently_named,
    refuse,
)
from bayesbl.recording.channels import did_you_mean

Method = Literal["forward", "inverse", "free_motion"]


def effect_names(value: object) -> object:
    """Refused before the choice between ``"all"`` and a list, which would report every branch."""
    # Imported here: the catalogue needs the compiled simulator, which takes a second.
    from bayesbl.bench.effects import EFFECT_BY_NAME

    if value == "all":
        return value
    if not isinstance(value, list | tuple) or not value:
        refuse("This is not a list of effects.", expected='"all", or names in brackets: ["…"]')
    unknown = [name for name in value if not (isinstance(name, str) and name in EFFECT_BY_NAME)]
    if unknown:
        hints = dict.fromkeys(did_you_mean(str(name), EFFECT_BY_NAME) for name in unknown)
        refuse(
            "There is no such effect." + "".join(hints),
            found=", ".join(map(repr, unknown)),
            expected="one of " + ", ".join(EFFECT_BY_NAME),
        )
    return tuple(value)


def bench_parameter(name: str) -> str:
    """A name of a bench parameter; refused if there is none."""
    from bayesbl.bench.parameters import PARAMETER_INFO

    if name not in PARAMETER_INFO:
        refuse(
            "There is no such bench parameter." + did_you_mean(name, PARAMETER_INFO),
            expected="one of " + ", ".join(PARAMETER_INFO),
        )
    return name


class Compared(Section):
    """``[comparison]``: how simulation and recordings are compared.

    Without ``channels`` the method takes what the recordings hold. ``known_torque`` names columns
    that are added to the torque the bench asks for, N m at the motor. ``cutoff_hz`` is that of the
    zero-phase filter that both sides of the inverse method pass; by default the frequency at which
    prediction and measurement lose coherence.
    """

    method: Method = "forward"
    channels: Items[ChannelName] = ()
    known_torque: Items[str] = ()
    load_angle_known: bool = False
    motor_angle_known: bool = False
    cutoff_hz: Positive | None = None

    @field_validator("known_torque")
    @classmethod
    def _in_newton_metres(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        for name in names:
            if not name.endswith("_nm"):
                refuse(
                    "A known torque is given in N m at the motor.",
                    found=f'"{name}"',
                    expected="a name ending in _nm; map the column to one under [columns]",
                )
        return names


class Unknowns(Section):
    """``[unknowns]``: what is fitted in any case."""

    gap_rad: GapBounds | None = None
    bench_parameters: Items[Annotated[str, AfterValidator(bench_parameter)]] = ()


class DiagnosedRecording(SnapshotRecording):
    """An entry of ``[[recordings]]``; ``split`` fits on its first half and predicts the second."""

    use: Literal["fit", "hold_out", "split"] = "fit"


class Candidates(Section):
    """``[candidates]``: effects that may be named, how many, and how often a line is one falsely.

    The last is of a rigid drive's speed. Without ``max_effects`` three in the closed loop, where
    each costs many simulations, else six.
    """

    effects: Annotated[Literal["all"] | tuple[str, ...], BeforeValidator(effect_names)] = "all"
    max_effects: int | None = Field(default=None, ge=1, le=10)
    false_alarm: float = Field(default=0.01, gt=0.0, le=0.5)


class DiagnoseConfig(RecordedConfig):
    """``kind = "diagnose"``."""

    kind: Literal["diagnose"]
    bench: BenchSource
    comparison: Compared = Field(default_factory=Compared)
    unknowns: Unknowns = Field(default_factory=Unknowns)
    recordings: Annotated[Items[DiagnosedRecording], AfterValidator(differently_named)]
    candidates: Candidates = Field(default_factory=Candidates)
    interval: Interval = Field(default_factory=Interval)

    @model_validator(mode="after")
    def _something_held_out(self) -> Self:
        uses = {recording.use for recording in self.recordings}
        if "split" not in uses and uses != {"fit", "hold_out"}:
            missing = "held out" if "fit" in uses else "to fit on"
            refuse(
                f"There is nothing {missing}: an effect is named only if it also predicts what it "
                "was not fitted on.",
                found=", ".join(f'{r.name}: use = "{r.use}"' for r in self.recordings)
                or "no recordings",
                expected='use = "hold_out" for one recording, or "split"',
            )
        return self
