"""A row of ``recordings.parquet`` as one line, for a log."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayesbl.presentation.words import significant


def recording_line(row: Mapping[str, Any]) -> str:
    """Joint, date and gap with its interval, or why there is none."""
    what = f"{row['joint']}, {row['date']}: "
    if row["reason"] is not None:
        return what + str(row["reason"])
    middle, low, high = (
        significant(1e3 * row[f"delta_rad_{end}"], 3) for end in ("median", "low", "high")
    )
    return f"{what}gap {middle} mrad ({low} to {high})"
