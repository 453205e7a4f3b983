"""The RMSE optimum of the disturbance model by CMA-ES.

The search starts from guesses taken from the recording and solves A, v_t and the baseline exactly.
The method ``paper`` also searches eq. 6 from the middle of Table 2's ranges
(:mod:`bayesbl.ringing.table_2`). Its result is stored beside the optimum.

The search may also start from the optimum of an earlier recording. The ringing of a joint keeps its
shape from one recording to the next, but a recording may start anywhere in a rotation. The old
waveform is therefore tried at every start time, with the rotation period scaled by the speed and
some variation of period and frequency. The best trial is refined, and so are its exchanged
neighbours, as in the full search.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bayesbl.errors import RecordingError
from bayesbl.recording.types import FloatArray
from bayesbl.ringing.guess import (
    SAMPLES_PER_RINGING,
    first_turn,
    guesses,
    phase_distance_s,
    range_starts,
    search_window,
    wrapped,
)
from bayesbl.ringing.objective import Objective
from bayesbl.ringing.search import SearchHistory, minimise, refine
from bayesbl.ringing.symbols import (
    DECAY,
    DEFAULT_RANGES,
    FREQUENCY,
    MEAN,
    ROTATION,
    SEPARATION,
    START,
    SYMBOLS,
    WINDOW_END,
    WINDOW_START,
    DisturbanceModel,
)
from bayesbl.ringing.table_2 import BoxSearch, search_as_printed
from bayesbl.ringing.waveform import model_speed

SearchMethod = Literal["guess", "paper"]
FoundBy = Literal[SearchMethod, "warm"]
"""How an optimum was found: by one of the searches, or from an earlier optimum."""

GUESSES_REFINED = 4
POPULATION = 20


@dataclass(frozen=True, slots=True)
class Rival:
    """Another local optimum in which the search ended."""

    symbols: dict[str, float]
    sum_of_squares: float


@dataclass(frozen=True, slots=True)
class Optimum:
    """Least-squares optimum of the disturbance model, in canonical form.

    Attributes
    ----------
    symbols
        All nine symbols by name: A > 0, 0 < T < T_w, the first positive pulse within one rotation
        of the recording's start (as far as these are free).
    baseline_rpm
        cos and sin of each load-angle harmonic, shape (2k,), rpm.
    sum_of_squares
        rpm².
    rivals
        Other local optima, best first.
    box_search
        Result of the paper's search, if requested.
    """

    model: DisturbanceModel
    symbols: dict[str, float]
    baseline_rpm: FloatArray
    sum_of_squares: float
    samples: int
    speed_sd_rpm: float
    history: SearchHistory
    rivals: tuple[Rival, ...]
    method: FoundBy
    seconds: float = 0.0
    box_search: BoxSearch | None = None

    @property
    def evaluations(self) -> int:
        """Evaluations of the objective by the search, without those of the local refinements."""
        return int(sum(self.history.evaluations[self.history.ends]))

    @property
    def rmse_rpm(self) -> float:
        """Root mean square error, the paper's objective, in rpm."""
        return math.sqrt(self.sum_of_squares / self.samples)

    @property
    def relative_rmse(self) -> float:
        """RMSE over the standard deviation of the speed."""
        return self.rmse_rpm / self.speed_sd_rpm

    @property
    def searched(self) -> FloatArray:
        """Values of the searched symbols, shape (d,)."""
        return np.array([self.symbols[name] for name in self.model.searched])

    def predict(self, time_s: FloatArray) -> FloatArray:
        """The model h(t) of eq. 6 with its baseline, shape (n,), rpm."""
        return model_speed(time_s, self.symbols, self.baseline_rpm)


def find_optimum(
    objective: Objective, method: SearchMethod, generator: np.random.Generator
) -> Optimum:
    """Search the RMSE optimum of a recording.

    Raises
    ------
    RecordingError
        If no values of the symbols explain anything: the speed has no ringing, or there are fewer
        samples than in a window.
    """
    started_s = time.perf_counter()
    ends, histories = _guess_search(objective, generator)
    box_search = None
    if method == "paper":
        box_search, box_history = search_as_printed(objective, generator)
        histories.append(box_history)
    optimum = settled(objective, ends, SearchHistory.of_runs(histories), method)
    return replace(optimum, box_search=box_search, seconds=time.perf_counter() - started_s)


def settled(
    objective: Objective, ends: FloatArray, history: SearchHistory, method: FoundBy
) -> Optimum:
    """Take the best end point (of (m, d)) of a search in canonical form, the others as its rivals.

    Raises
    ------
    RecordingError
        If the sum of squares is finite at none of them.
    """
    sse = objective.sum_of_squares(ends)
    ends, sse = ends[np.isfinite(sse)], sse[np.isfinite(sse)]
    if not len(ends):
        raise RecordingError(
            "No pulses fit this recording.",
            expected="a speed signal with impacts, longer than two load rotations",
        )
    order = np.argsort(sse, kind="stable")
    points = [_canonical(objective, ends[i]) for i in order]
    best, solution = objective.solved(points[0])
    return Optimum(
        model=objective.model,
        symbols=best,
        baseline_rpm=solution.coefficients[0, 1:-1],
        sum_of_squares=float(solution.sum_of_squares[0]),
        samples=objective.samples_used,
        speed_sd_rpm=float(objective.speed_rpm[objective.used].std()),
        history=history,
        rivals=_rivals(objective, points, sse[order]),
        method=method,
    )


def exchanged(model: DisturbanceModel, point: FloatArray) -> list[FloatArray]:
    """Exchange the pulses of a point and shift them half a ringing earlier or later; shapes (d,).

    Half a ringing off, a pulse resembles its own negative. These local optima come closest to the
    global one.
    """
    names = model.searched
    if not {START, SEPARATION} <= set(names):
        return []
    value = model.named(point)
    half = math.pi / value[FREQUENCY]
    neighbours = []
    for shift in (-half, half):
        neighbour = value | {
            START: value[START] - value[SEPARATION] + shift,
            SEPARATION: -value[SEPARATION] % value[ROTATION],
        }
        neighbour = wrapped(neighbour, range_starts(model))
        neighbours.append(np.array([neighbour[name] for name in names]))
    return neighbours


def promoted(objective: Objective, optimum: Optimum, rival: Rival) -> Optimum:
    """Replace the optimum by a rival, and add it to the rivals."""
    point = np.array([[rival.symbols[name] for name in objective.searched]])
    solution = objective.solve(point)
    other_rivals = tuple(other for other in optimum.rivals if other is not rival)
    return replace(
        optimum,
        symbols=rival.symbols,
        baseline_rpm=solution.coefficients[0, 1:-1],
        sum_of_squares=float(solution.sum_of_squares[0]),
        rivals=(Rival(optimum.symbols, optimum.sum_of_squares), *other_rivals),
    )


def local_search(
    objective: Objective, start: FloatArray, generator: np.random.Generator
) -> tuple[FloatArray, SearchHistory]:
    """Run CMA-ES from one point of the searched symbols, shape (d,); return the end point."""
    low, high = bounds(objective)
    return minimise(
        objective.sum_of_squares,
        np.clip(start, low + 1e-9 * (high - low), high - 1e-9 * (high - low)),
        _initial_steps(objective, start),
        (low, high),
        generator,
        population=POPULATION,
        iterations=400,
        samples=objective.samples_used,
    )


def bounds(objective: Objective) -> tuple[FloatArray, FloatArray]:
    """Search and prior box of the searched symbols, shapes (d,) and (d,), SI."""
    _, shortest, longest = search_window(objective)
    begin, end = objective.time_s[0], objective.time_s[-1]
    default: dict[str, tuple[float, float]] = {
        **DEFAULT_RANGES,
        START: (begin - longest, end),
        SEPARATION: (-longest, 2.0 * longest),
        ROTATION: (shortest, longest),
        WINDOW_START: (0.0, 0.102),
        WINDOW_END: (0.0, 0.204),
    }
    pairs = [objective.model.ranges.get(name, default[name]) for name in objective.searched]
    return np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs])


def _guess_search(
    objective: Objective, generator: np.random.Generator
) -> tuple[FloatArray, list[SearchHistory]]:
    starts = guesses(objective, GUESSES_REFINED)
    runs = [local_search(objective, start, generator) for start in starts]
    ends = [end for end, _ in runs]
    best = ends[int(np.argmin(objective.sum_of_squares(np.array(ends))))]
    ends += [refine(objective, start) for start in exchanged(objective.model, best)]
    return np.array(ends), [history for _, history in runs]


def _initial_steps(objective: Objective, start: FloatArray) -> FloatArray:
    """Initial step of each searched symbol around a guess."""
    value = objective.model.named(start)
    eighth = 0.25 * math.pi / value[FREQUENCY]
    scale = {
        START: eighth,
        DECAY: 0.3 * value[DECAY],
        FREQUENCY: 0.07 * value[FREQUENCY],
        SEPARATION: eighth,
        ROTATION: eighth * value[ROTATION] / objective.duration_s,
        WINDOW_START: 0.02,
        WINDOW_END: 0.02,
    }
    return np.array([scale[name] for name in objective.searched])


def _canonical(objective: Objective, point: FloatArray) -> FloatArray:
    """The equivalent solution with A > 0, 0 < T < T_w and t0 in the first rotation. If t0 or T has
    a range, the first T_w of that range counts instead. A form outside a range is not used."""
    names = objective.searched
    movable = {START, SEPARATION} <= set(names)
    value = objective.model.named(point)
    amplitude = float(objective.solve(point[None]).coefficients[0, -1])
    forms = [value]
    if movable and amplitude < 0.0:
        separation = value[SEPARATION]
        forms.insert(0, value | {START: value[START] - separation, SEPARATION: -separation})
    ranges = {name: r for name, r in objective.model.ranges.items() if name in names}
    for form in forms:
        shifted = first_turn(objective.model, form, objective.time_s[0] - form[WINDOW_START])
        if all(low <= shifted[name] <= high for name, (low, high) in ranges.items()):
            return np.array([shifted[name] for name in names])
    return point


def _rivals(objective: Objective, points: list[FloatArray], sse: FloatArray) -> tuple[Rival, ...]:
    """Distinct end points of the search other than the optimum."""
    rivals: list[Rival] = []
    accepted = [objective.solved(points[0])[0]]
    for point, value in zip(points[1:], sse[1:], strict=True):
        symbols, _ = objective.solved(point)
        if not any(_same(symbols, other) for other in accepted):
            rivals.append(Rival(symbols, float(value)))
            accepted.append(symbols)
    return tuple(rivals)


def _same(a: dict[str, float], b: dict[str, float]) -> bool:
    """Whether two optima are the same ringing, within a quarter of its period."""
    return (
        phase_distance_s(a, b) * a[FREQUENCY] < 0.5 * math.pi
        and abs(b[ROTATION] / a[ROTATION] - 1.0) < 0.02
        and abs(math.log(b[FREQUENCY] / a[FREQUENCY])) < 0.2
    )


@dataclass(frozen=True, slots=True)
class EarlierOptimum:
    """An earlier optimum from which a search starts.

    Attributes
    ----------
    told
        Where it comes from, in words.
    symbols
        All nine symbols by name.
    withheld
        Whether the earlier answer was withheld; then it cannot be a start.
    """

    told: str
    symbols: Mapping[str, float]
    rmse_rpm: float
    withheld: bool = False


class NoLongerFits(Exception):
    """An earlier optimum cannot be the start; the message says why, as part of a sentence."""


def warm_optimum(objective: Objective, earlier: EarlierOptimum) -> Optimum:
    """The optimum near the old one, whatever the phase of the load at the recording's start.

    The full search takes half a second, so it is preferred in case of doubt.

    Raises
    ------
    NoLongerFits
        If the earlier answer was withheld, the speed differs by more than a tenth, or the optimum
        cannot be the old one at a later date: its RMSE is more than 1.5 times the old one, its
        frequency moved by more than a fifth, or its decay by more than a factor of two.
    """
    started_s = time.perf_counter()
    old = earlier.symbols
    if earlier.withheld:
        raise NoLongerFits("its own answer was withheld")
    _require_near(MEAN, objective.offset_rpm, old[MEAN], 1.1, "rpm")
    folds = _folds(objective, old)
    sse = objective.sum_of_squares(folds)
    end = refine(objective, folds[int(np.argmin(sse))])
    ends = np.array([end, *(refine(objective, x) for x in exchanged(objective.model, end))])
    end_sse = objective.sum_of_squares(ends)
    rmse = np.sqrt(np.array([np.min(sse), np.min(end_sse)]) / objective.samples_used)
    evaluations = np.cumsum([float(len(folds)), float(len(ends))])
    history = SearchHistory(np.zeros(2), evaluations, rmse)
    if not np.any(np.isfinite(end_sse)):
        raise NoLongerFits("its pulses fit nowhere")
    optimum = settled(objective, ends, history, "warm")
    _require_near("rmse_rpm", optimum.rmse_rpm, earlier.rmse_rpm, 1.5, "rpm", 0.0)
    for name, largest_ratio in ((FREQUENCY, 1.2), (DECAY, 2.0)):
        _require_near(name, optimum.symbols[name], old[name], largest_ratio, SYMBOLS[name].unit)
    return replace(optimum, seconds=time.perf_counter() - started_s)


def _require_near(
    name: str, new: float, old: float, most: float, unit: str, least: float | None = None
) -> None:
    """Require old · ``least`` (default 1 / ``most``) ≤ new ≤ old · ``most``."""
    smallest_ratio = 1.0 / most if least is None else least
    if not smallest_ratio <= new / old <= most:
        raise NoLongerFits(
            f"{name} is {new:.4g} {unit} where it was {old:.4g} {unit}, more than a factor of "
            f"{most:g} away"
        )


def _folds(objective: Objective, old: Mapping[str, float]) -> FloatArray:
    """The old waveform at every phase, shape (m, d)."""
    ringing = 2.0 * math.pi / old[FREQUENCY]
    # At constant gear ratio, the load's period is inversely proportional to the motor's speed.
    rotation = objective.model.fixed.get(ROTATION, old[ROTATION] * old[MEAN] / objective.offset_rpm)
    # A quarter of a ringing over the recording.
    drift = 0.25 * ringing * rotation / objective.duration_s
    axes = {name: np.array([old[name]]) for name in objective.searched}
    axes[SEPARATION] = np.array([old[SEPARATION] * rotation / old[ROTATION]])
    begin, _ = objective.model.ranges.get(START, (objective.time_s[0], math.inf))
    axes[START] = begin + np.arange(0.0, rotation, ringing / SAMPLES_PER_RINGING)
    axes[ROTATION] = rotation + drift * np.arange(-2.0, 3.0)
    axes[FREQUENCY] = old[FREQUENCY] * np.array([0.9, 1.0, 1.1])
    low, high = bounds(objective)
    margin = 1e-6 * (high - low)
    mesh = np.meshgrid(*(axes[name] for name in objective.searched), indexing="ij")
    points = np.column_stack([grid.ravel() for grid in mesh])
    return np.asarray(np.clip(points, low + margin, high - margin))
