"""MDF files (versions 3 and 4); the master channel of each group is its time.

Formulas in a file are never evaluated: stored values are read, and factor and offset are applied
here. A channel with another conversion is withheld.
"""

from __future__ import annotations

import io
from typing import Any

import asammdf
import numpy as np

from bayesbl.recording.array_table import AnyArray, ArrayTable, Group, numbered, table_of_groups
from bayesbl.recording.channels import TIME


def read(data: bytes) -> ArrayTable:
    """Every one-dimensional channel, in physical units if its conversion is linear."""
    with asammdf.MDF(io.BytesIO(data)) as stored:
        groups = [_group(stored, number) for number in range(len(stored.groups))]
        return table_of_groups(groups, one_origin=True)


def _scale(conversion: Any) -> tuple[float, float, str]:
    """Factor and offset of a channel's conversion, or what a nonlinear one is."""
    if conversion is None:
        return 1.0, 0.0, ""
    is_new = conversion.id == b"##CC"
    kind = int(conversion.conversion_type)
    if kind == (0 if is_new else 65535):
        return 1.0, 0.0, ""
    if kind == (1 if is_new else 0):
        return float(conversion.a), float(conversion.b), ""
    if kind == (2 if is_new else 9):
        # (P1 x² + P2 x + P3) / (P4 x² + P5 x + P6)
        p = [float(getattr(conversion, f"P{i}")) for i in range(1, 7)]
        if p[0] == p[3] == p[4] == 0.0 != p[5]:
            return p[1] / p[5], p[2] / p[5], ""
    return 1.0, 0.0, "a formula or a table"


def _group(stored: Any, number: int) -> Group:
    channels = stored.groups[number].channels
    scales = [_scale(channel.conversion) for channel in channels]
    units = [_unit(channel) for channel in channels]
    for channel in channels:
        channel.conversion = None  # from here on asammdf has nothing to evaluate
    master = stored.masters_db.get(number)
    if master is not None and getattr(channels[master], "sync_type", 1) not in (0, 1):
        master = None  # an angle, a distance or a number of the sample
    time, withheld = None, ""
    if master is not None:
        factor, offset, withheld = scales[master]
        time = factor * np.asarray(stored.get_master(number)) + offset
    others = [index for index in range(len(channels)) if index != master]
    names = numbered([channels[index].name for index in others])
    columns: dict[str, AnyArray] = {}
    reasons: dict[str, str] = {}
    for name, index in zip(names, others, strict=True):
        signal = stored.get(group=number, index=index, raw=True, ignore_invalidation_bits=True)
        samples = np.asarray(signal.samples)
        if samples.ndim != 1:
            continue
        factor, offset, kind = scales[index]
        reason = kind or (withheld and f"{withheld} on its time")
        if reason:
            reasons[name] = f"values by {reason}, which is not applied"
            columns[name] = samples[:0]
        elif samples.dtype.kind in "biuf":
            columns[name] = factor * samples + offset
            if signal.invalidation_bits is not None:
                columns[name] = np.where(signal.invalidation_bits, np.nan, columns[name])
        else:
            columns[name] = samples
    stated = {name: units[index] for name, index in zip(names, others, strict=True)}
    stated[TIME] = "" if master is None else units[master]
    acquired = getattr(stored.groups[number].channel_group, "acq_name", "")
    return Group(
        acquired or f"group {number + 1}",
        columns,
        None if withheld else time,
        stated,
        reasons,
    )


def _unit(channel: Any) -> str:
    """Unit after the conversion, if there is one."""
    conversion = channel.conversion
    unit = getattr(conversion, "unit", "") or getattr(conversion, "unit_field", "")
    unit = unit or getattr(channel, "unit", "") or ""
    text = unit.decode("latin-1") if isinstance(unit, bytes) else str(unit)
    return text.strip("\0 ")
