"""The fits of the ringing in all recordings of a run, and the gaps that the curve makes of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from bayesbl.curve.branch import likeliest_branch
from bayesbl.curve.gap_curve import GapCurve
from bayesbl.measurement.change import Gap, MeasuredRinging, gaps
from bayesbl.measurement.task import Task
from bayesbl.processes import processes
from bayesbl.progress import Progress, StageProgress, of_stage
from bayesbl.recording.types import Recording
from bayesbl.results.work import NOTHING_KEPT, WorkStore
from bayesbl.ringing.estimator import Estimator, FinishedFit, Fit
from bayesbl.ringing.symbols import AMPLITUDE
from bayesbl.ringing.warm_start import EarlierOptimum

FEWEST_PER_PROCESS = 2
"""Fits for which a process is started: it takes as long to start as one fit takes."""


@dataclass(frozen=True, slots=True)
class FitJob:
    """All that one fit needs; it can be sent to another process."""

    estimator: Estimator
    curve: GapCurve | None
    recording: Recording
    seed: np.random.SeedSequence
    gear_ratio: float | None
    earlier: EarlierOptimum | None = None
    check: bool = False
    work: WorkStore = field(default=NOTHING_KEPT, compare=False)

    def run(self, progress: StageProgress | None = None) -> Fit:
        """Fit the recording, or restore the fit that an unfinished run had finished."""
        step = of_stage(progress, f"Sampling {self.recording.name}")
        made: list[Fit] = []

        def finished() -> FinishedFit:
            made.append(self._made(step))
            return made[0].finished

        kept = self.work.get("fit", self, finished, FinishedFit)
        if made:
            return made[0]
        return self.estimator.restored(kept, self.recording, self.gear_ratio)

    def _made(self, progress: Progress | None) -> Fit:
        curve = self.curve
        branch = None if curve is None else partial(likeliest_branch, curve, self.estimator)
        return self.estimator.fit(
            self.recording,
            self.seed,
            self.gear_ratio,
            progress,
            branch,
            earlier=self.earlier,
            check=self.check,
        )


def run_fits(jobs: Sequence[FitJob], workers: int, progress: StageProgress | None) -> list[Fit]:
    """Fits in the order of their jobs, the same for any number of workers.

    A fit takes a second or two, so that few recordings are done before processes have started; a
    check by a second sampler takes longer, and is worth a process of its own.
    """
    per_process = 1 if any(job.check for job in jobs) else FEWEST_PER_PROCESS
    count = min(workers, len(jobs) // per_process)
    if count <= 1:
        return [job.run(progress) for job in jobs]
    with processes(count) as pool:
        places = {pool.submit(job.run): n for n, job in enumerate(jobs)}
        done: dict[int, Fit] = {}
        for future in as_completed(places):
            place = places[future]
            done[place] = future.result()
            if progress is not None:
                steps = done[place].posterior.diagnostics.steps
                progress(f"Sampling {jobs[place].recording.name}", steps, steps)
    return [done[n] for n in range(len(jobs))]


def earlier_of(name: str, optima: Mapping[str, EarlierOptimum]) -> EarlierOptimum | None:
    """The optimum to start from: that of the same name, else the last one."""
    return optima.get(name) or next(reversed([*optima.values()]), None)


def gaps_of_fits(task: Task, curves: Sequence[GapCurve], fits: Sequence[Fit]) -> list[Gap]:
    """The gap of every fit through its curve, all through the same draws."""
    return gaps(
        curves,
        [measured_ringing(fit) for fit in fits],
        task.seeds.gap,
        allow_extrapolation=task.config.curve.allow_extrapolation,
        level=task.config.interval.level,
    )


def measured_ringing(fit: Fit) -> MeasuredRinging:
    """What a fit says of the ringing."""
    return MeasuredRinging(fit.posterior.draws[AMPLITUDE], *fit.point.ringing)
