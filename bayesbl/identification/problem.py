"""What is identified: a data sheet, recordings, and what of them is unknown."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from bayesbl.bench.bench import Bench
from bayesbl.matching.observed import Observed
from bayesbl.matching.signals import (
    Unknown,
    effect_unknowns,
    gap_unknown,
    reference_delay_unknown,
    start_angle_unknown,
    tolerance_unknowns,
)


@dataclass(frozen=True, slots=True)
class Problem:
    """What is identified, and from what.

    Attributes
    ----------
    used, held_out
        Recordings to fit on, and to predict.
    parameters
        Bench parameters that are free, each with a tolerance.
    effects
        Free from the start, by name; ``"catalogue"``: those that the recordings name.
    shares_gap
        Whether all recordings have one gap.
    """

    bench: Bench
    used: tuple[Observed, ...]
    held_out: tuple[Observed, ...]
    parameters: tuple[str, ...]
    effects: tuple[str, ...] | Literal["catalogue"]
    gap_rad: tuple[float, float]
    shares_gap: bool
    workers: int = field(default=1, compare=False)

    @property
    def unknowns(self) -> list[Unknown]:
        """Gaps, start angles, delays of motions, effects of the bench file, and parameters."""
        names = [seen.name for seen in self.used]
        gap = gap_unknown(*self.gap_rad)
        return [
            *([gap] if self.shares_gap else (replace(gap, recording=name) for name in names)),
            *(start_angle_unknown(name) for name in names),
            *(reference_delay_unknown(r.name) for r in self.used if r.motion is not None),
            *effect_unknowns(self.bench, names),
            *(u for u in tolerance_unknowns(self.bench) if u.name in self.parameters),
        ]
