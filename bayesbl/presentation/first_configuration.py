"""What ``init`` guessed, for the user to confirm."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from bayesbl.presentation.terminal import add_row, new_table, print_table, say
from bayesbl.recording.guessing import NO_UNIT

if TYPE_CHECKING:
    from rich.console import Console

    from bayesbl.recording.guessing import Guess


def print_guess(guess: Guess, path: Path, console: Console, *, sound: bool) -> None:
    """Columns with channel, unit and the reason for it; what to do next, if it can run at all."""
    say(console, "Guessed from the recording; please confirm:", "bold")
    table = new_table(("Column", "left"), ("is", "left"), ("in", "left"), ("because", "left"))
    for column in guess.columns:
        add_row(table, column.name, column.channel, column.unit, column.reason)
    print_table(table, console)
    if guess.unused:
        say(console, ", ".join(guess.unused), label="Not used")
    for column in guess.columns:
        if not column.sure:
            say(
                console,
                f"the unit of {column.name} is not stated"
                + ("." if column.reason == NO_UNIT else f" ({column.reason})."),
                "yellow",
                label="Check",
            )
    after = (
        "Correct it there, fill in gear_ratio and limit_rad (the gap at which the joint is to be "
        f"repaired, in rad), then: bayesbl run {shlex.quote(str(path))}"
        if sound
        else "It cannot run as it is; what stands against it:"
    )
    console.print(f"Written to {path}. {after}", soft_wrap=True)
