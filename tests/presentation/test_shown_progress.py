"""Progress is shown on a terminal, and nothing of it in a pipe."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from bayesbl.presentation import terminal


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("kind", "shown"), [(io.StringIO, False), (Terminal, True)])
def test_a_bar_is_shown_on_a_terminal_alone(kind, shown):
    file = kind()
    with terminal.progress(Console(file=file, force_terminal=True)) as tell:
        tell("Sampling before [1]", 1, 3)
    assert ("Sampling before [1]" in file.getvalue()) is shown
    assert shown or not file.getvalue()
