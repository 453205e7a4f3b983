"""A recording over time, with the bench before and after naming, and the residuals of both."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesbl.presentation.figures.layout import grid
from bayesbl.presentation.figures.panels import shade
from bayesbl.presentation.figures.stored_figure import file_ending, holding, stored_figure
from bayesbl.presentation.figures.style import (
    DOUBLE_COLUMN_IN,
    MEASURED,
    MODEL,
    NEUTRAL,
    head_panels,
    legend_above,
    new_figure,
)
from bayesbl.recording.types import CHANNELS

BEFORE = "#d55e00"
_HEIGHT_IN = 3.6


def _each_recording(tree: xr.DataTree) -> Iterator[tuple[str, tuple[object, ...]]]:
    recordings = tree["signals"].to_dataset()["recording"].values
    for name in dict.fromkeys(map(str, recordings)):
        yield file_ending(name), (tree, name)


@stored_figure(
    "Measured signal, bench before and after naming, and the residuals.",
    90,
    holding("signals/measured"),
    name="diagnosis",
    parts=_each_recording,
)
def recorded_and_predicted(tree: xr.DataTree, recording: str) -> Figure:
    """Overlay above, residuals below; the half that was held out is tinted."""
    signals = tree["signals"].to_dataset()
    rows = [i for i, name in enumerate(signals["recording"].values) if str(name) == recording]
    figure = new_figure(DOUBLE_COLUMN_IN, _HEIGHT_IN)
    spec = grid(figure, 2, 1, between=(0.35, 0.0))
    upper = figure.add_subplot(spec[0, 0])
    lower = figure.add_subplot(spec[1, 0], sharex=upper)
    for row in rows:
        _draw(upper, lower, signals.isel(piece=row), row == rows[0], len(rows) > 1)
    unit = signals["measured"].attrs["units"]
    channel = str(signals["channel"].values[rows[0]])
    name = CHANNELS.get(channel, channel)
    upper.set_ylabel(f"{name.capitalize()} ({unit})")
    lower.set_ylabel(f"Residual ({unit})")
    lower.axhline(0.0, color=NEUTRAL, linewidth=0.6)
    lower.set_xlabel("Time (s)")
    upper.tick_params(labelbottom=False)
    uses = {str(signals["use"].values[row]) for row in rows}
    words = {"used": "fitted on", "held_out": "held out"}
    whole = " and ".join(words[use] for use in sorted(uses, reverse=True))
    head_panels([upper, lower], [f"{recording} ({whole})", "measured minus bench"])
    legend_above(upper)
    return figure


def _draw(upper: Axes, lower: Axes, piece: xr.Dataset, labelled: bool, split: bool) -> None:
    time = piece["time_s"].values
    there = np.isfinite(time)
    time = time[there]
    measured, before, after = (
        piece[name].values[there] for name in ("measured", "before", "after")
    )

    def label(text: str) -> str | None:
        return text if labelled else None

    upper.plot(time, measured, color=MEASURED, linewidth=0.6, label=label("measured"))
    upper.plot(time, before, color=BEFORE, linewidth=0.8, linestyle="--", label=label("before"))
    upper.plot(time, after, color=MODEL, linewidth=0.8, label=label("after"))
    lower.plot(time, measured - before, color=BEFORE, linewidth=0.6, linestyle="--")
    lower.plot(time, measured - after, color=MODEL, linewidth=0.6)
    if str(piece["use"].values) == "held_out" and split:
        for axes in (upper, lower):
            shade(axes, time[0], time[-1])
