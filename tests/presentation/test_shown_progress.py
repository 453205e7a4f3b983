"""Progress in a pipe: no long silence, and no flood."""

from __future__ import annotations

import io
import threading
import time

import pytest
from rich.console import Console

from bayesbl.presentation import terminal


def _lines_of_a_silent_stage(lasting_s: float) -> list[str]:
    pipe = io.StringIO()
    with terminal.progress(Console(file=pipe)) as tell:
        tell("Sampling before [1]", 1, 3)
        time.sleep(lasting_s)
    return pipe.getvalue().splitlines()


def test_what_ends_before_a_silence_is_long_says_nothing():
    assert _lines_of_a_silent_stage(0.0) == []


def test_a_stage_that_reports_nothing_is_told_again(monkeypatch):
    monkeypatch.setattr(terminal, "SILENT_S", 0.02)
    lines = _lines_of_a_silent_stage(0.5)
    assert len(lines) >= 2
    assert all(line.startswith("Sampling before [1]: 1 of 3, after ") for line in lines)


def test_silences_grow_with_the_time(monkeypatch):
    monkeypatch.setattr(terminal, "SILENT_S", 1e-3)
    monkeypatch.setattr(terminal, "SILENT_SHARE", 1.0)
    # Each silence is at least as long as all before it: 1, 2, 4, … ms.
    assert len(_lines_of_a_silent_stage(0.5)) <= 10


@pytest.mark.parametrize("error", [None, KeyboardInterrupt])
def test_nothing_speaks_after_the_end(error):
    try:
        with terminal.progress(Console(file=io.StringIO())):
            if error is not None:
                raise error
    except KeyboardInterrupt:
        pass
    assert not [thread for thread in threading.enumerate() if thread.name == "progress"]
