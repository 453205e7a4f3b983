"""What a comparison with the bench says of the joint: items, sentences, what is withheld.

From what :mod:`bayesbl.model_search.joint_change` finds to the checks of snapshot and comparison.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bayesbl.bench.effects import EFFECT_BY_NAME
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
    between = found.between
    sentences = [_sentence(c) for c in between]
    if between:
        if others := _alike(found, between):
            listed = _listed(others, "or")
            sentences[-1] += f" {listed[0].upper()}{listed[1:]} would look the same."
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


def bench_lacks(found: JointFindings) -> dict[str, Any]:
    """What no recording has as the bench has it, for its sentence; empty where all is as it has."""
    changed = found.beyond_bench
    if not changed:
        return {}
    several = len({c.recording for c in changed}) > 1
    where = [f" in {c.recording or 'all'}" if several else "" for c in changed]
    effects = [EFFECT_BY_NAME.get(c.name.partition(".")[0]) for c in changed]
    return {
        "parameters": [_as_estimated(c) + own for c, own in zip(changed, where, strict=True)],
        "alike": _alike(found, changed),
        "in_bench_file": [e.in_bench_file for e in dict.fromkeys(effects) if e and e.in_bench_file],
    }


def _alike(found: JointFindings, changed: Sequence[ChangedParameter]) -> list[str]:
    """What the recordings cannot tell from what changed."""
    freed = {part for c in changed for part in (c.name, c.name.partition(".")[0])}
    freed |= {name for name, parts in CHANGED_TOGETHER.items() if freed >= set(parts)}
    if freed >= set(FRICTION[:2]):
        freed |= {MOTOR_FRICTION, *FRICTION}
    return [spoken(name) for name in found.could_be if name not in freed]


def _item(changed: ChangedParameter) -> CheckItem:
    z = (changed.estimate - changed.expected) / changed.sd if changed.sd > 0.0 else 0.0
    return check_item(changed.name, changed.estimate, changed.expected, changed.unit, z)


def _sentence(changed: ChangedParameter) -> str:
    value = _as_estimated(changed)
    return f"In {changed.recording} something other than the gap is different: {value}."


def _as_estimated(changed: ChangedParameter) -> str:
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
