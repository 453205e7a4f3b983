"""The numbers of an answer, large, for the head of its page."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from bayesbl.presentation import answer, diagnosis, wear, words
from bayesbl.units import number

if TYPE_CHECKING:
    from bayesbl.diagnosis.disagreement import Use
    from bayesbl.diagnosis.summary import DiagnosisSummary
    from bayesbl.measurement.summary_types import (
        ComparisonSummary,
        MeasuredSummary,
        WearSummary,
    )
    from bayesbl.results.intervals import Interval


@dataclass(frozen=True, slots=True)
class Card:
    """A number with what it is and how sure it is."""

    label: str
    value: str
    unit: str
    note: str


def of_snapshots(summary: MeasuredSummary) -> Iterator[Card]:
    """Every gap and the change; of dated snapshots the gap now, its growth and its limit."""
    if summary["kind"] == "compare" and (rated := wear.with_rate(summary)) is not None:
        yield from _of_wear(summary, rated)
        return
    if answer.is_ringing_alone(summary):
        yield from _of_ringing(summary)
        return
    labelled = [
        (f"Gap δ, {name}" if name else "Gap δ", part["delta_rad"])
        for name, part in answer.snapshots(summary)
    ]
    if summary["kind"] == "compare":
        labelled.append(("Change", summary["change_rad"]))
    places = words.common_decimals(found for _, found in labelled)
    for label, found in labelled:
        yield of_interval(label, found, places)


def _of_ringing(summary: MeasuredSummary) -> Iterator[Card]:
    """Every amplitude, and its change from first to last."""
    for name, part in answer.snapshots(summary):
        found = part["amplitude_rpm"]
        label = f"Ringing A, {name}" if name else "Ringing A"
        if found is not None and not part["reason"]:
            value = number(found["median"], words.decimals(found))
            yield Card(label, value, "rpm", _note(found, words.bounds(found)))
    if summary["outcome"] == "withheld":
        return
    if summary["kind"] == "compare" and summary["ringing_change"] is not None:
        change = summary["ringing_change"]
        sign = "+" if change["median"] > 0.0 else ""
        value = sign + number(100.0 * change["median"], words.decimals(change, 100.0))
        yield Card("Change", value, "%", _note(change, words.bounds(change, 100.0)))


def of_diagnosis(summary: DiagnosisSummary) -> Iterator[Card]:
    """How far bench and measurement lie apart, on held-out recordings where there are any; δ."""
    overall = summary["disagreement"]["over_all"]
    use: Use | None = "held_out" if "held_out" in overall else next(iter(overall), None)
    if use is not None:
        found, note = overall[use], diagnosis.use_in_words(use)
        unit = "× noise" if found["unit"] == "noise" else found["unit"]
        yield Card("Model error before", words.significant(found["before"], 3), unit, note)
        yield Card("Model error after", words.significant(found["after"], 3), unit, note)
    gap = summary["delta_rad_after"]
    if gap is not None or "gap_withheld" in summary:
        yield of_interval("Gap δ", gap, words.common_decimals([gap]))


def of_interval(label: str, found: Interval | None, places: int) -> Card:
    """A gap, or its change, in rad; ``places``: decimals in mrad."""
    if found is None:
        return Card(label, "withheld", "", "")
    value = number(1e3 * found["median"], places)
    sign = "+" if label == "Change" and found["median"] > 0.0 else ""
    return Card(label, sign + value, "mrad", _note(found, words.bounds(found, 1e3, places)))


def _of_wear(summary: ComparisonSummary, found: WearSummary) -> Iterator[Card]:
    """The gap now, how fast it grows, and when it reaches the limit; the picture shows them all."""
    last = summary["snapshots"][-1]["delta_rad"]
    change, rate = summary["change_rad"], found["rate"]
    places = words.common_decimals([last, change])
    yield of_interval("Gap δ now", last, places)
    if not wear.spans_repair(summary, found):
        yield of_interval("Change", change, places)  # across a repair it is no sign of wear
    yield Card(
        "Wear", wear.median_in_mrad(rate), "mrad a year", _note(rate, words.bounds(rate, 1e3))
    )
    reached = wear.limit_dates(found, wear.month)
    if reached is not None:
        middle, dates = reached
        yield Card("Limit reached", middle, "", _note(rate, dates))


def _note(interval: Interval, shown: str) -> str:
    return f"{100.0 * interval['level']:g} %: {shown}"
