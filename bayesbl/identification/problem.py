"""What is identified: a data sheet, recordings, and what of them is unknown."""

from __future__ import annotations

import math
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
            *(parameter_unknown(self.bench, name) for name in self.parameters),
        ]


def parameter_unknown(bench: Bench, name: str) -> Unknown:
    """A parameter uniform within its tolerance, by its logarithm where all of it is above zero.

    What no recording can show, such as all torques and the torque constant times one factor, is a
    straight line among logarithms, however wide the tolerances.
    """
    value, half = bench.value(name), bench.tolerances[name]
    if value <= half:
        return Unknown(name, value - half, value + half)
    low, high = math.log(value - half), math.log(value + half)
    return Unknown(name, low, high, logarithmic=True, flat_in_value=True)
