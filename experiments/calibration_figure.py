"""Calibration of a study: coverage less what was promised, and ranks less uniform, with bands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from calibration_statistics import (
    FALSE_ALARM,
    LEVELS,
    POINTS,
    coverage_band,
    ecdf,
    ecdf_band,
    uniformity,
)
from calibration_table import WORDS
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesbl.presentation.figures import style

if TYPE_CHECKING:
    import xarray as xr

_ROW_IN = 0.24
_NAMES_IN = 2.1
_RANKS_IN = 1.9


def draw_calibration(
    table: Sequence[Mapping[str, Any]], cases: Mapping[str, xr.Dataset], names: Sequence[str]
) -> Figure:
    """Coverage row by row at each level, and beneath it the distribution of ranks.

    Parameters
    ----------
    table
        The study's lines, each as :func:`calibration_table.calibration_line`
        makes it.
    cases
        By row; ``NAME_rank`` of each truth.
    names
        Of the quantities, in the order they are drawn; those that no row has are left out.
    """
    shown = [name for name in names if any(f"{name}_holds" in line for line in table)]
    rows = len(table)
    above = 0.3 + _ROW_IN * rows + 0.42
    with style.publication_style():
        figure = style.new_figure(style.DOUBLE_COLUMN_IN, above + 0.3 + _RANKS_IN)
        upper = style.grid(
            figure, 1, len(LEVELS), left=_NAMES_IN, bottom=0.72 + _RANKS_IN, between=(0.0, 0.15)
        )
        axes = [figure.add_subplot(upper[0, i]) for i in range(len(LEVELS))]
        for level, panel in zip(LEVELS, axes, strict=True):
            _coverage(panel, table, shown, level)
        axes[0].set_yticks(range(rows), [str(line["name"]) for line in table])
        axes[0].legend(loc="upper right", bbox_to_anchor=(-0.05, -0.02), handletextpad=0.2)
        lower = style.grid(figure, 1, len(shown), left=0.75, top=above + 0.3, between=(0.0, 0.6))
        below = [figure.add_subplot(lower[0, i]) for i in range(len(shown))]
        for name, panel in zip(shown, below, strict=True):
            _ranks(panel, table, cases, name)
        below[0].set_ylabel("Share of ranks below,\nless uniform")
        titles = [f"{p:.0%} intervals".replace("%", " %") for p in LEVELS]
        style.head_panels(
            [*axes, *below], [*titles, *(f"Ranks of {WORDS[name]}" for name in shown)]
        )
    return figure


def _coverage(
    panel: Axes, table: Sequence[Mapping[str, Any]], names: Sequence[str], level: float
) -> None:
    """Coverage less ``level`` in percentage points, with the band of exact intervals."""
    for y, line in enumerate(table):
        count = int(line["cases"]) - int(line["failed"])
        low, high = (100.0 * (end - level) for end in coverage_band(max(count, 1), level))
        panel.fill_between([low, high], y - 0.4, y + 0.4, color=style.BAND, linewidth=0.0)
        for index, name in enumerate(names):
            if f"{name}_holds" in line:
                own = style.look(index)
                panel.plot(
                    100.0 * (float(line[f"{name}_{level:.0%}"]) - level),
                    y + 0.7 / len(names) * (index - 0.5 * (len(names) - 1)),
                    color=own.colour, marker=own.marker, markersize=3.0, linestyle="none",
                    label=WORDS[name] if y == 0 else None,
                )  # fmt: skip
    panel.axvline(0.0, color=style.NEUTRAL, linewidth=0.6)
    panel.set_ylim(len(table) - 0.5, -0.5)
    panel.set_yticks([])
    panel.set_xlabel("covered − promised (%)")


def _ranks(
    panel: Axes, table: Sequence[Mapping[str, Any]], cases: Mapping[str, xr.Dataset], name: str
) -> None:
    """Distribution of ranks less the uniform one; named are the rows that leave the band."""
    points = np.arange(1, POINTS) / POINTS
    asked = [line for line in table if line.get(f"{name}_uniform_p") is not None]
    by_row = {str(line["name"]): _finished(cases[str(line["name"])], name) for line in asked}
    for count in sorted({ranks.size for ranks in by_row.values()}):
        low, high = ecdf_band(count)
        panel.fill_between(
            points, low - points, high - points, color=style.BAND, alpha=0.5, linewidth=0.0
        )
    named = 0
    for row, ranks in by_row.items():
        out = uniformity(ranks) < FALSE_ALARM
        own = style.look(named + 1)
        panel.plot(
            points, ecdf(ranks) - points,
            color=own.colour if out else style.NEUTRAL, linestyle=own.dashes if out else "-",
            linewidth=1.0 if out else 0.4, label=row if out else None,
        )  # fmt: skip
        named += out
    panel.axhline(0.0, color=style.NEUTRAL, linewidth=0.6)
    panel.set_xlim(0.0, 1.0)
    panel.set_xlabel("rank")
    if named:
        panel.legend(loc="lower left")


def _finished(cases: xr.Dataset, name: str) -> np.ndarray:
    """Ranks of the cases that did not fail."""
    ranks = cases[f"{name}_rank"].values
    return np.asarray(ranks[np.isfinite(ranks)])
