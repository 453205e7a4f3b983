"""Residuals of a simulation, in sentences."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from bayesbl.presentation.words import capitalised, significant
from bayesbl.recording.types import CHANNELS
from bayesbl.units import unit_of

if TYPE_CHECKING:
    import xarray as xr

    from bayesbl.diagnosis.summary import RemainingSummary


def residual_sentences(stored: xr.Dataset) -> list[str]:
    """What is significant over all recordings, of a group that diagnosis.residual_groups stored."""
    names = [str(name) for name in stored["recording"].values]
    entries: list[RemainingSummary] = json.loads(stored.attrs["unexplained"])
    if not entries:
        rate = 100.0 * float(stored.attrs["false_discovery_rate"])
        return [
            "Nothing repeats, drifts or lags beyond noise in any channel "
            f"(tested so that {rate:g} % of data without any show a line by chance)."
        ]
    sentences = [f"{unexplained_phrase(entry)}{_where(entry, names)}." for entry in entries]
    shown = {entry["channel"] for entry in entries if entry["dependence"] == "offset"}
    offsets = [o for o in json.loads(stored.attrs["offsets"]) if o["channel"] in shown]
    if len(names) > 1:
        sentences += filter(None, map(_offset_sentence, offsets))
    return [capitalised(text) for text in sentences]


def unexplained_phrase(entry: RemainingSummary) -> str:
    """``motor current: 0.13 A at 7.3 Hz, periodic in time``; for a verdict's list."""
    return f"{channel_name(entry['channel'])}: {_what(entry)}"


def _what(entry: RemainingSummary) -> str:
    size = quantity(entry["amplitude"], entry["unit"])
    order, highest, hertz = entry["lowest_order"], entry["highest_order"], entry["frequency_hz"]
    match entry["dependence"]:
        case "offset":
            return f"an offset of {size}"
        case "drift":
            return f"a drift of {size}"
        case "skew":
            return _lag(entry["amplitude"])
        case "outliers":
            return f"{entry['amplitude']:g} samples that no noise explains"
        case "load angle":
            return f"{size} with the load angle, mostly at {_orders(order, highest)}"
        case "motor angle":
            return f"{size} at order {order:.4g} of the motor"
        case "time":
            return f"{size} at {hertz:.4g} Hz, periodic in time"
    return (
        f"{size} at {hertz:.4g} Hz or order {order:.4g} of the motor (these recordings do not "
        "show which)"
    )


def quantity(value: float, unit: str) -> str:
    """Two significant figures and the unit: ``−0.25 A``."""
    return f"{significant(value)} {unit}"


def channel_name(channel: str) -> str:
    """``motor speed``."""
    return CHANNELS.get(channel, channel)


def _orders(low: float | None, high: float | None) -> str:
    return f"order {low:.0f}" if low == high else f"orders {low:.0f} to {high:.0f}"


def _lag(seconds: float) -> str:
    verb = "lags" if seconds > 0.0 else "leads"
    return f"{verb} by {quantity(1e3 * abs(seconds), 'ms')}"


def _where(entry: RemainingSummary, names: Sequence[str]) -> str:
    """Which recordings show it, if not all do."""
    if len(entry["recordings"]) == len(names):
        return ""
    return f" (in {', '.join(repr(name) for name in entry['recordings'])})"


def _offset_sentence(offset: dict[str, Any]) -> str:
    """How an offset depends on direction and speed; empty if that is not sure."""
    unit = unit_of(offset["channel"])
    parts = [
        text.format(quantity(offset[part], unit))
        for part, text in (
            ("constant", "{} in both directions"),
            ("with_direction", "{} with the sign of the motion"),
            ("per_1000_rpm", "{} for every 1000 rpm"),
        )
        if offset[part] is not None and abs(offset[part]) > 3.0 * offset[f"{part}_error"]
    ]
    name = channel_name(offset["channel"])
    return f"The {name}'s mean is off by {', '.join(parts)}." if parts else ""
