"""What ``init`` guessed, for the user to confirm."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from bayesbl.presentation.blocks import Block, Sentence, table, text
from bayesbl.recording.guessing import NO_UNIT

if TYPE_CHECKING:
    from bayesbl.recording.guessing import Guess
    from bayesbl.runs.first_diagnosis import Choice


_SHARE = re.compile(r"[\[(]\s*(%|‰|prozent|promille|per ?cent|per ?mille)", re.IGNORECASE)


def guessed(guess: Guess) -> Iterator[Block]:
    """Columns with channel, unit and the reason for it."""
    yield Sentence("Guessed from the recording; please confirm:", "answer")
    rows = [(column.name, column.channel, column.unit, column.reason) for column in guess.columns]
    yield table(map(text, ("Column", "Channel", "Unit", "Reason")), rows)
    if guess.unused:
        yield Sentence(", ".join(guess.unused), label="Not used")
    for name in filter(_SHARE.search, guess.unused):
        yield Sentence(
            f"{name} is a share of a rated value. If it is the motor's current or torque, write "
            "its A to the file: this column times the rated current. A current makes the gap "
            "several times sharper and shows a changed joint.",
            "warning",
            "Check",
        )
    for column in guess.columns:
        if column.doubted:
            yield Sentence(f"{column.name} is {column.reason}", "warning", "Check")
        if not column.sure:
            why = "" if column.reason == NO_UNIT else f" ({column.reason})"
            unit = f"the unit of {column.name} is not stated{why}."
            yield Sentence(unit, "warning", "Check")


def chosen(guess: Iterable[Choice]) -> Iterator[Block]:
    """How recordings and bench would be compared, with the reasons."""
    for choice in guess:
        yield Sentence(choice.told)


def what_next(
    path: Path, *, sound: bool, torque_ramps: bool = False, two_encoders: bool = False
) -> str:
    """Where the configuration is, and what to do with it."""
    if not sound:
        return f"Written to {path}. It cannot run yet:"
    if torque_ramps:
        return (
            f"Written to {path}, for ramps of torque with the output held. Correct units and "
            f"gear_ratio there, then: bayesbl run {shlex.quote(str(path))}"
        )
    if two_encoders:
        return (
            f"Written to {path}, for encoders of motor and load. Correct units there, fill in "
            f"gear_ratio if it is known, then: bayesbl run {shlex.quote(str(path))}"
        )
    return (
        f"Written to {path}. Correct it there, fill in gear_ratio, limit_rad (the gap at which "
        f"the joint is to be repaired, in rad) and bench (what is known of the joint), then: "
        f"bayesbl run {shlex.quote(str(path))}"
    )
