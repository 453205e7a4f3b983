"""Figures of the gap: snapshots and change, the gap curve, and wear over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date as Date

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure

from bayesbl.measurement.stored import Snapshot, routes_of, stored_answers
from bayesbl.measurement.wear import DAYS_PER_YEAR, LONGEST_YEARS, WEAR, Laws, used_dates
from bayesbl.presentation.figures import style
from bayesbl.presentation.figures.stored_figure import (
    credible_interval,
    gap_colour,
    gap_in_words,
    gap_interval,
    holding,
    holds,
    interval_name,
    route_holding,
    snapshots,
    stored_figure,
)
from bayesbl.presentation.figures.style import GAP
from bayesbl.presentation.words import RAREST, bounds, curve_name, in_words, middle, probability
from bayesbl.recording.types import FloatArray
from bayesbl.results.store import summary_of
from bayesbl.results.variables import STACKED
from bayesbl.ringing.symbols import AMPLITUDE

_ROW_IN = 0.5
VISIBLE = 0.005  # share of a density's peak below which it is not drawn
_RIDGE = 0.6  # height of a density in rows


@dataclass(frozen=True, slots=True)
class _Row:
    """Draws in mrad with their label; ``answers``: drawn by the answering route."""

    label: str
    draws: FloatArray
    colour: str
    answers: bool
    withheld: bool


@stored_figure(
    "(a) The gap of each snapshot by each route, with the limit; (b) its change from first to last"
    ".",
    20,
    holding("gap/delta_rad"),
)
def gap(tree: xr.DataTree) -> Figure:
    """A row for each snapshot and route: density, median and interval, with the limit."""
    gaps, changes = _gap_rows(tree), _change_rows(tree)
    count = max(len(gaps), len(changes))
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, 0.85 + _ROW_IN * count)
    columns = 2 if changes else 1
    spec = style.grid(
        figure, 1, columns, left=1.45, right=0.2, between=(0.0, 1.25), widths=(1.35, 1.0)[:columns]
    )
    axes = [figure.add_subplot(spec[0, column]) for column in range(columns)]
    titles = [f"gap δ, {interval_name(tree)}"]
    _draw_rows(axes[0], tree, gaps, count, "Gap δ (mrad)", tree.attrs.get("limit_rad"))
    if changes:
        _draw_rows(axes[1], tree, changes, len(changes), "Change of the gap δ (mrad)")
        axes[1].axvline(0.0, color=style.NEUTRAL, linewidth=0.8, linestyle=(0.0, (3.0, 2.0)))
        titles.append("change from first to last")
    style.head_panels(axes, titles)
    return figure


def _gap_rows(tree: xr.DataTree) -> list[_Row]:
    """Rows by snapshot, with its date if it has one; the answering route first."""
    routes = [name for name in routes_of(tree) if holds(tree.children[name], f"posterior/{GAP}")]
    each = {route: stored_answers(tree, route) for route in routes}
    names = [str(name) for name in np.atleast_1d(tree.attrs["recordings"])]
    if "wear" in tree.children:
        dates = map(Date.fromisoformat, map(str, tree["wear"].to_dataset()["date"].values))
        names = [f"{name}, {day:%d %b %Y}" for name, day in zip(names, dates, strict=True)]
    rows = []
    for index, name in enumerate(names):
        for route in routes:
            snapshot, answers = each[route][index], route == routes[0]
            label = [name] * answers + [f"by {in_words(route)}"] * (len(routes) > 1)
            draws = 1e3 * snapshot.values("posterior", GAP).ravel()
            colour = style.look(index).colour
            rows.append(_Row("\n".join(label), draws, colour, answers, snapshot.withheld))
    return rows


def _change_rows(tree: xr.DataTree) -> list[_Row]:
    """Change from first to last by each route, and each step by the answering route."""
    if "change" not in tree.children:
        return []
    summary = summary_of(tree)
    rows: list[_Row] = []
    for route in routes_of(tree):
        if not holds(tree.children[route], f"posterior/{GAP}"):
            continue
        first, *_, last = stored_answers(tree, route)
        draws = 1e3 * (last.values("posterior", GAP) - first.values("posterior", GAP)).ravel()
        withheld = summary["routes"][route]["change_rad"] is None
        rows.append(_Row(f"by {in_words(route)}", draws, style.NEUTRAL, not rows, withheld))
    stored, steps = tree["change"].to_dataset(), summary["changes"]
    for number, step in enumerate(steps if len(steps) > 1 else ()):
        draws = 1e3 * stored["step_change_rad"].values[number].ravel()
        label, colour = f"{step['from']} to\n{step['to']}", style.look(number + 1).colour
        rows.append(_Row(label, draws, colour, True, step["change_rad"] is None))
    return rows


def density(draws: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Places and heights of a density, up to its edges; draws of a withheld gap may be equal."""
    from arviz_stats.base import array_stats

    if np.ptp(draws) == 0.0:
        return draws[:1], np.ones(1)
    # Silverman's width is zero where half of the draws, of no gap at all, are alike.
    half = float(np.ptp(np.quantile(draws, (0.25, 0.75))))
    width = "silverman" if half > 0.0 else 0.9 * float(draws.std()) * draws.size**-0.2
    across, heights, _ = array_stats.kde(draws, bw=width, bound_correction=False)
    return across, heights


def _draw_rows(
    panel: Axes,
    tree: xr.DataTree,
    rows: Sequence[_Row],
    count: int,
    label: str,
    limit_rad: float | None = None,
) -> None:
    """Draw rows from top to bottom; only the answer's densities are filled."""
    drawn = []
    for row in rows:
        across, heights = density(row.draws)
        visible = heights > VISIBLE * heights.max()
        drawn.append((across[visible], heights[visible] / heights.max()))
    low = min(float(across[0]) for across, _ in drawn)
    high = max(float(across[-1]) for across, _ in drawn)
    if limit_rad is not None:
        limit = 1e3 * float(limit_rad)
        panel.annotate(
            f"limit {limit:g}", (limit, -0.95), (-3.0, 0.0), textcoords="offset points",
            ha="right", va="top", fontsize=7.0,
        )  # fmt: skip
        low, high = min(low, limit), max(high, limit)
    # Draws of a withheld gap may all be the same.
    room = 0.05 * ((high - low) or abs(high) or 1.0)
    panel.set_xlim(low - room, high + room)
    for place, (row, (across, heights)) in enumerate(zip(rows, drawn, strict=True)):
        ridge, colour = place - _RIDGE * heights, style.WITHHELD if row.withheld else row.colour
        if row.answers:
            panel.fill_between(across, ridge, place, color=colour, alpha=0.35, linewidth=0.0)
        panel.plot(across, ridge, color=colour, linewidth=0.7)
        at, text = float(np.median(row.draws)), "withheld"
        if not row.withheld:
            interval = credible_interval(tree, row.draws)
            ends = [interval["low"], interval["high"]]
            panel.plot(ends, [place, place], color=colour, lw=2.2, solid_capstyle="butt")
            panel.plot(interval["median"], place, "|", color=colour, ms=7.0, mew=1.4)
            text = f"{middle(interval)}  ({bounds(interval)})"
        share = (at - low + room) / (high - low + 2.0 * room)
        side = "left" if share < 0.3 else "right" if share > 0.7 else "center"
        away = {"left": -12.0, "right": 12.0, "center": 0.0}[side]
        panel.annotate(
            text, (at, place), (away, -4.5), textcoords="offset points", ha=side, va="top",
            fontsize=7.0,
        )  # fmt: skip
    if limit_rad is not None:  # above the densities
        panel.axvline(limit, color=style.LIMIT, linewidth=0.9, linestyle=style.LIMIT_DASHES)
    panel.set(ylim=(count - 0.45, -1.0), xlabel=label)
    panel.set_yticks(range(len(rows)), [row.label for row in rows])
    panel.tick_params(axis="y", length=0.0)
    panel.spines["left"].set_visible(False)
    panel.grid(axis="x", color=style.NEUTRAL, alpha=0.15, linewidth=0.5)


THROUGH = "curve_amplitude_rpm"
_MOST_SHOWN = 400  # largest number of draws shown


@stored_figure(
    "The gap curve, which converts each draw of the ringing's amplitude to a gap, and the "
    "intervals of both.",
    30,
    holding("posterior/curve_amplitude_rpm", "curve/delta_rad"),
)
def amplitude_to_gap(tree: xr.DataTree) -> Figure:
    """δ against A, with draws of both."""
    parts = snapshots(tree, "posterior/curve_amplitude_rpm")
    lines = 2 + len(parts) + ("limit_rad" in tree.attrs)
    top = 0.1 + style.LINE_IN * ((lines + 1) // 2)
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, top + 2.9)
    panel = figure.add_subplot(style.grid(figure, 1, 1, top=top)[0, 0])
    curve = tree[f"{route_holding(tree, 'curve')}/curve"].to_dataset()
    stacked = STACKED in curve.dims
    for name in curve[STACKED].values if stacked else ("",):
        own = curve.sel({STACKED: name}) if stacked else curve
        which, band = curve_name(own.attrs["name"]), style.band_in_words(own)
        label = f"gap curve{f' of {name}' if name else ''} ({which}), {band}"
        style.draw_curve(panel, own, style.NEUTRAL, label, None)
    for index, snapshot in enumerate(parts):
        _draw_snapshot(panel, tree, snapshot, index)
    _set_view(panel, tree, parts)
    style.limit_line(panel, tree)
    panel.set(xlabel="Amplitude of the ringing A (rpm)", ylabel="Gap δ (mrad)")
    style.legend_over(figure, panel, 2)
    return figure


def _draw_snapshot(main: Axes, tree: xr.DataTree, snapshot: Snapshot, index: int) -> None:
    """Draws, their medians and intervals; hollow and grey if withheld."""
    drawn, gaps = (snapshot.values("posterior", name).ravel() for name in (THROUGH, GAP))
    shown = slice(None, None, max(1, drawn.size // _MOST_SHOWN))
    colour = gap_colour(snapshot, index)
    main.plot(
        drawn[shown], 1e3 * gaps[shown], linestyle="none", marker=".", markersize=1.6,
        markeredgewidth=0.0, color=colour, alpha=0.45, zorder=2.0,
    )  # fmt: skip
    amplitude, delta = credible_interval(tree, drawn), gap_interval(tree, snapshot)
    main.errorbar(
        amplitude["median"],
        delta["median"],
        xerr=style.reach(amplitude),
        yerr=style.reach(delta),
        capsize=2.0,
        zorder=3.0,
        label=gap_in_words(tree, snapshot),
        color=colour,
        marker=style.look(index).marker,
        markerfacecolor="white" if snapshot.withheld else colour,
        linestyle="none",
    )


def _set_view(main: Axes, tree: xr.DataTree, parts: list[Snapshot]) -> None:
    """Show the posteriors, and a limit that is near."""
    for name, factor, setter in ((AMPLITUDE, 1.0, main.set_xlim), (GAP, 1e3, main.set_ylim)):
        draws = np.concatenate([p.values("posterior", name).ravel() for p in parts])
        low, high = map(float, np.quantile(draws, (0.001, 0.999)))
        margin = max(0.35 * (high - low), 0.12 * high)
        limit = tree.attrs.get("limit_rad")
        bottom, top = max(0.0, low - margin), high + margin
        if limit is not None and name == GAP and low - 3.0 * margin < limit < high + 3.0 * margin:
            bottom, top = min(bottom, 0.97 * float(limit)), max(top, 1.05 * float(limit))
        setter(factor * bottom, factor * top)


_HIGHEST_VIEW = 1.3  # end of the view, in multiples of limit and gaps; a path may run far out
_LONGEST_VIEW = 3.0  # how far ahead the view extends, in times since the first snapshot in use


@stored_figure(
    "(a) The gap against the date, with its path; (b) the probability that it reached the limit.",
    5,
    holding(WEAR.name),
)
def wear(tree: xr.DataTree) -> Figure:
    """δ of every dated snapshot with its path, and when the limit is reached."""
    group = tree[WEAR.name].to_dataset()
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, 2.9)
    limited = "years_to_limit" in group
    spec = style.grid(figure, 1, 2 if limited else 1, top=0.6)
    panels = [figure.add_subplot(spec[0, 0])]
    titles = ["gap and its path" + (" since the repair" if np.any(group["used"] == 0.0) else "")]
    ahead = _years_ahead(group)
    _draw_gaps(panels[0], tree, group, ahead)
    if limited:
        panels.append(figure.add_subplot(spec[0, 1]))
        titles.append("probability that the limit is reached")
        _draw_limit_reached(panels[1], group, ahead)
    for panel in panels:
        locator = AutoDateLocator(minticks=3, maxticks=7)  # type: ignore[no-untyped-call]
        formatter = ConciseDateFormatter(locator)  # type: ignore[no-untyped-call]
        panel.xaxis.set(major_locator=locator, major_formatter=formatter)
        panel.set_xlabel("Date")
    style.head_panels(panels, titles)
    style.legend_over(figure, panels[0])
    return figure


def path_band(group: xr.Dataset, years: FloatArray, level: float) -> FloatArray:
    """Low, median and high of the mean path, by years from the last snapshot, shape (3, n), rad.

    Equal-tailed. Between first and last gap, the path follows the law that connects them; beyond,
    the law without irregular wear.
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
    """Probability that the limit is reached within these years from the last snapshot."""
    times = np.sort(group["years_to_limit"].values.ravel())
    return np.asarray(np.searchsorted(times, years, side="right") / times.size)


def _days(days: list[Date]) -> FloatArray:
    """Days since 1970, as matplotlib counts them."""
    return np.array(days, dtype="datetime64[D]").astype(np.float64)


def _years_ahead(group: xr.Dataset) -> float:
    """When 80 % of the draws have reached the limit, within the longest view."""
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
        label = f"{interval_name(tree)} of the path"
        panel.fill_between(shown, low, high, color=style.BAND, linewidth=0.0, label=label)
        panel.plot(shown, middle, color=style.MODEL, label="path, median")
    parts, used = snapshots(tree), group["used"].values
    every = _days([Date.fromisoformat(str(day)) for day in group["date"].values])
    for index, (day, part) in enumerate(zip(every, parts, strict=True)):
        interval = gap_interval(tree, part)
        colour = gap_colour(part, 1) if used[index] or part.withheld else style.NEUTRAL
        panel.errorbar(
            day,
            interval["median"],
            yerr=style.reach(interval),
            color=colour,
            marker=style.look(1).marker,
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
            above = bool(interval["low"] > 1e3 * path_band(group, at, level)[1, 0])
        panel.annotate(
            f"{part.name}: withheld" if part.withheld else part.name,
            (day, interval["high" if above else "low"]),
            xytext=(0.0, 4.0) if above else (4.0, -4.0), textcoords="offset points",
            ha="center" if above else "left", va="bottom" if above else "top", fontsize=7.0,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6}, zorder=0.5,
        )  # fmt: skip
    if np.any(used == 0.0):
        first = every[np.flatnonzero(used)[0]]
        panel.axvline(
            first, color=style.NEUTRAL, linewidth=0.6, linestyle=":", label="after the repair"
        )
    style.limit_line(panel, tree)
    panel.margins(y=0.12)
    gaps = [gap_interval(tree, part) for part in parts]
    lowest = min(interval["low"] for interval in gaps)
    limit = 1e3 * float(tree.attrs.get("limit_rad", 0.0))
    highest = max(limit, *(interval["high"] for interval in gaps))
    room = (_HIGHEST_VIEW - 1.0) * highest
    panel.set(ylim=(max(0.0, lowest - 0.5 * room), highest + room), ylabel="Gap δ (mrad)")


def _draw_limit_reached(panel: Axes, group: xr.Dataset, ahead: float) -> None:
    years = np.linspace(0.0, ahead, 300)
    last = _days(used_dates(group))[-1]
    passed = float(reached(group, np.zeros(1))[0])
    if passed > RAREST:
        label = f"passed before {used_dates(group)[-1]}: {probability(passed)}"
        panel.plot([last], [passed], "o", color=style.MODEL, label=label)
    panel.plot(last + DAYS_PER_YEAR * years, reached(group, years), color=style.MODEL)
    if "decide_before" in group.attrs:
        asked = group.attrs["decide_before"]
        day = _days([Date.fromisoformat(asked)])[0]
        share = float(reached(group, np.array([(day - last) / DAYS_PER_YEAR]))[0])
        panel.axvline(day, color=style.NEUTRAL, linewidth=0.8, linestyle=(0.0, (3.0, 2.0)))
        panel.plot(
            [day], [share], "o", color=style.NEUTRAL, label=f"by {asked}: {probability(share)}"
        )
    if panel.get_legend_handles_labels()[0]:
        panel.legend(loc="lower right")
    panel.set(ylim=(0.0, 1.03), ylabel="Probability")
