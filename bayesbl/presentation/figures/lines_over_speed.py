"""Lines of a speed loop over the motor's speed: a torque's stay, an encoder's error grows."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesbl.presentation.figures import layout, style
from bayesbl.presentation.figures.stored_figure import holding, stored_figure

MOST_PANELS = 6
_TITLES = {
    "torque": "a torque",
    "angle": "an error of the angle",
    "both": "a torque and an error of the angle",
    "none": "no law that is sure",
}


@stored_figure(
    "The torque that would make the line at each order of the motor, over the speed: that of a "
    "torque stays, that of an error of the encoder's angle grows with the square.",
    80,
    holding("order_sizes"),
)
def lines_over_speed(tree: xr.DataTree) -> Figure:
    """A panel per order, largest line first; hollow points were held out."""
    lines = tree["order_sizes"].to_dataset()
    orders = list(dict.fromkeys(lines["order"].values.tolist()))[:MOST_PANELS]
    figure, axes = layout.one_panel_each(len(orders), 2.2, shared=False, above=1.2 * layout.LINE_IN)
    for panel, order in zip(axes, orders, strict=True):
        _draw(panel, lines.isel(line=np.flatnonzero(lines["order"].values == order)))
    laws = [str(lines["law"].values[lines["order"].values == order][0]) for order in orders]
    titles = [f"order {order:.4g}: {_TITLES[law]}" for order, law in zip(orders, laws, strict=True)]
    style.head_panels(axes, titles)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper left", bbox_to_anchor=(0.01, 1.0), ncols=4)
    return figure


def _draw(panel: Axes, lines: xr.Dataset) -> None:
    speed, torque, sd = (np.abs(lines[name].values) for name in ("speed_rpm", "torque_nm", "sd_nm"))
    law, used = str(lines["law"].values[0]), lines["use"].values == "used"
    for chosen, face, label in ((used, style.NEUTRAL, "fitted on"), (~used, "white", "held out")):
        if chosen.any():
            panel.errorbar(
                speed[chosen], torque[chosen], yerr=sd[chosen], color=style.NEUTRAL,
                markerfacecolor=face, marker="o", markersize=4.0, linestyle="none", label=label,
            )  # fmt: skip
    along = np.linspace(0.0, 1.05 * speed.max(), 100)
    weight = sd**-2.0 * used
    for name, power in (("torque", 0), ("angle", 2)):
        size = np.sum(weight * torque * speed**power) / np.sum(weight * speed ** (2 * power))
        followed = law == name
        panel.plot(
            along, size * along**power, color=style.MODEL if followed else style.NEUTRAL,
            linestyle="-" if power == 0 else "--", linewidth=1.2 if followed else 0.6,
            label=f"one {name}",
        )  # fmt: skip
    if law == "both":
        place = np.argsort(speed)
        panel.plot(speed[place], lines["by_law_nm"].values[place], color=style.MODEL, linewidth=1.2)
    panel.set_ylim(0.0, 1.1 * float((torque + sd).max()))
    panel.set_xlabel("Motor speed (rpm)")
    panel.set_ylabel("Torque (N m)")
