"""A motion cycle by cycle, with the changes of flank that tell the gap."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayesbl.presentation.figures import layout, style
from bayesbl.presentation.figures.snapshots import Snapshot, snapshots
from bayesbl.presentation.figures.stored_figure import holding, stored_figure
from bayesbl.recording.types import FloatArray

MOST_CYCLES = 6
QUIET = 4.0
"""Rows are this many standard deviations of the deviation apart."""


@stored_figure(
    "Departure of the motor speed from what it was asked for, cycle by cycle; the load crosses the "
    "gap where a stretch is marked.",
    12,
    holding("predictive/flank_changes"),
)
def cycles(tree: xr.DataTree) -> Figure:
    """One panel per snapshot: rows of cycles, measured over simulated, changes of flank marked."""
    parts = [
        part
        for part in snapshots(tree, "predictive/flank_changes")
        if "flank_changes" in part.groups["predictive"]
    ]
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, 0.7 + 2.9 * len(parts))
    spec = layout.grid(figure, len(parts), 1, top=0.5, between=(0.65, 0.5))
    panels: list[Axes] = []
    for row, snapshot in enumerate(parts):
        panels.append(figure.add_subplot(spec[row, 0]))
        _draw(panels[-1], snapshot)
    style.head_panels(panels, [part.name for part in parts])
    figure.legend(
        handles=[
            Line2D([], [], color=style.MEASURED, label="measured"),
            Line2D([], [], color=style.MODEL, label="simulated at the optimum"),
            Line2D([], [], color=style.LIMIT, linewidth=3.0, label="the load crosses the gap"),
        ],
        loc="upper center",
        ncols=3,
    )
    return figure


def _draw(panel: Axes, snapshot: Snapshot) -> None:
    time = snapshot.time_s
    time = time - time[0]
    asked = snapshot.values("predictive", "reference_speed_rpm")
    measured = snapshot.channel("motor_speed_rpm") - asked
    simulated = snapshot.values("predictive", "simulated_motor_speed_rpm") - asked
    period = snapshot.number("predictive", "rotation_period_s")
    count = min(MOST_CYCLES, max(1, int(np.ceil((time[-1] + 1e-9) / period))))
    distance = QUIET * float(simulated.std())
    changes = _changes(snapshot)
    for row in range(count):
        inside = (time >= row * period) & (time < (row + 1) * period)
        begin, level = row * period, -distance * row
        panel.plot(time[inside] - begin, level + measured[inside], color=style.MEASURED, lw=0.5)
        panel.plot(time[inside] - begin, level + simulated[inside], color=style.MODEL, lw=0.8)
        for left, met in changes:
            if begin <= met < begin + period:
                panel.plot(
                    [max(left - begin, 0.0), met - begin],
                    [level - 0.42 * distance] * 2,
                    color=style.LIMIT,
                    linewidth=3.0,
                    solid_capstyle="butt",
                )
    panel.set_xlim(0.0, min(period, time[-1]))
    panel.set_yticks([-distance * row for row in range(count)])
    panel.set_yticklabels([str(row + 1) for row in range(count)])
    panel.set_ylabel("Cycle")
    panel.set_xlabel("Time in the cycle (s)")
    low, high = panel.get_ylim()
    rise = float(f"{0.5 * distance:.1g}")
    panel.plot([0.99 * min(period, time[-1])] * 2, [low, low + rise], color="k", linewidth=1.5)
    panel.set_ylim(low, high)
    panel.annotate(
        f"{rise:g} rpm",
        (0.985 * min(period, time[-1]), low + 0.5 * rise),
        ha="right",
        va="center",
        fontsize="small",
    )


def _changes(snapshot: Snapshot) -> list[tuple[float, float]]:
    """When the teeth part and when they meet again, s."""
    if "flank_left_s" not in snapshot.groups["predictive"]:
        return []
    left: FloatArray = snapshot.values("predictive", "flank_left_s")
    return list(zip(left, snapshot.values("predictive", "flank_met_s"), strict=True))
