"""Whether a joint is what its bench says, and the same in all snapshots, in sentences."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from bayesbl.presentation.blocks import Block, Sentence
from bayesbl.units import number

if TYPE_CHECKING:
    from bayesbl.measurement.summary_types import BlindSpotSummary, MeasuredSummary

MOST_TOLD = 3
"""Blind spots that are told; all are stored."""


def blocks(summary: MeasuredSummary) -> Iterator[Block]:
    """A warning for every finding, then what none of the checks can see."""
    if summary["kind"] == "compare":
        checks = [(snapshot["name"], snapshot["model_check"]) for snapshot in summary["snapshots"]]
        checks.append(("", summary["same_joint"]))
    else:
        checks = [("", summary["model_check"])]
    for name, check in checks:
        # What the change is withheld for has been said.
        for sentence in (s for s in check["sentences"] if s not in (summary["reason"] or "")):
            yield Sentence(f"{name}: {sentence}" if name else sentence, "warning", "Check")
    spots = [spot for _, check in checks[-1:] for spot in check["blind_spots"]]
    for reason in dict.fromkeys(spot["reason"] for spot in spots):
        told = [_in_words(spot) for spot in spots if spot["reason"] == reason]
        if len(told) > MOST_TOLD:
            told[MOST_TOLD:] = [f"{len(told) - MOST_TOLD} more in summary.json"]
        text = f"{'; '.join(told)} ({reason})."
        yield Sentence(text[0].upper() + text[1:], "aside", "Would pass unseen")


def _in_words(spot: BlindSpotSummary) -> str:
    error = spot["delta_error_rad"]
    if error is None:
        return spot["change"]
    return f"{spot['change']}, which would move the change of δ by {number(1e3 * error, 3)} mrad"
