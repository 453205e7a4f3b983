"""Wear in time in words: how fast, how long until the limit, and how sure."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from datetime import date
from typing import TYPE_CHECKING

from bayesbl.presentation import words
from bayesbl.presentation.blocks import Block, Sentence, Table, numbers, table, text
from bayesbl.presentation.words import Summary
from bayesbl.units import number

if TYPE_CHECKING:
    from bayesbl.results.intervals import Interval

MODEL = (
    "Rate and date are averages over laws of wear, each by how well it fits, and over how "
    "irregular wear may be. No law heals: draws in which the gap shrinks are not used for them, "
    "so neither is evidence of wear."
)

LAWS = {
    "linear": "steady",
    "running_in": "slowing down (running in)",
    "power": "speeding up as a power of age",
    "exponential": "speeding up exponentially",
    "s_shaped": "speeding up, then levelling off",
}
"""The laws of :data:`bayesbl.measurement.wear_laws.LAWS` in words."""


def blocks(summary: Summary) -> Iterator[Block]:
    """Sentences and table of ``wear`` of a summary of a dated comparison."""
    wear = summary["wear"]
    if spans_repair(summary):
        yield Sentence(repaired(wear))
    if wear["reason"]:
        yield Sentence(wear["reason"], "warning", "No rate of wear")
        return
    fell = fallen(wear)
    if fell:
        yield Sentence(fell, "warning", "Warning")
    for sentence in sentences(wear):
        yield Sentence(sentence)
    yield _table(wear)
    for sentence in notes(wear):
        yield Sentence(sentence, "aside")


def has_rate(summary: Summary) -> bool:
    """Whether a summary says how fast the gap grows."""
    wear = summary.get("wear")
    return wear is not None and not wear["reason"]


def spans_repair(summary: Summary) -> bool:
    """Whether a repair lies between the first and the last of dated snapshots."""
    return len(summary["wear"]["snapshots"]) < len(summary["snapshots"])


def headline(summary: Summary) -> str:
    """How large the gap is now and how fast it grows: the answer of dated snapshots."""
    wear, last = summary["wear"], summary["snapshots"][-1]["delta_rad"]
    now = "" if last is None else f"is {median_in_mrad(last)} mrad now and "
    if wear["probability_wear"] < words.SURE:
        return (
            f"The gap {now}is not shown to have grown since {wear['first_date']} (probability "
            f"{words.probability(wear['probability_wear'])})."
        )
    rate = wear["rate"]
    places = words.decimals(rate, 1e3)
    return (
        f"The gap {now}has grown by {median_in_mrad(rate)} mrad a year since {wear['first_date']} "
        f"({words.interval_kind(rate)} {words.bounds(rate, 1e3, places)})."
    )


def median_in_mrad(interval: Interval) -> str:
    """The median in mrad, with as many digits as its interval bears."""
    return number(1e3 * interval["median"], words.decimals(interval, 1e3))


def month(value: str | None) -> str:
    """``Nov 2026`` of an ISO date: a forecast is never known to the day."""
    return day(value) if value is None else date.fromisoformat(value).strftime("%b %Y")


def repaired(wear: Summary) -> str:
    """What a repair between the snapshots means for what they show."""
    return (
        f'The joint was repaired before "{wear["snapshots"][0]}": the change from first to last '
        "spans the repair, and only the snapshots since then show how the joint wears."
    )


def sentences(wear: Summary) -> Iterator[str]:
    """The answer to how fast, until when, and whether before the date asked for."""
    from bayesbl.measurement.wear import LONGEST_YEARS

    share = words.probability(wear["level"])
    rate = 1e3 * wear["rate_at_most_rad_per_year"]
    yield (
        f"The gap has grown since {wear['first_date']} (probability "
        f"{words.probability(wear['probability_wear'])}); with {share} probability by at most "
        f"{words.significant(rate)} mrad a year."
    )
    yield law(wear)
    if wear["years_to_limit"] is None:
        return
    limit = f"the limit of {1e3 * wear['limit_rad']:g} mrad"
    if has_passed(wear, "high"):
        yield f"The gap passed {limit} before {wear['last_date']}."
    elif not_before(wear) == wear["last_date"]:
        yield (
            f"The gap may have passed {limit} before {wear['last_date']}: the probability that it "
            f"had not is below {share}."
        )
    elif not_before(wear) is None:
        yield (
            f"With {share} probability the gap does not reach {limit} within "
            f"{LONGEST_YEARS:g} years."
        )
    else:
        yield (
            f"With {share} probability the gap does not reach {limit} before {not_before(wear)}."
        )
    if wear["decide_before"] is not None:
        yield (
            f"Probability that it passes {limit} by {wear['decide_before']}: "
            f"{words.probability(wear['probability_before']['probability'])}."
        )


def not_before(wear: Summary) -> str | None:
    """The date to plan by; ``None`` where it is too far ahead to be given."""
    found: str | None = wear["not_before"]["date"]
    return found


def law(wear: Summary) -> str:
    """How probable each law of wear is, the likeliest first."""
    ranked = sorted(wear["law"].items(), key=lambda item: -item[1])
    told = ", ".join(f"{LAWS[name]} {words.probability(share)}" for name, share in ranked)
    return f"If the joint wears, its wear is: {told}."


def fallen(wear: Summary) -> str | None:
    """That the gap fell between two dates, which no wear explains."""
    from bayesbl.measurement.wear import FALSE_ALARM

    fall = wear.get("fall")  # results of earlier versions have none
    if fall is None or not fall["is_fall"]:
        return None
    return (
        f"{fall['snapshot']} lies {words.significant(1e3 * fall['fall_rad'])} mrad below the "
        f"snapshot before it ({fall['standard_deviations']:.1f} standard deviations; a test that "
        f"errs in {100.0 * FALSE_ALARM:g} % of cases), and wear does not heal: the joint was "
        "repaired (repaired = true) or a recording is off. Do not rely on the rate or any date."
    )


def notes(wear: Summary) -> Iterator[str]:
    """The model, what so few snapshots cannot show, and what drift was allowed for."""
    from bayesbl.measurement.wear import FEWEST_FOR_SCATTER

    yield MODEL
    count = len(wear["snapshots"])
    if count == 2:
        yield (
            "Two snapshots cannot show whether wear is steady: the date is as uncertain as what "
            "is believed of wear before measuring. Take a third."
        )
    elif count < FEWEST_FOR_SCATTER:
        yield (
            f"Fewer than {FEWEST_FOR_SCATTER} snapshots since the repair cannot tell irregular "
            "wear from measurement errors: the date allows for as much as is believed before "
            "measuring."
        )
    if wear["drift_widens"] is not None:
        yield (
            f"Temperature, grease and the like may move the gap by "
            f"{100.0 * wear['relative_sd_per_date']:g} % from date to date (relative_sd_per_date): "
            f"that makes the rate {wear['drift_widens']:.1f} times as uncertain."
        )


def _table(wear: Summary) -> Table:
    rate, scatter = wear["rate"], wear["scatter_rad_per_root_year"]
    rows = [
        _row(f"mean rate since {wear['first_date']}", rate, 1e3, "mrad/year"),
        _row("rate at the last recording", wear["rate_now"], 1e3, "mrad/year"),
    ]
    if scatter is not None:
        rows.append(_row("irregular wear", scatter, 1e3, "mrad/√year"))
    if wear["years_to_limit"] is not None and not has_passed(wear, "high"):
        rows.append(_row("from last recording to limit", wear["years_to_limit"], 1.0, "years"))
    if wear["date_of_limit"] is not None:
        rows.append(("date of the limit", *limit_dates(wear, day), ""))
    kind = words.short_kind(rate)
    return table((text("Wear"), numbers("Median"), numbers(kind), text("Unit")), rows)


def _row(name: str, found: Interval, scale: float, unit: str) -> tuple[str, ...]:
    low, middle, high = (_cell(scale * found[key]) for key in ("low", "median", "high"))
    return name, middle, f"{low} to {high}", unit


def has_passed(wear: Summary, end: str) -> bool:
    """Whether the limit lies before the last recording, by this end of the interval."""
    return bool(wear["years_to_limit"][end] == 0.0)


def limit_dates(wear: Summary, shown: Callable[[str | None], str]) -> tuple[str, str]:
    """When the limit is reached, and between which dates; a past date is given only as past."""
    dates = wear["date_of_limit"]
    low, middle, high = (
        f"before {wear['last_date']}" if has_passed(wear, end) else shown(dates[end])
        for end in ("low", "median", "high")
    )
    return middle, low if low == high else f"{low} to {high}"


def _cell(value: float) -> str:
    from bayesbl.measurement.wear import LONGEST_YEARS

    if value >= LONGEST_YEARS:
        return f"> {LONGEST_YEARS:g}"
    return words.significant(value) if value < 100.0 else f"{value:.0f}"


def day(value: str | None) -> str:
    """An ISO date, or that it is too far ahead to be given."""
    return "far ahead" if value is None else value
