"""Finished cases of a study on disk, and the processes or the cluster that run the others.

Cases are kept beside the output folder until the study is whole: a file per row, a line per case,
each written at once. A study that is killed loses the cases in flight and nothing else.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from bayesbl.errors import UserError
from bayesbl.results.checkpoint import locked_sibling
from bayesbl.runs.processes import processes
from bayesbl.runs.study_file import Study, Table, load_study, seed_of_case


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


class CaseStore:
    """Finished cases of an unfinished study, by row."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    @classmethod
    @contextmanager
    def beside(cls, output: Path, *, fresh: bool = False) -> Iterator[CaseStore]:
        """The store of an output folder, locked; ``fresh`` forgets what it holds.

        Raises
        ------
        ResultError
            If another run of the same study is under way, or no folder can be made there.
        """
        with locked_sibling(output, ".cases") as folder:
            if fresh:
                for file in folder.glob("*.jsonl"):
                    file.unlink()
            yield cls(folder)

    def take_over(self, row: str, definition: str) -> dict[int, Case] | None:
        """Finished cases of a row by index; ``None``, and forgotten, if it was defined otherwise.

        A row that is new to the store is entered.
        """
        file = self._file(row)
        lines = _whole_lines(file)
        if lines and json.loads(lines[0])["definition"] == definition:
            cases = [Case(**json.loads(line)) for line in lines[1:]]
            return {case.index: case for case in cases}
        file.unlink(missing_ok=True)
        self._append(file, {"row": row, "definition": definition})
        return None if lines else {}

    def add(self, row: str, case: Case) -> None:
        """Keep a finished case."""
        self._append(self._file(row), asdict(case))

    def clear(self) -> None:
        """Delete the store; the result holds everything."""
        shutil.rmtree(self._folder, ignore_errors=True)

    def _file(self, row: str) -> Path:
        return self._folder / f"{hashlib.sha256(row.encode()).hexdigest()[:16]}.jsonl"

    @staticmethod
    def _append(file: Path, content: Mapping[str, object]) -> None:
        with open(file, "ab", buffering=0) as stream:
            stream.write(json.dumps(content).encode() + b"\n")


def run_cases(
    study: Study,
    jobs: Sequence[Job],
    workers: int,
    commit: str,
    scheduler: str | None = None,
    say: Callable[[str], None] = print,
) -> Iterator[tuple[Job, Case]]:
    """Run cases in processes of their own, or on the cluster of a Dask scheduler.

    Yields them as they end, in any order. One worker is a process of its own too: linear algebra
    on one thread rounds otherwise than on many, and the numbers must not depend on the workers.

    Raises
    ------
    ClusterError
        As :func:`bayesbl.runs.cluster.run_on_cluster`.
    """
    if not jobs:
        return
    if scheduler is not None:
        from bayesbl.runs.cluster import run_on_cluster

        yield from run_on_cluster(study, jobs, commit, scheduler, say)
        return
    with processes(min(workers, len(jobs)), _load, study.path) as pool:
        futures = {pool.submit(_run_loaded, job, commit): job for job in jobs}
        for future in as_completed(futures):
            yield futures[future], future.result()


def run_job(study: Study, job: Job, commit: str) -> Case:
    """Run a case here; a :class:`UserError` of the study is its message."""
    start = time.perf_counter()
    values, message = {}, ""
    try:
        values = study.run_case(job.table, job.index, seed_of_case(job.seed, job.row, job.index))
    except UserError as error:
        message = str(error)
    except Exception as error:
        error.add_note(f"In {job.in_words}.")
        raise
    return Case(job.index, values, time.perf_counter() - start, commit, message)


_loaded: Study | None = None
"""The study of this worker process."""


def _load(path: Path) -> None:
    global _loaded
    _loaded = load_study(path)


def _run_loaded(job: Job, commit: str) -> Case:
    assert _loaded is not None
    return run_job(_loaded, job, commit)


def _whole_lines(file: Path) -> list[bytes]:
    """Lines of a file; one that was cut by a kill is taken off the file first."""
    if not file.exists():
        return []
    data = file.read_bytes()
    whole = data[: data.rfind(b"\n") + 1]
    if len(whole) < len(data):
        os.truncate(file, len(whole))
    return whole.splitlines()
