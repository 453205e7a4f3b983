"""A speed in steps: rounded, or differentiated from an encoder's counts.

If the other noise is well below a step, the rounding is the same in every rotation that starts at
the same count. It then cancels between rotations like the misfit, so rotation differences do not
show it. Its size is known from the step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from bayesbl.recording.types import FloatArray

ON_STEPS = 0.9
"""Share of the samples that must lie on the steps; bridged samples lie between."""

MOVES = 0.5
"""Share of the rounding's variance above which a signal is taken to move through its steps."""

BEYOND_ONE_ROUNDING = 1.5
"""Factor on the variance of one rounding: half-way to that of the difference of two."""

COARSEST_PRINT = 0.1
"""Coarsest printed digits, in steps: with coarser ones any speed would seem to be on steps."""

SHARED_COUNT = -0.25
"""Correlation of neighbouring samples: half-way to that of differences that share a count."""

_WHOLE = 0.01
"""Largest distance from a whole number of steps, in steps."""


@dataclass(frozen=True, slots=True)
class SpeedSteps:
    """Steps of a quantised speed.

    Attributes
    ----------
    size_rpm
        Size of one step.
    differentiated
        Whether the speed is the difference of counted positions, one count a step.
    level_rpm
        One of the levels.
    """

    size_rpm: float
    differentiated: bool
    level_rpm: float = 0.0

    @property
    def sd_rpm(self) -> float:
        """Standard deviation of rounding: uniform in a step, or the difference of two such."""
        return self.size_rpm / math.sqrt(6.0 if self.differentiated else 12.0)

    def drawn(self, exact_rpm: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw the rounding error of an exact speed, rpm, with random position of the steps."""
        position = exact_rpm / self.size_rpm
        if not self.differentiated:
            position = position + rng.uniform()
            return np.asarray(self.size_rpm * (position - np.round(position)))
        position = np.cumsum(position) + rng.uniform()
        error = position - np.round(position)
        return np.asarray(self.size_rpm * np.diff(error, prepend=rng.uniform(-0.5, 0.5)))

    def rounded_away(self, exact_rpm: FloatArray) -> FloatArray:
        """Exact minus rounded speed, about its mean, rpm."""
        position = (exact_rpm - self.level_rpm) / self.size_rpm
        if self.differentiated:
            position = np.cumsum(exact_rpm / self.size_rpm)
        error = position - np.round(position)
        if self.differentiated:
            error = np.diff(error)
        return np.asarray(self.size_rpm * (error - error.mean()))


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
    # Printed digits may make neighbouring steps differ in size; over all steps that cancels.
    single = float(gaps[gaps < 1.5 * gaps.min()].mean())
    size = float(gaps.sum()) / float(np.round(gaps / single).sum())
    printed = _printed_resolution(speed_rpm)
    distance = np.abs(speed_rpm - levels[0] - size * np.round((speed_rpm - levels[0]) / size))
    tolerance = _WHOLE * size + (printed if printed < COARSEST_PRINT * size else 0.0)
    if np.mean(distance < tolerance) < ON_STEPS:
        return None
    # Lag-1 autocorrelation of the change from sample to sample: −1/2 for white rounding,
    # −2/3 for the difference of it.
    change = np.diff(speed_rpm)
    change = change - change.mean()
    correlation = float(change[1:] @ change[:-1] / (change @ change))
    return SpeedSteps(size, correlation < -0.58, float(levels[0]))


def _printed_resolution(values: FloatArray) -> float:
    """Decimal resolution of all values (0.01 for 1495.06); 0 if there is none."""
    for digits in range(7):
        if np.all(np.abs(values - np.round(values, digits)) < 1e-9 * np.maximum(1.0, abs(values))):
            return float(10.0**-digits)
    return 0.0


@dataclass(frozen=True, slots=True)
class Rounding:
    """Least difference between a recorded channel and its simulation: rounding and simulation
    error.

    Attributes
    ----------
    steps
        Steps of the channel; ``None`` if it is not quantised.
    least_sd
        Standard deviation of the error of the simulation.
    """

    steps: SpeedSteps | None
    least_sd: float

    @property
    def sd(self) -> float:
        """Standard deviation of both together, in the channel's unit."""
        return math.hypot(self.least_sd, 0.0 if self.steps is None else self.steps.sd_rpm)

    def autocovariance(self, exact: FloatArray, residual: FloatArray, lags: int) -> FloatArray:
        """γ(0) … γ(lags − 1) of the rounding of an exact signal, shape (lags,).

        A signal that hardly moves within a step is treated as one that moves: its rounding is
        white, or for a differentiated signal that of the position is.

        Parameters
        ----------
        exact, residual
            Shape (n,): the signal, and recording minus signal.
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
        error = steps.rounded_away(exact)
        power = float(error @ error)
        if power > MOVES * error.size * variance:
            autocovariance[1:] += variance * np.array(
                [error[k:] @ error[: error.size - k] / power for k in range(1, lags)]
            )
        elif steps.differentiated:
            autocovariance[1] -= 0.5 * variance
        return autocovariance

    def drawn(
        self, exact: FloatArray, residual: FloatArray, rng: np.random.Generator
    ) -> FloatArray:
        """Draw signal minus recording, (n,); arguments as for :meth:`autocovariance`."""
        rounding = self.least_sd * rng.standard_normal(exact.size)
        if self.steps is None:
            return rounding
        steps = self._steps_behind(residual)
        if steps is None:
            counts = rng.uniform(size=(2, exact.size))
            return np.asarray(rounding + self.steps.size_rpm * (counts[1] - counts[0]))
        return rounding + steps.drawn(exact, rng)

    def _steps_behind(self, residual: FloatArray) -> SpeedSteps | None:
        """The steps that are consistent with the residual, (n,). ``None`` for differences over less
        than a sample, no two of which share a count."""
        steps = self.steps
        if steps is None or (
            float(np.mean(residual**2)) <= BEYOND_ONE_ROUNDING * steps.size_rpm**2 / 12.0
        ):
            return steps
        if residual[1:] @ residual[:-1] > SHARED_COUNT * (residual @ residual):
            return None
        return replace(steps, differentiated=True)
