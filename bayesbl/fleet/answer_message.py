"""A row of ``recordings.parquet`` as a message: written by ``watch``, checked by ``collect``.

What is not a row that ``watch`` can have written is refused with its reason.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from bayesbl.errors import shortened
from bayesbl.fleet.message import encoded, require_date, require_digest, require_joint
from bayesbl.fleet.plant_tables import QUANTILE_COLUMNS, RECORDING_COLUMNS

ANSWER = "recording"
"""Kind of a message that holds a row."""

LONGEST_TEXT = 10_000

LARGEST_RPM = 1e6

OUTCOMES = frozenset({"converged", "usable", "withheld", "no_curve", "refused", "failed"})

_REQUIRED = ("joint", "date", "file", "outcome")

_GAP = (
    *(f"delta_rad_{end}" for end in ("median", "low", "high", "sd")),
    *QUANTILE_COLUMNS,
)
_AMPLITUDE = ("amplitude_rpm_low", "amplitude_rpm_high")


def encoded_answer(row: Mapping[str, Any], device: str) -> bytes:
    """A row as a message; columns without a value, or with none that is finite, are left out."""
    return encoded(ANSWER, {name: row[name] for name in row if _is_given(row[name])}, device)


def decoded_answer(given: Any, device: str) -> dict[str, Any]:
    """The row that a message of this kind holds, every column in it.

    Raises
    ------
    ValueError
        If something in it cannot be, with a reason that may be printed.
    """
    if not isinstance(given, dict):
        raise ValueError("it holds no row")
    unknown = sorted(given.keys() - (RECORDING_COLUMNS.keys() - {"device"}))
    if unknown:
        raise ValueError(f"there is no column {shortened(unknown[0])!r}")
    row: dict[str, Any] = dict.fromkeys(RECORDING_COLUMNS)
    for name, value in given.items():
        row[name] = _VALUES[RECORDING_COLUMNS[name][0]](name, value)
    _require_names(row)
    _require_gap(row)
    return row | {"device": device}


def _is_given(value: object) -> bool:
    return value is not None and not (isinstance(value, float) and not math.isfinite(value))


def _text(name: str, value: object) -> str:
    if not isinstance(value, str) or len(value) > LONGEST_TEXT or "\0" in value:
        raise ValueError(f"{name} is no text of at most {LONGEST_TEXT} characters")
    try:
        value.encode()
    except UnicodeEncodeError:
        raise ValueError(f"{name} is no text") from None
    return value


def _flag(name: str, value: object) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"{name} is neither true nor false")
    return value


def _number(name: str, value: object) -> float:
    """Within what it can be: noise alone may ring with a negative amplitude, gaps are positive."""
    low, largest = 0.0, 1.0 if name.startswith("probability") else math.pi
    if name.startswith("amplitude"):
        low, largest = -LARGEST_RPM, LARGEST_RPM
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{name} is no number")
    if not low <= value <= largest:
        raise ValueError(f"{name} = {shortened(str(value))} is not within {low:g} and {largest:g}")
    return float(value)


_VALUES: Mapping[str, Callable[[str, object], object]] = {
    "string": _text,
    "bool": _flag,
    "double": _number,
}


def _require_names(row: Mapping[str, Any]) -> None:
    for name in _REQUIRED:
        if not row[name]:
            raise ValueError(f"{name} is missing")
    require_joint(row["joint"])
    if row["outcome"] not in OUTCOMES:
        raise ValueError(f"{shortened(row['outcome'])!r} is no outcome")
    if row["sha256"] is not None:
        require_digest(row["sha256"])
    if row["outcome"] == "refused":
        return  # perhaps just for its date
    if row["sha256"] is None:
        raise ValueError("sha256 is missing")
    require_date(row["date"])


def _require_gap(row: Mapping[str, Any]) -> None:
    """A gap, all of it, or a reason; bounds in their order."""
    if row["reason"] is None:
        lacking = [name for name in _GAP if row[name] is None]
        if lacking:
            raise ValueError(f"there is no {lacking[0]}, and no reason")
        if row["outcome"] not in ("converged", "usable"):
            raise ValueError("there is a gap, but its outcome says that there is none")
    elif any(row[name] is not None for name in (*_GAP, "probability_above_limit")):
        raise ValueError("there is a gap beside the reason why there is none")
    for names in (("delta_rad_low", "delta_rad_high"), QUANTILE_COLUMNS, _AMPLITUDE):
        given = [row[name] for name in names if row[name] is not None]
        if given != sorted(given) or len(given) not in (0, len(names)):
            raise ValueError(f"{names[0]} to {names[-1]} are not in order, or not whole")
