"""``kind = "identify"``: recordings of a joint, and the data sheet that its bench is found from."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from bayesbl.config.diagnose import bench_parameter, effect_names
from bayesbl.config.sections import (
    GapBounds,
    InputPath,
    Interval,
    Items,
    RecordedConfig,
    Section,
    SnapshotRecording,
    differently_named,
    refuse,
)


class IdentifiedRecording(SnapshotRecording):
    """An entry of ``[[recordings]]``; one that is held out is predicted, not fitted."""

    use: Literal["fit", "hold_out"] = "fit"


def _parameters(value: object) -> object:
    if value == "toleranced":
        return value
    if not isinstance(value, list | tuple) or not value:
        refuse(
            "This is not a list of bench parameters.",
            expected='"toleranced", or names in brackets: ["…"]',
        )
    return tuple(bench_parameter(str(name)) for name in value)


def _effects(value: object) -> object:
    if value == "catalogue" or (isinstance(value, list | tuple) and not value):
        return value if isinstance(value, str) else ()
    return effect_names(value)


class Identify(Section):
    """``[identify]``: what is free beside gap and start angles.

    ``parameters``: those with a tolerance in the bench, or some of these by name. ``effects``:
    names of the catalogue, free from the start; ``"catalogue"``: those that the recordings name,
    if the bench cannot explain them. ``gap_rad``: range of the gap's log-uniform prior.
    """

    parameters: Annotated[Literal["toleranced"] | tuple[str, ...], BeforeValidator(_parameters)] = (
        "toleranced"
    )
    effects: Annotated[Literal["catalogue"] | tuple[str, ...], BeforeValidator(_effects)] = ()
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
    def _something_to_fit(self) -> Self:
        if all(recording.use == "hold_out" for recording in self.recordings):
            refuse(
                "There is no recording to identify the bench from.",
                found="no recordings" if not self.recordings else 'use = "hold_out" in all',
                expected='[[recordings]] with use = "fit", best at two speeds in both directions',
            )
        return self

    @model_validator(mode="after")
    def _held_out_with_the_same_gap(self) -> Self:
        held = [recording.name for recording in self.recordings if recording.use == "hold_out"]
        if held and not self.shares_gap:
            refuse(
                "A recording that is held out is predicted with the gap of the others.",
                found=f"{', '.join(held)} held out, and dates that differ",
                expected='one date for all recordings, or use = "fit"',
            )
        return self
