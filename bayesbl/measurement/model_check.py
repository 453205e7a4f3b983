"""What a comparison with the bench says of the joint: items, sentences, what is withheld.

From what :mod:`bayesbl.model_search.joint_change` finds to the checks of snapshot and comparison.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesbl.bench.effects import with_bench_file_hint
from bayesbl.bench.parameters import PARAMETER_INFO, declaration_of
from bayesbl.matching.posterior import MATTERS
from bayesbl.measurement.joint_check import (
    BlindSpot,
    CheckItem,
    JointCheck,
    check_item,
    joint_check,
)
from bayesbl.model_search.always_in import CHANGED_TOGETHER
from bayesbl.model_search.joint_change import (
    FRICTION,
    MOTOR_FRICTION,
    ChangedParameter,
    JointFindings,
    Rival,
)
from bayesbl.recording.types import FloatArray
from bayesbl.units import number


def check_of_snapshot(found: JointFindings, recording: str) -> JointCheck:
    """One recording against its bench."""
    own = [c for c in found.changed if c.recording in (None, recording)]
    allowed = [c for c in found.allowed if c.recording in (None, recording)]
    return joint_check(
        found.explained and not own,
        [_item(c) for c in (*own, *allowed)],
        found.could_be if own else (),
    )


def check_of_comparison(
    found: JointFindings, change_rad: FloatArray, level: float, *, is_given: bool
) -> JointCheck:
    """The recordings against one another, with what none of them would show.

    ``change_rad``: draws of the change of δ from the first to the last; ``is_given``: it is not
    withheld.
    """
    between = [] if found.against_bench else found.changed
    sentences = [_sentence(c) for c in between]
    if between:
        sentences[-1] += _others(found, between)
        if is_given:
            sentences[-1] += " The change of δ is given with this allowed for."
    return joint_check(
        found.explained and not between,
        [_item(c) for c in between],
        found.could_be if between else (),
        sentences,
        [
            BlindSpot(
                change=f"{spoken(spot.name)} by {_size(spot.size, spot.expected, spot.unit)}",
                reason="too small for these recordings to show",
                delta_error_rad=spot.error_rad,
            )
            for spot in found.blind_spots
            if spot.error_rad > MATTERS * _width(change_rad, level)
        ],
    )


def against_the_bench(found: JointFindings) -> str | None:
    """Why no gap can be trusted where all recordings contradict the bench."""
    if not found.against_bench:
        return None
    several = len({c.recording for c in found.changed}) > 1
    told = _listed(
        [_as_found(c) + (f" in {c.recording or 'all'}" if several else "") for c in found.changed],
        "and",
    )
    contradiction = (
        f"The recordings contradict the bench: with {told} it would explain them."
        f"{_others(found, found.changed)} Correct the bench file (`bayesbl diagnose` writes one "
        "with what is missing), or give uncertain values a tolerance."
    )
    return with_bench_file_hint(contradiction, (c.name.partition(".")[0] for c in found.changed))


UNEXPLAINED = (
    "Something is off that neither the bench nor any change of it explains, so δ cannot be "
    "trusted. `bayesbl diagnose` looks for what is missing."
)
"""Why δ is withheld where a change was found that leaves something, though little repeats."""


def undecided(
    found: JointFindings,
    draws_rad: FloatArray,
    level: float,
    index: int | None = None,
    *,
    with_current: bool = True,
) -> str | None:
    """Why δ, or its change from first to last, depends on which of several changes is true.

    Parameters
    ----------
    draws_rad
        Of δ of the recording of this ``index``; without one, of its change.
    with_current
        Whether the current was recorded.
    """
    if not found.explained:
        return None
    chosen_rad, width_rad = float(np.median(draws_rad)), _width(draws_rad, level)
    what, apart = "δ" if index is not None else "the change of δ", []
    for rival in found.rivals:
        gaps = rival.gaps_rad
        value = float(gaps[-1] - gaps[0] if index is None else gaps[index])
        if abs(value - chosen_rad) > MATTERS * width_rad:
            apart.append((abs(value - chosen_rad), value, rival))
    if not apart:
        return None
    _, value, rival = max(apart, key=lambda each: each[0])
    chosen = _listed([_where(found, changed) for changed in found.changed], "and")
    other = _where(found, rival)
    differs = "is not as the bench file says" if found.against_bench else "changed in the joint"
    record = "Record a second" if with_current else "Record the motor current too, record a second"
    return (
        f"Something other than the gap {differs}, and the recordings do not show what: "
        f"if it is {chosen}, {what} is {1e3 * chosen_rad:.3g} mrad; if it is "
        f"{other}, {1e3 * value:.3g} mrad. {record} speed, direction or motion, or give "
        "what is known of the recording in [[recordings]] bench."
    )


def _where(found: JointFindings, change: ChangedParameter | Rival) -> str:
    """What changed, and in which of several recordings."""
    own = change.recording if len(found.recordings) > 1 else None
    return spoken(change.name) + (f" in {own}" if own else "")


def _others(found: JointFindings, changed: Sequence[ChangedParameter]) -> str:
    """A sentence on what the recordings cannot tell from what changed, behind a space."""
    freed = {part for c in changed for part in (c.name, c.name.partition(".")[0])}
    freed |= {name for name, parts in CHANGED_TOGETHER.items() if freed >= set(parts)}
    if freed >= set(FRICTION[:2]):
        freed |= {MOTOR_FRICTION, *FRICTION}
    others = [spoken(name) for name in found.could_be if name not in freed]
    if not others:
        return ""
    listed = _listed(others, "or")
    return f" {listed[0].upper()}{listed[1:]} would look the same."


def _item(changed: ChangedParameter) -> CheckItem:
    z = (changed.estimate - changed.expected) / changed.sd if changed.sd > 0.0 else 0.0
    return check_item(changed.name, changed.estimate, changed.expected, changed.unit, z)


def _sentence(changed: ChangedParameter) -> str:
    return (
        f"In {changed.recording} something other than the gap is different: {_as_found(changed)}."
    )


def _as_found(changed: ChangedParameter) -> str:
    share = ""
    if changed.expected:
        percent = 100.0 * (changed.estimate / changed.expected - 1.0)
        share = f" ({'+' if percent > 0.0 else ''}{number(percent, 1)} %)"
    text = f"{spoken(changed.name)} of {changed.estimate:.4g} instead of {changed.expected:.4g}"
    return f"{text} {changed.unit}".rstrip() + share


def _size(size: float, believed: float, unit: str) -> str:
    """As a share of the believed value, or in its unit where that is zero."""
    if believed:
        return f"{100.0 * size / abs(believed):.2g} %"
    return f"{size:.2g} {unit}".rstrip()


def spoken(name: str) -> str:
    """A bench parameter or ``effect.parameter`` in words, with its name."""
    effect, _, parameter = name.partition(".")
    if effect in PARAMETER_INFO:
        return f"{PARAMETER_INFO[effect].meaning} ({name})"
    if not parameter:
        return name.replace("_", " ")
    return f"{effect.replace('_', ' ')}, {declaration_of(name).meaning} ({name})"


def _width(draws_rad: FloatArray, level: float) -> float:
    low, high = np.quantile(draws_rad, [0.5 - 0.5 * level, 0.5 + 0.5 * level])
    return float(high - low)


def _listed(texts: Sequence[str], last: str) -> str:
    if len(texts) < 2:
        return "".join(texts)
    return f"{', '.join(texts[:-1])} {last} {texts[-1]}"
