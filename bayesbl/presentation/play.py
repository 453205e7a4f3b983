"""What comes with a gap that is measured directly: by torque ramps, or by two encoders."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

from bayesbl.presentation import words

if TYPE_CHECKING:
    from bayesbl.measurement.summary_types import SnapshotSummary
    from bayesbl.results.intervals import Interval


def no_play_by_ramps(part: SnapshotSummary) -> str | None:
    """The answer of a preloaded joint; ``None`` with play."""
    if not part.get("preloaded") or part["delta_rad"] is None:
        return None
    lifts = part["preload_torque_nm"]
    up_to = "the preload is unknown"
    if lifts is not None:
        up_to = f"both flanks carry the torque up to {words.with_bounds(lifts, 'N m')}"
    most = words.significant(1e3 * part["delta_rad"]["high"])
    return (
        "These ramps show no play: the joint is stiffer around zero torque than at larger torque; "
        f"{up_to}. "
        f"Any gap δ that this hides is below {most} mrad."
    )


def columns(part: SnapshotSummary) -> dict[str, Callable[[SnapshotSummary], str]]:
    """What a route that measures the play shows of a snapshot beside δ, by title of its column."""
    if "ramps" in part:
        at = words.significant(part["lost_motion_torque_nm"])
        return {
            f"Lost motion\n±{at} N m\n(mrad)": lambda p: _median(p["lost_motion_rad"], 1e3),
            "Compliance\n(mrad/N m)": lambda p: _median(p["compliance_rad_per_nm"], 1e3),
            "Friction\n(N m)": lambda p: _median(p["friction_torque_nm"]),
        }
    if "reversals" in part:
        return {
            "Play 2δ\n(mrad)": lambda p: _median(p["play_rad"], 1e3),
            "Lost motion\n(mrad)": lambda p: _median(p["lost_motion_rad"], 1e3),
            "Skew\n(ms)": lambda p: words.bounds(p["channel_skew_s"], 1e3),
            "Gear\nratio": lambda p: words.middle(p["gear_ratio"]),
        }
    return {}


def outcome(part: SnapshotSummary) -> str:
    """Whether there is play, where that is not sure; else how the measurement ended."""
    if part.get("preloaded"):
        return "no play"
    if "reversals" in part and part["delta_upper_bound_rad"] is not None:
        return "play likely" if part["probability_of_play"] > 0.5 else "no play found"
    return part["diagnostics"]["outcome"]


def of_positions(parts: Sequence[tuple[str, SnapshotSummary]]) -> Iterator[str]:
    """A sentence for each snapshot on the widths that its positions around the turn have."""
    for name, part in parts:
        if part["delta_rad"] is None:
            continue
        ramps = part["ramps"]
        each = ", ".join(words.significant(500.0 * w, 3) for w in ramps["width_rad"])
        where = "1 position" if ramps["positions"] == 1 else f"{ramps['positions']} positions"
        yield (
            f"Half the width at zero torque{words.of(name)}, at {where} around the turn: {each} "
            f"mrad ({ramps['cycles']} cycles of ±{ramps['torque_nm']:.3g} N m)."
        )
    for name, part in parts:
        held = part["held_windup_rad"]["median"]
        if held > 0.0 and not part["preloaded"] and part["delta_rad"] is not None:
            yield (
                f"About {words.significant(1e3 * held)} mrad of half the width{words.of(name)} may "
                "be wind-up that friction holds at zero torque, or more if the flanks are softer "
                "at small torque. It was subtracted from the gap as an unknown share."
            )


def _median(interval: Interval | None, scale: float = 1.0) -> str:
    return "withheld" if interval is None else words.significant(scale * interval["median"], 3)


RAMPS_ASSUME = (
    "The output was held and did not give way; position and torque are those of the output.",
    "The ramps are slow: friction and inertia do not depend on how fast the joint moves.",
    "The measured positions represent the whole turn.",
    "Play is the width of the loop at zero torque. If the joint is soft, part of this width is "
    "wind-up held by friction.",
)

ENCODERS_ASSUME = (
    "Friction drags the load through the play, or the load crosses it by itself; the load's weight "
    "does not hold it on one flank in both directions.",
    "Both encoders turn with their shafts and read without hysteresis: a loose ring or coupling "
    "looks like play, and so does hysteresis.",
    "Transmission error depends only on the angles and is the same in both directions.",
)
