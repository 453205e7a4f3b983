"""The gap over its dates as a drawing in the page itself: small in a row, large on its own page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import date as Date
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from markupsafe import Markup

Row = Mapping[str, Any]


def sparkline(rows: Sequence[Row], limit_rad: float | None) -> Markup | str:
    """Medians with the band of their intervals, and the limit; nothing without a gap."""
    from markupsafe import Markup

    if not rows:
        return ""
    width, height, margin = 132.0, 30.0, 3.0
    x, y = _scales(rows, limit_rad, (margin, width - margin), (height - margin, margin))
    return Markup(
        f'<svg class="spark" width="{width:g}" height="{height:g}" '
        f'viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{_told(rows)}">'
        f"{_limit(limit_rad, y, 0.0, width)}{_drawn(rows, x, y, 2.0)}</svg>"
    )


def history(rows: Sequence[Row], limit_rad: float | None) -> Markup | str:
    """The same with its axes."""
    from markupsafe import Markup

    if not rows:
        return ""
    width, height = 760.0, 280.0
    left, right, top, bottom = 52.0, 14.0, 14.0, 34.0
    x, y = _scales(rows, limit_rad, (left + 8.0, width - right - 8.0), (height - bottom, top))
    highest = max([row["delta_rad_high"] for row in rows] + [limit_rad or 0.0])
    step = _step(1e3 * highest)
    ticks = [n * step for n in range(math.floor(1e3 * highest / step) + 1)]
    axes = "".join(
        f'<path class="grid" d="M{left} {y(1e-3 * v):.1f}H{width - right}"/>'
        f'<text x="{left - 6}" y="{y(1e-3 * v) + 4:.1f}" text-anchor="end">{v:g}</text>'
        for v in ticks
    )
    days = [rows[0]["date"]] if len(rows) == 1 else [rows[0]["date"], rows[-1]["date"]]
    anchors = ("start", "end")
    axes += "".join(
        f'<text x="{x(day):.1f}" y="{height - 10}" text-anchor="{anchor}">{day}</text>'
        for day, anchor in zip(days, anchors, strict=False)
    )
    bars = "".join(
        f'<path class="bar" d="M{x(r["date"]):.1f} {y(r["delta_rad_low"]):.1f}'
        f'V{y(r["delta_rad_high"]):.1f}"/>'
        for r in rows
    )
    return Markup(
        f'<svg class="history" viewBox="0 0 {width:g} {height:g}" role="img" '
        f'aria-label="{_told(rows)}">{axes}{_limit(limit_rad, y, left, width - right)}'
        f"{_drawn(rows, x, y, 3.5)}{bars}"
        f'<text x="{left}" y="{top - 2}">Gap (mrad)</text></svg>'
    )


def _scales(
    rows: Sequence[Row],
    limit_rad: float | None,
    across: tuple[float, float],
    up: tuple[float, float],
) -> tuple[Any, Any]:
    """From a date and from a gap to places; the gap's axis starts at 0, as shares are compared."""
    days = [Date.fromisoformat(row["date"]).toordinal() for row in rows]
    first, span = days[0], max(days[-1] - days[0], 1)
    highest = 1.08 * max([row["delta_rad_high"] for row in rows] + [limit_rad or 0.0])

    def x(day: str) -> float:
        share = (Date.fromisoformat(day).toordinal() - first) / span if len(rows) > 1 else 0.5
        return across[0] + share * (across[1] - across[0])

    def y(gap_rad: float) -> float:
        return float(up[0] + gap_rad / highest * (up[1] - up[0]))

    return x, y


def _drawn(rows: Sequence[Row], x: Any, y: Any, radius: float) -> str:
    places = [x(row["date"]) for row in rows]
    low, middle, high = (
        [f"{p:.1f},{y(row[f'delta_rad_{end}']):.1f}" for p, row in zip(places, rows, strict=True)]
        for end in ("low", "median", "high")
    )
    dots = "".join(
        f'<circle cx="{one.split(",")[0]}" cy="{one.split(",")[1]}" r="{radius:g}"/>'
        for one in (middle if radius > 3.0 else middle[-1:])
    )
    if len(rows) == 1:
        return dots
    band = " ".join([*high, *reversed(low)])
    return f'<polygon points="{band}"/><polyline points="{" ".join(middle)}"/>{dots}'


def _limit(limit_rad: float | None, y: Any, left: float, right: float) -> str:
    if limit_rad is None:
        return ""
    return f'<path class="limit" d="M{left:g} {y(limit_rad):.1f}H{right:g}"/>'


def _told(rows: Sequence[Row]) -> str:
    first, last = rows[0], rows[-1]
    start = f"{1e3 * first['delta_rad_median']:.3g} mrad on {first['date']}"
    if len(rows) == 1:
        return start
    return f"{start}, {1e3 * last['delta_rad_median']:.3g} mrad on {last['date']}"


def _step(highest: float) -> float:
    """1, 2 or 5 times a power of ten that divides an axis into four to ten."""
    rough = highest / 5.0
    power = 10.0 ** math.floor(math.log10(rough))
    return next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= rough)
