"""Messages of devices: JSON of one schema, and whose recording each is about.

Whatever may come from a network is checked: :mod:`bayesbl.fleet.answer_message` and
:mod:`bayesbl.fleet.mean_rotation` say what may stand in a message of each kind.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from datetime import date as Date
from typing import Any, NoReturn

from bayesbl.errors import shortened
from bayesbl.fleet.inventory import is_joint_name

SCHEMA = 1

LARGEST_MESSAGE_BYTES = 1_000_000
"""An answer takes some 1,200 bytes; two channels of ten seconds at 4 kHz as means 430,000."""

_SHA256 = re.compile(r"[0-9a-f]{64}")


def encoded(kind: str, given: Mapping[str, Any]) -> bytes:
    """A message of a kind."""
    return json.dumps({"schema": SCHEMA, kind: given}, allow_nan=False).encode()


def decoded(message: bytes) -> tuple[str, Any]:
    """Kind and content of a message.

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
    if not isinstance(content, dict) or content.pop("schema", None) != SCHEMA:
        raise ValueError(f"it is no message of schema {SCHEMA}")
    if len(content) != 1:
        raise ValueError("it has other parts than schema and one more")
    ((kind, given),) = content.items()
    return kind, given


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
