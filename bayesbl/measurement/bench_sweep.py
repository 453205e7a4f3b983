"""Sweeps of a bench and of benches drawn around it, each row made once and kept."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.curve.bench_draws import SweptDraws
from bayesbl.curve.sweep import SweepRow, SweepSettings, sweep_like, sweep_nominal
from bayesbl.curve.swept_curve import departures
from bayesbl.errors import BenchError
from bayesbl.processes import processes
from bayesbl.recording.types import FloatArray
from bayesbl.results.work import WorkStore
from bayesbl.ringing.symbols import DisturbanceModel

DrawProgress = Callable[[str, int, int], None]
"""Called with (what is worked on, benches swept, benches in all)."""


@dataclass(frozen=True, slots=True)
class SweepProblem:
    """What decides the numbers of every row, and where finished rows of all sweeps are kept."""

    bench: Bench
    model: DisturbanceModel
    settings: SweepSettings
    seed: int
    work: WorkStore

    def nominal(self, seed: np.random.SeedSequence, workers: int) -> SweepRow:
        """The row of the bench itself.

        Raises
        ------
        BenchError
            If a simulation fails, or cannot be fitted.
        """
        generator = np.random.default_rng(seed)
        return self._row(
            None, lambda: sweep_nominal(self.bench, self.model, self.settings, generator, workers)
        )

    def draws(
        self,
        nominal: SweepRow,
        count: int,
        seed: np.random.SeedSequence,
        workers: int,
        progress: DrawProgress | None = None,
    ) -> SweptDraws | None:
        """Sweeps of benches drawn within the tolerances, over processes; ``None`` for none.

        The benches depend on bench, count and seed alone: two problems of one bench at other
        speeds or rates draw the same ones.
        """
        if count == 0:
            return None
        tolerances = self.bench.tolerances
        benches = [self.bench.draw(np.random.default_rng(s)) for s in seed.spawn(count)]
        names = tuple(tolerances)
        shifts = np.array(
            [[(b.value(n) - self.bench.value(n)) / tolerances[n] for n in names] for b in benches]
        )
        rows = []
        for row in _mapped(_drawn_row, [(self, nominal, b) for b in benches], workers):
            rows.append(departures(row, nominal, self.model))
            if progress is not None:
                progress("Simulating bench draws", len(rows), count)
        return SweptDraws(names, shifts, np.array(rows), _root_of_shifts(self.bench))

    def drawn(self, nominal: SweepRow, bench: Bench) -> SweepRow:
        """The row of a bench drawn around the nominal one."""
        return self._row(bench, lambda: sweep_like(bench, nominal, self.model, self.settings))

    def _row(self, drawn: Bench | None, make: Callable[[], SweepRow]) -> SweepRow:
        """The row of the bench, or of one drawn around it, if no earlier sweep has made it."""
        benches = (self.bench.fingerprint(), None if drawn is None else drawn.fingerprint())
        inputs = (*benches, self.model, self.settings, self.seed)
        return self.work.get("sweep row", inputs, partial(_finite, make), SweepRow)


def _root_of_shifts(bench: Bench) -> FloatArray | None:
    """Of the covariance of the shifts of a bench with identified parameters; to first order."""
    joint = bench.identified
    if joint is None:
        return None
    names = list(bench.tolerances)
    covariance = np.eye(len(names)) / 3.0  # of those that are uniform
    own = [names.index(name) for name in joint.names]
    scale = np.array([bench.value(name) / bench.tolerances[name] for name in joint.names])
    covariance[np.ix_(own, own)] = np.outer(scale, scale) * joint.covariance
    return np.asarray(np.linalg.cholesky(covariance))


def _finite(make: Callable[[], SweepRow]) -> SweepRow:
    row = make()
    if not np.all(np.isfinite(row.amplitude_rpm)):
        raise BenchError(
            "A simulated recording could not be fitted.",
            found="an amplitude that is not a number",
            expected="a bench whose gap shows in the motor speed",
        )
    return row


def _drawn_row(job: tuple[SweepProblem, SweepRow, Bench]) -> SweepRow:
    problem, nominal, drawn = job
    return problem.drawn(nominal, drawn)


def _mapped(
    function: Callable[[Any], SweepRow], jobs: list[Any], workers: int
) -> Iterator[SweepRow]:
    """In order, over processes where that pays."""
    if workers == 1 or len(jobs) < 2 * workers:
        yield from map(function, jobs)
        return
    with processes(workers) as pool:
        yield from pool.map(function, jobs)
