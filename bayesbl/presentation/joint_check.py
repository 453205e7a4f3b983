"""Whether a joint is what its bench says, and the same in all snapshots, in sentences."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from bayesbl.presentation import torque_ramps
from bayesbl.presentation.blocks import Block, Sentence
from bayesbl.presentation.words import capitalised
from bayesbl.units import number

if TYPE_CHECKING:
    from bayesbl.measurement.summary_types import (
        BlindSpotSummary,
        ComparisonSummary,
        MeasuredSummary,
    )

MOST_TOLD = 3
"""Blind spots that are told; all are stored."""


def other_cause(summary: ComparisonSummary) -> str | None:
    """A change of the joint that could be all there is, and why it is not told from wear.

    ``None`` where the change of δ is withheld or holds zero, or is larger than any such change
    would make it.
    """
    spots = summary["same_joint"]["blind_spots"]
    ends = _change_ends_rad(summary) if spots else None
    if ends is None:
        return None
    worst = max(spots, key=lambda spot: spot["delta_error_rad"] or 0.0)
    nearest = max(ends[0], -ends[1])
    if not 0.0 < nearest <= (worst["delta_error_rad"] or 0.0):
        return None
    return f"{worst['change']} ({worst['reason']})"


def unless(summary: ComparisonSummary) -> str:
    """The condition behind a probability of growth, where it could be something else."""
    if other_cause(summary) is not None:
        return ", if nothing else in the joint changed"
    if (unseen := unseen_without_current(summary)) is not None:
        return f", if {unseen} did not change"
    # By any size, and no ramp tells it from play.
    softer = ", if no flank became softer at small torque"
    return softer if torque_ramps.is_by_ramps(summary) else ""


def unseen_without_current(summary: ComparisonSummary) -> str | None:
    """What may have changed by any size, where no motor current shows it; ``None`` elsewhere."""
    from bayesbl.measurement.joint_check import NO_CURRENT  # numbers are behind it

    spots = summary["same_joint"]["blind_spots"]
    return next((spot["change"] for spot in spots if spot["reason"] == NO_CURRENT), None)


def _change_ends_rad(summary: ComparisonSummary) -> tuple[float, float] | None:
    """Of the change of δ; of its medians since the repair, where there was one."""
    found, parts = summary["wear"], summary["snapshots"]
    if found is not None and len(found["snapshots"]) < len(parts):
        first, last = (
            next(part for part in parts if part["name"] == name)["delta_rad"]
            for name in (found["snapshots"][0], found["snapshots"][-1])
        )
        if first is None or last is None:
            return None
        return (last["median"] - first["median"],) * 2
    change = summary["change_rad"]
    return None if change is None else (change["low"], change["high"])


def blocks(summary: MeasuredSummary, codes: Sequence[str]) -> Iterator[Block]:
    """A warning for every finding, then what none of the checks can see.

    ``codes``: why the answer is withheld, which may have said it.
    """
    if summary["kind"] == "compare":
        checks = [(snapshot["name"], snapshot["model_check"]) for snapshot in summary["snapshots"]]
        checks.append(("", summary["same_joint"]))
    else:
        checks = [("", summary["model_check"])]
    for name, check in checks:
        # What the change is withheld for has been said.
        for sentence in () if "joint_changed" in codes and not name else check["sentences"]:
            yield Sentence(f"{name}: {sentence}" if name else sentence, "warning", "Check")
    spots = [spot for _, check in checks[-1:] for spot in check["blind_spots"]]
    for label, known in (("Could pass for wear", True), ("Would pass unseen", False)):
        own = [spot for spot in spots if (spot["delta_error_rad"] is not None) == known]
        for reason in dict.fromkeys(spot["reason"] for spot in own):
            told = _listed([_told(spot) for spot in own if spot["reason"] == reason])
            yield Sentence(capitalised(f"{told}."), "aside", f"{label} ({reason})")


def _listed(told: list[str]) -> str:
    more = [f"{len(told) - MOST_TOLD} more in summary.json"] if len(told) > MOST_TOLD else []
    return "; ".join([*told[:MOST_TOLD], *more])


def _told(spot: BlindSpotSummary) -> str:
    error_rad = spot["delta_error_rad"]
    up_to = "" if error_rad is None else f", up to {number(1e3 * error_rad, 3)} mrad"
    return spot["change"] + up_to
