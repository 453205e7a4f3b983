"""Whether the independent ensembles agree: their draws in turn, and their densities."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesbl.presentation.figures import layout, style
from bayesbl.presentation.figures.scales import scale_of, time_constant
from bayesbl.presentation.figures.snapshots import GAP, Snapshot
from bayesbl.presentation.figures.stored_figure import each_snapshot, holding, stored_figure
from bayesbl.recording.types import FloatArray
from bayesbl.ringing.symbols import DECAY

_BINS = 30


@stored_figure(
    "Draws of each parameter, a panel each, ensemble by ensemble, with their densities.",
    150,
    holding("posterior/amplitude_rpm"),
    parts=each_snapshot("posterior/amplitude_rpm"),
    for_specialists=True,
)
def trace(snapshot: Snapshot) -> Figure:
    """Per symbol: draws of every chain in turn, so that none hides another, and their densities."""
    names = snapshot.symbols
    rows = math.ceil(len(names) / 2)
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, 0.5 + 1.25 * rows)
    spec = layout.grid(figure, rows, 2, left=0.45, top=0.45, between=(0.36, 0.55))
    heads: list[Axes] = []
    titles: list[str] = []
    for index, name in enumerate(names):
        inner = spec[divmod(index, 2)].subgridspec(1, 2, width_ratios=(3.4, 1.0), wspace=0.04)
        left = figure.add_subplot(inner[0, 0])
        right = figure.add_subplot(inner[0, 1], sharey=left)
        draws = snapshot.values("posterior", name)
        scale = scale_of(name, draws)
        _draw(left, right, scale.shown(draws))
        if index >= len(names) - 2:
            left.set_xlabel("Draw, ensembles one after the other")
        else:
            left.tick_params(labelbottom=False)
        heads.append(left)
        constant = f", 1/τ ≈ {time_constant(draws)}" if name == DECAY else ""
        titles.append(f"{scale.label()}{constant}: {_diagnostics(snapshot, name)}")
    style.head_panels(heads, titles)
    figure.text(0.99, 0.995, snapshot.name, ha="right", va="top")
    return figure


def _draw(left: Axes, right: Axes, draws: FloatArray) -> None:
    """``draws`` has shape (chain, draw)."""
    chains, count = draws.shape
    edges = np.histogram_bin_edges(draws, _BINS)
    for chain, values in enumerate(draws):
        own = style.look(chain)
        left.plot(
            chain * count + np.arange(count),
            values,
            color=own.colour,
            linewidth=0.35,
            label=f"ensemble {chain + 1}",
        )
        counts, _ = np.histogram(values, edges)
        right.stairs(counts, edges, orientation="horizontal", color=own.colour,
                     linestyle=own.dashes, linewidth=0.8)  # fmt: skip
        if chain:
            left.axvline(chain * count, color=style.NEUTRAL, linewidth=0.4)
    left.set_xlim(0, chains * count)
    left.set_xticks(count * np.arange(chains + 1))
    for axis in (right.xaxis, right.yaxis):
        axis.set_visible(False)
    right.spines["bottom"].set_visible(False)


def _diagnostics(snapshot: Snapshot, name: str) -> str:
    """R̂ and effective sample size as stored; δ has none of its own."""
    if name == GAP:
        return "from A through the gap curve" + (" (withheld)" if snapshot.withheld else "")
    one = snapshot.groups["diagnostics"].sel(symbol=name)
    return f"$\\hat{{R}}$ {float(one['r_hat']):.3f}, ESS {float(one['ess_bulk']):.0f}"
