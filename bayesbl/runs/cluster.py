"""Independent jobs over processes of this machine, or on a Dask cluster that is already there.

The numbers are the same. So every worker of a cluster must run the same code on the same files, its
linear algebra on one thread; a worker that differs refuses, whenever it joins. In a worker process
one job runs at a time whatever its threads, as jobs need not be safe against each other. A job
whose worker dies is run again by another.
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
        """Which job it is."""


J = TypeVar("J", bound=InWords)
R = TypeVar("R")


Facts = tuple[tuple[str, str], ...]
"""What numbers depend on beside the jobs, by name."""


def facts(files: Iterable[str]) -> Facts:
    """Of this process: versions, the package's code, threads of linear algebra, files' content."""
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
    """What is otherwise in this process, which is a worker's, in words."""
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
    """Run jobs where ``[run]`` says; yields them as they end, in any order, and holds none longer.

    One worker is a process of its own too: linear algebra on one thread rounds differently than on
    many, and the numbers must not depend on the workers.

    ``run``: a function of a module, or a ``partial`` of one. ``files``: that every job reads, to be
    the same for all workers of a cluster. ``what``: the jobs, in a sentence. Raises WorkerError if
    a process dies, and ClusterError if the scheduler does not answer or is lost, a worker differs,
    or a job kills all that run it.
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
                    "Workers died repeatedly while they ran this case, or one beside it.",
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
    """A job, in a worker."""
    with _one_job:
        _require_here(wanted, files)
        return run(job)


@cache
def _require_here(wanted: Facts, files: tuple[str, ...]) -> None:
    """This worker differs in nothing, asked again as workers may join later."""
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
    with _quiet(), Client(scheduler, timeout=ANSWER_WITHIN_S, set_as_default=False) as client:
        yield client


@contextmanager
def _quiet() -> Iterator[None]:
    """Dask logs a traceback for what is then raised as a sentence."""
    log = logging.getLogger("distributed.client")
    before = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(before)


async def _kind_at(address: str) -> str:
    """What of Dask answers at an address: a client would wait for ever for what is not Dask."""
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
