"""The distribution of the change of the gap."""

from __future__ import annotations

from collections.abc import Mapping

import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesbl.presentation.figures import layout, panels, style
from bayesbl.presentation.figures.snapshots import (
    Snapshot,
    credible_interval,
    interval_in_words,
    snapshots,
)
from bayesbl.presentation.figures.stored_figure import holding, stored_figure
from bayesbl.recording.types import FloatArray

_STEPS = "each step in the colour of its later snapshot"


@stored_figure(
    "The distribution of the change of the gap.",
    30,
    lambda tree: any(
        holding(answering, "change/change_rad")(tree)
        for answering in ("optimum/cramer_rao_sd", "loop")
    ),
)
def change(tree: xr.DataTree) -> Figure:
    """The change of δ between snapshots; beside gaps on their curve it is a panel of theirs."""
    above = 0.3 + layout.LINE_IN * legend_lines(tree)
    figure = style.new_figure(style.SINGLE_COLUMN_IN, 2.0 + above)
    panel = figure.add_subplot(layout.grid(figure, 1, 1, top=above)[0, 0])
    draw_change(panel, tree, snapshots(tree))
    return figure


def draw_change(panel: Axes, tree: xr.DataTree, parts: list[Snapshot]) -> None:
    """Change from first to last snapshot with its interval; each step too where there are more."""
    stored = tree["change"].to_dataset()
    hidden = parts[0].withheld or parts[-1].withheld
    _draw_total(panel, tree, 1e3 * stored["change_rad"].values, hidden)
    if stored.sizes["step"] > 1:
        _draw_steps(panel, stored, {p.name: p.withheld for p in parts})
    panel.axvline(0.0, color=style.NEUTRAL, linewidth=0.8, linestyle=(0.0, (3.0, 2.0)))
    panel.set_ylim(0.0, 1.1 * panel.get_ylim()[1])
    panel.set_xlabel("Change of the gap δ (mrad)")
    panel.set_ylabel("Posterior density (1/mrad)")
    # The whole change is grey, as no snapshot is: colours are those of the panels beside it.
    panel.legend(
        loc="lower left", bbox_to_anchor=(-0.05, 1.12), borderaxespad=0.0, alignment="left",
        title=_STEPS if stored.sizes["step"] > 1 else None,
    )  # fmt: skip


def legend_lines(tree: xr.DataTree) -> int:
    """How many lines the legend of the change has."""
    steps = tree["change"].to_dataset().sizes["step"]
    return 1 if steps == 1 else 2 + steps


def _draw_total(panel: Axes, tree: xr.DataTree, mrad: FloatArray, hidden: bool) -> None:
    """Distribution, and above it the median with its interval; grey and without where withheld."""
    colour = style.WITHHELD if hidden else style.NEUTRAL
    label = "withheld" if hidden else None
    heights, _ = panels.density(panel, mrad, colour, linewidth=1.0, label=label)
    if hidden:
        return
    found = credible_interval(tree, mrad)
    panel.errorbar(
        [found["median"]], [1.06 * heights.max()], xerr=panels.reach(found), color=colour,
        marker="o", linestyle="none", capsize=2.5, label=interval_in_words(tree, found),
    )  # fmt: skip


def _draw_steps(panel: Axes, change: xr.Dataset, withheld: Mapping[str, bool]) -> None:
    for step in range(change.sizes["step"]):
        first, last = (str(change[k].values[step]) for k in ("step_from", "step_to"))
        hidden, own = withheld[first] or withheld[last], style.look(step + 1)
        panels.density(
            panel,
            1e3 * change["step_change_rad"].values[step],
            style.WITHHELD if hidden else own.colour,
            filled=False,
            linestyle=own.dashes,
            linewidth=1.0,
            label=f"{first} to {last}" + (": withheld" if hidden else ""),
        )
