"""An answer for the ringing alone, where no curve leads from it to the gap."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesbl.presentation import words
from bayesbl.units import number

if TYPE_CHECKING:
    from bayesbl.measurement.summary_types import MeasuredSummary
    from bayesbl.results.intervals import Interval

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
        told = f"{_change_in_words(change)}; probability that it grew: {words.probability(grew)}"
        if not summary["same_joint"]["agrees"]:
            told += ". Something other than the gap changed, so this says nothing of wear"
        return f"{told}."
    found = summary["amplitude_rpm"]
    if found is None:
        return "The ringing is withheld."
    places = words.decimals(found)
    return (
        f"The ringing has an amplitude of {number(found['median'], places)} rpm "
        f"({words.interval_kind(found)} {words.bounds(found, places=places)} rpm)."
    )


def _change_in_words(change: Interval) -> str:
    """Whether the ringing grew, shrank, or may have done neither, in percent."""
    if change["low"] > 0.0:
        return f"The ringing grew by {_in_percent(change, 1.0)}"
    if change["high"] < 0.0:
        return f"The ringing shrank by {_in_percent(change, -1.0)}"
    return f"The ringing may not have changed: the change is {_in_percent(change, 1.0)}"


def _in_percent(change: Interval, sign: float) -> str:
    scale = 100.0 * sign
    middle = number(scale * change["median"], words.decimals(change, scale))
    return f"{middle} % ({words.interval_kind(change)} {words.bounds(change, scale)} %)"
