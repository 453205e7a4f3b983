"""What was found where something measured is compared with what it should be.

A snapshot is compared with its bench (``model_check``), and the snapshots of a comparison with one
another (``same_joint``). Both have the form of :class:`JointCheck`, whoever makes it. What they
find, and what they cannot see, are codes with numbers, as other reasons are.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, TypedDict


class CheckItem(TypedDict):
    """A quantity as measured and as expected; ``z`` is their difference in standard deviations."""

    quantity: str
    measured: float
    expected: float
    unit: str
    z: float


class JointCheck(TypedDict):
    """A snapshot against its bench, or snapshots against one another.

    ``could_be`` names effects or parameters of the bench that would explain what was found.
    ``blind_spots`` are changes of the joint that the check cannot detect. Each has
    ``delta_error_rad``, by how much it would move δ, if that is known. If nothing was compared,
    ``items`` is empty and ``agrees`` true.
    """

    agrees: bool
    items: list[CheckItem]
    could_be: list[str]
    findings: list[dict[str, Any]]
    blind_spots: list[dict[str, Any]]


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
    findings: Iterable[Mapping[str, Any]] = (),
    blind_spots: Iterable[Mapping[str, Any]] = (),
) -> JointCheck:
    """What was compared, nothing by default; ``could_be`` names each cause once."""
    return {
        "agrees": agrees,
        "items": list(items),
        "could_be": list(dict.fromkeys(could_be)),
        "findings": [dict(finding) for finding in findings],
        "blind_spots": [dict(spot) for spot in blind_spots],
    }


def blind_spot(code: str, delta_error_rad: float | None = None, **values: object) -> dict[str, Any]:
    """A change of the joint that a check cannot see, and what it would do to δ, where known."""
    return {"code": code, **values, "delta_error_rad": delta_error_rad}
