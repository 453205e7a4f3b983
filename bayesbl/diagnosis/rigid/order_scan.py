"""Which order of the motor's turning stands out of the residual, against the noise around it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.stats import chi2

from bayesbl.diagnosis.residuals.unexplained import Unexplained
from bayesbl.recording.types import ComplexArray, FloatArray
from bayesbl.units import unit_of

FEWEST_CYCLES = 3.0
FEWEST_SAMPLES = 20
"""That an order must pass in to be judged: below, its score is no χ²."""
MOST_REMAINING = 5
_STEPS_PER_CYCLE = 5.0
_MOST_ORDERS = 40_000
_LEVEL_CYCLES = 20.0
"""Resolved cycles over which the noise of an order is taken: wide beside a line, not the range."""


@dataclass(frozen=True, slots=True)
class OrderScan:
    """Score of sin and cos of every order: χ² if nothing is there.

    |Σ r exp(i n θ)|² over half of what the noise around that order makes of it, by the median of
    the neighbouring orders, which a line among them does not move; summed over recordings before
    the square where they share one phase, after it where not.

    Attributes
    ----------
    orders, scores
        Shape (m,), evenly spaced; empty if the motor does not turn far enough.
    amplitudes
        Of the wave of each order, mean over recordings weighted by samples, shape (m,).
    independent
        Number of orders that are independent of one another.
    freedom
        Degrees of freedom of a score.
    """

    orders: FloatArray
    scores: FloatArray
    amplitudes: FloatArray
    independent: float
    freedom: int

    def best(self) -> tuple[float, float, float]:
        """The order of the highest score, the scan's step, and the number of trials."""
        if not self.orders.size:
            return 1.0, 0.1, 1.0
        step, k = float(self.orders[1] - self.orders[0]), int(np.argmax(self.scores))
        return float(self.orders[k]), step, self.trials(float(self.scores[k]))

    def trials(self, score: float) -> float:
        """How much likelier a score is somewhere than at one order (Baluev 2008).

        W √(χ²/2), W the independent orders: between them the score can rise a little further.
        """
        return self.independent * math.sqrt(max(1.0, 0.5 * score))

    def remaining(
        self, channel: str, recordings: tuple[str, ...], false_alarm: float
    ) -> tuple[Unexplained, ...]:
        """Orders that stand out, strongest first, at most :data:`MOST_REMAINING`.

        ``recordings`` are those that were scanned. Neighbours within two resolved cycles belong to
        the stronger line.
        """
        found = list[Unexplained]()
        if not self.orders.size:
            return ()
        width = 2.0 * _STEPS_PER_CYCLE * float(self.orders[1] - self.orders[0])
        left = self.scores.copy()
        while len(found) < MOST_REMAINING:
            k = int(np.argmax(left))
            score, order = float(left[k]), float(self.orders[k])
            if self.trials(score) * chi2.sf(score, self.freedom) > false_alarm:
                break
            found.append(
                Unexplained(
                    channel,
                    "motor angle",
                    float(self.amplitudes[k]),
                    unit_of(channel),
                    order,
                    order,
                    math.nan,
                    recordings,
                    score,
                )
            )
            left[np.abs(self.orders - order) <= width] = 0.0
        return tuple(found)


def scan_orders(
    angles: list[FloatArray],
    rests: list[FloatArray],
    shared: bool,
    low: float,
    high: float,
    highest: list[FloatArray],
) -> OrderScan:
    """Scan residuals over motor angles (rad), one array each per recording.

    Parameters
    ----------
    shared
        Whether all recordings have one phase, because their angle is absolute.
    low, high
        Orders looked at; none with fewer than three cycles in the longest recording.
    highest
        At every sample, the highest order that its filter passes: one as fast as that is not there
        to be seen.
    """
    ends = [(float(a.min()), float(a.max())) for a in angles]
    turns = max(last - first for first, last in ends) / (2.0 * math.pi)
    if shared:
        turns = (max(e[1] for e in ends) - min(e[0] for e in ends)) / (2.0 * math.pi)
    low = max(low, FEWEST_CYCLES / turns) if turns > 0.0 else high
    count = int(min(_MOST_ORDERS, (high - low) * turns * _STEPS_PER_CYCLE)) + 1
    freedom = 2 if shared else 2 * len(angles)
    if low >= high or count < 2:
        nothing = np.array([])
        return OrderScan(nothing, nothing, nothing, 1.0, freedom)
    orders = np.linspace(low, high, count)
    total, size = np.zeros(count, dtype=complex), np.zeros(count)
    scores, spread = np.zeros(count), np.zeros(count)
    samples = np.zeros(count)
    for angle, rest, passed in zip(angles, rests, highest, strict=True):
        slowest_first = np.argsort(-passed)
        ends = np.searchsorted(-passed[slowest_first], -orders)
        found = _transform(angle[slowest_first], rest[slowest_first], orders, ends)
        samples += ends
        level = median_filter(np.abs(found) ** 2, round(_LEVEL_CYCLES * _STEPS_PER_CYCLE))
        here = np.maximum(level / chi2.median(2), np.finfo(float).tiny)
        total += found
        size += np.abs(found)
        spread += here
        scores += np.abs(found) ** 2 / here
    if shared:
        scores, size = np.abs(total) ** 2 / spread, np.abs(total)
    scores = np.where(samples < FEWEST_SAMPLES, 0.0, scores)
    amplitudes = 2.0 * size / np.maximum(samples, 1.0)
    return OrderScan(orders, scores, amplitudes, max(1.0, (high - low) * turns), freedom)


def _transform(
    angle: FloatArray, rest: FloatArray, orders: FloatArray, ends: NDArray[np.intp]
) -> ComplexArray:
    """Σ r exp(i n θ) over the first samples, for evenly spaced orders.

    One wave is turned on from order to order.
    """
    wave = rest * np.exp(1j * orders[0] * angle)
    turn = np.exp(1j * (orders[1] - orders[0]) * angle)
    out = np.empty(orders.size, dtype=complex)
    for k, end in enumerate(ends):
        out[k] = wave[:end].sum()
        wave = wave[:end] * turn[:end]
    return out
