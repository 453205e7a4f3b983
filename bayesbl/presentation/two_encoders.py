"""What comes with a gap from two encoders: play, lost motion, wind-up, ratio, skew, error."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from bayesbl.presentation import words
from bayesbl.presentation.blocks import Block, Sentence, Table, numbers, table, text

if TYPE_CHECKING:
    from bayesbl.measurement.summary_types import MeasuredSummary, RouteSummary, SnapshotSummary

CONDITION = "the load goes from flank to flank in the recording"


def is_by_two_encoders(summary: MeasuredSummary) -> bool:
    """Whether the answer comes from the encoders of motor and load."""
    first = summary["snapshots"][0] if summary["kind"] == "compare" else summary
    return first["route"] == "two_encoders"


def no_play(part: RouteSummary) -> str | None:
    """The answer where play is not told from none."""
    upper = part["delta_upper_bound_rad"]
    if "transmission_error" not in part or upper is None:
        return None
    return (
        f"Play is not told from none: the gap δ is below "
        f"{words.significant(1e3 * upper)} mrad with 95 % probability."
    )


def snapshot_table(parts: Sequence[tuple[str, SnapshotSummary]], places: int) -> Table:
    """A row per snapshot; ``places``: decimals of the gap in mrad."""
    kind = words.short_kind(parts[0][1]["lost_motion_rad"])
    named = any(name for name, _ in parts)
    columns = (
        *([text("Snapshot")] if named else []),
        numbers("Gap δ\n(mrad)"),
        numbers(f"{kind}\n(mrad)"),
        numbers("Play 2δ\n(mrad)"),
        numbers("Lost motion\n(mrad)"),
        numbers("Skew\n(ms)"),
        numbers("Gear\nratio"),
        text("Outcome"),
    )
    rows = [[*([name] if named else []), *_cells(part, places)] for name, part in parts]
    return table(columns, rows)


def _cells(part: SnapshotSummary, places: int) -> Iterator[str]:
    play = part["play_rad"]
    yield from words.gap_cells(part["delta_rad"], places)
    yield "withheld" if play is None else words.significant(1e3 * play["median"], 3)
    yield words.significant(1e3 * part["lost_motion_rad"]["median"], 3)
    yield words.significant(1e3 * part["channel_skew_s"]["median"], 2)
    yield words.significant(part["gear_ratio"]["median"], 5)
    yield "no play told" if no_play(part) else part["diagnostics"]["outcome"]


def blocks(part: RouteSummary) -> Iterator[Block]:
    """Every quantity with its interval."""
    labels = {
        "play_rad": ("whole play", 1e3, "mrad"),
        "lost_motion_rad": ("lost motion", 1e3, "mrad"),
        "held_windup_rad": ("wind-up in the lost motion", 1e3, "mrad"),
        "windup_rad_per_nm": ("wind-up (compliance)", 1e3, "mrad/N m"),
        "gear_ratio": ("gear ratio", 1.0, "1"),
        "channel_skew_s": ("load's stamps late by", 1e3, "ms"),
        "transmission_error_rad": ("transmission error, peak to peak", 1e3, "mrad"),
    }
    found = [
        (label, part["parameters"][name], scale, unit)
        for name, (label, scale, unit) in labels.items()
        if name in part["parameters"]
    ]
    found += [
        (f"its order {entry['order']} per turn of the {entry['of']}", entry["amplitude_rad"], 1e3,
         "mrad")
        for entry in part["transmission_error"]["harmonics"]
    ]  # fmt: skip
    kind = words.short_kind(part["lost_motion_rad"])
    columns = (text("Quantity"), numbers("Median"), numbers(kind), text("Unit"))
    rows = [
        (label, words.significant(scale * each["median"], 4), words.bounds(each, scale), unit)
        for label, each, scale, unit in found
    ]
    yield table(columns, rows)
    yield Sentence(words.probability(part["probability_of_play"]), label="Probability of play")
    yield Sentence(f"{part['reversals']}", label="Reversals of the motor")


def assumptions(summary: MeasuredSummary) -> Iterator[str]:
    """What the answer rests on."""
    yield (
        "The load is dragged through the play by its friction, or goes through it by itself; its "
        "weight does not hold it on one flank in both directions."
    )
    yield "Both encoders turn with their shafts: a loose ring or coupling is play as well."
    yield "Transmission error is a curve of the angles alone, the same in both directions."
    if summary["kind"] == "compare":
        yield "Nothing but the gap changed between the snapshots: same joint and same load."
