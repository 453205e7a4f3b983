"""``kind = "diagnose"``: recordings, the bench believed to describe them, what is unknown."""

from __future__ import annotations

from collections.abc import Callable, Collection
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


def effect_name(name: str) -> str:
    """A name of the catalogue; refused if there is none."""
    # Imported here: the catalogue needs the compiled simulator, which takes a second.
    from bayesbl.bench.effects import EFFECT_BY_NAME

    return known_name(name, EFFECT_BY_NAME, "effect")


def bench_parameter(name: str) -> str:
    """A name of a bench parameter; refused if there is none."""
    from bayesbl.bench.parameters import PARAMETER_INFO

    return known_name(name, PARAMETER_INFO, "bench parameter")


def known_name(name: str, known: Collection[str], what: str) -> str:
    """The name; refused unless it is one of those known."""
    if name not in known:
        refuse(
            f"There is no such {what}." + did_you_mean(name, known),
            found=repr(name),
            expected="one of " + ", ".join(known),
        )
    return name


def word_or_names(
    word: str, what: str, known: Callable[[str], str], fewest: int = 1
) -> BeforeValidator:
    """Refuses before the choice between a word and a list, which would report every branch."""

    def read(value: object) -> object:
        if value == word:
            return value
        if not isinstance(value, list | tuple) or len(value) < fewest:
            refuse(
                f"This is not a list of {what}.", expected=f'"{word}", or names in brackets: ["…"]'
            )
        return tuple(known(str(name)) for name in value)

    return BeforeValidator(read)


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

    effects: Annotated[
        Literal["all"] | tuple[str, ...], word_or_names("all", "effects", effect_name)
    ] = "all"
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
