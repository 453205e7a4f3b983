"""Which order of the motor's turning stands out of the residual, against the noise around it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
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
_MOST_PRODUCTS = 100_000_000
_LEVEL_CYCLES = 20.0
"""Resolved cycles over which the noise of an order is taken: wide beside a line, not the range."""


@dataclass(frozen=True, slots=True)
class OrderScan:
    """Score of sin and cos of every order: χ² if nothing is there.

    |Σ r exp(i n θ)|² over half of what noise makes of it: the larger of what the neighbouring
    orders hold, by their median, which a line among them does not move, and of what the residual
    would if it were white, so that what leaks from a line into a quiet place is none. It is summed
    over recordings before the square where they share one phase, after it where not. What a filter
    passes and what it holds back are scored apart: a ripple may show at high speed alone.

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


@dataclass(frozen=True, slots=True)
class OrderedRest:
    """A residual over the motor's angle, rad, each of shape (n,).

    ``passing``: order of the motor's turning at the filter's cut-off at that sample; those below it
    are seen, or those ``above``.
    """

    recording: str
    angle: FloatArray
    rest: FloatArray
    passing: FloatArray
    above: bool


def scan_orders(rests: list[OrderedRest], shared: bool, low: float, high: float) -> OrderScan:
    """Scan residuals over motor angles.

    Parameters
    ----------
    shared
        Whether all recordings have one phase, because their angle is absolute.
    low, high
        Orders looked at; none with fewer than three cycles in the longest recording.
    """
    ends = [(float(item.angle.min()), float(item.angle.max())) for item in rests]
    turns = max(last - first for first, last in ends) / (2.0 * math.pi)
    if shared:
        turns = (max(e[1] for e in ends) - min(e[0] for e in ends)) / (2.0 * math.pi)
    low = max(low, FEWEST_CYCLES / turns) if turns > 0.0 else high
    count = int(min(_MOST_ORDERS, (high - low) * turns * _STEPS_PER_CYCLE)) + 1
    owners = [(item.above, "" if shared else item.recording) for item in rests]
    sums = dict.fromkeys(owners)
    if low >= high or count < 2:
        nothing = np.array([])
        return OrderScan(nothing, nothing, nothing, 1.0, 2 * len(sums))
    orders = np.linspace(low, high, count)
    waves = {owner: np.zeros(count, dtype=complex) for owner in sums}
    powers = {owner: np.zeros(count) for owner in sums}
    size, samples = np.zeros(count), np.zeros(count)
    for owner, item in zip(owners, rests, strict=True):
        found, seen, white = _transform(item, orders)
        level = median_filter(np.abs(found) ** 2, round(_LEVEL_CYCLES * _STEPS_PER_CYCLE))
        enough = seen >= FEWEST_SAMPLES
        waves[owner] += np.where(enough, found, 0.0)
        powers[owner] += np.where(enough, np.maximum(level / chi2.median(2), white), 0.0)
        samples += seen
    scores = np.zeros(count)
    for owner, wave in waves.items():
        scores += np.abs(wave) ** 2 / np.where(powers[owner] > 0.0, powers[owner], np.inf)
        size += np.abs(wave)
    amplitudes = 2.0 * size / np.maximum(samples, 1.0)
    return OrderScan(orders, scores, amplitudes, max(1.0, (high - low) * turns), 2 * len(sums))


def _transform(
    item: OrderedRest, orders: FloatArray
) -> tuple[ComplexArray, FloatArray, FloatArray]:
    """Σ r exp(i n θ) over the samples that show the order, their number, and ½ Σ r² of them.

    Orders are evenly spaced: one wave is turned on from order to order.
    """
    below, limit = not item.above, item.passing
    chosen = np.arange(limit.size)
    most = max(_MOST_PRODUCTS // orders.size, 1)
    if limit.size > most:  # at random: even steps would make one order look like another
        chosen = np.sort(np.random.default_rng(0).permutation(limit.size)[:most])
    limit, angle, rest = limit[chosen], item.angle[chosen], item.rest[chosen]
    # Ordered so that the samples that show an order are always the first ones.
    first = np.argsort(-limit if below else limit)
    ordered = limit[first]
    ends = np.searchsorted(-ordered, -orders) if below else np.searchsorted(ordered, orders)
    steps = range(orders.size) if below else range(orders.size - 1, -1, -1)
    wave = rest[first] * np.exp(1j * orders[steps[0]] * angle[first])
    turn = np.exp(1j * (orders[1] - orders[0]) * angle[first] * (1.0 if below else -1.0))
    out = np.empty(orders.size, dtype=complex)
    for k in steps:
        end = ends[k]
        out[k] = wave[:end].sum()
        wave = wave[:end] * turn[:end]
    squares = np.concatenate(([0.0], np.cumsum(rest[first] ** 2)))
    return out, ends.astype(float), 0.5 * squares[ends]
