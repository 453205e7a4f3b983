"""Figures of a recording with its model (ringing or bench), and of the posterior pair by pair."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from scipy.ndimage import gaussian_filter

from bayesbl.measurement.stored import Snapshot
from bayesbl.presentation.figures import style
from bayesbl.presentation.figures.stored_figure import (
    holding,
    interval_name,
    snapshots,
    stored_figure,
)
from bayesbl.recording.types import FloatArray
from bayesbl.ringing.symbols import ROTATION, SEPARATION, START, SYMBOLS, WINDOW_END, WINDOW_START

_BLOCK_IN = 2.5
_OVERLAY_IN = 2.4
_BINS = 700


_Signals = Mapping[str, FloatArray]  # ``time``, ``measured``, ``model``, ``residual``, each (n,)


@stored_figure(
    "The measured motor speed with the fitted ringing.", 10, holding("predictive/model_rpm")
)
def signal(tree: xr.DataTree) -> Figure:
    """A block for each snapshot: the whole recording, a positive and a negative pulse."""
    parts = snapshots(tree, "predictive/model_rpm")
    band = interval_name(tree).replace("interval", "predictive band")
    band = band.replace("HDI", "predictive band")
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, 0.65 + _BLOCK_IN * len(parts))
    spec = style.grid(figure, len(parts), 1, top=0.45, between=(0.55, 0.0))
    heads: dict[Axes, str] = {}
    for row, snapshot in enumerate(parts):
        inner = spec[row, 0].subgridspec(
            2, 3, height_ratios=(2.4, 1.0), width_ratios=(2.3, 1.0, 1.0), hspace=0.08, wspace=0.16
        )
        panels = inner.subplots(sharex="col", sharey="row", squeeze=False)
        upper, lower = panels[:, 0]
        names = ("model", "low", "high", "residual")
        data = {name: snapshot.values("predictive", f"{name}_rpm") for name in names}
        data |= {"time": snapshot.time_s, "measured": snapshot.channel("motor_speed_rpm")}
        _draw_whole(upper, lower, data)
        heads[upper] = f"{snapshot.name}: whole recording"
        for column, positive in ((1, True), (2, False)):
            edges = start, stop = impact_window(snapshot, positive)
            begin, end = start - 0.4 * (stop - start), stop + 0.4 * (stop - start)
            top, bottom = panels[:, column]
            inside = (data["time"] >= begin) & (data["time"] <= end)
            _draw_part(top, bottom, {name: part[inside] for name, part in data.items()}, band)
            for edge, label in zip(edges, ("window of the fit", None), strict=True):
                for axes in (top, bottom):
                    axes.axvline(
                        edge, color=style.NEUTRAL, linewidth=0.6, linestyle=":", label=label
                    )
            for axes in (upper, lower):
                style.shade(axes, begin, end)
            heads[top] = "positive pulse" if positive else "negative pulse"
        for axes, label in ((upper, "Motor speed (rpm)"), (lower, "Residual (rpm)")):
            axes.set_ylabel(label)
            axes.yaxis.set_label_coords(-0.125, 0.5)
    style.head_panels(list(heads), list(heads.values()))
    style.legend_over(figure, list(heads)[1])
    return figure


def impact_window(snapshot: Snapshot, positive: bool) -> tuple[float, float]:
    """Start and end, in s, of the window of the pulse nearest to the middle."""
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


def _draw_whole(upper: Axes, lower: Axes, data: _Signals) -> None:
    """Outlines of dense traces, which show every extreme."""
    time = data["time"]
    middle, _, high = style.envelope(time, data["high"], _BINS)
    _, low, _ = style.envelope(time, data["low"], _BINS)
    upper.fill_between(middle, low, high, color=style.BAND, linewidth=0.0)
    outlines = (upper, "measured", style.MEASURED), (upper, "model", style.MODEL)
    for axes, name, colour in (*outlines, (lower, "residual", style.MEASURED)):
        middle, low, high = style.envelope(time, data[name], _BINS)
        axes.fill_between(middle, low, high, color=colour, linewidth=0.5)
    lower.axhline(0.0, color=style.NEUTRAL, linewidth=0.6)
    lower.set(xlim=(time[0], time[-1]), xlabel="Time (s)")


def _draw_part(top: Axes, bottom: Axes, data: _Signals, band: str) -> None:
    """Every sample of a short stretch."""
    time, model, low, high = (data[name] for name in ("time", "model", "low", "high"))
    top.fill_between(time, low, high, color=style.BAND, linewidth=0.0, label=band)
    bottom.fill_between(time, low - model, high - model, color=style.BAND, linewidth=0.0)
    _draw_samples(top, bottom, data, "model")
    bottom.locator_params(axis="x", nbins=3)


def _draw_samples(upper: Axes, lower: Axes, data: _Signals, label: str) -> None:
    """A measured signal and its model, with the residual below."""
    time = data["time"]
    upper.plot(time, data["measured"], color=style.MEASURED, linewidth=0.7, label="measured")
    upper.plot(time, data["model"], color=style.MODEL, linewidth=1.0, label=label)
    lower.plot(time, data["residual"], color=style.MEASURED, linewidth=0.7, label="residual")
    lower.axhline(0.0, color=style.MODEL, linewidth=0.7)
    lower.set(xlim=(time[0], time[-1]), xlabel="Time (s)")


_CHANNELS = {"motor_speed_rpm": "Motor speed (rpm)", "motor_current_a": "Motor current (A)"}


@stored_figure(
    "The measured signals with those of the simulated bench, and their difference; in a motion the "
    "load crosses the gap in the shaded stretches.",
    15,
    holding("predictive/simulated_motor_speed_rpm"),
    name="simulation",
)
def overlay(tree: xr.DataTree) -> Figure:
    """A row for each snapshot: the middle rotation of each compared channel."""
    parts = snapshots(tree, "predictive/simulated_motor_speed_rpm")
    channels = [c for c in _CHANNELS if any(_has(part, c) for part in parts)]
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, 0.65 + _OVERLAY_IN * len(parts))
    spec = style.grid(figure, len(parts), len(channels), top=0.45, between=(0.55, 0.65))
    heads: dict[Axes, str] = {}
    for row, snapshot in enumerate(parts):
        for column, channel in enumerate(channels):
            if not _has(snapshot, channel):
                continue
            inner = spec[row, column].subgridspec(2, 1, height_ratios=(2.2, 1.0), hspace=0.08)
            (upper,), (lower,) = inner.subplots(sharex=True, squeeze=False)
            _draw_overlay(upper, lower, snapshot, channel)
            moves = "flank_changes" in snapshot.group("predictive")
            heads[upper] = f"{snapshot.name}: one {'cycle' if moves else 'load rotation'}"
    style.head_panels(list(heads), list(heads.values()))
    style.legend_over(figure, next(iter(heads)))
    return figure


def _has(snapshot: Snapshot, channel: str) -> bool:
    name = f"simulated_{channel}"
    predictive = snapshot.group("predictive")
    return name in predictive and bool(predictive[name].notnull().any())


def _draw_overlay(upper: Axes, lower: Axes, snapshot: Snapshot, channel: str) -> None:
    time = snapshot.time_s
    period = snapshot.number("predictive", "rotation_period_s")
    begin = time[0] + 0.5 * max(0.0, time[-1] - time[0] - period)
    inside = (time >= begin) & (time <= begin + period)
    whole = {
        "time": time,
        "measured": snapshot.channel(channel),
        "model": snapshot.values("predictive", f"simulated_{channel}"),
        "residual": snapshot.values("predictive", f"residual_{channel}"),
    }
    data = {name: values[inside] for name, values in whole.items()}
    _draw_samples(upper, lower, data, "simulated at the optimum")
    reach = 1.1 * float(np.nanmax(np.abs(data["residual"])))
    upper.set_ylabel(_CHANNELS[channel])
    unit = _CHANNELS[channel].rsplit(" ", 1)[1]
    lower.set(ylim=(-reach, reach), ylabel=f"Residual {unit}")
    if "flank_left_s" in snapshot.group("predictive"):
        parted, met = (snapshot.values("predictive", f"flank_{end}_s") for end in ("left", "met"))
        for start, stop in zip(time[0] + parted, time[0] + met, strict=True):
            if begin <= stop < begin + period:
                style.shade(upper, start, stop)
    for axes in (upper, lower):
        axes.yaxis.set_label_coords(-0.13, 0.5)


_CELLS, _BETWEEN = 30, 2
_HELD = (0.5, 0.9)
_RANGE = (0.001, 0.999)  # quantiles between which draws are shown; outliers would squeeze the rest


class _Symbol(NamedTuple):
    """A symbol of the posterior; a pair takes ``_CELLS`` cells each way."""

    label: str
    low: float
    high: float
    draws: FloatArray
    """Shape (m,), in cells from the lower end of what is shown."""

    @classmethod
    def of(cls, name: str, values: FloatArray) -> _Symbol:
        label = "δ\n(mrad)"
        if name == style.GAP:
            values = 1e3 * values
        else:  # as ``T$_{w}$``, above its unit
            letter, _, index = SYMBOLS[name].paper.partition("_")
            label = letter + (f"$_{{{index}}}$" if index else "") + f"\n({SYMBOLS[name].unit})"
        low, high = np.quantile(values, _RANGE)
        margin = 0.08 * (high - low) or 1.0
        low, high = low - margin, high + margin
        return cls(label, float(low), float(high), _CELLS * (values - low) / (high - low))

    def ticks(self) -> list[tuple[float, str]]:
        """Position, in cells, and label of each tick."""
        values = MaxNLocator(3, prune="both").tick_values(self.low, self.high)
        scale = _CELLS / (self.high - self.low)
        shown = [value for value in values if self.low < value < self.high]
        return [(scale * (value - self.low), f"{value:.10g}") for value in shown]


def _each_snapshot(tree: xr.DataTree) -> Iterator[tuple[str, tuple[Snapshot]]]:
    """One figure for each snapshot; that of a fit has no own name."""
    for snapshot in snapshots(tree, "posterior/amplitude_rpm"):
        name = f"_{snapshot.name}".replace(" ", "_")
        yield name if tree.attrs["kind"] == "compare" else "", (snapshot,)


@stored_figure(
    "The posterior of every free symbol, pair by pair: contours hold 50 % and 90 % of the draws, "
    "dashed lines are the median and the 5 % and 95 % quantiles; τ is a decay rate.",
    40,
    holding("posterior/amplitude_rpm"),
    parts=_each_snapshot,
)
def corner(snapshot: Snapshot) -> Figure:
    """Marginals on the diagonal, pairs below, for every free symbol and δ.

    All are in one panel, in cells: separate panels take four times as long to draw.
    """
    names = [name for name in (*SYMBOLS, style.GAP) if name in snapshot.group("posterior")]
    symbols = [_Symbol.of(name, snapshot.values("posterior", name).ravel()) for name in names]
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, style.DOUBLE_COLUMN_IN)
    panel = figure.add_subplot(style.grid(figure, 1, 1, left=0.75, bottom=0.7, top=0.1)[0])
    begins = (_CELLS + _BETWEEN) * np.arange(len(symbols))
    size = int(begins[-1]) + _CELLS
    density, held = np.full((2, size, size), np.nan)
    for row, own in enumerate(symbols):
        up = int(begins[-1 - row])
        _draw_marginal(panel, begins[row], up, own.draws)
        for right, other in zip(begins[:row], symbols, strict=False):
            cells = np.s_[up : up + _CELLS, right : right + _CELLS]
            density[cells], held[cells] = _pair(own.draws, other.draws)
    panel.pcolorfast(density, cmap="Blues")
    centres = np.arange(size) + 0.5
    panel.contour(centres, centres, held, _HELD, colors=style.NEUTRAL, linewidths=(0.9, 0.5))
    rows, columns = np.tril_indices(len(symbols))
    x, y = begins[columns], begins[-1 - rows]
    panel.hlines(y, x, x + _CELLS, color="k", linewidth=0.6)
    panel.vlines(x, y, y + np.where(rows > columns, _CELLS, 0), color="k", linewidth=0.6)
    panel.set(xlim=(-0.3, size), ylim=(-0.3, size))
    panel.spines[:].set_visible(False)
    panel.tick_params(labelsize=6.0)
    panel.tick_params(axis="x", rotation=90.0)
    panel.tick_params(which="minor", length=0.0, pad=34.0)
    panel.tick_params(axis="y", which="minor", rotation=90.0)
    for axis, shown in ((panel.xaxis, symbols), (panel.yaxis, symbols[:0:-1])):
        placed = list(zip(begins, shown, strict=False))
        ticks = [(begin + at, label) for begin, symbol in placed for at, label in symbol.ticks()]
        axis.set_ticks([at for at, _ in ticks], [label for _, label in ticks])
        axis.set_ticks([b + 0.5 * _CELLS for b, _ in placed], [s.label for s in shown], minor=True)
    withheld = snapshot.withheld and style.GAP in names
    head = f"{snapshot.name}: δ is withheld" if withheld else snapshot.name
    figure.text(0.98, 0.97, head, ha="right", va="top", fontsize=9.0)
    return figure


def _draw_marginal(panel: Axes, right: int, up: int, draws: FloatArray) -> None:
    counts, edges = np.histogram(draws, _CELLS, (0.0, _CELLS))
    heights = up + 0.95 * _CELLS * counts / counts.max()
    panel.stairs(heights, right + edges, baseline=up, fill=True, color="#6baed6")
    quantiles = right + np.quantile(draws, (0.05, 0.5, 0.95))
    dashes = (0.0, (3.0, 2.0))
    panel.vlines(quantiles, up, up + _CELLS, style.NEUTRAL, linestyle=dashes, linewidth=0.6)


def _pair(up: FloatArray, across: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Density of draws over its maximum, and the share of draws in denser cells."""
    box = (0.0, _CELLS), (0.0, _CELLS)
    counts, _, _ = np.histogram2d(up, across, _CELLS, box)
    # Contours of raw counts are ragged.
    smooth = np.asarray(gaussian_filter(counts, 1.0, mode="constant"))
    order = np.argsort(-smooth, axis=None)
    held = np.empty(smooth.size)
    held[order] = np.cumsum(smooth.ravel()[order]) / smooth.sum()
    return counts / counts.max(), held.reshape(smooth.shape)
