"""A fleet in words: what was measured, what is urgent, how each type wears."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from bayesbl.presentation import words
from bayesbl.presentation.blocks import Advice, Block, Sentence, numbers, table, text
from bayesbl.presentation.wear import LAWS, median_in_mrad, month

if TYPE_CHECKING:
    from bayesbl.runs.fleet import FleetSummary

_SHOWN = 10

_MEASURED = ("converged", "usable")


def headline(summary: Mapping[str, Any]) -> str:
    """How many joints and recordings, and how many joints are over their limit."""
    counted = summary["recordings"]
    measured = sum(counted.get(outcome, 0) for outcome in _MEASURED)
    alarms = len(summary["alarms"])
    over = "None is" if alarms == 0 else "One is" if alarms == 1 else f"{alarms} are"
    return (
        f"{_count(summary['joints'], 'joint')}, {summary['with_rate']} with a rate of wear, from "
        f"{measured} of {_count(sum(counted.values()), 'recording')}. {over} called over the limit."
    )


def types_in_words(summary: Mapping[str, Any]) -> Iterator[str]:
    """How the joints of each type wear."""
    for name, found in summary["types"].items():
        rate = found["median_rad_per_year"]
        spread = found["spread"]["median"]
        factor = words.significant(math.exp(spread))
        law = max(found["law"], key=lambda name: found["law"][name])
        yield (
            f"{name}: the median joint wears by {median_in_mrad(rate)} mrad a year "
            f"({words.interval_kind(rate)} {words.bounds(rate, 1e3)}); two joints in three are "
            f"within a factor of {factor} of that ({found['joints']} joints). "
            f"Most likely law: {LAWS[law]} ({words.probability(found['law'][law])}). "
            f"Share of joints unlike the rest: {words.probability(found['own']['median'])}."
            + "".join(map(_factor, found["covariates"].items()))
        )


def _factor(covariate: tuple[str, Mapping[str, Any]]) -> str:
    name, found = covariate
    factor = found["factor"]
    more, times = words.significant(found["sd"]), words.significant(factor["median"])
    return (
        f" With {more} more of {name} a joint wears {times} times as fast ({words.bounds(factor)})."
    )


def unlike_type(row: Mapping[str, Any], summary: Mapping[str, Any]) -> str | None:
    """How a joint wears whose recordings speak against its type; ``None`` where they do not."""
    probability = row["probability_unlike_type"]
    if probability is None or probability < 0.5:
        return None
    of_type = summary["types"].get(str(row.get(summary["pool_by"])))
    middle = None if of_type is None else of_type["median_rad_per_year"]["median"]
    if middle is not None and row["rate_alone_rad_per_year_low"] > middle:
        return "faster than its type"
    if middle is not None and row["rate_alone_rad_per_year_high"] < middle:
        return "more slowly than its type"
    return "unlike its type"


def blocks(summary: FleetSummary) -> Iterator[Block]:
    """The most urgent joints, and what was left out."""
    rows = summary["most_urgent"][:_SHOWN]
    columns = (
        text("Joint"),
        text("Gearbox"),
        numbers("Gap (mrad)"),
        numbers("Rate (mrad/year)"),
        text("Reaches limit"),
        text("State"),
    )
    yield table(columns, [_row(row, summary) for row in rows])
    for sentence in types_in_words(summary):
        yield Sentence(sentence)
    counted = summary["recordings"]
    left = {k: n for k, n in counted.items() if k not in _MEASURED}
    if left:
        told = ", ".join(f"{n} {_LEFT[outcome]}" for outcome, n in left.items())
        yield Sentence(f"{told}: see reason in recordings.parquet.", "warning", "Left out")
    if summary["alarms"]:
        names = ", ".join(summary["alarms"][:_SHOWN])
        more = len(summary["alarms"]) - _SHOWN
        yield Sentence(
            names + (f" and {more} others" if more > 0 else "") + ". At most 5 % of these are "
            "expected to be false alarms.",
            "warning",
            "Called over their limit",
        )


_LEFT = {
    "withheld": "withheld",
    "no_curve": "without a bench or a curve",
    "refused": "refused",
    "failed": "failed by a bug",
}


def _row(row: Mapping[str, Any], summary: FleetSummary) -> list[str]:
    def middle(name: str) -> str:
        value = row[f"{name}_median"]
        return "–" if value is None else words.significant(1e3 * value, 3)

    dated = row["rate_rad_per_year_median"] is not None and row["limit_rad"] is not None
    date = month(row["limit_date_median"]) if row["limit_date_median"] else "not in sight"
    unlike = unlike_type(row, summary)
    state = "no rate" if row["reason"] else f"wears {unlike}" if unlike else "measured"
    if not row["reason"] and row["probability_wear"] < words.SURE:
        state = "not shown to grow"
    if row["alarm"]:
        state = "over its limit"
    return [
        str(row["joint"]),
        row["gearbox"] or "",
        middle("delta_rad"),
        middle("rate_rad_per_year"),
        date if dated else "–",
        state,
    ]


def advice(summary: FleetSummary) -> Advice:
    """What to do about the plant."""
    if summary["alarms"]:
        return Advice("act", "Repair these joints.", (", ".join(summary["alarms"]),))
    return Advice("fine", "No joint is called over its limit.", (headline(summary),))


def assumptions(summary: FleetSummary) -> Iterator[str]:
    """What is taken for granted of the fleet as a whole."""
    yield "Each recording belongs to the joint and the date that its name or its table says."
    if summary["types"]:
        yield (
            f"Most joints of one {summary['pool_by']} wear by the same kinds of law, with the "
            "same scatter, at rates from one log-normal distribution; the others differ."
        )


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
