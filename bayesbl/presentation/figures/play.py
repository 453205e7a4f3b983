"""Figures of directly measured play: torque ramps, and encoders at motor and load."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesbl.measurement.stored import Snapshot
from bayesbl.presentation.figures import style
from bayesbl.presentation.figures.stored_figure import (
    credible_interval,
    gap_colour,
    gap_in_words,
    holding,
    snapshots,
    stored_figure,
)
from bayesbl.presentation.figures.style import GAP


@stored_figure(
    "Position over torque at each position around the turn, and the play.",
    10,
    holding("loop"),
    name="loop",
)
def ramp_loops(tree: xr.DataTree) -> Figure:
    """A panel for each snapshot with its files, centred; the band is the play 2δ."""
    labels = "Torque at the output (N m)", "Position at the output (mrad)"
    return _panels(tree, "loop", _draw_ramp_loops, labels)


def _panels(
    tree: xr.DataTree,
    group: str,
    draw: Callable[[Axes, xr.DataTree, Snapshot, int], None],
    labels: tuple[str, str],
) -> Figure:
    """A panel for each snapshot that the route with this group stores."""
    parts = snapshots(tree, group)
    lines = 2 if len(parts) == 1 and group == "loop" else 1
    above = (lines + 0.2) * style.LINE_IN  # for the legend
    columns = min(len(parts), 2)
    rows = math.ceil(len(parts) / columns)
    width = style.SINGLE_COLUMN_IN if len(parts) == 1 else style.DOUBLE_COLUMN_IN
    figure = style.new_figure(width, 2.6 * rows + 0.2 + above)
    spec = style.grid(figure, rows, columns, top=0.3 + above, between=(0.65, 0.35))
    axes: list[Axes] = []
    for index, snapshot in enumerate(parts):
        shared = axes[0] if axes else None
        panel = figure.add_subplot(spec[divmod(index, columns)], sharex=shared, sharey=shared)
        draw(panel, tree, snapshot, index)
        panel.set(xlabel=labels[0], ylabel="" if index % columns else labels[1])
        axes.append(panel)
    style.head_panels(axes, [gap_in_words(tree, snapshot) for snapshot in parts])
    most = max(axes, key=lambda panel: len(panel.lines))
    style.legend_over(figure, most, 4 // lines)
    return figure


def _draw_ramp_loops(panel: Axes, tree: xr.DataTree, snapshot: Snapshot, index: int) -> None:
    names = ("torque_nm", "position_rad", "file", "left_low_rad", "left_high_rad")
    torque, position, file, low, high = (snapshot.values("loop", name) for name in names)
    play = credible_interval(tree, 2e3 * snapshot.values("posterior", GAP))
    colour = gap_colour(snapshot, index)
    if not snapshot.withheld:
        panel.axhspan(
            -0.5 * play["median"], 0.5 * play["median"], color=colour, alpha=0.18, linewidth=0.0,
            label="play 2δ",
        )  # fmt: skip
        for side in (-1.0, 1.0):
            panel.errorbar(
                [0.0], [0.5 * side * play["median"]], yerr=style.reach(play, 0.5), color=colour,
                capsize=2.5, zorder=4.0, linewidth=1.4,
            )  # fmt: skip
    for place, number in enumerate(np.unique(file)):
        middle = 0.5 * (low[place] + high[place])
        own = file == number
        panel.plot(
            torque[own], 1e3 * (position[own] - middle), color=style.MEASURED, linewidth=0.5,
            alpha=0.8, label="measured, every position and cycle" if place == 0 else None,
        )  # fmt: skip
        panel.plot(
            [0.0, 0.0], 1e3 * (np.array([low[place], high[place]]) - middle), color=style.NEUTRAL,
            marker=style.look(place).marker, markersize=3.0, linestyle="none", zorder=5.0,
            label="left at zero torque" if place == 0 else None,
        )  # fmt: skip
    panel.axvline(0.0, color=style.NEUTRAL, linewidth=0.5)


@stored_figure(
    "Motor minus load over the angle, without skew, ratio and transmission error: forwards and "
    "backwards, the model's path through the gap, and the play.",
    10,
    holding("transmission"),
    name="flanks",
)
def flank_paths(tree: xr.DataTree) -> Figure:
    """A panel for each snapshot; the band is the play 2δ."""
    labels = "Angle of the load (rad)", "Motor minus load (mrad)"
    return _panels(tree, "transmission", _draw_flank_paths, labels)


def _draw_flank_paths(panel: Axes, tree: xr.DataTree, snapshot: Snapshot, index: int) -> None:
    names = ("position_rad", "forward", "lag_rad", "model_rad")
    angle, forward, lag, model = (snapshot.values("transmission", name) for name in names)
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
