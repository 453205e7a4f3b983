"""Motor less load over the load's angle, with the play between both directions."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesbl.presentation.figures import layout, style
from bayesbl.presentation.figures.snapshots import (
    GAP,
    Snapshot,
    credible_interval,
    gap_colour,
    gap_in_words,
    snapshots,
)
from bayesbl.presentation.figures.stored_figure import holding, stored_figure


@stored_figure(
    "Motor less load over the angle, skew, ratio and transmission error taken out: forwards and "
    "backwards, the model's way through the gap, and the play.",
    10,
    holding("transmission"),
    name="flanks",
)
def flank_paths(tree: xr.DataTree) -> Figure:
    """A panel per snapshot; the band is the play, 2δ."""
    parts = snapshots(tree, "transmission")
    figure, axes = layout.one_panel_each(len(parts), 2.6, above=1.2 * layout.LINE_IN)
    for index, (panel, snapshot) in enumerate(zip(axes, parts, strict=True)):
        _draw(panel, tree, snapshot, index)
    style.head_panels(axes, [gap_in_words(tree, snapshot) for snapshot in parts])
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper left", bbox_to_anchor=(0.01, 1.0), ncols=4)
    return figure


def _draw(panel: Axes, tree: xr.DataTree, snapshot: Snapshot, index: int) -> None:
    angle, forward, lag, model = (
        snapshot.values("transmission", name)
        for name in ("position_rad", "forward", "lag_rad", "model_rad")
    )
    for way, look, label in ((1.0, style.look(0), "forwards"), (0.0, style.look(1), "backwards")):
        own = forward == way
        panel.plot(
            angle[own], 1e3 * lag[own], color=style.MEASURED, marker=look.marker, markersize=1.5,
            linestyle="none", alpha=0.5, label=label,
        )  # fmt: skip
    panel.plot(angle, 1e3 * model, color=style.MODEL, linewidth=0.6, alpha=0.7, label="model")
    if not snapshot.withheld:
        play = credible_interval(tree, 1e3 * snapshot.values("posterior", GAP))
        panel.axhspan(
            -play["median"], play["median"], color=gap_colour(snapshot, index), alpha=0.18,
            linewidth=0.0, label="play 2δ",
        )  # fmt: skip
    spread = 1e3 * float(np.quantile(np.abs(lag), 0.995))
    panel.set_ylim(-1.3 * spread - 1e-9, 1.3 * spread + 1e-9)
    panel.set_xlabel("Angle of the load (rad)")
    if index % layout.MOST_COLUMNS == 0:  # the axes are shared
        panel.set_ylabel("Motor less load (mrad)")
