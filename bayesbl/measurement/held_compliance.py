"""Whether friction holds as much compliance in the last of some torque ramps as in the first.

What ramps leave between the flanks is the dead zone and the compliance that friction holds. Where
that changed, the width changes without wear.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bayesbl.matching.posterior import MATTERS
from bayesbl.measurement.joint_check import NOTHING_COMPARED, BlindSpot, CheckItem, JointCheck
from bayesbl.recording.types import FloatArray

HELD = 3.0
"""Times ``held_windup_rad`` that ramps leave beyond the dead zone.

Flanks are softer at small torque than where their compliance is read: by 2.4 times in the middle
of the gearboxes of ``configs/torque_ramps_study.toml``, by about 3 or less in three of four
(``held_ratio_3_of_4`` of its table).
"""

DIFFERS = 2.0
"""Standard deviations from which friction or compliance counts as changed: 5 % each by chance."""

TOLD = {
    "compliance_rad_per_nm": ("compliance", "rad/N m"),
    "friction_torque_nm": ("friction", "N m"),
}


NOT_TOLD = "ramps do not tell it from play"
SOFTER = BlindSpot("flanks that became softer at small torque alone", NOT_TOLD)


def held_alike(first: Mapping[str, FloatArray], last: Mapping[str, FloatArray]) -> JointCheck:
    """What changed in friction and compliance, and how far it may have moved the change of δ.

    Parameters
    ----------
    first, last
        Draws of ``delta_rad``, ``held_windup_rad``, ``compliance_rad_per_nm`` and
        ``friction_torque_nm`` of two snapshots, rad and N m.
    """
    if first is last:
        return NOTHING_COMPARED
    items = [
        CheckItem(
            quantity,
            float(np.median(last[name])),
            float(np.median(first[name])),
            unit,
            _deviations(last[name], first[name]),
        )
        for name, (quantity, unit) in TOLD.items()
    ]
    held = float(np.median(last["held_windup_rad"]) - np.median(first["held_windup_rad"]))
    low, middle, high = np.quantile(last["delta_rad"] - first["delta_rad"], (0.05, 0.5, 0.95))
    # Less compliance held cannot pass for growth. A width falls with it, and also where more
    # friction keeps the ramps from the flanks.
    error = HELD * (max(held, 0.0) if middle > 0.0 else abs(held))
    changed = [item for item in items if abs(item.z) > DIFFERS]
    if not changed or error <= MATTERS * (high - low):
        return JointCheck(True, items, blind_spots=(SOFTER,))
    told = " and ".join(_in_words(item) for item in changed)
    held_more = BlindSpot(f"compliance that friction holds, with {told}", NOT_TOLD, error)
    return JointCheck(True, items, blind_spots=(held_more, SOFTER))


def _in_words(item: CheckItem) -> str:
    scale, unit = (1e3, f"m{item.unit}") if item.unit.startswith("rad") else (1.0, item.unit)
    after, before = scale * item.measured, scale * item.expected
    return f"{item.quantity} of {after:.3g} instead of {before:.3g} {unit}"


def _deviations(last: FloatArray, first: FloatArray) -> float:
    sd = float(np.hypot(last.std(), first.std()))
    return float(np.median(last) - np.median(first)) / sd if sd > 0.0 else 0.0
