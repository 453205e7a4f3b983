"""Run independent jobs in processes of this machine, or on an existing Dask cluster.

The numbers are the same. So each worker of a cluster must have the same code and files, and one
thread of linear algebra; a worker that differs refuses, whenever it joins. A worker process runs
one job at a time whatever its threads, because jobs need not be thread-safe. If a worker dies,
another one runs its job again.
"""

from __future__ import annotations

import asyncio
import logging
import os
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures import as_completed as completed
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Protocol, TypeVar

from bayesbl.config.sections import ClusterRun
from bayesbl.errors import ClusterError
from bayesbl.processes import processes
from bayesbl.results.provenance import code_sha256, code_versions, file_sha256

if TYPE_CHECKING:
    from distributed import Client

ANSWER_WITHIN_S = 10.0

_LINEAR_ALGEBRA = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

_SAME = "the same bayesbl, Python and packages, and the same files at the same paths"

_one_job = threading.Lock()


class InWords(Protocol):
    """A job that can be named in a sentence."""

    @property
    def in_words(self) -> str:
        """The job's name."""


J = TypeVar("J", bound=InWords)
R = TypeVar("R")


Facts = tuple[tuple[str, str], ...]  # what numbers depend on besides the jobs, by name


def facts(files: Iterable[str]) -> Facts:
    """Versions, the package's code, threads of linear algebra and files, in this process."""
    threads = os.environ.get(_LINEAR_ALGEBRA[0], "not set")
    return (
        *code_versions().items(),
        ("SHA-256 of the code of bayesbl", code_sha256()),
        *((name, os.environ.get(name, threads)) for name in _LINEAR_ALGEBRA),
        *((file, _content(file)) for file in dict.fromkeys(files)),
    )


def _content(file: str) -> str:
    try:
        return f"with SHA-256 {file_sha256(file)}"
    except OSError as error:
        return f"cannot be read ({error.strerror})"


def differences(wanted: Facts, files: Sequence[str]) -> list[str]:
    """How this process, a worker, differs from these facts, in words."""
    own = dict(facts(files))
    return [f"{name} {own.get(name)} in place of {v}" for name, v in wanted if own.get(name) != v]


def run_jobs(
    run: Callable[[J], R],
    jobs: Sequence[J],
    files: Iterable[str],
    where: ClusterRun,
    say: Callable[[str], None],
    what: str,
) -> Iterator[tuple[J, R]]:
    """Run jobs as ``[run]`` says, and yield them as they end, in any order, holding none longer.

    A single worker is also a process of its own, because linear algebra rounds differently on
    several threads. ``run`` is a function of a module or a ``partial`` of one; ``files`` are read
    by every job and must be the same for all workers; ``what`` names the jobs. Raises WorkerError
    if a process dies, and ClusterError if the scheduler does not answer or is lost, a worker
    differs, or a job kills all of its workers.
    """
    if where.scheduler is not None:
        yield from _on_cluster(run, jobs, files, where.scheduler, say, what)
        return
    with processes(min(where.workers, len(jobs))) as pool:
        futures = {pool.submit(run, job): job for job in jobs}
        for future in completed(list(futures)):
            yield futures.pop(future), future.result()


def _on_cluster(
    run: Callable[[J], R],
    jobs: Sequence[J],
    files: Iterable[str],
    scheduler: str,
    say: Callable[[str], None],
    what: str,
) -> Iterator[tuple[J, R]]:
    with _connected(scheduler) as client:
        from distributed import KilledWorker, as_completed
        from distributed.client import FutureCancelledError
        from distributed.comm import CommClosedError

        files = tuple(files)
        # Of one thread, however many are free here: a worker process has one.
        wanted = tuple(dict(facts(files), **dict.fromkeys(_LINEAR_ALGEBRA, "1")).items())
        count = len(client.nthreads())
        say(
            f"{len(jobs)} {what} run on {count} workers of {scheduler}."
            if count
            else f"{scheduler} has no workers yet; {len(jobs)} {what} wait for them."
        )
        futures = {client.submit(_run, wanted, files, run, job, pure=False): job for job in jobs}
        for future in as_completed(futures, loop=client.loop):
            job = futures[future]
            try:
                done = future.result()
            except KilledWorker as error:
                raise ClusterError(
                    # Dask suspects all that a dead worker had at hand.
                    "Workers died repeatedly while they ran this case, or another one with it.",
                    file=scheduler,
                    where=job.in_words,
                    found=f"last {error.last_worker.address}" if error.last_worker else None,
                    expected="workers with memory enough for a case",
                ) from None
            except (FutureCancelledError, CommClosedError):
                raise ClusterError(
                    "The scheduler was lost. What is finished is kept; the same command continues.",
                    file=scheduler,
                ) from None
            except ImportError as error:
                raise ClusterError(
                    "A worker of the cluster lacks a package.",
                    file=scheduler,
                    found=str(error),
                    expected=_SAME,
                ) from None
            except ClusterError as error:
                error.name_file(scheduler)
                raise
            yield job, done
            future.release()


def _run(wanted: Facts, files: tuple[str, ...], run: Callable[[J], R], job: J) -> R:
    """Run a job in a worker."""
    with _one_job:
        _require_here(wanted, files)
        return run(job)


@cache
def _require_here(wanted: Facts, files: tuple[str, ...]) -> None:
    """Require that this worker is the same; each checks itself, as workers may join later."""
    from distributed import get_worker

    different = differences(wanted, files)
    if different:
        raise ClusterError(
            "A worker of the cluster would not compute the same numbers as this machine.",
            found=f"{get_worker().address}: {'; '.join(different)}",
            expected=_SAME,
        )


@contextmanager
def _connected(scheduler: str) -> Iterator[Client]:
    try:
        from distributed import Client
    except ImportError:
        raise ClusterError(
            "A Dask cluster needs a package that is not installed.",
            where="[run] scheduler",
            found=scheduler,
            expected="pip install 'bayesbl[cluster]', or no scheduler",
        ) from None
    # A thread has no event loop yet, which a notebook would.
    with ThreadPoolExecutor(1) as thread:
        try:
            kind = thread.submit(asyncio.run, _kind_at(scheduler)).result()
        except (OSError, ValueError, TypeError, RuntimeError) as error:
            raise _unanswered(
                scheduler, str(error) or f"nothing within {ANSWER_WITHIN_S:g} s"
            ) from None
    if kind != "Scheduler":
        raise _unanswered(scheduler, f"a {kind.lower()}")
    log = logging.getLogger("distributed.client")
    before = log.level
    log.setLevel(logging.CRITICAL)  # its tracebacks are of errors that are raised as sentences
    try:
        with Client(scheduler, timeout=ANSWER_WITHIN_S, set_as_default=False) as client:
            yield client
    finally:
        log.setLevel(before)


async def _kind_at(address: str) -> str:
    """What of Dask answers at an address; a client would wait forever for anything else."""
    from distributed.core import rpc
    from distributed.security import Security

    connection = Security().get_connection_args("client")
    async with asyncio.timeout(ANSWER_WITHIN_S), rpc(address, connection_args=connection) as there:
        return str((await there.identity())["type"])


def _unanswered(scheduler: str, actual: str) -> ClusterError:
    return ClusterError(
        "No Dask scheduler answers at this address.",
        file=scheduler,
        found=actual,
        expected="the address that `dask scheduler` prints, reachable from here",
    )
