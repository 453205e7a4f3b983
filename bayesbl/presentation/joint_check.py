"""Whether a joint is what its bench says, and the same in all snapshots, in sentences."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from bayesbl.presentation.blocks import Block, Sentence
from bayesbl.presentation.words import Summary
from bayesbl.units import number

if TYPE_CHECKING:
    from bayesbl.measurement.summary_types import BlindSpotSummary, JointCheckSummary

MOST_TOLD = 3
"""Blind spots that are told; all are stored."""


def blocks(summary: Summary) -> Iterator[Block]:
    """A warning for every finding, then what none of the checks can see."""
    alone: list[Any] = [summary]
    checks: list[tuple[str, JointCheckSummary]] = [
        (part.get("name", ""), part["model_check"]) for part in summary.get("snapshots", alone)
    ]
    if "same_joint" in summary:
        checks.append(("", summary["same_joint"]))
    for name, check in checks:
        for sentence in check["sentences"]:
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
