"""A speed that comes in steps: rounded, or differentiated from an encoder's counts.

If the other noise is well below a step, the rounding is the same in every rotation that starts at
the same count. Like the misfit it then cancels between rotations, so what does not repeat does not
show it. Its size is known from the step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bayesbl.recording.types import FloatArray

ON_STEPS = 0.9
"""Share of the samples that must lie on the steps; bridged ones lie between."""

_WHOLE = 0.01
"""Largest distance from a whole number of steps."""


@dataclass(frozen=True, slots=True)
class SpeedSteps:
    """Steps of a quantised speed.

    Attributes
    ----------
    size_rpm
        One step.
    differentiated
        The speed is the difference of counted positions, one count a step.
    """

    size_rpm: float
    differentiated: bool

    @property
    def sd_rpm(self) -> float:
        """Standard deviation of the rounding, uniform within a step: of one, or of two together."""
        return self.size_rpm / math.sqrt(6.0 if self.differentiated else 12.0)


def speed_steps(speed_rpm: FloatArray) -> SpeedSteps | None:
    """The steps of a quantised speed; ``None`` if it is not quantised."""
    values, count = np.unique(speed_rpm, return_counts=True)
    levels = values[count > 1]
    if levels.size < 2:
        return None
    gaps = np.diff(levels)
    # The same level computed in two ways differs by rounding.
    size = float(gaps[gaps > 1e-9 * np.abs(levels).max()].min(initial=np.inf))
    if not math.isfinite(size):
        return None
    size = float(levels[-1] - levels[0]) / round(float(levels[-1] - levels[0]) / size)
    steps = (speed_rpm - levels[0]) / size
    if np.mean(np.abs(steps - np.round(steps)) < _WHOLE) < ON_STEPS:
        return None
    # Lag-1 autocorrelation of the change from sample to sample: −1/2 of a white rounding,
    # −2/3 of the difference of one.
    change = np.diff(speed_rpm)
    change = change - change.mean()
    correlation = float(change[1:] @ change[:-1] / (change @ change))
    return SpeedSteps(size, correlation < -0.58)
