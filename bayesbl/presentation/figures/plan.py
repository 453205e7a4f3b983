"""Planned motions, ranked by what they would tell of the gap."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from bayesbl.presentation.figures import layout, style
from bayesbl.presentation.figures.stored_figure import holding, stored_figure
from bayesbl.units import number

MOST_SHOWN = 16


@stored_figure(
    "The motions that would tell the gap best, with the standard deviation that each promises.",
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
    spec = layout.grid(figure, 1, 2, left=1.5, between=(0.5, 0.3))
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
