"""A fleet in words: what was measured, what is urgent, how each type wears."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bayesbl.presentation import words
from bayesbl.presentation.blocks import Block, Sentence, table
from bayesbl.presentation.wear import LAWS, month

if TYPE_CHECKING:
    from bayesbl.results.store import Interval
    from bayesbl.runs.fleet import FleetSummary

Row = Mapping[str, Any]  # A row of a table of the fleet, or its summary
_SHOWN = 10

_MEASURED = ("converged", "usable")

OUTCOMES = {
    "converged": "measured",
    "usable": "measured, with notes",
    "withheld": "withheld",
    "no_curve": "without a bench or a curve",
    "refused": "refused",
    "failed": "failed because of a bug",
}
"""Outcomes of recordings in words."""


def headline(summary: Row) -> str:
    """Number of joints and recordings, and of joints over their limit."""
    counted, alarms = summary["recordings"], len(summary["alarms"])
    measured = sum(counted.get(outcome, 0) for outcome in _MEASURED)
    over = {0: "None is", 1: "One is"}.get(alarms, f"{alarms} are")
    return (
        f"{_count(summary['joints'], 'joint')}, {summary['with_rate']} with a rate of wear, from "
        f"{measured} of {_count(sum(counted.values()), 'recording')}. "
        f"{over} flagged as over the limit."
    )


def types_in_words(summary: Row) -> Iterator[str]:
    """How the joints of each type wear."""
    for name, rates in summary["types"].items():
        rate = rates["median_rad_per_year"]
        factor = words.significant(math.exp(rates["spread"]["median"]))
        law = max(rates["law"], key=lambda name: rates["law"][name])
        yield (
            f"{name}: the median joint wears by {words.middle(rate, 1e3)} mrad a year "
            f"({words.interval_kind(rate)} {words.bounds(rate, 1e3)}); two joints in three are "
            f"within a factor of {factor} of that ({rates['joints']} joints). "
            f"Most likely law: {LAWS[law]} ({words.probability(rates['law'][law])}). "
            f"Share of joints unlike the rest: {words.probability(rates['own']['median'])}."
            + "".join(
                f" If {covariate} is larger by {words.significant(effect['sd'])}, a joint wears "
                f"{words.significant(effect['factor']['median'])} times as fast "
                f"({words.bounds(effect['factor'])})."
                for covariate, effect in rates["covariates"].items()
            )
        )


def unlike_type(row: Row, summary: Row) -> str | None:
    """How a joint wears if its recordings contradict its type; otherwise ``None``."""
    if (row["probability_unlike_type"] or 0.0) < 0.5:
        return None
    of_type = summary["types"].get(str(row.get(summary["pool_by"])))
    middle = math.nan if of_type is None else of_type["median_rad_per_year"]["median"]
    if row["rate_alone_rad_per_year_low"] > middle:
        return "faster than its type"
    if row["rate_alone_rad_per_year_high"] < middle:
        return "more slowly than its type"
    return "unlike its type"


def blocks(summary: FleetSummary) -> Iterator[Block]:
    """The most urgent joints, and what was left out."""
    titles = ("Joint", "Gearbox", "#Gap (mrad)", "#Rate (mrad/year)", "Reaches limit", "State")
    rows = [
        (
            row["joint"],
            row["gearbox"] or "",
            in_mrad(row, "delta_rad", summary).text,
            in_mrad(row, "rate_rad_per_year", summary).text,
            limit_reached(row).text,
            "over its limit" if row["alarm"] else state(row, summary),
        )
        for row in summary["most_urgent"][:_SHOWN]
    ]
    yield table(titles, rows)
    yield from map(Sentence, types_in_words(summary))
    unmeasured = [(n, key) for key, n in summary["recordings"].items() if key not in _MEASURED]
    if unmeasured:
        counts = ", ".join(f"{n} {OUTCOMES[outcome]}" for n, outcome in unmeasured)
        yield Sentence(f"{counts}: see reason in recordings.parquet.", "warning", "Left out")
    if summary["alarms"]:
        names, more = ", ".join(summary["alarms"][:_SHOWN]), len(summary["alarms"]) - _SHOWN
        others = f" and {more} others" if more > 0 else ""
        why = f"{names}{others}. At most 5 % of these are expected to be false alarms."
        yield Sentence(why, "warning", "Flagged as over their limit")


@dataclass(frozen=True, slots=True)
class Cell:
    """A text, a second line below it, and the key that its column is sorted by."""

    text: str
    below: str = ""
    key: str | float = ""


def interval_of(row: Row, name: str, summary: Row) -> Interval | None:
    """A quantity of a table's row as an interval, if the row has it."""
    if row[f"{name}_median"] is None:
        return None
    median, low, high = (row[f"{name}_{end}"] for end in ("median", "low", "high"))
    level, kind = summary["level"], summary["interval_kind"]
    return {"median": median, "low": low, "high": high, "level": level, "kind": kind}


def in_mrad(row: Row, name: str, summary: Row) -> Cell:
    """A quantity in rad, shown in mrad with its interval."""
    interval = interval_of(row, name, summary)
    if interval is None:
        return Cell("–", key=-1.0)
    return Cell(words.middle(interval, 1e3), words.bounds(interval, 1e3), interval["median"])


def limit_reached(row: Row) -> Cell:
    """When the limit is reached; sorted as the table is ranked."""
    if row["rate_rad_per_year_median"] is None or row["limit_rad"] is None:
        return Cell("–", key="9999-99")
    middle = row["limit_date_median"]
    if middle is not None and middle <= row["last_date"]:
        return Cell("passed", f"by {month(row['last_date'])}", "0000")
    low, high = (row[f"limit_date_{end}"] for end in ("low", "high"))
    later = "later" if high is None else month(high)
    text = "not in sight" if middle is None else month(middle)
    return Cell(text, f"{month(low)} to {later}", middle or "9999-98")


def state(row: Row, summary: Row) -> str:
    """What is known of a joint's wear."""
    if row["rate_rad_per_year_median"] is None:
        return "no gap" if row["delta_rad_median"] is None else "no rate"
    left_out, unlike = row["withheld"] + row["broken"], unlike_type(row, summary)
    notes = ["measured"]
    notes += ["not shown to grow"] * (row["probability_wear"] < words.SURE)
    notes += [f"wears {unlike}"] * bool(unlike) + [f"{left_out} left out"] * bool(left_out)
    return ", ".join(notes)


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
