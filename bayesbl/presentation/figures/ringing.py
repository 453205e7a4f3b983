"""A recording beside its model: the fitted ringing, the simulated bench."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesbl.measurement.stored import Snapshot
from bayesbl.presentation.figures import style
from bayesbl.presentation.figures.stored_figure import (
    holding,
    interval_name,
    snapshots,
    stored_figure,
)
from bayesbl.recording.types import FloatArray
from bayesbl.ringing.symbols import ROTATION, SEPARATION, START, WINDOW_END, WINDOW_START

_BLOCK_IN = 2.5
_OVERLAY_IN = 2.4
_BINS = 700


class _Signal(NamedTuple):
    """What is drawn of one snapshot, each of shape (n,), s and rpm."""

    time: FloatArray
    speed: FloatArray
    model: FloatArray
    low: FloatArray
    high: FloatArray
    residual: FloatArray


def _signal(snapshot: Snapshot) -> _Signal:
    time, speed = snapshot.time_s, snapshot.channel("motor_speed_rpm")
    names = ("model_rpm", "low_rpm", "high_rpm", "residual_rpm")
    # By the time's length: a sample that was left out has no residual, like the padding.
    curves = (snapshot.groups["predictive"][n].values[: time.size] for n in names)
    return _Signal(time, speed, *curves)


@stored_figure(
    "The measured motor speed with the fitted ringing.", 10, holding("predictive/model_rpm")
)
def signal(tree: xr.DataTree) -> Figure:
    """One block per snapshot: the whole recording, a positive and a negative pulse."""
    parts = snapshots(tree, "predictive/model_rpm")
    band = interval_name(tree).replace("interval", "predictive band")
    band = band.replace("HDI", "predictive band")
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, 0.65 + _BLOCK_IN * len(parts))
    spec = style.grid(figure, len(parts), 1, top=0.45, between=(0.55, 0.0))
    heads: list[Axes] = []
    titles: list[str] = []
    for row, snapshot in enumerate(parts):
        inner = spec[row, 0].subgridspec(
            2, 3, height_ratios=(2.4, 1.0), width_ratios=(2.3, 1.0, 1.0), hspace=0.08, wspace=0.16
        )
        panels = inner.subplots(sharex="col", sharey="row", squeeze=False)
        upper, lower = panels[:, 0]
        data = _signal(snapshot)
        _draw_whole(upper, lower, data)
        heads.append(upper)
        titles.append(f"{snapshot.name}: whole recording")
        for column, positive in ((1, True), (2, False)):
            edges = start, stop = impact_window(snapshot, positive)
            begin, end = start - 0.4 * (stop - start), stop + 0.4 * (stop - start)
            top, bottom = panels[:, column]
            inside = (data.time >= begin) & (data.time <= end)
            _draw_part(top, bottom, _Signal(*(part[inside] for part in data)), band)
            for edge, label in zip(edges, ("window of the fit", None), strict=True):
                for axes in (top, bottom):
                    axes.axvline(
                        edge, color=style.NEUTRAL, linewidth=0.6, linestyle=":", label=label
                    )
            for axes in (upper, lower):
                style.shade(axes, begin, end)
            heads.append(top)
            titles.append("positive pulse" if positive else "negative pulse")
        upper.set_ylabel("Motor speed (rpm)")
        lower.set_ylabel("Residual (rpm)")
        for axes in (upper, lower):
            axes.yaxis.set_label_coords(-0.125, 0.5)
    style.head_panels(heads, titles)
    style.legend_over(figure, heads[1])
    return figure


def impact_window(snapshot: Snapshot, positive: bool) -> tuple[float, float]:
    """Start and end, in s, of the window of the pulse that is nearest to the middle."""
    time = snapshot.time_s
    symbol = {
        name: snapshot.number("optimum", name)
        for name in (START, WINDOW_START, WINDOW_END, SEPARATION, ROTATION)
    }
    length = symbol[WINDOW_END] - symbol[WINDOW_START]
    first = symbol[START] + symbol[WINDOW_START] - (0.0 if positive else symbol[SEPARATION])
    middle = 0.5 * (time[0] + time[-1] - length)
    start = first + symbol[ROTATION] * round((middle - first) / symbol[ROTATION])
    return start, start + length


def _draw_whole(upper: Axes, lower: Axes, data: _Signal) -> None:
    """Outlines of the dense traces: every extreme is on the page, not every sample."""
    time, _, band_high = style.envelope(data.time, data.high, _BINS)
    _, band_low, _ = style.envelope(data.time, data.low, _BINS)
    upper.fill_between(time, band_low, band_high, color=style.BAND, linewidth=0.0)
    _outline(upper, data.time, data.speed, style.MEASURED)
    _outline(upper, data.time, data.model, style.MODEL)
    _outline(lower, data.time, data.residual, style.MEASURED)
    lower.axhline(0.0, color=style.NEUTRAL, linewidth=0.6)
    lower.set_xlim(data.time[0], data.time[-1])
    lower.set_xlabel("Time (s)")


def _outline(axes: Axes, time: FloatArray, values: FloatArray, colour: str) -> None:
    middle, low, high = style.envelope(time, values, _BINS)
    axes.fill_between(middle, low, high, color=colour, linewidth=0.5)


def _draw_part(top: Axes, bottom: Axes, data: _Signal, band: str) -> None:
    """Every sample of a short stretch."""
    top.fill_between(data.time, data.low, data.high, color=style.BAND, linewidth=0.0, label=band)
    top.plot(data.time, data.speed, color=style.MEASURED, linewidth=0.7, label="measured")
    top.plot(data.time, data.model, color=style.MODEL, linewidth=1.1, label="model")
    low, high = data.low - data.model, data.high - data.model
    bottom.fill_between(data.time, low, high, color=style.BAND, linewidth=0.0)
    bottom.plot(data.time, data.residual, color=style.MEASURED, linewidth=0.7, label="residual")
    bottom.axhline(0.0, color=style.MODEL, linewidth=0.8)
    bottom.set_xlim(data.time[0], data.time[-1])
    bottom.set_xlabel("Time (s)")
    bottom.locator_params(axis="x", nbins=3)


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
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, 0.65 + _OVERLAY_IN * len(parts))
    spec = style.grid(figure, len(parts), len(channels), top=0.45, between=(0.55, 0.65))
    heads: list[Axes] = []
    titles: list[str] = []
    for row, snapshot in enumerate(parts):
        for column, channel in enumerate(channels):
            if not _has(snapshot, channel):
                continue
            inner = spec[row, column].subgridspec(2, 1, height_ratios=(2.2, 1.0), hspace=0.08)
            (upper,), (lower,) = inner.subplots(sharex=True, squeeze=False)
            _draw_overlay(upper, lower, snapshot, channel)
            heads.append(upper)
            moves = "flank_changes" in snapshot.groups["predictive"]
            titles.append(f"{snapshot.name}: one {'cycle' if moves else 'load rotation'}")
    style.head_panels(heads, titles)
    style.legend_over(figure, heads[0])
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
    upper.plot(time[inside], measured, color=style.MEASURED, linewidth=0.6, label="measured")
    simulated = snapshot.values("predictive", f"simulated_{channel}")[inside]
    label = "simulated at the optimum"
    upper.plot(time[inside], simulated, color=style.MODEL, linewidth=0.9, label=label)
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
    if "flank_left_s" in snapshot.groups["predictive"]:
        parted, met = (snapshot.values("predictive", f"flank_{end}_s") for end in ("left", "met"))
        for start, stop in zip(time[0] + parted, time[0] + met, strict=True):
            if begin <= stop < begin + period:
                style.shade(upper, start, stop)
    for axes in (upper, lower):
        axes.yaxis.set_label_coords(-0.13, 0.5)
