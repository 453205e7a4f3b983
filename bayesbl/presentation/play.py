"""What comes with a gap that is measured directly: by torque ramps, or by two encoders."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from bayesbl.presentation import words
from bayesbl.presentation.blocks import Block, Sentence, Table, numbers, table, text
from bayesbl.units import number, quantity_and_unit

if TYPE_CHECKING:
    from bayesbl.measurement.summary_types import MeasuredSummary, RouteSummary, SnapshotSummary
    from bayesbl.results.intervals import Interval


RELATIVE_EXPLAINED = (
    "Relative compliance: between the positions that ramps leave at zero torque, over that of "
    "larger ramps. A joint with play is above 1, as it crosses the play at nearly no torque; a "
    "preloaded one is below, as both flanks carry it there."
)


def is_by_ramps(summary: MeasuredSummary) -> bool:
    """Whether the answer comes from torque ramps."""
    first = summary["snapshots"][0] if summary["kind"] == "compare" else summary
    return "ramps" in first


def no_play_by_ramps(part: SnapshotSummary) -> str | None:
    """The answer of a preloaded joint; ``None`` with play."""
    if not part.get("preloaded") or part["delta_rad"] is None:
        return None
    lifts = part["preload_torque_nm"]
    up_to = (
        "the preload is unknown"
        if lifts is None
        else f"both flanks carry it up to {words.significant(lifts['median'])} N m "
        f"({words.interval_kind(lifts)} {words.bounds(lifts)})"
    )
    most = words.significant(1e3 * part["delta_rad"]["high"])
    return (
        f"These ramps show no play: the joint is stiffer around zero torque than beyond; {up_to}. "
        f"A gap δ that this hides is below {most} mrad."
    )


def gap_table(parts: Sequence[tuple[str, SnapshotSummary]], places: int) -> Table:
    """A row per snapshot, named in a comparison: the gap, what the route measures, the outcome.

    ``places``: decimals of the gap in mrad.
    """
    cells = _encoder_cells
    titles = ["Play 2δ\n(mrad)", "Lost motion\n(mrad)", "Skew\n(ms)", "Gear\nratio"]
    if "ramps" in parts[0][1]:
        cells, at = _ramp_cells, words.significant(parts[0][1]["lost_motion_torque_nm"])
        titles = [f"Lost motion\n±{at} N m\n(mrad)", "Compliance\n(mrad/N m)", "Friction\n(N m)"]
    named = [text("Snapshot")] if any(name for name, _ in parts) else []
    kind = words.short_kind(parts[0][1]["lost_motion_rad"])
    columns = (
        *named,
        *map(numbers, ("Gap δ\n(mrad)", f"{kind}\n(mrad)", *titles)),
        text("Outcome"),
    )
    rows = ([*([name] if named else []), *cells(part, places)] for name, part in parts)
    return table(columns, rows)


def _ramp_cells(part: SnapshotSummary, places: int) -> Iterator[str]:
    yield from words.gap_cells(part["delta_rad"], places, part["delta_upper_bound_rad"])
    yield _median(part["lost_motion_rad"], 1e3)
    yield _median(part["compliance_rad_per_nm"], 1e3)
    yield _median(part["friction_torque_nm"])
    yield "no play" if part.get("preloaded") else part["diagnostics"]["outcome"]


def of_positions(parts: Sequence[tuple[str, SnapshotSummary]]) -> Iterator[str]:
    """A sentence for each snapshot on the widths that its positions around the turn have."""
    for name, part in parts:
        if part["delta_rad"] is None:
            continue
        found = part["ramps"]
        each = ", ".join(words.significant(500.0 * w, 3) for w in found["width_rad"])
        where = "1 position" if found["positions"] == 1 else f"{found['positions']} positions"
        yield (
            f"Half the width at zero torque{words.of(name)}, at {where} around the turn: {each} "
            f"mrad ({found['cycles']} cycles of ±{found['torque_nm']:.3g} N m)."
        )
    for name, part in parts:
        held = part["held_windup_rad"]["median"]
        if held > 0.0 and not part["preloaded"] and part["delta_rad"] is not None:
            yield (
                f"Of the gap{words.of(name)}, about {words.significant(1e3 * held)} mrad may be "
                "compliance that friction holds at zero torque, more if the flanks are softer at "
                "small torque."
            )


def ramp_blocks(part: RouteSummary) -> Iterator[Block]:
    """Every quantity with its interval, and what says whether there is play."""
    first = part["friction_torque_nm"]
    yield _quantities(part)
    relative = part["relative_compliance"]
    shown = "not known, without larger ramps" if relative is None else words.significant(relative)
    sure = words.probability(part["probability_of_play"])
    yield Sentence(f"{shown}; probability that it is above 1: {sure}", label="Relative compliance")
    yield Sentence(RELATIVE_EXPLAINED, "aside")
    stated = part["lost_motion_torque_nm"]
    if stated < first["median"]:
        yield Sentence(
            f"Lost motion is stated at ±{words.significant(stated)} N m, less than the friction: "
            "the middles of the loop there say little about the joint.",
            "aside",
        )
    yield Sentence(words.sampling(part), label="Sampling")


def _quantities(part: RouteSummary, angles: Sequence[tuple[str, Interval]] = ()) -> Table:
    """All parameters by the quantity and unit in their names, and further angles by a name."""
    found = [(*quantity_and_unit(name), each) for name, each in part["parameters"].items()]
    found += [(name, "rad", each) for name, each in angles]
    rows = []
    for name, unit, each in found:
        scale, milli = (1e3, "m") if unit.startswith(("rad", "s")) else (1.0, "")
        middle = words.significant(scale * each["median"], 4)
        rows.append((name, middle, words.bounds(each, scale), f"{milli}{unit}"))
    kind = words.short_kind(part["lost_motion_rad"])
    return table((text("Quantity"), numbers("Median"), numbers(kind), text("Unit")), rows)


def _median(found: Interval, scale: float = 1.0) -> str:
    return words.significant(scale * found["median"], 3)


def is_by_two_encoders(summary: MeasuredSummary) -> bool:
    """Whether the answer comes from the encoders of motor and load."""
    first = summary["snapshots"][0] if summary["kind"] == "compare" else summary
    return first["route"] == "two_encoders"


def _encoder_cells(part: SnapshotSummary, places: int) -> Iterator[str]:
    play = part["play_rad"]
    yield from words.gap_cells(part["delta_rad"], places, part["delta_upper_bound_rad"])
    yield "withheld" if play is None else words.significant(1e3 * play["median"], 3)
    yield words.significant(1e3 * part["lost_motion_rad"]["median"], 3)
    yield words.bounds(part["channel_skew_s"], 1e3)
    ratio = part["gear_ratio"]
    yield number(ratio["median"], words.decimals(ratio))
    bounded = part["delta_upper_bound_rad"] is not None
    yield "no play found" if bounded else part["diagnostics"]["outcome"]


def encoder_blocks(part: RouteSummary) -> Iterator[Block]:
    """Every quantity with its interval."""
    orders = part["transmission_error"]["harmonics"]
    told = [(f"order {e['order']} per turn of the {e['of']}", e["amplitude_rad"]) for e in orders]
    yield _quantities(part, told)
    yield Sentence(words.probability(part["probability_of_play"]), label="Probability of play")
    yield Sentence(f"{part['reversals']}", label="Reversals of the motor")


def encoder_assumptions(summary: MeasuredSummary) -> Iterator[str]:
    """What the answer rests on."""
    yield (
        "Friction drags the load through the play, or it moves through by itself; its weight does "
        "not hold it on one flank in both directions."
    )
    yield "Both encoders turn with their shafts: a loose ring or coupling is play as well."
    yield "Transmission error is a curve of the angles alone, the same in both directions."
    if summary["kind"] == "compare":
        yield "Nothing but the gap changed between the snapshots: same joint and same load."
