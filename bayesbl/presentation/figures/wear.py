"""The gap against the date, its mean path, and when it reaches the limit."""

from __future__ import annotations

from datetime import date as Date

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure

from bayesbl.measurement.dated_wear import DAYS_PER_YEAR, WEAR, used_dates
from bayesbl.measurement.wear import LONGEST_YEARS
from bayesbl.measurement.wear_laws import Laws
from bayesbl.presentation.figures import layout, panels, style
from bayesbl.presentation.figures.snapshots import (
    gap_colour,
    gap_interval,
    interval_name,
    snapshots,
)
from bayesbl.presentation.figures.stored_figure import holding, stored_figure
from bayesbl.recording.types import FloatArray

_RAREST = 0.005
"""A probability nearer than this to 0 or 1 is given as less than 1 % or more than 99 %."""

_HIGHEST_VIEW = 1.3
"""How far beyond the limit and the gaps is shown: a path that speeds up would hide them."""

_LONGEST_VIEW = 3.0
"""How far ahead is shown at most, in times since the first snapshot in use."""


@stored_figure(
    "(a) The gap against the date, with its path; (b) the probability that it reached the limit.",
    5,
    holding(WEAR.name),
)
def wear(tree: xr.DataTree) -> Figure:
    """δ of every dated snapshot with its path since the last repair; when the limit is reached."""
    group = tree[WEAR.name].to_dataset()
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, 2.9)
    limited = "years_to_limit" in group
    spec = layout.grid(figure, 1, 2 if limited else 1, top=0.6)
    panels, titles = (
        [figure.add_subplot(spec[0, 0])],
        ["gap and its path" + (" since the repair" if np.any(group["used"] == 0.0) else "")],
    )
    ahead = _years_ahead(group)
    _draw_gaps(panels[0], tree, group, ahead)
    if limited:
        panels.append(figure.add_subplot(spec[0, 1]))
        titles.append("probability that the limit is reached")
        _draw_limit_reached(panels[1], group, ahead)
    for panel in panels:
        locator = AutoDateLocator(minticks=3, maxticks=7)  # type: ignore[no-untyped-call]
        panel.xaxis.set_major_locator(locator)
        formatter = ConciseDateFormatter(locator)  # type: ignore[no-untyped-call]
        panel.xaxis.set_major_formatter(formatter)
        panel.set_xlabel("Date")
    style.head_panels(panels, titles)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper left", bbox_to_anchor=(0.01, 1.0), ncols=4)
    return figure


def path_band(group: xr.Dataset, years: FloatArray, level: float) -> FloatArray:
    """Low, median and high of the mean path, years from the last snapshot, shape (3, n), rad.

    Equal-tailed: between first and last gap by the law that leads from one to the other, beyond
    by the law alone, without what irregular wear adds.
    """
    days = _days(used_dates(group))
    span = (days[-1] - days[0]) / DAYS_PER_YEAR
    laws = Laws(group["law_shape"].values.reshape(-1, group["law"].size))
    first, current, expected = (
        group[name].values.ravel() for name in ("first_rad", "current_rad", "expected_growth_rad")
    )
    quantiles = [0.5 - 0.5 * level, 0.5, 0.5 + 0.5 * level]
    bands = []
    for elapsed in 1.0 + years / span:
        share = laws.grown(np.asarray(elapsed)) - 1.0
        path = current + share * np.where(elapsed < 1.0, current - first, expected)
        bands.append(np.quantile(path, quantiles))
    return np.transpose(bands)


def reached(group: xr.Dataset, years: FloatArray) -> FloatArray:
    """Probability that the limit is reached within so many years of the last snapshot."""
    times = np.sort(group["years_to_limit"].values.ravel())
    return np.asarray(np.searchsorted(times, years, side="right") / times.size)


def _days(days: list[Date]) -> FloatArray:
    """Days since 1970, which is how matplotlib counts them."""
    return np.array(days, dtype="datetime64[D]").astype(np.float64)


def _years_ahead(group: xr.Dataset) -> float:
    """Up to where 80 % of the draws have reached the limit, or as far as the path may be drawn."""
    days = _days(used_dates(group))
    span = (days[-1] - days[0]) / DAYS_PER_YEAR
    ahead = 0.5 * span
    if "years_to_limit" in group:
        ahead = float(np.quantile(group["years_to_limit"].values, 0.8))
    if "decide_before" in group.attrs:
        asked = _days([Date.fromisoformat(group.attrs["decide_before"])])[0] - days[-1]
        ahead = max(ahead, 1.2 * asked / DAYS_PER_YEAR)
        return float(min(ahead, max(_LONGEST_VIEW * span, 1.2 * asked / DAYS_PER_YEAR)))
    return float(np.clip(ahead, 0.2 * span, min(_LONGEST_VIEW * span, LONGEST_YEARS)))


def _draw_gaps(panel: Axes, tree: xr.DataTree, group: xr.Dataset, ahead: float) -> None:
    has_rate = "law" in group
    days = _days(used_dates(group))
    level = float(tree.attrs["interval_level"])
    if has_rate:
        years = np.linspace((days[0] - days[-1]) / DAYS_PER_YEAR, ahead, 100)
        shown = days[-1] + DAYS_PER_YEAR * years
        low, middle, high = 1e3 * path_band(group, years, level)
        panel.fill_between(
            shown,
            low,
            high,
            color=style.BAND,
            linewidth=0.0,
            label=f"{interval_name(tree)} of the path",
        )
        panel.plot(shown, middle, color=style.MODEL, label="path, median")
    parts, used = snapshots(tree), group["used"].values
    every = _days([Date.fromisoformat(str(day)) for day in group["date"].values])
    own = style.look(1)
    for index, (day, part) in enumerate(zip(every, parts, strict=True)):
        found = gap_interval(tree, part)
        colour = gap_colour(part, 1) if used[index] or part.withheld else style.NEUTRAL
        panel.errorbar(
            [day],
            [found["median"]],
            yerr=panels.reach(found),
            color=colour,
            marker=own.marker,
            markerfacecolor=colour if used[index] and not part.withheld else "white",
            linestyle="none",
            markersize=3.0,
            capsize=2.5,
            zorder=3.0,
            label=None if index else f"gap with its {interval_name(tree)}",
        )
        above = False  # on the side of the point where the path is not
        if has_rate and used[index]:
            at = np.array([(day - days[-1]) / DAYS_PER_YEAR])
            above = bool(found["low"] > 1e3 * path_band(group, at, level)[1, 0])
        panel.annotate(
            f"{part.name}: withheld" if part.withheld else part.name,
            (day, found["high" if above else "low"]),
            xytext=(0.0, 4.0) if above else (4.0, -4.0), textcoords="offset points",
            ha="center" if above else "left", va="bottom" if above else "top", fontsize=7.0,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6}, zorder=0.5,
        )  # fmt: skip
    if np.any(used == 0.0):
        first = every[np.flatnonzero(used)[0]]
        panel.axvline(
            first, color=style.NEUTRAL, linewidth=0.6, linestyle=":", label="after the repair"
        )
    panels.limit_line(panel, tree)
    panel.margins(y=0.12)
    gaps = [gap_interval(tree, part) for part in parts]
    lowest = min(found["low"] for found in gaps)
    limit = 1e3 * float(tree.attrs.get("limit_rad", 0.0))
    highest = max(limit, *(found["high"] for found in gaps))
    room = (_HIGHEST_VIEW - 1.0) * highest
    panel.set_ylim(max(0.0, lowest - 0.5 * room), highest + room)
    panel.set_ylabel("Gap δ (mrad)")


def _draw_limit_reached(panel: Axes, group: xr.Dataset, ahead: float) -> None:
    years = np.linspace(0.0, ahead, 300)
    last = _days(used_dates(group))[-1]
    passed = float(reached(group, np.zeros(1))[0])
    if passed > _RAREST:
        low = passed < 0.2  # no room below
        panel.plot([last], [passed], color=style.MODEL, marker="o")
        panel.annotate(
            f"passed before {used_dates(group)[-1]}: {_share(passed)}", (last, passed),
            xytext=(4.0, 6.0 if low else -6.0), textcoords="offset points",
            va="bottom" if low else "top", fontsize=7.0,
        )  # fmt: skip
    panel.plot(last + DAYS_PER_YEAR * years, reached(group, years), color=style.MODEL)
    if "decide_before" in group.attrs:
        asked = group.attrs["decide_before"]
        day = _days([Date.fromisoformat(asked)])[0]
        share = float(reached(group, np.array([(day - last) / DAYS_PER_YEAR]))[0])
        panel.axvline(day, color=style.NEUTRAL, linewidth=0.8, linestyle=(0.0, (3.0, 2.0)))
        panel.plot([day], [share], color=style.NEUTRAL, marker="o")
        early = day < last + 0.5 * DAYS_PER_YEAR * ahead  # no room before
        panel.annotate(
            f"by {asked}: {_share(share)}", (day, share),
            xytext=(4.0, -4.0) if early else (-4.0, 4.0), textcoords="offset points",
            ha="left" if early else "right", va="top" if early else "bottom", fontsize=7.0,
        )  # fmt: skip
    panel.set_ylim(0.0, 1.03)
    panel.set_ylabel("Probability")


def _share(probability: float) -> str:
    """``68 %``; never 0 % or 100 %, which no number of draws can show."""
    if probability < _RAREST:
        return "< 1 %"
    return "> 99 %" if probability > 1.0 - _RAREST else f"{100.0 * probability:.0f} %"
