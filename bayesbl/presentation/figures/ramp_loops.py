"""The loop of position over torque, with its model and the play between the flanks."""

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
    gap_colour,
    gap_in_words,
    snapshots,
)
from bayesbl.presentation.figures.stored_figure import holding, stored_figure


@stored_figure(
    "Position over torque at each position round the turn, the loop of play, compliance and "
    "friction, and the play.",
    10,
    holding("loop"),
    name="loop",
)
def ramp_loops(tree: xr.DataTree) -> Figure:
    """A panel per snapshot: its files from their middles; the band is the play, 2δ."""
    parts = snapshots(tree, "loop")
    lines = 2 if len(parts) == 1 else 1
    figure, axes = layout.one_panel_each(len(parts), 2.6, above=(lines + 0.2) * layout.LINE_IN)
    for index, (panel, snapshot) in enumerate(zip(axes, parts, strict=True)):
        _draw(panel, tree, snapshot, index)
    style.head_panels(axes, [gap_in_words(tree, snapshot) for snapshot in parts])
    most = max(axes, key=lambda panel: len(panel.lines))
    handles, labels = most.get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper left", bbox_to_anchor=(0.01, 1.0), ncols=4 // lines)
    return figure


def _draw(panel: Axes, tree: xr.DataTree, snapshot: Snapshot, index: int) -> None:
    torque, position, model, file, last = (
        snapshot.values("loop", name)
        for name in ("torque_nm", "position_rad", "model_rad", "file", "last")
    )
    low, high = snapshot.values("loop", "left_low_rad"), snapshot.values("loop", "left_high_rad")
    play = credible_interval(tree, 2e3 * snapshot.values("posterior", GAP))
    colour = gap_colour(snapshot, index)
    if not snapshot.withheld:
        panel.axhspan(
            -0.5 * play["median"], 0.5 * play["median"], color=colour, alpha=0.18, linewidth=0.0,
            label="play 2δ",
        )  # fmt: skip
        for side in (-1.0, 1.0):
            panel.errorbar(
                [0.0], [0.5 * side * play["median"]], yerr=panels.reach(play, 0.5), color=colour,
                capsize=2.5, zorder=4.0, linewidth=1.4,
            )  # fmt: skip
    for place, number in enumerate(np.unique(file)):
        middle = 0.5 * (low[place] + high[place])
        own = file == number
        panel.plot(
            torque[own], 1e3 * (position[own] - middle), color=style.MEASURED, linewidth=0.5,
            alpha=0.8, label="measured, every position and cycle" if place == 0 else None,
        )  # fmt: skip
        once = own & (last > 0.5)
        panel.plot(
            torque[once], 1e3 * (model[once] - middle), color=style.MODEL, linewidth=0.9,
            linestyle=style.look(place).dashes,
            label="model, the last cycle of each" if place == 0 else None,
        )  # fmt: skip
        panel.plot(
            [0.0, 0.0], 1e3 * (np.array([low[place], high[place]]) - middle), color=style.NEUTRAL,
            marker=style.look(place).marker, markersize=3.0, linestyle="none", zorder=5.0,
            label="left at zero torque" if place == 0 else None,
        )  # fmt: skip
    panel.axvline(0.0, color=style.NEUTRAL, linewidth=0.5)
    panel.set_xlabel("Torque at the output (N m)")
    if index % layout.MOST_COLUMNS == 0:  # the axes are shared
        panel.set_ylabel("Position at the output (mrad)")
