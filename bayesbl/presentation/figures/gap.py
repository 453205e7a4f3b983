"""The gap of every snapshot and its change, by each route that answers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date as Date

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesbl.measurement.stored import routes_of, stored_answers, summary_of
from bayesbl.presentation.figures import layout, panels, style
from bayesbl.presentation.figures.snapshots import (
    GAP,
    credible_interval,
    decimals,
    gap_colour,
    holds,
    interval_name,
)
from bayesbl.presentation.figures.stored_figure import holding, stored_figure
from bayesbl.presentation.words import route_in_words
from bayesbl.recording.types import FloatArray
from bayesbl.units import number

_ROW_IN = 0.5
_RIDGE = 0.6
"""Height of a density, in rows."""
_BINS = 60


@dataclass(frozen=True, slots=True)
class _Row:
    """Draws in mrad with what is written beside them; ``answers``: of the route that does."""

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
    """A row per snapshot and route: density, median and interval, on one axis with the limit."""
    gaps, changes = _gap_rows(tree), _change_rows(tree)
    count = max(len(gaps), len(changes))
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, 0.85 + _ROW_IN * count)
    columns = 2 if changes else 1
    spec = layout.grid(
        figure, 1, columns, left=1.45, right=0.2, between=(0.0, 1.25), widths=(1.35, 1.0)[:columns]
    )
    axes = [figure.add_subplot(spec[0, column]) for column in range(columns)]
    titles = [f"gap δ, {interval_name(tree)}"]
    limit = tree.attrs.get("limit_rad")
    _draw(axes[0], tree, gaps, count, "Gap δ (mrad)", limit)
    if changes:
        _draw(axes[1], tree, changes, len(changes), "Change of the gap δ (mrad)")
        axes[1].axvline(0.0, color=style.NEUTRAL, linewidth=0.8, linestyle=(0.0, (3.0, 2.0)))
        titles.append("change from first to last")
    style.head_panels(axes, titles)
    return figure


def _gap_rows(tree: xr.DataTree) -> list[_Row]:
    """Snapshot by snapshot, the route that answers first."""
    routes = [name for name in routes_of(tree) if holds(tree.children[name], f"posterior/{GAP}")]
    each = {route: stored_answers(tree, route) for route in routes}
    dates, rows = _dates(tree), []
    for index, (name, day) in enumerate(dates.items()):
        for route in routes:
            snapshot = each[route][index]
            label = name if route == routes[0] else ""
            if day and route == routes[0]:
                label = f"{name}, {day}"
            by = f"by {route_in_words(route)}" if len(routes) > 1 else ""
            rows.append(
                _Row(
                    "\n".join(filter(None, [label, by])),
                    1e3 * snapshot.values("posterior", GAP).ravel(),
                    gap_colour(snapshot, index),
                    route == routes[0],
                    snapshot.withheld,
                )
            )
    return rows


def _dates(tree: xr.DataTree) -> dict[str, str]:
    """Name of every snapshot to its date, or to nothing."""
    names = [str(name) for name in np.atleast_1d(tree.attrs["recordings"])]
    if "wear" not in tree.children:
        return dict.fromkeys(names, "")
    days = tree["wear"].to_dataset()["date"].values
    return {
        n: Date.fromisoformat(str(d)).strftime("%d %b %Y") for n, d in zip(names, days, strict=True)
    }


def _change_rows(tree: xr.DataTree) -> list[_Row]:
    """From first to last by each route; each step too where there are more, by the answer's."""
    if "change" not in tree.children:
        return []
    summary = summary_of(tree)
    names = [part["name"] for part in summary["snapshots"]]
    rows: list[_Row] = []
    for route in routes_of(tree):
        if not holds(tree.children[route], f"posterior/{GAP}"):
            continue
        first, *_, last = stored_answers(tree, route)
        drawn = 1e3 * (last.values("posterior", GAP) - first.values("posterior", GAP))
        withheld = summary["routes"][route]["change_rad"] is None
        rows.append(
            _Row(
                f"by {route_in_words(route)}",
                drawn.ravel(),
                style.WITHHELD if withheld else style.NEUTRAL,
                not rows,
                withheld,
            )
        )
    stored = tree["change"].to_dataset()
    if len(names) > 2:
        rows += [
            _Row(
                f"{step['from']} to\n{step['to']}",
                1e3 * stored["step_change_rad"].values[number].ravel(),
                style.WITHHELD if step["change_rad"] is None else style.look(number + 1).colour,
                True,
                step["change_rad"] is None,
            )
            for number, step in enumerate(summary["changes"])
        ]
    return rows


def _draw(
    panel: Axes,
    tree: xr.DataTree,
    rows: Sequence[_Row],
    count: int,
    label: str,
    limit_rad: float | None = None,
) -> None:
    """Rows from above; the others' densities are outlines, the answer's filled."""
    texts: list[tuple[float, int, str]] = []
    for place, row in enumerate(rows):
        heights, edges = np.histogram(row.draws, _BINS)
        ridge = place - _RIDGE * heights / max(int(heights.max()), 1)
        if row.answers:
            panel.stairs(ridge, edges, baseline=place, fill=True, color=row.colour, alpha=0.35)
        panel.stairs(ridge, edges, baseline=None, color=row.colour, linewidth=0.7)
        if row.withheld:
            text = "withheld"
        else:
            found = credible_interval(tree, row.draws)
            panel.plot(
                [found["low"], found["high"]], [place, place], color=row.colour, linewidth=2.2,
                solid_capstyle="butt",
            )  # fmt: skip
            panel.plot([found["median"]], [place], color=row.colour, marker="|", markersize=7.0,
                       markeredgewidth=1.4)  # fmt: skip
            places = decimals(found)
            ends = " to ".join(number(found[k], places) for k in ("low", "high"))
            text = f"{number(found['median'], places)}  ({ends})"
        texts.append((float(np.median(row.draws)), place, text))
    everything = [row.draws for row in rows]
    low = min(float(np.quantile(draws, 0.001)) for draws in everything)
    high = max(float(np.quantile(draws, 0.999)) for draws in everything)
    if limit_rad is not None:
        limit = 1e3 * float(limit_rad)
        panel.axvline(limit, color=style.LIMIT, linewidth=0.9, linestyle=panels.LIMIT_DASHES)
        panel.annotate(
            f"limit {limit:g}", (limit, -0.95), (-3.0, 0.0), textcoords="offset points",
            ha="right", va="top", fontsize=7.0,
        )  # fmt: skip
        low, high = min(low, limit), max(high, limit)
    room = 0.1 * (high - low)
    panel.set_xlim(low - room, high + room)
    for at, place, text in texts:
        share = (at - low + room) / (high - low + 2.0 * room)
        side = "left" if share < 0.3 else "right" if share > 0.7 else "center"
        away = {"left": -12.0, "right": 12.0, "center": 0.0}[side]
        panel.annotate(
            text, (at, place), (away, -4.5), textcoords="offset points", ha=side, va="top",
            fontsize=6.5,
        )  # fmt: skip
    panel.set_ylim(count - 0.45, -1.0)
    panel.set_yticks(range(len(rows)), [row.label for row in rows])
    panel.tick_params(axis="y", length=0.0)
    panel.spines["left"].set_visible(False)
    panel.grid(axis="x", color=style.NEUTRAL, alpha=0.15, linewidth=0.5)
    panel.set_xlabel(label)
