"""What was found where something measured is compared with what it should be.

A snapshot is compared with its bench (``model_check``), and the snapshots of a comparison with one
another (``same_joint``). Both have the form of :class:`JointCheck`, whoever makes it; it is stored
as JSON, so that a check may have any number of items.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

NO_CURRENT = "no motor current can be compared"
"""Reason of a blind spot: gains that change move the ringing by any size, as a gap does."""


@dataclass(frozen=True, slots=True)
class CheckItem:
    """One quantity: as measured, as expected, and their difference in standard deviations.

    Attributes
    ----------
    quantity
        As it stands in a sentence, ``"ringing frequency"``.
    expected
        By the bench, or in the snapshot that another one is compared with.
    unit
        Of both; empty for a pure number.
    """

    quantity: str
    measured: float
    expected: float
    unit: str
    z: float


@dataclass(frozen=True, slots=True)
class BlindSpot:
    """A change of the joint that would pass the check.

    Attributes
    ----------
    change
        As it stands in a sentence, ``"the speed controller's gains"``.
    reason
        Why it cannot be seen.
    delta_error_rad
        What it would do to δ, in rad; ``None`` where that is not known.
    """

    change: str
    reason: str
    delta_error_rad: float | None = None


@dataclass(frozen=True, slots=True)
class JointCheck:
    """All quantities that were compared.

    Attributes
    ----------
    agrees
        Whether all differences may be chance, at the false-alarm rate of whoever made the check.
    could_be
        Names of effects, or of parameters of the bench, that would do what was found.
    sentences
        A sentence for each finding: what differs, by how much, what would do that.
    """

    agrees: bool
    items: Sequence[CheckItem] = ()
    could_be: Sequence[str] = ()
    sentences: Sequence[str] = ()
    blind_spots: Sequence[BlindSpot] = ()


NOTHING_COMPARED = JointCheck(True)
"""It agrees, as nothing speaks against it."""
