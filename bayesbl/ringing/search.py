"""Minimise the sum of squares: CMA-ES over ranges, and a fast local search near an optimum.

The local search fits a quadratic to the sum of squares on a cloud of points whose shape is the
Gauss-Newton covariance. The minimum becomes the new centre, and the cloud shrinks. One kernel call
evaluates a whole cloud, and the regression smooths the kinks caused by the window's edges.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesbl.recording.types import FloatArray
from bayesbl.ringing.objective import Objective
from bayesbl.ringing.symbols import SYMBOLS
from bayesbl.ringing.waveform import jacobian, jacobian_columns
from bayesbl.sampling.importance import quadratic_terms


@dataclass(frozen=True, slots=True)
class SearchHistory:
    """Convergence of CMA-ES, one row per iteration.

    Attributes
    ----------
    run
        Index of the start that the iteration belongs to, shape (i,).
    evaluations
        Evaluations so far in that run, shape (i,).
    rmse_rpm
        Best RMSE so far in that run, shape (i,), rpm.
    """

    run: FloatArray
    evaluations: FloatArray
    rmse_rpm: FloatArray

    @property
    def ends(self) -> NDArray[np.intp]:
        """Index of the last row of each run."""
        return np.flatnonzero(np.diff(self.run, append=np.inf))

    @classmethod
    def of_runs(cls, histories: Sequence[SearchHistory]) -> SearchHistory:
        """Join the histories of several runs, numbered in their order."""
        runs = [np.full(h.run.size, float(number)) for number, h in enumerate(histories)]
        return cls(
            np.concatenate(runs),
            np.concatenate([h.evaluations for h in histories]),
            np.concatenate([h.rmse_rpm for h in histories]),
        )


def minimise(
    sum_of_squares: Callable[[FloatArray], FloatArray],
    start: FloatArray,
    scale: FloatArray,
    box: tuple[FloatArray, FloatArray],
    generator: np.random.Generator,
    *,
    population: int,
    iterations: int,
    samples: int,
) -> tuple[FloatArray, SearchHistory]:
    """One CMA-ES run on log RMSE, whole populations at a time, in units of ``scale``.

    Points outside the box are reflected into it. cma's own handling of bounds works point by point
    and takes as long as everything else together.
    """
    import cma

    low, high = box
    options = {
        "popsize": population,
        "maxiter": iterations,
        # Use our own generator: cma would otherwise seed and draw from NumPy's global state.
        "randn": lambda rows, columns: generator.standard_normal((rows, columns)),
        "seed": math.nan,
        "verbose": -9,
        "tolfun": 1e-10,
        "tolfunhist": 1e-11,
        "tolx": 1e-7,
    }
    strategy = cma.CMAEvolutionStrategy(np.zeros(start.size), 1.0, options)
    rows: list[tuple[float, float]] = []
    best, best_point = math.inf, start
    while not strategy.stop():
        proposals = strategy.ask()
        width = high - low
        folded = (start + scale * np.asarray(proposals) - low) % (2.0 * width) - width
        points = high - np.abs(folded)
        values = sum_of_squares(points)
        values = np.where(np.isfinite(values), values, 1e300)
        strategy.tell(proposals, 0.5 * np.log(values / samples + 1e-300))
        best_index = int(np.argmin(values))
        if values[best_index] < best:
            best, best_point = float(values[best_index]), points[best_index]
        rows.append((float(strategy.countevals), math.sqrt(best / samples)))
    evaluations, rmse = np.array(rows).T
    return best_point, SearchHistory(np.zeros(len(rows)), evaluations, rmse)


MOST_ROUNDS = 60
POINTS_PER_COEFFICIENT = 3
FIRST_RADIUS_RPM = 10.0
LAST_RADIUS_RPM = 0.3
"""Cloud sizes, as the sd of white noise at 1 kHz that causes the same scatter, rpm."""
SHRINK, GROW = 0.4, 1.6

LEAST_SEEN = 1e-12
"""Smallest eigenvalue of a Gram matrix of unit columns that is not rounding."""


def refine(objective: Objective, start: FloatArray, seed: int = 0) -> FloatArray:
    """Local optimum of the searched symbols near ``start``, both of shape (d,).

    Symbols that would leave their range are fixed at its end, and the others are refined again.
    """
    end = _descend(objective, start, seed)
    names, ranges = objective.searched, objective.model.ranges
    unbounded = dict(zip(names, (float(x) for x in end), strict=True))
    clipped = {
        n: min(max(x, ranges[n][0]), ranges[n][1]) for n, x in unbounded.items() if n in ranges
    }
    fixed = {n: x for n, x in clipped.items() if x != unbounded[n]}
    if not fixed:
        return end
    reduced = objective.holding(fixed)
    point = unbounded | fixed
    if reduced.searched:
        refined = refine(reduced, np.array([point[n] for n in reduced.searched]), seed)
        point |= dict(zip(reduced.searched, refined, strict=True))
    return np.array([point[n] for n in names])


def _descend(objective: Objective, start: FloatArray, seed: int) -> FloatArray:
    """Local optimum near ``start``, both of shape (d,), ignoring ranges."""
    d = start.size
    generator = np.random.default_rng(seed)
    count = POINTS_PER_COEFFICIENT * (1 + d + d * (d + 1) // 2)
    # Points that fill a ball of radius √(d + 2): unit variance in every direction.
    unit = generator.standard_normal((count, d))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    unit *= np.sqrt(d + 2.0) * generator.uniform(size=(count, 1)) ** (1.0 / d)
    inverse = np.linalg.pinv(quadratic_terms(unit))
    centre = start
    best = float(objective.sum_of_squares(centre[None])[0])
    root = scatter_root(objective, centre)
    radius = FIRST_RADIUS_RPM
    for _ in range(MOST_ROUNDS):
        step = radius * root
        values = objective.sum_of_squares(centre + unit @ step.T)
        if not np.all(np.isfinite(values)):
            radius *= SHRINK
            continue
        move, inside = _minimum(inverse @ values, d)
        trials = np.stack([centre + step @ move, centre + step @ unit[int(np.argmin(values))]])
        reached = objective.sum_of_squares(trials)
        best_index = int(np.argmin(reached))
        if reached[best_index] < best:
            centre, best = trials[best_index], float(reached[best_index])
            radius *= SHRINK if inside else GROW
        else:
            radius *= SHRINK
        if radius < LAST_RADIUS_RPM:
            break
    return centre


def _minimum(coefficients: FloatArray, d: int) -> tuple[FloatArray, bool]:
    """Minimum of the fitted quadratic, and whether it lies well inside the cloud. The curvature is
    made positive, and the step is limited to the cloud."""
    gradient = coefficients[1 : 1 + d]
    curvature = np.zeros((d, d))
    curvature[np.triu_indices(d)] = coefficients[1 + d :]
    curvature = curvature + curvature.T
    values, vectors = np.linalg.eigh(curvature)
    convex = bool(values[0] > 0.0)
    values = np.maximum(np.abs(values), 1e-6 * np.abs(values).max() + 1e-300)
    move = -vectors @ ((vectors.T @ gradient) / values)
    length = float(np.linalg.norm(move))
    edge = math.sqrt(d + 2.0)
    inside = convex and length < 0.5 * edge
    return np.asarray(move if length <= edge else move * (edge / length)), inside


def scatter_root(objective: Objective, point: FloatArray) -> FloatArray:
    """Cholesky factor of the covariance of the searched symbols per rpm² of white noise, (d, d)."""
    symbols, solution = objective.solved(point)
    names = jacobian_columns(objective.model)
    columns = jacobian(objective.model, objective.time_s, symbols, solution.coefficients[0, 1:-1])
    norms = np.linalg.norm(columns, axis=0)
    norms = np.where(norms > 0.0, norms, 1.0)
    eigenvalues, eigenvectors = np.linalg.eigh((columns / norms).T @ (columns / norms))
    # Limit the scatter of hardly visible directions, which rounding would set otherwise.
    roots = eigenvectors / np.sqrt(np.maximum(eigenvalues, LEAST_SEEN)) / norms[:, None]
    order = [names.index(n) for n in SYMBOLS if n in objective.searched]
    triangle = np.linalg.qr(roots[order].T).R
    return np.asarray((triangle * np.where(np.diag(triangle) < 0.0, -1.0, 1.0)[:, None]).T)
