"""Worker processes: one that dies is a message, and the others go with it."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
from pathlib import Path

import pytest

from bayesbl.errors import WorkerError
from bayesbl.processes import processes


def test_a_worker_that_dies_is_a_message_and_leaves_no_process_behind() -> None:
    before = set(multiprocessing.active_children())
    with pytest.raises(WorkerError, match="worker process died"), processes(2) as pool:
        pool.submit(os._exit, 3).result()
    assert set(multiprocessing.active_children()) <= before


def test_a_script_needs_no_guard_around_what_it_runs(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "from bayesbl.processes import processes\n"
        "with processes(2) as pool:\n"
        "    print(*pool.map(abs, [-1, -2]))\n"
        "print(__file__)\n"
    )
    ran = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    assert (ran.stdout, ran.stderr) == (f"1 2\n{script}\n", "")
