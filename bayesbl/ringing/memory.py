"""What a run remembers of itself: finished stages, recalled when it is run again after a kill.

Where it is kept is not decided here (:mod:`bayesbl.results.checkpoint` keeps it on disk). A stage
is a name and named arrays; one that is recalled is bit for bit what was remembered.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, cast

import numpy as np

from bayesbl.errors import ResultError
from bayesbl.ringing.objective import Objective
from bayesbl.ringing.optimum import FoundBy, Optimum, Rival, SearchHistory
from bayesbl.ringing.symbols import SYMBOLS
from bayesbl.sampling.convergence import Contender

Arrays = Mapping[str, np.ndarray[Any, np.dtype[Any]]]

AGREEMENT = 1e-9
"""Largest relative difference between a stored sum of squares and the same one evaluated again."""


class Memory(Protocol):
    """Finished stages of one snapshot's fit."""

    def recall(self, stage: str) -> Arrays | None:
        """What was remembered; ``None`` if nothing was."""

    def remember(self, stage: str, arrays: Arrays) -> None:
        """Keep a finished stage, whole or not at all."""


class Forgetful:
    """Remembers nothing: the run is made in one go."""

    def recall(self, stage: str) -> Arrays | None:
        """Nothing."""
        return None

    def remember(self, stage: str, arrays: Arrays) -> None:
        """Not kept."""


def pack_optimum(
    optimum: Optimum,
    notes: tuple[str, ...],
    start: str,
    contenders: tuple[Contender, ...] | None,
) -> Arrays:
    """An optimum, and what is said of it, as arrays."""
    rivals = optimum.rivals
    found = () if contenders is None else contenders
    return {
        "symbols": _vector(optimum.symbols),
        "baseline_rpm": optimum.baseline_rpm,
        "sum_of_squares": np.array(optimum.sum_of_squares),
        "run": optimum.history.run,
        "run_evaluations": optimum.history.evaluations,
        "run_rmse_rpm": optimum.history.rmse_rpm,
        "rivals": np.array([_vector(r.symbols) for r in rivals]).reshape(-1, len(SYMBOLS)),
        "rival_sums_of_squares": np.array([r.sum_of_squares for r in rivals]),
        "evaluations": np.array(optimum.evaluations),
        "seconds": np.array(optimum.seconds),
        "method": np.array(optimum.method),
        "notes": np.array(notes, dtype=str),
        "start": np.array(start),
        "weighed": np.array(contenders is not None),
        "contenders": np.array([(c.amplitude_rpm, c.log_odds) for c in found]).reshape(-1, 2),
    }


def unpack_optimum(
    arrays: Arrays, objective: Objective
) -> tuple[Optimum, tuple[str, ...], str, tuple[Contender, ...] | None]:
    """The inverse of :func:`pack_optimum`, after the optimum was evaluated again.

    Raises
    ------
    ResultError
        If the recording gives another sum of squares at the stored optimum.
    """
    symbols = _named(arrays["symbols"])
    stored = float(arrays["sum_of_squares"])
    point = np.array([[symbols[name] for name in objective.searched]])
    found = float(objective.sum_of_squares(point)[0])
    if not abs(found - stored) <= AGREEMENT * stored:
        raise ResultError(
            "The optimum that an unfinished run stored does not agree with the recording.",
            found=f"a sum of squares of {found:.12g} rpm² where {stored:.12g} rpm² was stored",
            expected="the same value; --force starts over",
        )
    optimum = Optimum(
        model=objective.model,
        symbols=symbols,
        baseline_rpm=arrays["baseline_rpm"],
        sum_of_squares=stored,
        samples=objective.samples_used,
        speed_sd_rpm=float(objective.speed_rpm[objective.used].std()),
        history=SearchHistory(arrays["run"], arrays["run_evaluations"], arrays["run_rmse_rpm"]),
        rivals=tuple(
            Rival(_named(row), float(sse))
            for row, sse in zip(arrays["rivals"], arrays["rival_sums_of_squares"], strict=True)
        ),
        evaluations=int(arrays["evaluations"]),
        seconds=float(arrays["seconds"]),
        method=cast(FoundBy, str(arrays["method"])),
    )
    contenders = tuple(Contender(float(a), float(odds)) for a, odds in arrays["contenders"])
    notes = tuple(str(note) for note in arrays["notes"])
    return optimum, notes, str(arrays["start"]), contenders if bool(arrays["weighed"]) else None


def _vector(symbols: Mapping[str, float]) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array([symbols[name] for name in SYMBOLS])


def _named(values: np.ndarray[Any, np.dtype[Any]]) -> dict[str, float]:
    return dict(zip(SYMBOLS, values.tolist(), strict=True))
