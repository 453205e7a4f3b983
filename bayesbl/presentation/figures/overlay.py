"""Recording and simulation of the direct route over one load rotation, with their difference."""

from __future__ import annotations

import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayesbl.presentation.figures import layout, style
from bayesbl.presentation.figures.snapshots import Snapshot, snapshots
from bayesbl.presentation.figures.stored_figure import holding, stored_figure

_BLOCK_IN = 2.4
_CHANNELS = {"motor_speed_rpm": "Motor speed (rpm)", "motor_current_a": "Motor current (A)"}


@stored_figure(
    "The measured signals with those of the simulated bench, and their difference.",
    15,
    holding("predictive/simulated_motor_speed_rpm"),
    name="simulation",
)
def overlay(tree: xr.DataTree) -> Figure:
    """One row of panels per snapshot: the middle rotation of each channel that was compared."""
    parts = snapshots(tree, "predictive/simulated_motor_speed_rpm")
    channels = [c for c in _CHANNELS if any(_has(part, c) for part in parts)]
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, 0.65 + _BLOCK_IN * len(parts))
    spec = layout.grid(figure, len(parts), len(channels), top=0.45, between=(0.55, 0.65))
    heads: list[Axes] = []
    titles: list[str] = []
    for row, snapshot in enumerate(parts):
        for column, channel in enumerate(channels):
            if not _has(snapshot, channel):
                continue
            inner = spec[row, column].subgridspec(2, 1, height_ratios=(2.2, 1.0), hspace=0.08)
            upper = figure.add_subplot(inner[0, 0])
            lower = figure.add_subplot(inner[1, 0], sharex=upper)
            _draw(upper, lower, snapshot, channel)
            heads.append(upper)
            moves = "flank_changes" in snapshot.groups["predictive"]
            titles.append(f"{snapshot.name}: one {'cycle' if moves else 'load rotation'}")
    style.head_panels(heads, titles)
    figure.legend(
        handles=[
            Line2D([], [], color=style.MEASURED, label="measured"),
            Line2D([], [], color=style.MODEL, label="simulated at the optimum"),
        ],
        loc="upper center",
        ncols=2,
    )
    return figure


def _has(snapshot: Snapshot, channel: str) -> bool:
    name = f"simulated_{channel}"
    return name in snapshot.groups["predictive"] and snapshot.values("predictive", name).size > 0


def _draw(upper: Axes, lower: Axes, snapshot: Snapshot, channel: str) -> None:
    time = snapshot.time_s
    period = snapshot.number("predictive", "rotation_period_s")
    begin = time[0] + 0.5 * max(0.0, time[-1] - time[0] - period)
    inside = (time >= begin) & (time <= begin + period)
    measured = snapshot.channel(channel)[inside]
    upper.plot(time[inside], measured, color=style.MEASURED, linewidth=0.6)
    simulated = snapshot.values("predictive", f"simulated_{channel}")[inside]
    upper.plot(time[inside], simulated, color=style.MODEL, linewidth=0.9)
    residual = snapshot.values("predictive", f"residual_{channel}")[inside]
    lower.plot(time[inside], residual, color=style.MEASURED, linewidth=0.6)
    lower.axhline(0.0, color=style.NEUTRAL, linewidth=0.6)
    lower.set_xlim(begin, begin + period)
    lower.set_xlabel("Time (s)")
    unit = _CHANNELS[channel].rsplit(" ", 1)[1]
    upper.set_ylabel(_CHANNELS[channel])
    lower.set_ylabel(f"Residual {unit}")
    upper.tick_params(labelbottom=False)
    for axes in (upper, lower):
        axes.yaxis.set_label_coords(-0.13, 0.5)
