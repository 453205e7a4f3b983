"""Messages of devices: JSON of one schema, from which device, and whose recording each is about.

Whatever may come from a network is checked: here a row of
``recordings.parquet``, in :mod:`bayesbl.fleet.mean_rotation` a mean rotation. What ``watch`` cannot
have written is refused with its reason.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Callable, Mapping
from datetime import date as Date
from typing import Any, NoReturn

from bayesbl.config.sections import LONGEST_NAME
from bayesbl.errors import shortened
from bayesbl.fleet.plant_tables import QUANTILE_COLUMNS, RECORDING_COLUMNS

SCHEMA = 2

LARGEST_MESSAGE_BYTES = 1_000_000
"""An answer takes some 1,200 bytes; two channels of ten seconds at 4 kHz as means 430,000."""

STORED, REFUSED = "stored", "refused"
"""What ``collect`` answers: SHA-256 of messages that it has stored, and of those set aside."""

REPLIES = "stored"
"""Last level of the topic that ``collect`` answers on, below that of a message."""

_SHA256 = re.compile(r"[0-9a-f]{64}")
_JOINT = re.compile(rf"\w[\w .,+-]{{0,{LONGEST_NAME - 1}}}")
_DEVICE = re.compile(r"[A-Za-z0-9._-]{1,100}")


def encoded(kind: str, given: object, device: str) -> bytes:
    """A message of a kind."""
    return json.dumps({"schema": SCHEMA, "device": device, kind: given}, allow_nan=False).encode()


def name_of(message: bytes) -> str:
    """SHA-256 of a message, by which it is known to both sides."""
    return hashlib.sha256(message).hexdigest()


def replies(message: bytes) -> tuple[set[str], set[str]]:
    """Names of messages that are stored, and of those that were refused; none if it is no reply."""
    try:
        kind, given, _ = decoded(message)
    except ValueError:
        return set(), set()
    names = {name for name in given if isinstance(name, str)} if isinstance(given, list) else set()
    return (names if kind == STORED else set()), (names if kind == REFUSED else set())


def decoded(message: bytes) -> tuple[str, Any, str]:
    """Kind and content of a message, and the device that it is from.

    Raises
    ------
    ValueError
        If it is none, with a reason that may be printed.
    """
    if len(message) > LARGEST_MESSAGE_BYTES:
        raise ValueError(f"it has {len(message)} bytes, more than {LARGEST_MESSAGE_BYTES}")
    try:
        content = json.loads(message, parse_constant=_no_number, object_pairs_hook=_once)
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError):
        raise ValueError("it is no JSON") from None
    except ValueError as error:  # of a number with thousands of digits, also
        raise ValueError(shortened(str(error), 100)) from None
    if not isinstance(content, dict) or content.pop("schema", None) != SCHEMA:
        raise ValueError(f"it is no message of schema {SCHEMA}")
    device = content.pop("device", None)
    if not isinstance(device, str) or not _DEVICE.fullmatch(device):
        raise ValueError("it does not say which device it is from")
    if len(content) != 1:
        raise ValueError("it has other parts than schema, device and one more")
    ((kind, given),) = content.items()
    return kind, given, device


def require_joint(name: object) -> None:
    """Raise ``ValueError`` where no joint may be called so."""
    if not isinstance(name, str) or not _JOINT.fullmatch(name):
        raise ValueError(f"{shortened(str(name))!r} is no name of a joint")


def require_digest(sha256: object) -> None:
    """Raise ``ValueError`` for what is no SHA-256 in hexadecimal digits."""
    if not isinstance(sha256, str) or not _SHA256.fullmatch(sha256):
        raise ValueError("sha256 is no digest")


def require_date(date: object) -> None:
    """Raise ``ValueError`` for what is no date such as 2026-03-01."""
    try:
        day = Date.fromisoformat(str(date)).isoformat()
    except ValueError:
        day = ""
    if day != date:
        raise ValueError(f"{shortened(str(date))!r} is no date")


def _no_number(text: str) -> NoReturn:
    raise ValueError(f"{text} is no number")


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("it gives a value twice")
    return found


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
