"""The numbers of an answer, large, for the head of its page."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from bayesbl.presentation import answer, diagnosis, wear, words
from bayesbl.units import number

if TYPE_CHECKING:
    from bayesbl.results.intervals import Interval


@dataclass(frozen=True, slots=True)
class Card:
    """A number with what it is and how sure it is."""

    label: str
    value: str
    unit: str
    note: str


def of_snapshots(summary: words.Summary) -> Iterator[Card]:
    """Every gap and the change; of dated snapshots the gap now, its growth and its limit."""
    if wear.has_rate(summary):
        yield from _of_wear(summary)
        return
    labelled = [
        (f"Gap δ, {name}" if name else "Gap δ", part["delta_rad"])
        for name, part in answer.snapshots(summary)
    ]
    if "change_rad" in summary:
        labelled.append(("Change", summary["change_rad"]))
    places = words.common_decimals(found for _, found in labelled)
    for label, found in labelled:
        yield _of_interval(label, found, places)


def of_diagnosis(summary: words.Summary) -> Iterator[Card]:
    """How far bench and measurement lie apart, on held-out recordings where there are any; δ."""
    overall = summary["disagreement"]["over_all"]
    use = "held_out" if "held_out" in overall else next(iter(overall), None)
    if use is not None:
        unit = overall[use]["unit"]
        shown = "× noise" if unit == "noise" else unit
        for label, key in (("Model error before", "before"), ("Model error after", "after")):
            yield Card(
                label,
                words.significant(overall[use][key], 3),
                shown,
                diagnosis.use_in_words(use),
            )
    found = summary["delta_rad_after"]
    if found is not None:
        yield _of_interval("Gap δ", found, words.common_decimals([found]))


def _of_interval(label: str, found: Interval | None, places: int) -> Card:
    if found is None:
        return Card(label, "withheld", "", "")
    value = number(1e3 * found["median"], places)
    sign = "+" if label == "Change" and found["median"] > 0.0 else ""
    return Card(label, sign + value, "mrad", _note(found, words.bounds(found, 1e3, places)))


def _of_wear(summary: words.Summary) -> Iterator[Card]:
    """The gap now, how fast it grows, and when it reaches the limit; the picture shows them all."""
    found, last = summary["wear"], summary["snapshots"][-1]["delta_rad"]
    change, rate = summary["change_rad"], found["rate"]
    places = words.common_decimals([last, change])
    yield _of_interval("Gap δ now", last, places)
    if not wear.spans_repair(summary):
        yield _of_interval("Change", change, places)  # across a repair it is no sign of wear
    yield Card(
        "Wear", wear.median_in_mrad(rate), "mrad a year", _note(rate, words.bounds(rate, 1e3))
    )
    if found["date_of_limit"] is not None:
        middle, dates = wear.limit_dates(found, wear.month)
        yield Card("Limit reached", middle, "", _note(rate, dates))


def _note(interval: Interval, shown: str) -> str:
    return f"{100.0 * interval['level']:g} %: {shown}"
