"""What torque ramps show or do not, in sentences for the result."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from bayesbl.measurement.held_compliance import HELD
from bayesbl.ramps.flanks import Flanks
from bayesbl.ramps.torque_cycles import Ramps
from bayesbl.recording.types import FloatArray

GOOD_PART = 0.5
"""Of the gap that soft flanks may make up, from which a reader is told."""

UNSURE = 0.05
"""Probability of play, and of none, from which both are told."""


def against(flanks: Flanks) -> str | None:
    """Why δ is withheld; ``None`` where it is not."""
    level = flanks.level
    if flanks.answered or level is None:
        return None
    if flanks.skipped_nm:
        held = ", ".join(f"±{torque:.3g}" for torque in flanks.skipped_nm)
        return (
            f"The ramps of {held} N m hardly move the joint, and those of "
            f"±{level.amplitude_nm:.3g} N m bend the joint so far that its play is a small part "
            f"of what they leave. Add ramps to about {flanks.needed_nm:.2g} N m, twice the "
            "friction."
        )
    return (
        f"The ramps of ±{level.amplitude_nm:.3g} N m alone do not show the play: most of what they "
        "move goes back with the torque, as in a joint that friction or a preload holds, or one "
        f"that is bent far. Add ramps of another size: to at least {flanks.needed_nm:.2g} N m, or, "
        "if these are far beyond the friction already, small ones to about "
        f"{2.0 * level.friction_nm:.2g} N m."
    )


def notes_on(
    files: Sequence[Ramps],
    flanks: Flanks,
    draws: Mapping[str, FloatArray],
    *,
    ratio_given: bool,
    elsewhere: bool,
) -> Iterator[str]:
    """What a reader should know of how δ came about.

    ``draws``: of ``width_rad`` and ``preload_torque_nm``. ``elsewhere``: one file a snapshot, and
    not at the same position of the turn.
    """
    yield from _on_flanks(flanks, draws)
    yield from _on_torque(files, ratio_given=ratio_given)
    yield from _on_positions(files, flanks, elsewhere=elsewhere)


def _on_flanks(flanks: Flanks, draws: Mapping[str, FloatArray]) -> Iterator[str]:
    """Whether they play, carry a preload or are soft, and which ramps told it."""
    level = flanks.level
    assert level is not None
    if flanks.finding == "preloaded":
        width = 1e3 * float(np.median(draws["width_rad"]))
        lifts = float(np.median(draws["preload_torque_nm"]))
        seen = (
            "At no torque is a flank seen to lift, so the preload is not known."
            if np.isnan(lifts)
            else f"Both flanks carry it up to about {lifts:.2g} N m, where one lifts."
        )
        yield (
            "No play is seen: around zero torque the joint is stiffer than beyond (its compliance "
            f"is {flanks.relative_compliance:.2g} of that), as one is that is preloaded. {seen} "
            f"The {width:.2g} mrad that ramps leave between the flanks are compliance held by "
            "friction; δ is at most half of them."
        )
    if UNSURE < flanks.probability_of_play < 1.0 - UNSURE:
        yield (
            "Whether there is play is not certain (probability "
            f"{100.0 * flanks.probability_of_play:.0f} %): around zero torque the joint is "
            f"{flanks.relative_compliance:.2g} times as soft as beyond, but not alike at all "
            "positions. δ includes that there may be none."
        )
    soft = HELD / flanks.relative_compliance
    if flanks.finding == "play" and soft > GOOD_PART:
        part = (
            "all of δ, without any play"
            if soft > 1.0
            else f"{100.0 * soft:.0f} % of δ, and more if softer"
        )
        yield (
            f"Around zero torque the joint is {flanks.relative_compliance:.2g} times as soft as "
            "beyond. Flanks that are soft at small torque, as those of a strain wave gear, look "
            f"like play, and the probability of play does not count them: {HELD:.0f} times as soft "
            f"as beyond, as is common, they make up {part}. That part is lost motion."
        )
    if flanks.skipped_nm and flanks.answered:
        held = ", ".join(f"±{torque:.3g}" for torque in flanks.skipped_nm)
        yield (
            f"The ramps of {held} N m hardly move the joint, as friction holds it; those of "
            f"±{level.amplitude_nm:.3g} N m were used."
        )


def _on_torque(files: Sequence[Ramps], *, ratio_given: bool) -> Iterator[str]:
    """How it counts: from where, in which direction, at which side of the gear."""
    moved = [file.offset_nm for file in files if file.offset_nm]
    if moved:
        low, high = (f"{torque:.2g}" for torque in (min(moved), max(moved)))
        about = low if low == high else f"{low} to {high}"
        yield (
            f"The joint is free about {about} N m, more than friction holds: a load hangs at it, "
            "or the torque has another zero. This was taken off the torque."
        )
    if any(file.turned for file in files):
        yield "The torque counts against the position in the file, and was turned round."
    if not ratio_given:
        yield "No gear_ratio is given: position and torque are taken as those of the output."


def _on_positions(files: Sequence[Ramps], flanks: Flanks, *, elsewhere: bool) -> Iterator[str]:
    """How many of the turn δ is known at, and by how many cycles."""
    level = flanks.level
    assert level is not None
    missing = sum(not file for file in level.files)
    if missing:
        yield (
            f"{missing} of {len(files)} files have no cycle of ±{level.amplitude_nm:.3g} N m, and "
            "do not count for δ."
        )
    if elsewhere:
        yield (
            "One position round the turn in each snapshot, and not the same one: the intervals "
            "allow for a gap that changes round the turn by up to 70 %. Give ramps at three "
            "positions or more (files = […])."
        )
    elif len(files) - missing == 1:
        yield (
            "One position round the turn: δ is the gap there. How it changes round the turn is not "
            "known, nor in the interval; give ramps at three positions or more (files = […])."
        )
        if len(level.cycles) == 1:
            yield (
                "One cycle alone: how much repeated ramps scatter is not known, and the interval "
                "allows for up to 70 % of the gap."
            )
