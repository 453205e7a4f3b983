"""Messages from devices to ``collect``: a row of ``recordings.parquet`` each, as JSON.

Messages come from a network, so all that ``watch`` cannot have written is refused with a reason.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from datetime import date as Date
from typing import Annotated, Any, Literal, NoReturn

from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model

from bayesbl.config.sections import LONGEST_NAME
from bayesbl.errors import shortened
from bayesbl.fleet.plant_tables import QUANTILE_COLUMNS, RECORDING_COLUMNS

SCHEMA = 2
LARGEST_MESSAGE_BYTES = 1_000_000  # an answer takes about 1,200 bytes
LONGEST_TEXT = 10_000

LARGEST_RPM = 1e6

OUTCOMES = ("converged", "usable", "withheld", "no_curve", "refused", "failed")

_DEVICE = re.compile(r"[A-Za-z0-9._-]{1,100}")

_GAP = (*(f"delta_rad_{end}" for end in ("median", "low", "high", "sd")), *QUANTILE_COLUMNS)
_AMPLITUDE = ("amplitude_rpm_low", "amplitude_rpm_high")


def _no_number(text: str) -> NoReturn:
    raise ValueError(f"{text} is no number")


def encoded_answer(row: Mapping[str, Any], device: str) -> bytes:
    """A row as a message, without missing or infinite values."""
    given = {
        name: value
        for name, value in row.items()
        if value is not None and not (isinstance(value, float) and not math.isfinite(value))
    }
    return json.dumps({"schema": SCHEMA, "device": device, "recording": given}).encode()


def _column(name: str, kind: str) -> Any:
    """Type of a column. Noise may give a negative amplitude; gaps are positive."""
    if kind == "string":
        return Annotated[str, Field(max_length=LONGEST_TEXT, pattern=r"^[^\x00]*$")]
    if kind == "bool":
        return bool
    low, high = 0.0, 1.0 if name.startswith("probability") else math.pi
    if name.startswith("amplitude"):
        low, high = -LARGEST_RPM, LARGEST_RPM
    return Annotated[float, Field(ge=low, le=high)]


_Given = Annotated[str, Field(min_length=1, max_length=LONGEST_TEXT, pattern=r"^[^\x00]+$")]
_JointName = Annotated[str, Field(pattern=rf"^\w[\w .,+-]{{0,{LONGEST_NAME - 1}}}$")]
_COLUMNS: dict[str, Any] = {
    name: (_column(name, kind) | None, None)
    for name, (kind, _) in RECORDING_COLUMNS.items()
    if name != "device"
}
_COLUMNS |= {name: (_Given, ...) for name in ("date", "file")}
_COLUMNS |= {"joint": (_JointName, ...), "outcome": (Literal[OUTCOMES], ...)}
_COLUMNS |= {"sha256": (Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")] | None, None)}


class _Strict(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)


_Row = create_model("_Row", __base__=_Strict, **_COLUMNS)


def decoded_answer(message: bytes) -> dict[str, Any]:
    """The row in a message, with every column. The ValueError's reason may be printed."""
    if len(message) > LARGEST_MESSAGE_BYTES:
        raise ValueError(f"it has {len(message)} bytes, more than {LARGEST_MESSAGE_BYTES}")
    try:
        content = json.loads(message, parse_constant=_no_number)
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError):
        raise ValueError("it is not JSON") from None
    except ValueError as error:  # of a number with thousands of digits, also
        raise ValueError(shortened(str(error), 100)) from None
    if not isinstance(content, dict) or content.pop("schema", None) != SCHEMA:
        raise ValueError(f"it is not a message of schema {SCHEMA}")
    device = content.pop("device", None)
    if not isinstance(device, str) or not _DEVICE.fullmatch(device):
        raise ValueError("it does not say which device it is from")
    if content.keys() != {"recording"}:
        raise ValueError("it has other parts than schema, device and recording")
    try:
        recording = _Row.model_validate(content["recording"])
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise ValueError(shortened(f"{where}: {first['msg']}", 200)) from None
    row: dict[str, Any] = dict.fromkeys(RECORDING_COLUMNS) | dict(recording)
    if row["outcome"] != "refused":  # which it may be just for its date
        _require_day(row["date"])
        if row["sha256"] is None:
            raise ValueError("sha256: there is none")
    _require_gap(row)
    return row | {"device": device}


def _require_day(text: str) -> None:
    try:
        is_day = Date.fromisoformat(text).isoformat() == text
    except ValueError:
        is_day = False
    if not is_day:
        raise ValueError("date: it is not written as 2026-03-01")


def _require_gap(row: Mapping[str, Any]) -> None:
    """Require a whole gap or a reason, with bounds in order."""
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
            raise ValueError(f"{names[0]} to {names[-1]} are not in order, or not complete")
