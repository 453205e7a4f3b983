"""Worker processes: one that dies is a message, and the others go with it."""

from __future__ import annotations

import multiprocessing
import os

import pytest

from bayesbl.errors import WorkerError
from bayesbl.processes import processes


def test_a_worker_that_dies_is_a_message_and_leaves_no_process_behind() -> None:
    before = set(multiprocessing.active_children())
    with pytest.raises(WorkerError, match="worker process died"), processes(2) as pool:
        pool.submit(os._exit, 3).result()
    assert set(multiprocessing.active_children()) <= before
