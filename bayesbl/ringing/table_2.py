"""The paper's search: CMA-ES over eq. 6 as printed, from the middle of Table 2's ranges.

It finds the pulses of a recording only by luck (``configs/search_study.toml``), because the RMSE
has too many minima over T_w. Its result is kept beside the optimum, and trusted only if it has the
optimum's pulses.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
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


@dataclass(frozen=True, slots=True)
class BoxSearch:
    """Result of the search; all nine symbols by name, A of either sign, t0 in any rotation."""

    symbols: dict[str, float]
    rmse_rpm: float


def search_as_printed(
    objective: Objective, generator: np.random.Generator
) -> tuple[BoxSearch, SearchHistory]:
    """Search eq. 6 over the ranges of Table 2: x0 mid-range, σ0 a quarter of the range."""
    time_s, speed_rpm = objective.time_s[objective.used], objective.speed_rpm[objective.used]
    box = ranges_as_printed(time_s, speed_rpm)

    def sum_of_squares(points: FloatArray) -> FloatArray:
        return np.asarray(squares_as_printed(points, time_s, speed_rpm))

    low, high = np.array([box[name] for name in SYMBOLS]).T
    end, history = minimise(
        sum_of_squares,
        0.5 * (low + high),
        0.25 * (high - low),
        (low, high),
        generator,
        population=POPULATION,
        iterations=ITERATIONS,
        samples=speed_rpm.size,
    )
    symbols = dict(zip(SYMBOLS, map(float, end), strict=True))
    return BoxSearch(symbols, float(history.rmse_rpm[-1])), history


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
        WINDOW_START: (0.0, 0.204),
        WINDOW_END: (0.0, 0.102),
        SEPARATION: (begin, end),
        ROTATION: (begin, end),
    }


@compiled()
def squares_as_printed(points, time_s, speed_rpm):  # type: ignore[no-untyped-def]
    """Sum of squares of eq. 6 at points (m, 9), rpm², shape (m,).

    Windows have hard edges, and there are four repetitions with nothing before or after. sin ω(t)
    is read as sin(ω (t − t1)). If t2 is not later than t1, there is no pulse.
    """
    n = time_s.size
    centre = speed_rpm.mean()
    square = ((speed_rpm - centre) ** 2).sum()
    result = np.empty(len(points))
    train = np.zeros(n)
    for row in range(len(points)):
        amplitude, start, decay, frequency, mean, opens, closes, apart, rotation = points[row]
        total = square + n * (centre - mean) ** 2
        # Pulses may overlap: sum them first, then count and clear each sample once.
        for counting in (False, True):
            for repetition in range(1, REPETITIONS + 1):
                for sign in (1.0, -1.0):
                    pulse_time = start + repetition * rotation - (apart if sign < 0.0 else 0.0)
                    first = np.searchsorted(time_s, pulse_time + opens)
                    for k in range(first, n):
                        if time_s[k] - pulse_time > closes:
                            break
                        if counting:
                            total += train[k] * (train[k] - 2.0 * (speed_rpm[k] - mean))
                            train[k] = 0.0
                        else:
                            u = time_s[k] - pulse_time - opens
                            train[k] += (
                                sign * amplitude * math.exp(-decay * u) * math.sin(frequency * u)
                            )
        result[row] = total
    return result


def same_pulses(
    optimum: Mapping[str, float], truth: Mapping[str, float], duration_s: float
) -> bool:
    """Whether the optimum has pulses, and they match the true ones throughout a recording.

    Positive and negative pulses must match within a quarter of the ringing period.
    """
    rotation = truth[ROTATION]
    quarter = 0.5 * math.pi / truth[FREQUENCY]
    drift = abs(optimum[ROTATION] / rotation - 1.0) * duration_s
    shifts = [
        (a - b + 0.5 * rotation) % rotation - 0.5 * rotation
        for a, b in zip(_impacts(optimum), _impacts(truth), strict=True)
    ]
    rings = optimum[WINDOW_END] > optimum[WINDOW_START]
    return rings and drift < quarter and max(abs(shift) for shift in shifts) < quarter


def _impacts(symbols: Mapping[str, float]) -> tuple[float, float]:
    """Times of a positive and a negative impact, s; a negative A exchanges them."""
    first = symbols[START] + symbols[WINDOW_START]
    times = (first, first - symbols[SEPARATION])
    return times if symbols[AMPLITUDE] > 0.0 else times[::-1]
