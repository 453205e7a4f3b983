"""Finished cases of a study on disk, and the processes that run the others.

Cases are kept beside the output folder until the study is whole: a file per row, a line per case,
each written at once. A study that is killed loses the cases in flight and nothing else.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from bayesbl.errors import ResultError, UserError
from bayesbl.workflows.study_file import Study, Table, load_study

_THREADS = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NUMBA_NUM_THREADS",
)


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
    """A case that is to be run."""

    table: Table
    index: int
    seed: np.random.SeedSequence


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
        folder = output.with_name(f".{output.name}.cases")
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ResultError(
                "The output folder cannot be made.",
                file=output,
                found=error.strerror,
                expected="a place that can be written to",
            ) from None
        with _locked(folder, output):
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
    study: Study, jobs: Sequence[Job], workers: int, commit: str
) -> Iterator[tuple[str, Case]]:
    """Run cases in processes of their own; yields (row, case) as they end, in any order.

    One worker is a process of its own too: linear algebra on one thread rounds otherwise than on
    many, and the numbers must not depend on the workers.
    """
    if not jobs:
        return
    before = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(
        min(workers, len(jobs)),
        multiprocessing.get_context("spawn"),
        initializer=_start_worker,
        initargs=(study.path,),
    )
    try:
        with _single_threaded():
            # All processes start with the first submission, and keep the environment of now.
            rows = {pool.submit(_run_job, job, commit): str(job.table["name"]) for job in jobs}
        for future in as_completed(rows):
            yield rows[future], future.result()
    except BaseException:
        for process in set(multiprocessing.active_children()) - before:
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


_loaded: Study | None = None
"""The study of this worker process."""


def _start_worker(path: Path) -> None:
    global _loaded
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends workers without a traceback
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _loaded = load_study(path)


def _end_with_parent() -> None:
    """Workers of a run that was killed would wait for work for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _run_job(job: Job, commit: str) -> Case:
    assert _loaded is not None
    start = time.perf_counter()
    values, message = {}, ""
    try:
        values = _loaded.run_case(job.table, job.index, job.seed)
    except UserError as error:
        message = str(error)
    except Exception as error:
        error.add_note(f'In case {job.index} of row "{job.table["name"]}".')
        raise
    return Case(job.index, values, time.perf_counter() - start, commit, message)


@contextmanager
def _single_threaded() -> Iterator[None]:
    """Processes that start meanwhile use one thread each."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _whole_lines(file: Path) -> list[bytes]:
    """Lines of a file; one that was cut by a kill is taken off the file first."""
    if not file.exists():
        return []
    data = file.read_bytes()
    whole = data[: data.rfind(b"\n") + 1]
    if len(whole) < len(data):
        os.truncate(file, len(whole))
    return whole.splitlines()


@contextmanager
def _locked(folder: Path, output: Path) -> Iterator[None]:
    if sys.platform == "win32":
        yield  # folders cannot be locked there
        return
    import fcntl

    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise ResultError(
                "Another run of this study is under way.", file=output, expected="one at a time"
            ) from None
        yield
    finally:
        os.close(handle)
