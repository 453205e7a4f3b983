"""A plan in words: which motion to record, and which would show nothing."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from bayesbl.presentation.blocks import Block, Sentence, Table, numbers, table
from bayesbl.presentation.words import percent
from bayesbl.units import number

if TYPE_CHECKING:
    from bayesbl.runs.plan import PlannedEntry, PlanSummary

MOST_ROWS = 12

EXPLAINED = (
    "Load angles: 0 hangs straight down. Expected standard deviation of δ, as a share of it, from "
    "one recording with the noise and the tolerances of the bench file."
)


def headline(summary: PlanSummary) -> str:
    """The best motion."""
    if summary["reason"]:
        return "No motion within these limits shows the gap."
    best, *_ = summary["plan"]["motions"]
    return f"Record {in_words(best)}: δ to {_sd(best)}."


def in_words(motion: PlannedEntry) -> str:
    """``strokes from −30° to 30°, up to 1500 rpm at 6000 rpm/s, for 20 s``."""
    low, high = (number(math.degrees(angle), 0) for angle in motion["range_rad"])
    return (
        f"strokes of the load from {low}° to {high}°, up to {motion['speed_rpm']:g} rpm of the "
        f"motor at {motion['acceleration_rpm_per_s']:g} rpm/s, for {motion['duration_s']:g} s"
    )


def blocks(summary: PlanSummary) -> Iterator[Block]:
    """The best motions in a table, and how many show nothing."""
    plan = summary["plan"]
    shown = [m for m in plan["motions"] if m["expected_relative_sd"] is not None]
    if summary["reason"]:
        yield Sentence(summary["reason"], "warning", "Withheld")
    if shown:
        yield _table(shown[:MOST_ROWS])
        yield Sentence(EXPLAINED, "aside")
    blind = len(plan["motions"]) - len(shown)
    if blind and shown:
        yield Sentence(
            f"{blind} of {len(plan['motions'])} motions would show nothing: in them the load "
            "never, or only just, passes from one tooth flank to the other.",
            "aside",
        )
    yield Sentence(f"Reckoned for δ about {1e3 * plan['gap_rad']:g} mrad.", "aside")


def _table(motions: list[PlannedEntry]) -> Table:
    titles = (
        "From\n(°)",
        "To\n(°)",
        "Speed\n(rpm)",
        "Acceleration\n(rpm/s)",
        "Flank\nchanges",
        "Expected sd\nof δ",
    )
    rows = [
        (
            *(number(math.degrees(angle), 1) for angle in motion["range_rad"]),
            f"{motion['speed_rpm']:g}",
            f"{motion['acceleration_rpm_per_s']:g}",
            motion["flank_changes"],
            _sd(motion),
        )
        for motion in motions
    ]
    return table(map(numbers, titles), rows)


def _sd(motion: PlannedEntry) -> str:
    sd = motion["expected_relative_sd"]
    return "–" if sd is None else percent(sd)
