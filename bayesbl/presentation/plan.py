"""A plan in words: which motion would show the gap best."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from bayesbl.presentation.blocks import Advice, Block, Sentence, aside, table
from bayesbl.presentation.words import percent
from bayesbl.units import number

if TYPE_CHECKING:
    from bayesbl.runs.plan import PlanSummary


MOST_ROWS = 12

EXPLAINED = (
    "Load angles: 0 hangs straight down. The expected standard deviation is relative to δ, for one "
    "recording with the noise and the tolerances of the bench file."
)


def headline(summary: PlanSummary) -> str:
    """The best motion."""
    if summary["reason"]:
        return "No motion within these limits shows the gap."
    best, *_ = summary["plan"]["motions"]
    low, high = (number(math.degrees(angle), 0) for angle in best["range_rad"])
    return (
        f"Record strokes of the load from {low}° to {high}°, up to {best['speed_rpm']:g} rpm of "
        f"the motor at {best['acceleration_rpm_per_s']:g} rpm/s, for {best['duration_s']:g} s. "
        f"Expected standard deviation of δ: {percent(best['expected_relative_sd'] or 0.0)}."
    )


def blocks(summary: PlanSummary) -> Iterator[Block]:
    """The best motions in a table, and how many show nothing."""
    plan = summary["plan"]
    shown = [m for m in plan["motions"] if m["expected_relative_sd"] is not None]
    if summary["reason"]:
        yield Sentence(summary["reason"], "warning", "Withheld")
    if shown:
        titles = ["#From\n(°)", "#To\n(°)", "#Speed\n(rpm)", "#Acceleration\n(rpm/s)"]
        rows = [
            (
                *(number(math.degrees(angle), 1) for angle in motion["range_rad"]),
                f"{motion['speed_rpm']:g}",
                f"{motion['acceleration_rpm_per_s']:g}",
                motion["flank_changes"],
                percent(motion["expected_relative_sd"] or 0.0),
            )
            for motion in shown[:MOST_ROWS]
        ]
        yield table([*titles, "#Flank\nchanges", "#Expected sd\nof δ"], rows)
        yield aside(EXPLAINED)
    blind = len(plan["motions"]) - len(shown)
    if blind and shown:
        yield aside(
            f"{blind} of {len(plan['motions'])} motions would show nothing, because the load "
            "hardly reaches the other tooth flank."
        )
    yield aside(f"Calculated for δ = {1e3 * plan['gap_rad']:g} mrad.")


ASSUMPTIONS = (
    "The joint behaves as its bench file says, within the tolerances given there.",
    "Its noise is that of the bench file, and it starts from rest.",
)


def advice(summary: PlanSummary) -> Advice:
    """What to record."""
    if summary["reason"]:
        return Advice("withheld", "Widen the limits.", (summary["reason"],))
    return Advice(
        "note",
        "Record the first motion of the table.",
        (
            "Record the motor's speed and current, and the commanded speed or position, at about "
            "1 kHz. Then: `bayesbl fit RECORDING --bench FILE`.",
        ),
    )
