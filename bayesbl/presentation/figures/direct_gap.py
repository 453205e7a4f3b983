"""Posterior of the gap by the direct route, beside the amplitude route's."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesbl.presentation.figures import layout, panels, style
from bayesbl.presentation.figures.snapshots import (
    GAP,
    Snapshot,
    credible_interval,
    curve_name,
    gap_colour,
    gap_in_words,
    interval_in_words,
    snapshots,
)
from bayesbl.presentation.figures.stored_figure import holding, stored_figure

_OTHER = "#009e73"  # neither of the first two snapshots'


@stored_figure(
    "The distribution of each gap, a panel a snapshot; dashed: as wide as the Cramér-Rao bound; "
    "the bar below: the interval by the ringing's amplitude.",
    20,
    holding("optimum/cramer_rao_sd"),
    name="gap",
)
def direct_gap(tree: xr.DataTree) -> Figure:
    """A panel per snapshot: draws of δ, a normal curve as wide as the Cramér-Rao bound."""
    parts = snapshots(tree)
    figure, axes = layout.one_panel_each(len(parts), shared=False)
    curve = curve_name(tree["curve"].attrs["name"]) if "curve" in tree.children else ""
    for index, (panel, snapshot) in enumerate(zip(axes, parts, strict=True)):
        _draw(panel, tree, snapshot, gap_colour(snapshot, index), curve)
    style.head_panels(axes, [gap_in_words(tree, snapshot) for snapshot in parts])
    return figure


def _draw(panel: Axes, tree: xr.DataTree, snapshot: Snapshot, colour: str, curve: str) -> None:
    draws = 1e3 * snapshot.values("posterior", GAP).ravel()
    heights, _ = panels.density(panel, draws, colour, label="posterior, direct")
    sd = 1e3 * float(snapshot.groups["optimum"]["cramer_rao_sd"].sel(parameter=GAP))
    centre, width = float(np.median(draws)), 4.0 * max(sd, float(draws.std()))
    x = np.linspace(centre - width, centre + width, 300)
    bound = np.exp(-0.5 * ((x - centre) / sd) ** 2) / (sd * np.sqrt(2.0 * np.pi))
    panel.plot(
        x, bound, color=style.NEUTRAL, linewidth=0.8, linestyle=(0.0, (3.0, 2.0)),
        label="as wide as the Cramér-Rao bound",
    )  # fmt: skip
    _draw_other(panel, tree, snapshot, curve)
    limit = tree.attrs.get("limit_rad")
    if limit is not None and x[0] < 1e3 * float(limit) < x[-1]:
        panel.axvline(1e3 * float(limit), color=style.LIMIT, linewidth=0.8)
    panel.set_xlim(x[0], x[-1])
    panel.set_ylim(0.0, 1.6 * max(heights.max(), bound.max()))
    panel.set_xlabel("Gap δ (mrad)")
    panel.set_ylabel("Density (1/mrad)")
    panel.locator_params(axis="x", nbins=5)
    panel.legend(loc="upper left", borderaxespad=0.0)


def _draw_other(panel: Axes, tree: xr.DataTree, snapshot: Snapshot, curve: str) -> None:
    """The amplitude route's interval as a bar; most of it is usually beyond the panel."""
    if "amplitude_route" not in snapshot.groups:
        return
    draws = 1e3 * snapshot.values("amplitude_route", GAP).ravel()
    if not draws.size:
        return
    found = credible_interval(tree, draws)
    panel.plot(
        [found["low"], found["high"]], [0.02, 0.02], color=_OTHER, linewidth=2.0,
        solid_capstyle="butt", transform=panel.get_xaxis_transform(),
        label=f"by amplitude ({curve} curve):\n{interval_in_words(tree, found)}",
    )  # fmt: skip
