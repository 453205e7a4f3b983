"""Messages of devices: JSON of one schema, from which device, and whose recording each is about.

Whatever may come from a network is checked: :mod:`bayesbl.fleet.answer_message` and
:mod:`bayesbl.fleet.mean_rotation` say what may stand in a message of each kind.
"""

from __future__ import annotations

import hashlib
import json
import re
from datetime import date as Date
from typing import Any, NoReturn

from bayesbl.errors import shortened
from bayesbl.fleet.inventory import is_joint_name

SCHEMA = 2

LARGEST_MESSAGE_BYTES = 1_000_000
"""An answer takes some 1,200 bytes; two channels of ten seconds at 4 kHz as means 430,000."""

STORED, REFUSED = "stored", "refused"
"""What ``collect`` answers: SHA-256 of messages that it has stored, and of those set aside."""

REPLIES = "stored"
"""Last level of the topic that ``collect`` answers on, below that of a message."""

_SHA256 = re.compile(r"[0-9a-f]{64}")
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
    """A joint may be called so.

    Raises
    ------
    ValueError
        If not.
    """
    if not isinstance(name, str) or not is_joint_name(name):
        raise ValueError(f"{shortened(str(name))!r} is no name of a joint")


def require_digest(sha256: object) -> None:
    """A SHA-256 in hexadecimal digits.

    Raises
    ------
    ValueError
        If it is none.
    """
    if not isinstance(sha256, str) or not _SHA256.fullmatch(sha256):
        raise ValueError("sha256 is no digest")


def require_date(date: object) -> None:
    """A date such as 2026-03-01.

    Raises
    ------
    ValueError
        If it is none.
    """
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
