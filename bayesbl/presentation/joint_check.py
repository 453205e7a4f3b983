"""Whether a joint is what its bench says, and the same in all snapshots, in sentences."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from bayesbl.presentation.blocks import Block, Sentence
from bayesbl.presentation.words import Summary
from bayesbl.units import number

if TYPE_CHECKING:
    from bayesbl.measurement.summary_types import BlindSpotSummary, JointCheckSummary


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
    if spots:
        yield Sentence("; ".join(map(_in_words, spots)) + ".", "aside", "Cannot be seen here")


def _in_words(spot: BlindSpotSummary) -> str:
    error = spot["delta_error_rad"]
    effect = "" if error is None else f", {number(1e3 * error, 3)} mrad of δ"
    return f"{spot['change']} ({spot['reason']}{effect})"
