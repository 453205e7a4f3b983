"""``kind = "identify"``: recordings of a joint, and the data sheet that its bench is found from."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from bayesbl.config.diagnose import bench_parameter, effect_name, word_or_names
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
