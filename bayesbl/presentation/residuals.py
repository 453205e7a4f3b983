"""Residuals of a simulation, in sentences."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from bayesbl.diagnosis.residuals.unexplained import Unexplained
from bayesbl.recording.types import CHANNELS
from bayesbl.units import number, unit_of

if TYPE_CHECKING:
    import xarray as xr


def located_sentences(left: xr.Dataset) -> list[str]:
    """The residuals of a comparison, over all recordings; of a dataset of results.located."""
    names = [str(name) for name in left["recording"].values]
    entries = [unexplained(entry) for entry in json.loads(left.attrs["unexplained"])]
    if not entries:
        rate = 100.0 * float(left.attrs["false_discovery_rate"])
        return [
            "Nothing repeats, drifts or lags beyond noise in any channel "
            f"(tested so that {rate:g} % of data without any show a line by chance)."
        ]
    sentences = [f"{unexplained_phrase(entry)}{_where(entry, names)}." for entry in entries]
    shown = {entry.channel for entry in entries if entry.dependence == "offset"}
    offsets = [o for o in json.loads(left.attrs["offsets"]) if o["channel"] in shown]
    if len(names) > 1:
        sentences += filter(None, map(_offset_sentence, offsets))
    return [text[0].upper() + text[1:] for text in sentences]


def unexplained_phrase(entry: Unexplained) -> str:
    """``motor current: 0.13 A at 7.3 Hz, periodic in time``; for a verdict's list."""
    size = quantity(entry.amplitude, entry.unit)
    head = f"{channel_name(entry.channel)}: "
    if entry.dependence == "offset":
        return f"{head}an offset of {size}"
    if entry.dependence == "drift":
        return f"{head}a drift of {size}"
    if entry.dependence == "skew":
        return f"{head}{_lag(entry.amplitude)}"
    if entry.dependence == "outliers":
        return f"{head}{entry.amplitude:g} samples that no noise explains"
    if entry.dependence == "load angle":
        orders = _orders(int(entry.lowest_order), int(entry.highest_order))
        return f"{head}{size} with the load angle, mostly at {orders}"
    if entry.dependence == "motor angle":
        return f"{head}{size} at order {entry.lowest_order:.4g} of the motor"
    if entry.dependence == "time":
        return f"{head}{size} at {entry.frequency_hz:.4g} Hz, periodic in time"
    return (
        f"{head}{size} at {entry.frequency_hz:.4g} Hz or order {entry.lowest_order:.4g} of the "
        "motor (these recordings cannot tell which)"
    )


def quantity(value: float, unit: str) -> str:
    """Two significant figures with a true minus and the unit: ``−0.25 A``."""
    if value == 0.0:
        return f"0 {unit}"
    rounded = float(f"{value:.1e}")
    digits = 1 - math.floor(math.log10(abs(rounded)))
    return f"{number(rounded, max(0, digits))} {unit}"


def channel_name(channel: str) -> str:
    """``motor speed``."""
    return CHANNELS.get(channel, channel)


def _orders(low: int, high: int) -> str:
    return f"order {low}" if low == high else f"orders {low} to {high}"


def _lag(seconds: float) -> str:
    verb = "lags" if seconds > 0.0 else "leads"
    return f"{verb} by {quantity(1e3 * abs(seconds), 'ms')}"


def unexplained(entry: dict[str, Any]) -> Unexplained:
    """An entry as it was before JSON, which knows no NaN and no tuples."""
    values = {key: math.nan if value is None else value for key, value in entry.items()}
    return Unexplained(**values | {"recordings": tuple(entry["recordings"])})


def _where(entry: Unexplained, names: Sequence[str]) -> str:
    """Which recordings show it, if not all do."""
    if len(entry.recordings) == len(names):
        return ""
    return f" (in {', '.join(repr(name) for name in entry.recordings)})"


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
