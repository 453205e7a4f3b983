"""The RMSE optimum from that of an earlier recording of the same joint.

The ringing of a joint keeps its shape from one recording to the next, but a recording may start
anywhere in a rotation. So the old waveform is tried at every start time, with the rotation period
scaled by the speed and some room in period and frequency. The best trial is refined, and so are its
exchanged neighbours, as in the full search.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayesbl.recording.types import FloatArray
from bayesbl.ringing.objective import Objective
from bayesbl.ringing.optimum import Optimum, bounds, exchanged, settled
from bayesbl.ringing.search import SearchHistory, refine
from bayesbl.ringing.symbols import (
    DECAY,
    FREQUENCY,
    MEAN,
    ROTATION,
    SEPARATION,
    START,
    SYMBOLS,
)

STEPS_PER_RINGING = 8.0
PERIOD_STEPS = np.arange(-2.0, 3.0)
"""Rotation periods tried, in quarters of a ringing of drift over the recording."""
FREQUENCY_FACTORS = np.array([0.9, 1.0, 1.1])

LARGEST_SPEED_RATIO = 1.1
LARGEST_RMSE_RATIO = 1.5
LARGEST_FREQUENCY_RATIO = 1.2
LARGEST_DECAY_RATIO = 2.0


@dataclass(frozen=True, slots=True)
class EarlierOptimum:
    """What a search starts from.

    Attributes
    ----------
    told
        Where it comes from, in words.
    symbols
        All nine symbols by name.
    withheld
        Whether its own answer was withheld; then it is no start.
    """

    told: str
    symbols: Mapping[str, float]
    rmse_rpm: float
    withheld: bool = False


class NoLongerFits(Exception):
    """An earlier optimum cannot be the start; says why, as part of a sentence."""


def warm_optimum(objective: Objective, earlier: EarlierOptimum) -> Optimum:
    """The optimum near the old one, whatever the phase of the gear at the recording's start.

    Raises
    ------
    NoLongerFits
        If the earlier answer was withheld, the speed differs, or the optimum cannot be the old one
        at a later date: its RMSE is more than 1.5 times the old one, its frequency moved by more
        than a fifth, or its decay by more than a factor of two. The full search takes half a
        second: in doubt, it is run.
    """
    began = time.perf_counter()
    old = earlier.symbols
    if earlier.withheld:
        raise NoLongerFits("its own answer was withheld")
    _require_near(MEAN, objective.offset_rpm, old[MEAN], LARGEST_SPEED_RATIO, "rpm")
    folds = _folds(objective, old)
    sse = objective.sum_of_squares(folds)
    end = refine(objective, folds[int(np.argmin(sse))])
    ends = np.array([end, *(refine(objective, x) for x in exchanged(objective.model, end))])
    reached = objective.sum_of_squares(ends)
    rmse = np.sqrt(np.array([np.min(sse), np.min(reached)]) / objective.samples_used)
    history = SearchHistory(np.zeros(2), np.array([1.0, float(len(folds))]), rmse)
    if not np.any(np.isfinite(reached)):
        raise NoLongerFits("its pulses fit nowhere")
    optimum = settled(objective, ends, history, len(folds), began, "warm")
    _require_near("rmse_rpm", optimum.rmse_rpm, earlier.rmse_rpm, LARGEST_RMSE_RATIO, "rpm", 0.0)
    for name, most in ((FREQUENCY, LARGEST_FREQUENCY_RATIO), (DECAY, LARGEST_DECAY_RATIO)):
        _require_near(name, optimum.symbols[name], old[name], most, SYMBOLS[name].unit)
    return optimum


def _require_near(
    name: str, new: float, old: float, most: float, unit: str, least: float | None = None
) -> None:
    """A new value between old / ``most``, or ``least``, and old · ``most``."""
    lowest = 1.0 / most if least is None else least
    if not lowest <= new / old <= most:
        raise NoLongerFits(
            f"{name} is {new:.4g} {unit} where it was {old:.4g} {unit}, more than a factor of "
            f"{most:g} away"
        )


def _folds(objective: Objective, old: Mapping[str, float]) -> FloatArray:
    """The old waveform at every phase, shape (m, d)."""
    ringing = 2.0 * math.pi / old[FREQUENCY]
    # At constant gear ratio the period of the load goes with the inverse of the motor's speed.
    rotation = objective.model.fixed.get(ROTATION, old[ROTATION] * old[MEAN] / objective.offset_rpm)
    drift = 0.25 * ringing * rotation / objective.duration_s
    axes = {name: np.array([old[name]]) for name in objective.searched}
    axes[SEPARATION] = np.array([old[SEPARATION] * rotation / old[ROTATION]])
    begin, _ = objective.model.ranges.get(START, (objective.time_s[0], math.inf))
    axes[START] = begin + np.arange(0.0, rotation, ringing / STEPS_PER_RINGING)
    axes[ROTATION] = rotation + drift * PERIOD_STEPS
    axes[FREQUENCY] = old[FREQUENCY] * FREQUENCY_FACTORS
    low, high = bounds(objective)
    margin = 1e-6 * (high - low)
    mesh = np.meshgrid(*(axes[name] for name in objective.searched), indexing="ij")
    points = np.column_stack([grid.ravel() for grid in mesh])
    return np.asarray(np.clip(points, low + margin, high - margin))
