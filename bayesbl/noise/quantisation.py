"""A speed that comes in steps: rounded, or differentiated from an encoder's counts.

If the other noise is well below a step, the rounding is the same in every rotation that starts at
the same count. Like the misfit it then cancels between rotations, so what does not repeat does not
show it. Its size is known from the step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from bayesbl.recording.types import FloatArray

ON_STEPS = 0.9
"""Share of the samples that must lie on the steps; bridged ones lie between."""

MOVES = 0.5
"""Share of the rounding's variance from which on a signal moves through its steps."""

BEYOND_ONE_ROUNDING = 1.5
"""Variance of one rounding, times this: half-way to that of the difference of two."""

COARSEST_PRINT = 0.1
"""Of a step: of digits coarser than that any speed would seem to be on steps."""

SHARED_COUNT = -0.25
"""Correlation of neighbouring samples: half-way to that of differences that share a count."""

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
    level_rpm
        One of the levels.
    """

    size_rpm: float
    differentiated: bool
    level_rpm: float = 0.0

    @property
    def sd_rpm(self) -> float:
        """Standard deviation of the rounding, uniform within a step: of one, or of two together."""
        return self.size_rpm / math.sqrt(6.0 if self.differentiated else 12.0)

    def drawn(self, exact_rpm: FloatArray, rng: np.random.Generator) -> FloatArray:
        """What may be rounded away of an exact speed, rpm; where its steps lie is by chance."""
        place = exact_rpm / self.size_rpm
        if not self.differentiated:
            place = place + rng.uniform()
            return np.asarray(self.size_rpm * (place - np.round(place)))
        place = np.cumsum(place) + rng.uniform()
        away = place - np.round(place)
        return np.asarray(self.size_rpm * np.diff(away, prepend=rng.uniform(-0.5, 0.5)))

    def rounded_away(self, exact_rpm: FloatArray) -> FloatArray:
        """What an exact speed has more than the rounded one, about its mean, rpm."""
        place = (exact_rpm - self.level_rpm) / self.size_rpm
        if self.differentiated:
            place = np.cumsum(exact_rpm / self.size_rpm)
        away = place - np.round(place)
        if self.differentiated:
            away = np.diff(away)
        return np.asarray(self.size_rpm * (away - away.mean()))


def speed_steps(speed_rpm: FloatArray) -> SpeedSteps | None:
    """The steps of a quantised speed; ``None`` if it is not quantised."""
    values, count = np.unique(speed_rpm, return_counts=True)
    levels = values[count > 1]
    if levels.size < 2:
        return None
    gaps = np.diff(levels)
    # The same level computed in two ways differs by rounding.
    gaps = gaps[gaps > 1e-9 * np.abs(levels).max()]
    if not gaps.size:
        return None
    # Printed digits may make neighbouring steps differ in size; over all of them that cancels.
    single = float(gaps[gaps < 1.5 * gaps.min()].mean())
    size = float(gaps.sum()) / float(np.round(gaps / single).sum())
    printed = _printed_resolution(speed_rpm)
    away = np.abs(speed_rpm - levels[0] - size * np.round((speed_rpm - levels[0]) / size))
    off_by = _WHOLE * size + (printed if printed < COARSEST_PRINT * size else 0.0)
    if np.mean(away < off_by) < ON_STEPS:
        return None
    # Lag-1 autocorrelation of the change from sample to sample: −1/2 of a white rounding,
    # −2/3 of the difference of one.
    change = np.diff(speed_rpm)
    change = change - change.mean()
    correlation = float(change[1:] @ change[:-1] / (change @ change))
    return SpeedSteps(size, correlation < -0.58, float(levels[0]))


def _printed_resolution(values: FloatArray) -> float:
    """The decimal that all values are whole numbers of: 0.01 of 1495.06; 0 where there is none."""
    for digits in range(7):
        if np.all(np.abs(values - np.round(values, digits)) < 1e-9 * np.maximum(1.0, abs(values))):
            return float(10.0**-digits)
    return 0.0


@dataclass(frozen=True, slots=True)
class Rounding:
    """By how much a recorded channel differs from what it is compared with, however still it is.

    Attributes
    ----------
    steps
        Of the channel; ``None`` if it is not quantised.
    least_sd
        Standard deviation of what the simulation is not exact by.
    """

    steps: SpeedSteps | None
    least_sd: float

    @property
    def sd(self) -> float:
        """Standard deviation of both together, in the channel's unit."""
        return math.hypot(self.least_sd, 0.0 if self.steps is None else self.steps.sd_rpm)

    def autocovariance(self, exact: FloatArray, residual: FloatArray, lags: int) -> FloatArray:
        """γ(0) … γ(lags − 1) of what is rounded away of an exact signal, shape (lags,).

        A signal that hardly moves in a step is taken for one that moves: white rounding, of the
        position behind a difference.

        Parameters
        ----------
        exact, left
            Shape (n,): the signal, and what the recording has beyond it.
        """
        autocovariance = np.zeros(lags)
        autocovariance[0] = self.least_sd**2
        if self.steps is None:
            return autocovariance
        steps = self._steps_behind(residual)
        if steps is None:
            autocovariance[0] += self.steps.size_rpm**2 / 6.0
            return autocovariance
        variance = steps.sd_rpm**2
        autocovariance[0] += variance
        away = steps.rounded_away(exact)
        power = float(away @ away)
        if power > MOVES * away.size * variance:
            autocovariance[1:] += variance * np.array(
                [away[k:] @ away[: away.size - k] / power for k in range(1, lags)]
            )
        elif steps.differentiated:
            autocovariance[1] -= 0.5 * variance
        return autocovariance

    def drawn(
        self, exact: FloatArray, residual: FloatArray, rng: np.random.Generator
    ) -> FloatArray:
        """What a recording may have less than an exact signal, as :meth:`autocovariance` takes it.

        Shape (n,).
        """
        rounding = self.least_sd * rng.standard_normal(exact.size)
        if self.steps is None:
            return rounding
        steps = self._steps_behind(residual)
        if steps is None:
            counts = rng.uniform(size=(2, exact.size))
            return np.asarray(rounding + self.steps.size_rpm * (counts[1] - counts[0]))
        return rounding + steps.drawn(exact, rng)

    def _steps_behind(self, residual: FloatArray) -> SpeedSteps | None:
        """As what a recording has beyond the exact signal shows them, (n,).

        ``None``: differences over less than a sample, no two of which share a count.
        """
        steps = self.steps
        if steps is None or (
            float(np.mean(residual**2)) <= BEYOND_ONE_ROUNDING * steps.size_rpm**2 / 12.0
        ):
            return steps
        if residual[1:] @ residual[:-1] > SHARED_COUNT * (residual @ residual):
            return None
        return replace(steps, differentiated=True)
