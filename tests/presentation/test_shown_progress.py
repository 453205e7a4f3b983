"""Progress in a pipe: nothing of what ends soon, then a line now and then."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from bayesbl.presentation import terminal


@pytest.mark.parametrize(("every_s", "lines"), [(3600.0, 0), (0.0, 3)])
def test_a_pipe_gets_a_line_no_more_often_than_agreed(monkeypatch, every_s, lines):
    monkeypatch.setattr(terminal, "EVERY_S", every_s)
    pipe = io.StringIO()
    with terminal.progress(Console(file=pipe)) as tell:
        for done in (1, 2, 3):
            tell("Sampling before [1]", done, 3)
    told = pipe.getvalue().splitlines()
    assert len(told) == lines
    assert all(line.startswith("Sampling before [1]: ") for line in told)
