"""The paper's search: CMA-ES from the middle of Table 2's ranges, over eq. 6 or the pulse train.

Neither finds the pulses of a recording but by luck (``configs/search_study.toml``): their common
RMSE has too many minima over T_w. What they end at is kept beside the optimum, and trusted only
where it has the optimum's pulses.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from bayesbl.compiled import compiled
from bayesbl.recording.types import FloatArray
from bayesbl.ringing.objective import Objective
from bayesbl.ringing.search import SearchHistory, minimise
from bayesbl.ringing.symbols import (
    AMPLITUDE,
    DECAY,
    FREQUENCY,
    LINEAR,
    MEAN,
    ROTATION,
    SEPARATION,
    START,
    SYMBOLS,
    WINDOW_END,
    WINDOW_START,
)

POPULATION = 3500
ITERATIONS = 100
REPETITIONS = 4
LONGEST_WINDOW_S = 0.204


@dataclass(frozen=True, slots=True)
class BoxSearch:
    """Where a search from the middle of Table 2's ranges ended.

    Attributes
    ----------
    symbols
        All nine by name, as found: of either sign, in any rotation.
    searched
        What was searched, in words.
    """

    searched: str
    symbols: dict[str, float]
    rmse_rpm: float

    def has_pulses_of(self, symbols: Mapping[str, float], duration_s: float) -> bool:
        """Whether it rings where these symbols do."""
        rings = self.symbols[WINDOW_END] > self.symbols[WINDOW_START]
        return rings and same_pulses(self.symbols, symbols, duration_s)


def search_as_printed(
    objective: Objective, generator: np.random.Generator
) -> tuple[BoxSearch, SearchHistory]:
    """Exactly eq. 6, four repetitions, over the ranges of Table 2 as printed."""
    time_s, speed_rpm = objective.time_s[objective.used], objective.speed_rpm[objective.used]
    box = ranges_as_printed(time_s, speed_rpm)
    order = list(SYMBOLS)

    def sum_of_squares(points: FloatArray) -> FloatArray:
        return np.asarray(squares_as_printed(points, time_s, speed_rpm))

    low, high = np.array([box[name] for name in order]).T
    end, history = search_box(sum_of_squares, low, high, generator, speed_rpm.size)
    symbols = {name: float(value) for name, value in zip(order, end, strict=True)}
    rmse = float(history.rmse_rpm[-1])
    return BoxSearch("eq. 6 as printed, in the ranges of Table 2", symbols, rmse), history


def search_pulse_train(
    objective: Objective, generator: np.random.Generator
) -> tuple[BoxSearch, SearchHistory]:
    """The endless pulse train of the objective's model, all its free symbols in Table 2's box."""
    model = objective.model
    box = table_2_box(objective)
    names = [*objective.searched, *(name for name in LINEAR if name in model.free)]
    d = len(objective.searched)

    def sum_of_squares(x: FloatArray) -> FloatArray:
        values = dict(zip(names, x.T, strict=True)) | {
            n: np.full(len(x), v) for n, v in model.fixed.items() if n in LINEAR
        }
        return objective.sum_of_squares_at(x[:, :d], values[AMPLITUDE], values[MEAN])

    low, high = np.array([model.ranges.get(name, box[name]) for name in names]).T
    end, history = search_box(sum_of_squares, low, high, generator, objective.samples_used)
    found = dict(model.fixed) | dict(zip(names, map(float, end), strict=True))
    symbols = {name: found[name] for name in SYMBOLS}
    rmse = float(history.rmse_rpm[-1])
    return BoxSearch("the pulse train in Table 2's box", symbols, rmse), history


def ranges_as_printed(time_s: FloatArray, speed_rpm: FloatArray) -> dict[str, tuple[float, float]]:
    """Table 2's variability range of all nine symbols, in the paper's order."""
    begin, end = float(time_s[0]), float(time_s[-1])
    low, high = float(speed_rpm.min()), float(speed_rpm.max())
    half = 0.5 * (high - low)
    return {
        AMPLITUDE: (-half, half),
        START: (begin, end),
        DECAY: (5.0, 30.0),
        FREQUENCY: (2.0 * math.pi, 2.0 * math.pi * 40.0),
        MEAN: (low, high),
        WINDOW_START: (0.0, LONGEST_WINDOW_S),
        WINDOW_END: (0.0, 0.5 * LONGEST_WINDOW_S),
        SEPARATION: (begin, end),
        ROTATION: (begin, end),
    }


def table_2_box(objective: Objective) -> dict[str, tuple[float, float]]:
    """Table 2's ranges as an endless pulse train can have them, t1 and t2 read as swapped.

    The period starts at one pulse window instead of the first time stamp: at T_w = 0 the train
    has infinitely many pulses.
    """
    box = ranges_as_printed(objective.time_s, objective.speed_rpm)
    begin, end = box[ROTATION]
    return box | {
        WINDOW_START: box[WINDOW_END],
        WINDOW_END: box[WINDOW_START],
        ROTATION: (max(begin, LONGEST_WINDOW_S), end),
    }


def search_box(
    sum_of_squares: Callable[[FloatArray], FloatArray],
    low: FloatArray,
    high: FloatArray,
    generator: np.random.Generator,
    samples: int,
) -> tuple[FloatArray, SearchHistory]:
    """The paper's search: x0 mid-range, σ0 a quarter of it, 3500 individuals, 100 iterations."""
    return minimise(
        sum_of_squares,
        0.5 * (low + high),
        0.25 * (high - low),
        (low, high),
        generator,
        population=POPULATION,
        iterations=ITERATIONS,
        samples=samples,
    )


def speed_as_printed(time_s: FloatArray, symbols: Mapping[str, float]) -> FloatArray:
    """h(t) of eq. 6, shape (n,), rpm: hard edges, four repetitions, nothing before or after.

    sin ω(t) is read as sin(ω (t − t1)). Where t2 is not later than t1 there is no pulse.
    """
    train = np.zeros_like(time_s)
    for repetition in range(1, REPETITIONS + 1):
        first = symbols[START] + repetition * symbols[ROTATION]
        for sign, moved in ((1.0, first), (-1.0, first - symbols[SEPARATION])):
            since = time_s - moved
            u = since - symbols[WINDOW_START]
            decaying = np.exp(-symbols[DECAY] * np.maximum(u, 0.0))
            ringing = decaying * np.sin(symbols[FREQUENCY] * u)
            inside = (u >= 0.0) & (since <= symbols[WINDOW_END])
            train += sign * np.where(inside, ringing, 0.0)
    return np.asarray(symbols[MEAN] + symbols[AMPLITUDE] * train)


@compiled()
def squares_as_printed(points, time_s, speed_rpm):  # type: ignore[no-untyped-def]
    """Sum of squares of eq. 6, :func:`speed_as_printed`, at points (m, 9), rpm², shape (m,)."""
    n = time_s.size
    centre = speed_rpm.mean()
    square = ((speed_rpm - centre) ** 2).sum()
    result = np.empty(len(points))
    train = np.zeros(n)
    for row in range(len(points)):
        amplitude, start, decay, frequency, mean, opens, closes, apart, rotation = points[row]
        total = square + n * (centre - mean) ** 2
        # Pulses may overlap: summed first, and each sample is then counted and cleared once.
        for counted in (False, True):
            for repetition in range(1, REPETITIONS + 1):
                for sign in (1.0, -1.0):
                    zero = start + repetition * rotation - (apart if sign < 0.0 else 0.0)
                    first = np.searchsorted(time_s, zero + opens)
                    for k in range(first, n):
                        if time_s[k] - zero > closes:
                            break
                        if counted:
                            total += train[k] * (train[k] - 2.0 * (speed_rpm[k] - mean))
                            train[k] = 0.0
                        else:
                            u = time_s[k] - zero - opens
                            train[k] += (
                                sign * amplitude * math.exp(-decay * u) * math.sin(frequency * u)
                            )
        result[row] = total
    return result


def same_pulses(found: Mapping[str, float], truth: Mapping[str, float], duration_s: float) -> bool:
    """Whether positive and negative impacts agree all along a recording.

    To a quarter of the ringing period.
    """
    rotation = truth[ROTATION]
    quarter = 0.5 * math.pi / truth[FREQUENCY]
    drift = abs(found[ROTATION] / rotation - 1.0) * duration_s
    shifts = [
        (a - b + 0.5 * rotation) % rotation - 0.5 * rotation
        for a, b in zip(_impacts(found), _impacts(truth), strict=True)
    ]
    return drift < quarter and max(abs(shift) for shift in shifts) < quarter


def _impacts(symbols: Mapping[str, float]) -> tuple[float, float]:
    """Times of a positive and a negative impact, s; a negative A makes them change places."""
    first = symbols[START] + symbols[WINDOW_START]
    times = (first, first - symbols[SEPARATION])
    return times if symbols[AMPLITUDE] > 0.0 else times[::-1]
