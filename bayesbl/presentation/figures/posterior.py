"""The posterior of the ringing's symbols, pair by pair."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from scipy.ndimage import convolve

from bayesbl.measurement.stored import Snapshot
from bayesbl.presentation.figures import style
from bayesbl.presentation.figures.stored_figure import each_snapshot, holding, stored_figure
from bayesbl.presentation.figures.style import Scale
from bayesbl.recording.types import FloatArray
from bayesbl.ringing.symbols import AMPLITUDE, DECAY, SYMBOLS

_BINS = 30
_LEVELS = (0.9, 0.5)
_PANEL = 0.95
"""Side of a panel where panels are one apart."""
_LEFT, _BOTTOM = 0.62, 0.62


@stored_figure(
    "The posterior of every free symbol, pair by pair.",
    40,
    holding("posterior/amplitude_rpm"),
    parts=each_snapshot("posterior/amplitude_rpm"),
)
def corner(snapshot: Snapshot) -> Figure:
    """Marginals on the diagonal, pairs below it; every free symbol and δ have a row.

    All panels are drawn into one: forty of them take seconds each with its own axes.
    """
    names = _symbols(snapshot)
    draws = {n: snapshot.values("posterior", n).ravel() for n in names}
    scales = {n: style.scale_of(n, draws[n]) for n in names}
    shown = {n: scales[n].shown(draws[n]) for n in names}
    ranges = {n: _range(shown[n]) for n in names}
    count = len(names)
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, style.DOUBLE_COLUMN_IN)
    size = style.DOUBLE_COLUMN_IN
    panel = figure.add_axes(
        (_LEFT / size, _BOTTOM / size, 0.99 - _LEFT / size, 0.99 - _BOTTOM / size)
    )
    for row, vertical in enumerate(names):
        y = float(count - 1 - row)
        for column, horizontal in enumerate(names[: row + 1]):
            x = float(column)
            if row == column:
                _draw_marginal(panel, x, y, shown[vertical], ranges[vertical])
            else:
                _draw_pair(
                    panel, x, y, shown[horizontal], shown[vertical],
                    ranges[horizontal], ranges[vertical],
                )  # fmt: skip
            _frame(panel, x, y, whole=row != column)
        _label(panel, float(row), ranges[vertical], scales[vertical], across=True)
        if row:
            _label(panel, y, ranges[vertical], scales[vertical], across=False)
    panel.set_xlim(0.0, count)
    panel.set_ylim(0.0, count)
    panel.set_axis_off()
    _explain(figure, snapshot)
    return figure


def _symbols(snapshot: Snapshot) -> tuple[str, ...]:
    """Free symbols in the paper's order, δ behind them: all that has draws."""
    return tuple(n for n in (*SYMBOLS, style.GAP) if n in snapshot.groups["posterior"])


def _range(values: FloatArray) -> tuple[float, float]:
    """Where nearly all draws are, with a margin; outliers would squeeze the rest."""
    low, high = np.quantile(values, (0.001, 0.999))
    margin = 0.08 * (high - low) or 1.0
    return float(low - margin), float(high + margin)


def _inside(values: FloatArray, ends: tuple[float, float], at: float) -> FloatArray:
    return np.asarray(at + _PANEL * (values - ends[0]) / (ends[1] - ends[0]))


def _draw_marginal(
    panel: Axes, x: float, y: float, values: FloatArray, ends: tuple[float, float]
) -> None:
    heights, edges = np.histogram(values, _BINS, ends)
    panel.stairs(
        y + _PANEL * 0.95 * heights / heights.max(), _inside(edges, ends, x), baseline=y, fill=True,
        color="#6baed6",
    )  # fmt: skip
    for quantile in np.quantile(values, (0.05, 0.5, 0.95)):
        at = _inside(quantile, ends, x)
        panel.plot([at, at], [y, y + _PANEL], color=style.NEUTRAL, linewidth=0.6,
                   linestyle=(0.0, (3.0, 2.0)))  # fmt: skip


def _draw_pair(
    panel: Axes,
    x: float,
    y: float,
    horizontal: FloatArray,
    vertical: FloatArray,
    across: tuple[float, float],
    up: tuple[float, float],
) -> None:
    """Density as an image, with the outlines that hold 50 % and 90 % of the draws."""
    counts, _, _ = np.histogram2d(horizontal, vertical, _BINS, (across, up))
    panel.imshow(
        counts.T, origin="lower", extent=(x, x + _PANEL, y, y + _PANEL), aspect="auto",
        cmap="Blues", interpolation="nearest",
    )  # fmt: skip
    smooth = _smoothed(counts)
    levels = enclosing_levels(smooth, _LEVELS)
    if np.all(np.diff(levels) > 0.0):
        middles = _PANEL * (np.arange(_BINS) + 0.5) / _BINS
        panel.contour(
            x + middles, y + middles, smooth.T, levels=levels, colors=style.NEUTRAL,
            linewidths=(0.5, 0.9),
        )  # fmt: skip


def _smoothed(counts: FloatArray) -> FloatArray:
    """A 5-point binomial filter both ways: contours of raw counts are ragged."""
    kernel = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
    return np.asarray(convolve(counts, np.outer(kernel, kernel), mode="constant"))


def enclosing_levels(density: FloatArray, shares: tuple[float, ...]) -> FloatArray:
    """Heights above which the density holds the given shares of its mass, same order."""
    ordered = np.sort(density.ravel())[::-1]
    mass = np.cumsum(ordered) / ordered.sum()
    return np.asarray(ordered[np.searchsorted(mass, shares)])


def _frame(panel: Axes, x: float, y: float, *, whole: bool) -> None:
    ends = [(x, y + _PANEL), (x, y)] if whole else []
    corners = [*ends, (x, y), (x + _PANEL, y)]
    panel.plot(*zip(*corners, strict=True), color="black", linewidth=0.6)


def _label(
    panel: Axes, at: float, ends: tuple[float, float], scale: Scale, *, across: bool
) -> None:
    """Numbers and names at the outer edge only; inside there is nothing but the posterior."""
    middle = at + 0.5 * _PANEL
    for tick in _inner_ticks(*ends):
        place = float(_inside(np.array(tick), ends, at))
        line = ([place, place], [0.0, -0.03]) if across else ([0.0, -0.03], [place, place])
        panel.plot(*line, color="black", linewidth=0.6, clip_on=False)
        panel.text(
            *((place, -0.06) if across else (-0.06, place)), f"{tick:.10g}".replace("-", "−"),
            ha="center" if across else "right", va="top" if across else "center",
            rotation=0.0 if across else 90.0, fontsize=6.0,
        )  # fmt: skip
    where = (middle, -0.24) if across else (-0.36, middle)
    panel.text(
        *where, scale.label("\n"), ha="center", va="top" if across else "center",
        rotation=0.0 if across else 90.0, fontsize=7.0,
    )  # fmt: skip


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
        style.time_constant(snapshot.values("posterior", DECAY))
        if DECAY in _symbols(snapshot)
        else ""
    )
    lines = [
        f"{count} draws; contours hold 50 % and 90 % of them,",
        "dashed lines are the median and the 5 % and 95 % quantiles",
        f"τ is a decay rate: the time constant 1/τ is {constant}" if constant else "",
        f"not shown: {terms} baseline terms, sampled with the others" if terms else "",
        "δ is withheld" if snapshot.withheld and "delta_rad" in _symbols(snapshot) else "",
    ]
    figure.text(0.98, 0.97, snapshot.name, ha="right", va="top", fontsize=9.0)
    text = figure.text(0.98, 0.94, "\n".join(line for line in lines if line), ha="right", va="top")
    text.set_linespacing(1.4)
