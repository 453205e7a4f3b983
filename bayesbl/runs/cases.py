"""One case of a study, and processes that run many of them."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from bayesbl.errors import ConfigError, UserError, WorkerError
from bayesbl.processes import processes
from bayesbl.runs.study_file import Study, Table, error_of, load_study, seed_of_case


@dataclass(frozen=True, slots=True)
class Case:
    """One finished case.

    Attributes
    ----------
    values
        What the study returned; empty if the case failed.
    message
        Why it failed; empty if it did not.
    """

    index: int
    values: Mapping[str, float]
    seconds: float
    commit: str
    message: str = ""


@dataclass(frozen=True, slots=True)
class Job:
    """A case that is to be run; ``seed`` is the study's."""

    table: Table
    index: int
    seed: int

    @property
    def row(self) -> str:
        """The row's name."""
        return str(self.table["name"])

    @property
    def in_words(self) -> str:
        """Which case it is."""
        return f'case {self.index} of row "{self.row}"'


def run_in_processes(
    study: Study, jobs: Sequence[Job], commit: str, workers: int
) -> Iterator[tuple[Job, Case]]:
    """Run cases in processes of their own; yields them as they end, in any order.

    One worker is a process of its own too: linear algebra on one thread rounds differently than on
    many, and the numbers must not depend on the workers.

    Raises
    ------
    ConfigError
        If a case fails by anything but a :class:`UserError`, or its process dies.
    """
    try:
        with processes(min(workers, len(jobs)), _load, study.path) as pool:
            futures = {pool.submit(_run_loaded, job, commit): job for job in jobs}
            for future in as_completed(futures):
                yield futures[future], future.result()
    except WorkerError:
        raise ConfigError(
            "A process died that ran cases of this study.",
            file=study.path,
            expected="cases that return, and memory enough for one in each worker",
        ) from None


def run_job(study: Study, job: Job, commit: str) -> Case:
    """Run a case here; a :class:`UserError` of the study is its message."""
    start = time.perf_counter()
    values, message = {}, ""
    seed = seed_of_case(job.seed, job.row, job.index)
    with error_of(study.path, f"in {job.in_words}"):
        try:
            values = study.run_case(job.table, job.index, seed)
        except UserError as error:
            message = str(error)
    return Case(job.index, values, time.perf_counter() - start, commit, message)


def files_of_study(study: Study, jobs: Sequence[Job]) -> list[str]:
    """Path of the study file and of every file that the rows of these cases name."""
    named = (path for job in jobs for path in study.files(job.table))
    return list(dict.fromkeys([str(study.path), *named]))


def run_of_file(path: str, commit: str, job: Job) -> Case:
    """Run a case of the study in a file, in a process that stays for others."""
    return run_job(_study_in(path), job, commit)


@cache
def _study_in(path: str) -> Study:
    return load_study(path)


_loaded: Study | None = None
"""The study of this worker process."""


def _load(path: Path) -> None:
    global _loaded
    _loaded = load_study(path)


def _run_loaded(job: Job, commit: str) -> Case:
    assert _loaded is not None
    return run_job(_loaded, job, commit)
