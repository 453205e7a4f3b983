"""What ``init`` guessed, for the user to confirm."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bayesbl.recording.guessing import NO_UNIT
from bayesbl.report.output import add_row, new_table, print_table, say

if TYPE_CHECKING:
    from rich.console import Console

    from bayesbl.recording.guessing import Guess


def print_guess(guess: Guess, path: Path, console: Console) -> None:
    """Columns with channel, unit and the reason for it; what to do next."""
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
    console.print(
        f"Written to {path}. Correct it there, fill in gear_ratio and limit_rad (the gap at which "
        f"the joint is to be repaired, in rad), then: bayesbl run {path}",
        soft_wrap=True,
    )
