"""What was found where something measured is compared with what it should be.

A snapshot is compared with its bench (``model_check``), and the snapshots of a comparison with one
another (``same_joint``). Both have the form of :class:`JointCheck`, whoever makes it, and are
stored as they are.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypedDict

NO_CURRENT = "no motor current can be compared"
"""Reason of a blind spot: gains that change move the ringing by any size, as a gap does."""


class CheckItem(TypedDict):
    """A quantity as measured and as expected; ``z`` is their difference in standard deviations."""

    quantity: str
    measured: float
    expected: float
    unit: str
    z: float


class BlindSpot(TypedDict):
    """A change of the joint that the check cannot see, and what it would do to δ, where known."""

    change: str
    reason: str
    delta_error_rad: float | None


class JointCheck(TypedDict):
    """A snapshot against its bench, or snapshots against one another.

    ``could_be`` names effects or parameters of the bench that would explain it, ``sentences`` say
    so. If nothing was compared, ``items`` is empty and ``agrees`` true.
    """

    agrees: bool
    items: list[CheckItem]
    could_be: list[str]
    sentences: list[str]
    blind_spots: list[BlindSpot]


def check_item(quantity: str, measured: float, expected: float, unit: str, z: float) -> CheckItem:
    """One quantity; ``unit`` of both values, empty for a pure number."""
    return {
        "quantity": quantity,
        "measured": measured,
        "expected": expected,
        "unit": unit,
        "z": z,
    }


def joint_check(
    agrees: bool = True,
    items: Iterable[CheckItem] = (),
    could_be: Iterable[str] = (),
    sentences: Iterable[str] = (),
    blind_spots: Iterable[BlindSpot] = (),
) -> JointCheck:
    """What was compared, nothing by default; ``could_be`` names each cause once."""
    return {
        "agrees": agrees,
        "items": list(items),
        "could_be": list(dict.fromkeys(could_be)),
        "sentences": list(sentences),
        "blind_spots": list(blind_spots),
    }
