"""What a comparison with the bench says of the joint: items, findings, blind spots.

From what :mod:`bayesbl.model_search.joint_change` finds to the checks of snapshot and comparison.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bayesbl.matching.posterior import MATTERS
from bayesbl.measurement.joint_check import (
    CheckItem,
    JointCheck,
    blind_spot,
    check_item,
    joint_check,
)
from bayesbl.model_search.always_in import CHANGED_TOGETHER
from bayesbl.model_search.joint_change import ChangedParameter, JointFindings
from bayesbl.recording.types import FloatArray


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
    findings = [{"code": "parameter_changed", **_values(c)} for c in between]
    if between:
        alike = {"code": "would_look_the_same", "names": _alike(found, between)}
        given = {"code": "change_allows_for_it"}
        findings[-1]["also"] = [alike] * bool(alike["names"]) + [given] * is_given
    return joint_check(
        found.explained and not between,
        [_item(c) for c in between],
        found.could_be if between else (),
        findings,
        [
            blind_spot(
                "parameter_unseen",
                spot.error_rad,
                name=spot.name,
                size=spot.size,
                expected=spot.expected,
                unit=spot.unit,
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
    return {"parameters": [_values(c) for c in changed], "alike": _alike(found, changed)}


def _alike(found: JointFindings, changed: Sequence[ChangedParameter]) -> list[str]:
    """What the recordings cannot tell from what changed."""
    freed = {part for c in changed for part in (c.name, c.name.partition(".")[0])}
    freed |= {name for name, parts in CHANGED_TOGETHER.items() if freed >= set(parts)}
    return [name for name in found.could_be if name not in freed]


def _item(changed: ChangedParameter) -> CheckItem:
    z = (changed.estimate - changed.expected) / changed.sd if changed.sd > 0.0 else 0.0
    return check_item(changed.name, changed.estimate, changed.expected, changed.unit, z)


def _values(changed: ChangedParameter) -> dict[str, Any]:
    return {
        "name": changed.name,
        "measured": changed.estimate,
        "expected": changed.expected,
        "unit": changed.unit,
        "recording": changed.recording,
    }


def _width(draws_rad: FloatArray, level: float) -> float:
    low, high = np.quantile(draws_rad, [0.5 - 0.5 * level, 0.5 + 0.5 * level])
    return float(high - low)
