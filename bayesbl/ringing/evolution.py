"""CMA-ES on the RMSE of a recording."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from bayesbl.recording.types import FloatArray


@dataclass(frozen=True, slots=True)
class SearchHistory:
    """Convergence of CMA-ES, one row per iteration.

    Attributes
    ----------
    run
        Which start the iteration belongs to, shape (i,).
    evaluations
        Evaluations so far in that run, shape (i,).
    rmse_rpm
        Best RMSE so far in that run, shape (i,), rpm.
    """

    run: FloatArray
    evaluations: FloatArray
    rmse_rpm: FloatArray

    @classmethod
    def of_runs(cls, histories: Sequence[SearchHistory]) -> SearchHistory:
        """Of several runs, numbered in their order."""
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

    What lies beyond an end of the box counts as its mirror image: cma's own handling of bounds goes
    from point to point, and takes as long as all the rest.
    """
    import cma

    low, high = box
    options = {
        "popsize": population,
        "maxiter": iterations,
        # Own generator: cma would otherwise seed and draw from NumPy's global state.
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
        asked = strategy.ask()
        width = high - low
        beyond = (start + scale * np.asarray(asked) - low) % (2.0 * width) - width
        points = high - np.abs(beyond)
        values = sum_of_squares(points)
        values = np.where(np.isfinite(values), values, 1e300)
        strategy.tell(asked, 0.5 * np.log(values / samples + 1e-300))
        least = int(np.argmin(values))
        if values[least] < best:
            best, best_point = float(values[least]), points[least]
        rows.append((float(strategy.countevals), math.sqrt(best / samples)))
    evaluations, rmse = np.array(rows).T
    return best_point, SearchHistory(np.zeros(len(rows)), evaluations, rmse)
