"""Posterior of the gap by the direct route, beside the amplitude route's."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesbl.presentation.figures.change import draw_change, legend_lines, told
from bayesbl.presentation.figures.layout import LINE_IN, grid, one_panel_each
from bayesbl.presentation.figures.snapshots import GAP, Snapshot, credible_interval, snapshots
from bayesbl.presentation.figures.stored import curve_name
from bayesbl.presentation.figures.style import (
    LIMIT,
    NEUTRAL,
    SINGLE_COLUMN_IN,
    WITHHELD,
    head_panels,
    look,
    new_figure,
    publication_style,
)

_BINS = 40
_OTHER = "#d55e00"


@publication_style()
def direct_gap(tree: xr.DataTree) -> Figure:
    """A panel per snapshot: draws of δ, a normal curve as wide as the Cramér-Rao bound."""
    parts = snapshots(tree)
    figure, axes = one_panel_each(len(parts), shared=False)
    curve = curve_name(tree["curve"].attrs["name"])
    for index, (panel, snapshot) in enumerate(zip(axes, parts, strict=True)):
        _draw(panel, tree, snapshot, look(index).colour, curve)
    head_panels(axes, [_title(tree, snapshot) for snapshot in parts])
    return figure


@publication_style()
def direct_change(tree: xr.DataTree) -> Figure:
    """The change of δ between snapshots."""
    above = 0.3 + LINE_IN * legend_lines(tree)
    figure = new_figure(SINGLE_COLUMN_IN, 2.0 + above)
    panel = figure.add_subplot(grid(figure, 1, 1, top=above)[0, 0])
    draw_change(panel, tree, snapshots(tree))
    return figure


def _title(tree: xr.DataTree, snapshot: Snapshot) -> str:
    if snapshot.withheld:
        return f"{snapshot.name}: δ withheld"
    found = credible_interval(tree, 1e3 * snapshot.values("posterior", GAP))
    return f"{snapshot.name}: {told(tree, found)}"


def _draw(panel: Axes, tree: xr.DataTree, snapshot: Snapshot, colour: str, curve: str) -> None:
    draws = 1e3 * snapshot.values("posterior", GAP).ravel()
    shown = WITHHELD if snapshot.withheld else colour
    counts, edges = np.histogram(draws, _BINS, density=True)
    panel.stairs(counts, edges, fill=True, color=shown, alpha=0.3)
    panel.stairs(counts, edges, color=shown, label="posterior, direct")
    bound = 1e3 * float(snapshot.groups["optimum"]["cramer_rao_sd"].sel(parameter=GAP))
    centre = float(np.median(draws))
    sd = max(bound, float(draws.std()))
    x = np.linspace(centre - 4.0 * sd, centre + 4.0 * sd, 300)
    density = np.exp(-0.5 * ((x - centre) / bound) ** 2) / (bound * np.sqrt(2.0 * np.pi))
    panel.plot(
        x, density, color=NEUTRAL, linewidth=0.8, linestyle=(0.0, (3.0, 2.0)),
        label="as wide as the Cramér-Rao bound",
    )  # fmt: skip
    _draw_other(panel, tree, snapshot, curve)
    limit = tree.attrs.get("limit_rad")
    if limit is not None and x[0] < 1e3 * float(limit) < x[-1]:
        panel.axvline(1e3 * float(limit), color=LIMIT, linewidth=0.8)
    panel.set_xlim(x[0], x[-1])
    panel.set_ylim(0.0, 1.6 * max(counts.max(), density.max()))
    panel.set_xlabel("Gap δ (mrad)")
    panel.set_ylabel("Density (1/mrad)")
    panel.locator_params(axis="x", nbins=5)
    panel.legend(loc="upper left", borderaxespad=0.0)


def _draw_other(panel: Axes, tree: xr.DataTree, snapshot: Snapshot, curve: str) -> None:
    """The amplitude route's interval as a bar; most of it is usually beyond the panel."""
    draws = 1e3 * snapshot.values("amplitude_route", GAP).ravel()
    if not draws.size:
        return
    found = credible_interval(tree, draws)
    panel.plot(
        [found["low"], found["high"]], [0.02, 0.02], color=_OTHER, linewidth=2.0,
        solid_capstyle="butt", transform=panel.get_xaxis_transform(),
        label=f"by amplitude ({curve} curve):\n{told(tree, found)}",
    )  # fmt: skip
