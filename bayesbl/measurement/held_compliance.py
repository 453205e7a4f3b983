"""Whether friction holds as much compliance in the last of some torque ramps as in the first.

What ramps leave between the flanks is the dead zone and the compliance that friction holds. Where
that changed, the width changes without wear.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri, stdtr

from bayesbl.matching.posterior import MATTERS
from bayesbl.measurement.joint_check import NOTHING_COMPARED, BlindSpot, CheckItem, JointCheck
from bayesbl.ramps.flanks import observations
from bayesbl.recording.types import FloatArray

HELD = 3.0
"""Times ``held_windup_rad`` that ramps leave beyond the dead zone.

Flanks are softer at small torque than where their compliance is read: by 2.4 times in the middle
of the gearboxes of ``configs/torque_ramps_study.toml``, by about 3 or less in three of four
(``held_ratio_3_of_4`` of its table).
"""

DIFFERS = 2.0
"""Standard deviations from which friction or compliance counts as changed: 5 % each by chance."""

ROUNDING = float(np.finfo(float).eps)
"""Of a logarithm, so that changes without scatter have a finite size too."""

TOLD = {
    "compliance_rad_per_nm": ("compliance", "rad/N m"),
    "friction_torque_nm": ("friction", "N m"),
}


NOT_TOLD = "ramps do not tell it from play"
SOFTER = BlindSpot("flanks that became softer at small torque alone", NOT_TOLD)


@dataclass(frozen=True, slots=True)
class Held:
    """What the ramps of a snapshot show beside its width.

    Attributes
    ----------
    draws
        Of ``delta_rad``, ``held_windup_rad`` and the quantities in :data:`TOLD`, rad and N m.
    measured
        The quantities in :data:`TOLD`, by file and cycle.
    """

    draws: Mapping[str, FloatArray]
    measured: Mapping[str, Sequence[FloatArray]]


def held_alike(first: Held, last: Held) -> JointCheck:
    """What changed in friction and compliance, and how far it may have moved the change of δ."""
    if first.draws is last.draws:
        return NOTHING_COMPARED
    before, after = first.draws, last.draws
    items = [
        CheckItem(
            quantity,
            float(np.median(after[name])),
            float(np.median(before[name])),
            unit,
            _deviations(last.measured[name], first.measured[name]),
        )
        for name, (quantity, unit) in TOLD.items()
    ]
    held = float(np.median(after["held_windup_rad"]) - np.median(before["held_windup_rad"]))
    low, middle, high = np.quantile(after["delta_rad"] - before["delta_rad"], (0.05, 0.5, 0.95))
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


def _deviations(last: Sequence[FloatArray], first: Sequence[FloatArray]) -> float:
    """The change by its scatter (Student's t), as standard deviations of equal probability.

    Positions round the turn are paired by their order, as their widths are: a pattern that stays
    then hides no change. Where nothing tells the scatter, no change is told.
    """
    after, before = observations(last), observations(first)
    if np.all(after > 0.0) and np.all(before > 0.0):
        after, before = np.log(after), np.log(before)
    change = float(after.mean() - before.mean())
    paired = len(last) == len(first) > 1
    samples = [after - before] if paired else [after, before]
    if change == 0.0 or min(each.size for each in samples) < 2:
        return 0.0
    errors = np.array([each.var(ddof=1) / each.size + ROUNDING**2 for each in samples])
    freedoms = np.array([each.size - 1.0 for each in samples])
    variance = float(errors.sum())
    freedom = variance**2 / float(np.sum(errors**2 / freedoms))  # of two samples, Welch's
    chance = float(stdtr(freedom, -abs(change) / np.sqrt(variance)))
    return float(-np.sign(change) * ndtri(max(chance, ROUNDING**2)))
