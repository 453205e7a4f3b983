"""Joint posterior of everything that was sampled: all free symbols and the gap."""

from __future__ import annotations

import textwrap

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayesbl.presentation.figures import style
from bayesbl.presentation.figures.scales import Scale, scale_of, time_constant
from bayesbl.presentation.figures.snapshots import Snapshot
from bayesbl.presentation.figures.stored_figure import each_snapshot, holding, stored_figure
from bayesbl.recording.types import FloatArray
from bayesbl.ringing.symbols import AMPLITUDE, DECAY

_BINS = 32
_LEVELS = (0.9, 0.5)
_LEFT_IN, _BOTTOM_IN, _EDGE_IN, _GAP_IN = 0.62, 0.62, 0.08, 0.06


@stored_figure(
    "The posterior of every free parameter, pair by pair.",
    140,
    holding("posterior/amplitude_rpm"),
    parts=each_snapshot,
    for_specialists=True,
)
def corner(snapshot: Snapshot) -> Figure:
    """Marginals on the diagonal, pairs below it; every free symbol and δ have a row."""
    names = snapshot.symbols
    draws = {n: snapshot.values("posterior", n).ravel() for n in names}
    scales = {n: scale_of(n, draws[n]) for n in names}
    shown = {n: scales[n].shown(draws[n]) for n in names}
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, style.DOUBLE_COLUMN_IN)
    for row, vertical in enumerate(names):
        for column, horizontal in enumerate(names[: row + 1]):
            panel = figure.add_axes(_place(row, column, len(names)))
            if row == column:
                _draw_marginal(panel, shown[vertical], snapshot.withheld and row == len(names) - 1)
            else:
                _draw_pair(panel, shown[horizontal], shown[vertical])
            _label(panel, row, column, len(names), scales[horizontal], scales[vertical])
    _explain(figure, snapshot)
    return figure


def _place(row: int, column: int, count: int) -> tuple[float, float, float, float]:
    """Left, bottom, width and height of a panel as shares of the figure."""
    pitch = (style.DOUBLE_COLUMN_IN - _LEFT_IN - _EDGE_IN + _GAP_IN) / count
    left = _LEFT_IN + column * pitch
    bottom = _BOTTOM_IN + (count - 1 - row) * pitch
    size = (pitch - _GAP_IN) / style.DOUBLE_COLUMN_IN
    return left / style.DOUBLE_COLUMN_IN, bottom / style.DOUBLE_COLUMN_IN, size, size


def _draw_marginal(panel: Axes, values: FloatArray, withheld: bool) -> None:
    colour = style.WITHHELD if withheld else "#6baed6"
    panel.hist(values, bins=_BINS, color=colour, histtype="stepfilled", linewidth=0.0)
    for quantile in np.quantile(values, (0.05, 0.5, 0.95)):
        panel.axvline(quantile, color=style.NEUTRAL, linewidth=0.6, linestyle=(0.0, (3.0, 2.0)))
    panel.spines["left"].set_visible(False)


def _draw_pair(panel: Axes, x: FloatArray, y: FloatArray) -> None:
    """Density as an image, with the outlines that hold 50 % and 90 % of the draws."""
    counts, x_edges, y_edges = np.histogram2d(x, y, bins=_BINS)
    extent = (x_edges[0], x_edges[-1], y_edges[0], y_edges[-1])
    panel.imshow(
        counts.T,
        origin="lower",
        extent=extent,
        aspect="auto",
        cmap="Blues",
        interpolation="nearest",
    )
    smooth = _smoothed(counts)
    levels = enclosing_levels(smooth, _LEVELS)
    if np.all(np.diff(levels) > 0.0):
        x_middle, y_middle = (0.5 * (e[1:] + e[:-1]) for e in (x_edges, y_edges))
        panel.contour(
            x_middle, y_middle, smooth.T, levels=levels, colors=style.NEUTRAL, linewidths=(0.5, 0.9)
        )


def _smoothed(counts: FloatArray) -> FloatArray:
    """A 5-point binomial filter both ways: contours of raw counts are ragged."""
    kernel = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
    for axis in (0, 1):
        counts = np.apply_along_axis(np.convolve, axis, counts, kernel, mode="same")
    return counts


def enclosing_levels(density: FloatArray, shares: tuple[float, ...]) -> FloatArray:
    """Heights above which the density holds the given shares of its mass, same order."""
    ordered = np.sort(density.ravel())[::-1]
    mass = np.cumsum(ordered) / ordered.sum()
    return np.asarray(ordered[np.searchsorted(mass, shares)])


def _label(
    panel: Axes, row: int, column: int, count: int, horizontal: Scale, vertical: Scale
) -> None:
    """Numbers and names at the outer edge only; inside there is nothing but the posterior."""
    for axis, outer, scale, away in (
        (panel.xaxis, row == count - 1, horizontal, (0.5, -0.24)),
        (panel.yaxis, column == 0 and row > 0, vertical, (-0.42, 0.5)),
    ):
        axis.set_visible(outer)
        if outer:
            axis.set_ticks(_inner_ticks(*axis.get_view_interval()))
            axis.set_tick_params(length=1.8, pad=1.5, labelsize=5.5)
            axis.set_label_text(scale.label("\n"), fontsize=7.0)
            axis.set_label_coords(*away)


def _inner_ticks(low: float, high: float) -> list[float]:
    """Two round values away from the panel's corners, where neighbours' would collide.

    As round as they can be while far enough apart for their numbers not to touch.
    """
    margin = 0.12 * (high - low)
    inner: list[float] = []
    for count in range(3, 12):
        ticks = MaxNLocator(count).tick_values(low, high)
        inner = [float(t) for t in ticks if low + margin < t < high - margin]
        if len(inner) > 1 and inner[-1] - inner[0] > 0.4 * (high - low):
            break
    return [inner[0], inner[-1]] if len(inner) > 1 else inner


def _explain(figure: Figure, snapshot: Snapshot) -> None:
    """Name, what the lines mean, and what has no row, in the empty upper corner."""
    count = snapshot.values("posterior", AMPLITUDE).size
    terms = snapshot.groups["posterior"].sizes.get("baseline_term", 0)
    constant = (
        time_constant(snapshot.values("posterior", DECAY)) if DECAY in snapshot.symbols else ""
    )
    lines = [
        f"{count} draws; contours hold 50 % and 90 % of them,",
        "dashed lines are the median and the 5 % and 95 % quantiles",
        f"τ is a decay rate: the time constant 1/τ is {constant}" if constant else "",
        f"not shown: {terms} baseline terms, sampled with the others" if terms else "",
        *textwrap.wrap(f"δ withheld: {snapshot.reason}" if snapshot.reason else "", 62),
    ]
    figure.text(0.98, 0.97, snapshot.name, ha="right", va="top", fontsize=9.0)
    text = figure.text(0.98, 0.94, "\n".join(line for line in lines if line), ha="right", va="top")
    text.set_linespacing(1.4)
