"""An answer for the ringing alone, where no curve leads from it to the gap."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesbl.presentation import joint_check, words

if TYPE_CHECKING:
    from bayesbl.measurement.summary_types import MeasuredSummary

EXPLAINED = "The amplitude A is that of the ringing after each impact, in the motor's speed."


def is_alone(summary: MeasuredSummary) -> bool:
    """Whether there is no curve, so no gap."""
    parts = summary["snapshots"] if summary["kind"] == "compare" else [summary]
    return summary["curve"] is None and all(part["route"] == "amplitude" for part in parts)


def headline(summary: MeasuredSummary) -> str:
    """The amplitude, or its change from first to last."""
    if summary["outcome"] == "withheld":
        what = "change of the ringing" if summary["kind"] == "compare" else "ringing"
        return f"The {what} is withheld: these data do not give an answer that can be trusted."
    if summary["kind"] == "compare":
        change, grew = summary["ringing_change"], summary["probability_ringing_grew"]
        if change is None or grew is None:
            return "The change of the ringing is withheld."
        told = words.change_of("The ringing", change, "%", 100.0)
        told += f"; probability that it grew: {words.probability(grew)}"
        if not summary["same_joint"]["agrees"]:
            told += ". Something other than the gap changed, so this says nothing of wear"
        elif (unseen := joint_check.unseen_without_current(summary)) is not None:
            told += (
                f". This says something of the gap only if {unseen} did not change: no motor "
                "current can be compared"
            )
        return f"{told}."
    found = summary["amplitude_rpm"]
    if found is None:
        return "The ringing is withheld."
    return f"The ringing has an amplitude of {words.with_bounds(found, 'rpm')}."
