"""How CMA-ES found the optimum: the error of every run against its model evaluations."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesbl.presentation.figures import layout, style
from bayesbl.presentation.figures.snapshots import Snapshot, snapshots
from bayesbl.presentation.figures.stored_figure import holding, stored_figure


@stored_figure(
    "How the search found its optimum.", 130, holding("search_history"), for_specialists=True
)
def convergence(tree: xr.DataTree) -> Figure:
    """Best RMSE so far of each run, a panel a snapshot; rivals end above the dashed optimum."""
    parts = snapshots(tree, "search_history")
    figure, axes = layout.one_panel_each(len(parts))
    for panel, snapshot in zip(axes, parts, strict=True):
        _draw(panel, snapshot)
    axes[0].set_ylabel("RMSE (rpm)")
    style.head_panels(axes, [s.name for s in parts])
    return figure


def _draw(panel: Axes, snapshot: Snapshot) -> None:
    runs = snapshot.values("search_history", "run")
    evaluations = snapshot.values("search_history", "evaluations")
    rmse = snapshot.values("search_history", "rmse_rpm")
    for index, run in enumerate(np.unique(runs)):
        mine, own = runs == run, style.look(index)
        panel.plot(
            evaluations[mine],
            rmse[mine],
            color=own.colour,
            linestyle=own.dashes,
            marker=own.marker,
            markerfacecolor="none",
            markevery=[int(mine.sum()) - 1],
            label=f"run {index + 1}",
        )
    best = snapshot.number("optimum", "rmse_rpm")
    panel.axhline(best, color=style.NEUTRAL, linewidth=0.6, linestyle=(0.0, (1.0, 2.0)), zorder=0.0)
    panel.annotate(
        f"optimum {best:.3f} rpm",
        (0.02, best),
        (0.0, -2.0),
        xycoords=("axes fraction", "data"),
        textcoords="offset points",
        va="top",
        fontsize=7.0,
        color=style.NEUTRAL,
    )
    panel.set_xscale("log")
    panel.margins(y=0.12)
    panel.set_xlabel("Model evaluations in the run")
    style.legend_above(panel)
