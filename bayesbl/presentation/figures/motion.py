"""Motions of the simulated bench beside the measured ones, and motions that are planned."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesbl.measurement.stored import Snapshot
from bayesbl.presentation.figures import style
from bayesbl.presentation.figures.stored_figure import holding, snapshots, stored_figure
from bayesbl.units import number

_BLOCK_IN = 2.4
_LOOKS = {
    "measured": {"color": style.MEASURED},
    "simulated at the optimum": {"color": style.MODEL},
}
_CHANNELS = {"motor_speed_rpm": "Motor speed (rpm)", "motor_current_a": "Motor current (A)"}


@stored_figure(
    "The measured signals with those of the simulated bench, and their difference; in a motion the "
    "load crosses the gap in the shaded stretches.",
    15,
    holding("predictive/simulated_motor_speed_rpm"),
    name="simulation",
)
def overlay(tree: xr.DataTree) -> Figure:
    """One row of panels per snapshot: the middle rotation of each channel that was compared."""
    parts = snapshots(tree, "predictive/simulated_motor_speed_rpm")
    channels = [c for c in _CHANNELS if any(_has(part, c) for part in parts)]
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, 0.65 + _BLOCK_IN * len(parts))
    spec = style.grid(figure, len(parts), len(channels), top=0.45, between=(0.55, 0.65))
    heads: list[Axes] = []
    titles: list[str] = []
    for row, snapshot in enumerate(parts):
        for column, channel in enumerate(channels):
            if not _has(snapshot, channel):
                continue
            inner = spec[row, column].subgridspec(2, 1, height_ratios=(2.2, 1.0), hspace=0.08)
            upper = figure.add_subplot(inner[0, 0])
            lower = figure.add_subplot(inner[1, 0], sharex=upper)
            _draw_overlay(upper, lower, snapshot, channel)
            heads.append(upper)
            moves = "flank_changes" in snapshot.groups["predictive"]
            titles.append(f"{snapshot.name}: one {'cycle' if moves else 'load rotation'}")
    style.head_panels(heads, titles)
    style.legend_of(figure, _LOOKS)
    return figure


def _has(snapshot: Snapshot, channel: str) -> bool:
    name = f"simulated_{channel}"
    return name in snapshot.groups["predictive"] and snapshot.values("predictive", name).size > 0


def _draw_overlay(upper: Axes, lower: Axes, snapshot: Snapshot, channel: str) -> None:
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
    reach = 1.1 * float(np.nanmax(np.abs(residual)))
    lower.set_ylim(-reach, reach)
    lower.set_xlim(begin, begin + period)
    lower.set_xlabel("Time (s)")
    unit = _CHANNELS[channel].rsplit(" ", 1)[1]
    upper.set_ylabel(_CHANNELS[channel])
    lower.set_ylabel(f"Residual {unit}")
    upper.tick_params(labelbottom=False)
    if "flank_left_s" in snapshot.groups["predictive"]:
        parted, met = (snapshot.values("predictive", f"flank_{end}_s") for end in ("left", "met"))
        for start, stop in zip(time[0] + parted, time[0] + met, strict=True):
            if begin <= stop < begin + period:
                style.shade(upper, start, stop)
    for axes in (upper, lower):
        axes.yaxis.set_label_coords(-0.13, 0.5)


MOST_SHOWN = 16


@stored_figure(
    "The motions that would show the gap best, with the expected standard deviation of each.",
    10,
    holding("motions/expected_relative_sd"),
    name="plan",
)
def planned_motions(tree: xr.DataTree) -> Figure:
    """Range of each stroke beside its expected standard deviation, the best motion at the top."""
    stored = tree["motions"].to_dataset()
    shown = np.flatnonzero(np.isfinite(stored["expected_relative_sd"].values))[:MOST_SHOWN]
    rows = max(shown.size, 1)
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, 0.9 + 0.19 * rows)
    spec = style.grid(figure, 1, 2, left=1.5, between=(0.5, 0.3))
    ranges = figure.add_subplot(spec[0, 0])
    widths = figure.add_subplot(spec[0, 1], sharey=ranges)
    value = {str(name): stored[name].values[shown] for name in stored.data_vars}
    place = np.arange(shown.size)
    low, high = np.degrees(value["low_rad"]), np.degrees(value["high_rad"])
    ranges.barh(place, high - low, left=low, height=0.55, color=style.MODEL)
    reversal = [180.0 * k for k in range(-4, 5) if low.size and low.min() < 180.0 * k < high.max()]
    for angle in reversal:
        ranges.axvline(angle, color=style.NEUTRAL, linewidth=0.6)
    ranges.set_xlabel("Load angle of the strokes (°)")
    ranges.set_yticks(place)
    ranges.set_yticklabels(
        [
            f"{speed:g} rpm, {number(acceleration, 0)} rpm/s"
            for speed, acceleration in zip(
                value["speed_rpm"], value["acceleration_rpm_per_s"], strict=True
            )
        ]
    )
    ranges.set_ylim(rows - 0.5, -0.5)
    sd = 100.0 * value["expected_relative_sd"]
    widths.plot(sd, place, "o", color=style.MEASURED, markersize=4.0)
    if sd.size and sd.max() / sd.min() > 3.0:
        widths.set_xscale("log")
    widths.set_xlabel("Expected sd of δ (%)")
    widths.tick_params(labelleft=False)
    widths.grid(axis="x", linewidth=0.4, alpha=0.5)
    gap = 1e3 * float(tree.attrs.get("gap_rad", math.nan))
    style.head_panels([ranges, widths], ["strokes", f"at δ = {gap:g} mrad"])
    return figure
