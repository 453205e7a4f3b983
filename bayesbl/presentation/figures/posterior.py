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
from bayesbl.recording.types import FloatArray
from bayesbl.ringing.symbols import AMPLITUDE, SYMBOLS

_BINS = 30
_LEVELS = (0.9, 0.5)
_BETWEEN_IN = 0.05
_RANGE = (0.001, 0.999)
"""Quantiles between which draws are shown; outliers would squeeze the rest."""


@stored_figure(
    "The posterior of every free symbol, pair by pair.",
    40,
    holding("posterior/amplitude_rpm"),
    parts=each_snapshot("posterior/amplitude_rpm"),
)
def corner(snapshot: Snapshot) -> Figure:
    """Marginals on the diagonal, pairs below it; every free symbol and δ have a row."""
    draws = {
        name: (1e3 if name == style.GAP else 1.0) * snapshot.values("posterior", name).ravel()
        for name in (*SYMBOLS, style.GAP)
        if name in snapshot.groups["posterior"]
    }
    count = len(draws)
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, style.DOUBLE_COLUMN_IN)
    spec = style.grid(
        figure, count, count, left=0.75, bottom=0.7, top=0.1, between=(_BETWEEN_IN, _BETWEEN_IN)
    )
    for row, (vertical, up) in enumerate(draws.items()):
        for column, (horizontal, across) in enumerate(list(draws.items())[: row + 1]):
            panel = figure.add_subplot(spec[row, column])
            if row == column:
                _draw_marginal(panel, up)
            else:
                _draw_pair(panel, across, up)
                panel.yaxis.set_major_locator(MaxNLocator(3, prune="both"))
            panel.xaxis.set_major_locator(MaxNLocator(3, prune="both"))
            panel.tick_params(labelsize=6.0)
            panel.tick_params(axis="x", rotation=90.0)
            panel.label_outer()
            if row == count - 1:
                panel.set_xlabel(_label(horizontal))
                panel.xaxis.set_label_coords(0.5, -0.48 / panel.bbox.height * style.PNG_DPI)
            if row and not column:
                panel.set_ylabel(_label(vertical))
                panel.yaxis.set_label_coords(-0.48 / panel.bbox.width * style.PNG_DPI, 0.5)
    _explain(figure, snapshot)
    return figure


def _range(values: FloatArray) -> tuple[float, float]:
    low, high = np.quantile(values, _RANGE)
    margin = 0.08 * (high - low) or 1.0
    return float(low - margin), float(high + margin)


def _draw_marginal(panel: Axes, values: FloatArray) -> None:
    panel.hist(values, bins=_BINS, range=_range(values), color="#6baed6")
    for quantile in np.quantile(values, (0.05, 0.5, 0.95)):
        panel.axvline(quantile, color=style.NEUTRAL, linewidth=0.6, linestyle=(0.0, (3.0, 2.0)))
    panel.set_xlim(*_range(values))
    panel.spines["left"].set_visible(False)
    panel.set_yticks([])


def _draw_pair(panel: Axes, across: FloatArray, up: FloatArray) -> None:
    """Density as an image, with the outlines that hold 50 % and 90 % of the draws."""
    counts, x, y, _ = panel.hist2d(
        across,
        up,
        bins=_BINS,
        range=(_range(across), _range(up)),
        cmap="Blues",
        rasterized=True,
    )
    # A 5-point binomial filter both ways: contours of raw counts are ragged.
    kernel = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
    smooth = np.asarray(convolve(counts, np.outer(kernel, kernel), mode="constant"))
    ordered = np.sort(smooth.ravel())[::-1]
    levels = ordered[np.searchsorted(np.cumsum(ordered) / ordered.sum(), _LEVELS)]
    if levels[0] < levels[1]:
        middles = (0.5 * (ends[1:] + ends[:-1]) for ends in (x, y))
        panel.contour(
            *middles, smooth.T, levels=levels, colors=style.NEUTRAL, linewidths=(0.5, 0.9)
        )


def _label(name: str) -> str:
    """``T$_{w}$`` above its unit."""
    if name == style.GAP:
        return "δ\n(mrad)"
    letter, _, index = SYMBOLS[name].paper.partition("_")
    return letter + (f"$_{{{index}}}$" if index else "") + f"\n({SYMBOLS[name].unit})"


def _explain(figure: Figure, snapshot: Snapshot) -> None:
    """Name, what the lines mean, and what has no row, in the empty upper corner."""
    count = snapshot.values("posterior", AMPLITUDE).size
    terms = snapshot.groups["posterior"].sizes.get("baseline_term", 0)
    lines = [
        f"{count} draws; contours hold 50 % and 90 % of them,",
        "dashed lines are the median and the 5 % and 95 % quantiles",
        "τ is a decay rate: the time constant is 1/τ",
    ]
    if terms:
        lines.append(f"not shown: {terms} baseline terms, sampled with the others")
    if snapshot.withheld and style.GAP in snapshot.groups["posterior"]:
        lines.append("δ is withheld")
    figure.text(0.98, 0.97, snapshot.name, ha="right", va="top", fontsize=9.0)
    text = "\n".join(lines)
    figure.text(0.98, 0.94, text, ha="right", va="top", linespacing=1.4)
