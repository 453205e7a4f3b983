"""What a change of the gap means: other possible causes, and how fast the joint wears."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import date
from typing import TYPE_CHECKING, Literal

from bayesbl.presentation import words
from bayesbl.presentation.blocks import Block, Sentence, Table, aside, table
from bayesbl.presentation.words import capitalised
from bayesbl.sentences import UNSEEN_WITHOUT_CURRENT
from bayesbl.units import number

if TYPE_CHECKING:
    from bayesbl.measurement.summary_types import ComparisonSummary, MeasuredSummary, WearSummary


MOST_TOLD = 3  # largest number of blind spots printed; all are stored


def other_cause(summary: ComparisonSummary) -> str | None:
    """An undetectable change of the joint that could explain the whole change of δ.

    ``None`` if the change of δ is withheld, may be zero, or is larger than any such change.
    """
    spots = summary["same_joint"]["blind_spots"]
    ends = _change_ends_rad(summary) if spots else None
    if ends is None:
        return None
    worst = max(spots, key=lambda spot: spot["delta_error_rad"] or 0.0)
    nearest = max(ends[0], -ends[1])
    return worst["text"] if 0.0 < nearest <= (worst["delta_error_rad"] or 0.0) else None


def unless(summary: ComparisonSummary) -> str:
    """The condition on a probability of growth, if something else may have changed."""
    if other_cause(summary) is not None:
        return ", if nothing else in the joint changed"
    if (unseen := unseen_without_current(summary)) is not None:
        return f", if {unseen} did not change"
    # By any size, and no ramp tells it from play.
    if "ramps" in summary["snapshots"][0]:
        return ", if no flank became softer at small torque"
    held = max(part["budget"].get("held_windup", 0.0) for part in summary["snapshots"])
    return ", if the load's friction did not change" if held > 0.5 else ""


def unseen_without_current(summary: ComparisonSummary) -> str | None:
    """What may have changed undetected without a motor current; otherwise ``None``."""
    spots = summary["same_joint"]["blind_spots"]
    unseen = any(spot["code"] == "gains_unseen" for spot in spots)
    return UNSEEN_WITHOUT_CURRENT if unseen else None


def _change_ends_rad(summary: ComparisonSummary) -> tuple[float, float] | None:
    """Ends of the interval of the change of δ; since a repair, the change of the medians."""
    wear, parts = summary["wear"], summary["snapshots"]
    if wear is not None and spans_repair(summary, wear):
        gaps = {part["name"]: part["delta_rad"] for part in parts}
        first, last = (gaps[wear["snapshots"][end]] for end in (0, -1))
        if first is None or last is None:
            return None
        return (last["median"] - first["median"],) * 2
    change = summary["change_rad"]
    return None if change is None else (change["low"], change["high"])


def check_blocks(summary: MeasuredSummary, codes: Sequence[str]) -> Iterator[Block]:
    """A warning for every finding, then the changes that no check can detect.

    ``codes``: why the answer is withheld, which may repeat a finding.
    """
    if summary["kind"] == "compare":
        checks = [(snapshot["name"], snapshot["model_check"]) for snapshot in summary["snapshots"]]
        checks.append(("", summary["same_joint"]))
    else:
        checks = [("", summary["model_check"])]
    for name, check in checks:
        # What the change is withheld for has been said.
        for finding in () if "joint_changed" in codes and not name else check["findings"]:
            text = finding["text"]
            yield Sentence(f"{name}: {text}" if name else text, "warning", "Check")
    unsized = "Undetectable changes"
    sized = f"{unsized} that could look like wear (too small for these recordings to show)"
    unseen: dict[str, list[str]] = {sized: [], unsized: []}
    for spot in checks[-1][1]["blind_spots"]:
        up_to = spot["delta_error_rad"]
        if up_to is None:
            unseen[unsized].append(spot["text"])
        else:
            unseen[sized].append(f"{spot['text']}, up to {number(1e3 * up_to, 3)} mrad")
    for label, listed in unseen.items():
        if len(listed) > MOST_TOLD:
            listed[MOST_TOLD:] = [f"{len(listed) - MOST_TOLD} more in summary.json"]
        if listed:
            yield Sentence(capitalised(f"{'; '.join(listed)}."), "aside", label)


MODEL = (
    "Rate and date are averages over laws of wear, weighted by how well each fits, over how "
    "irregular wear may be, and over changes of wear that may still come. Wear cannot shrink a "
    "gap: draws in which it shrinks are left out of both, so neither is evidence of wear."
)

LAWS = {"slowing": "slowing down", "steady": "steady", "speeding_up": "speeding up"}
"""The laws of :data:`bayesbl.measurement.wear.KINDS` in words."""

_ENDS: tuple[Literal["low", "median", "high"], ...] = ("low", "median", "high")


def blocks(
    summary: ComparisonSummary, wear: WearSummary, *, is_told: bool = False
) -> Iterator[Block]:
    """Sentences and table of wear. ``is_told``: why there is no rate was printed before."""
    if spans_repair(summary, wear):
        yield Sentence(
            f'The joint was repaired before "{wear["snapshots"][0]}": the change from first to '
            "last spans the repair, and only the snapshots since then show how the joint wears."
        )
    if wear["reason"] is not None:
        if not is_told:
            yield Sentence(wear["reason"]["text"], "warning", "No rate of wear")
        return
    yield from map(Sentence, sentences(wear, unless=unless(summary)))
    yield _table(wear)
    yield from map(aside, notes(wear))


def with_rate(summary: ComparisonSummary) -> WearSummary | None:
    """The wear, if a summary has a rate."""
    wear = summary["wear"]
    return None if wear is None or wear["reason"] is not None else wear


def spans_repair(summary: ComparisonSummary, wear: WearSummary) -> bool:
    """Whether there was a repair between the first and the last snapshot."""
    return len(wear["snapshots"]) < len(summary["snapshots"])


def headline(summary: ComparisonSummary, wear: WearSummary) -> str:
    """How large the gap is now, and how fast it grows."""
    last = summary["snapshots"][-1]
    gap, upper_rad = last["delta_rad"], last["delta_upper_bound_rad"]
    size, _ = words.gap_cells(gap, upper_rad)
    now = "" if gap is None and upper_rad is None else f"is {size} mrad now and "
    if wear["probability_wear"] < words.SURE:
        return (
            f"The gap {now}is not shown to have grown since {wear['first_date']} (probability "
            f"{words.probability(wear['probability_wear'])})."
        )
    rate = wear["rate"]
    by = (
        f"by {words.middle(rate, 1e3)} mrad a year since {wear['first_date']} "
        f"({words.interval_kind(rate)} {words.bounds(rate, 1e3)})"
    )
    if (cause := other_cause(summary)) is not None:
        return (
            f"The gap {now}is not shown to have grown: it grew {by} if nothing else in the joint "
            f"changed, but a change of {cause} could explain as much."
        )
    return f"The gap {now}has grown {by}."


def month(value: str | None) -> str:
    """``Nov 2026`` for an ISO date: a forecast is never known to the day."""
    return day(value) if value is None else date.fromisoformat(value).strftime("%b %Y")


def sentences(wear: WearSummary, *, unless: str = "") -> Iterator[str]:
    """How fast the joint wears, until when, and whether before the date asked for.

    ``unless``: condition on the growth, if it may have another cause.
    """
    from bayesbl.measurement.wear import LONGEST_YEARS

    share = words.probability(wear["level"])
    rate = 1e3 * wear["rate_at_most_rad_per_year"]
    yield (
        f"Probability that the gap has grown since {wear['first_date']}: "
        f"{words.probability(wear['probability_wear'])}{unless}. With {share} probability it grew "
        f"by at most {words.significant(rate)} mrad a year."
    )
    ranked = sorted(wear["law"].items(), key=lambda item: -item[1])
    first, second, third = (f"{LAWS[name]} ({words.probability(p)})" for name, p in ranked)
    yield f"If the joint wears, its wear is now {first}, {second} or {third}."
    years = wear["years_to_limit"]
    if years is None or wear["limit_rad"] is None:
        return
    limit = f"the limit of {words.limit(wear['limit_rad'], wear['limit'])}"
    earliest = not_before(wear)
    if years["high"] == 0.0:
        yield f"The gap passed {limit} before {wear['last_date']}."
    elif earliest == wear["last_date"]:
        yield (
            f"The gap may have passed {limit} before {wear['last_date']}: the probability that it "
            f"had not is below {share}."
        )
    else:
        when = f"within {LONGEST_YEARS:g} years" if earliest is None else f"before {earliest}"
        dates = wear["date_of_limit"]
        middle = None if dates is None or earliest is None else dates["median"]
        about = "" if middle is None else f"; the median date is {middle}"
        yield f"With {share} probability the gap does not reach {limit} {when}{about}."
    asked = wear["probability_before"]
    if asked is not None:
        yield (
            f"Probability that it passes {limit} by {asked['date']}: "
            f"{words.probability(asked['probability'])}."
        )


def not_before(wear: WearSummary) -> str | None:
    """The date to plan by; ``None`` if it is too far ahead, or without a limit."""
    bound = wear["not_before"]
    return None if bound is None else bound["date"]


def notes(wear: WearSummary) -> Iterator[str]:
    """The model, what few snapshots cannot show, and the drift that is allowed for."""
    from bayesbl.measurement.wear import FEWEST_FOR_SCATTER

    yield MODEL
    count = len(wear["snapshots"])
    if count == 2:
        yield (
            "Two snapshots cannot show whether wear is steady: the date depends on assumptions "
            "about wear in general. Take a third."
        )
    elif count < FEWEST_FOR_SCATTER:
        yield (
            f"Fewer than {FEWEST_FOR_SCATTER} snapshots since the repair cannot distinguish "
            "irregular wear from measurement error: the date allows for as much irregular wear as "
            "is assumed in general."
        )
    if (prior := wear["forecast_from_prior"]) is not None:
        yield (
            "Future wear is mostly assumed: with these recordings, the interval of the time to the "
            f"limit is {prior['width_over_prior']:.2f} times as wide as without them (on a "
            f"logarithmic scale), and in {words.probability(prior['probability_change_ahead'])} of "
            "forecasts the wear changes before the limit is reached."
        )
    if wear["drift_widens"] is not None:
        yield (
            f"Temperature, grease and the like may move the gap by "
            f"{100.0 * wear['relative_sd_per_date']:g} % from date to date (relative_sd_per_date). "
            f"This makes the rate {wear['drift_widens']:.1f} times as uncertain."
        )


def _table(wear: WearSummary) -> Table:
    from bayesbl.measurement.wear import LONGEST_YEARS

    def shown(value: float) -> str:
        if value >= LONGEST_YEARS:
            return f"> {LONGEST_YEARS:g}"
        return words.significant(value) if value < 100.0 else f"{value:.0f}"

    years = wear["years_to_limit"]
    ahead = None if years is None or years["high"] == 0.0 else years
    rows = []
    for name, interval, scale, unit in (
        (f"mean rate since {wear['first_date']}", wear["rate"], 1e3, "mrad/year"),
        ("rate at the last recording", wear["rate_now"], 1e3, "mrad/year"),
        ("irregular wear", wear["scatter_rad_per_root_year"], 1e3, "mrad/√year"),
        ("from last recording to limit", ahead, 1.0, "years"),
    ):
        if interval is not None:
            low, middle, high = (shown(scale * interval[end]) for end in _ENDS)
            rows.append((name, middle, f"{low} to {high}", unit))
    if years is not None and (dates := wear["date_of_limit"]) is not None:
        low, middle, high = (  # a past date is given only as past
            f"before {wear['last_date']}" if years[end] == 0.0 else day(dates[end]) for end in _ENDS
        )
        rows.append(("date of the limit", middle, low if low == high else f"{low} to {high}", ""))
    return table(("Wear", "#Median", f"#{words.interval_kind(wear['rate'])}", "Unit"), rows)


def day(value: str | None) -> str:
    """An ISO date, or that it is too far ahead."""
    return "far ahead" if value is None else value
