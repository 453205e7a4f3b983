"""Where δ comes from by the paper's route: draws of A, the curve, draws of δ."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from bayesbl.presentation.figures import layout, panels, style
from bayesbl.presentation.figures.snapshots import (
    GAP,
    Snapshot,
    credible_interval,
    curve_name,
    gap_colour,
    gap_in_words,
    group_of,
    snapshots,
)
from bayesbl.presentation.figures.stored_figure import holding, stored_figure
from bayesbl.results.variables import STACKED
from bayesbl.ringing.symbols import AMPLITUDE

THROUGH = "curve_amplitude_rpm"
_MOST_SHOWN = 400
"""Draws that are drawn one by one."""


@stored_figure(
    "(a) The gap curve with the draws of the ringing's amplitude pushed through it: above them the "
    "distribution of the amplitude, beside them that of the gap; (b) the whole curve.",
    30,
    holding("posterior/curve_amplitude_rpm", "curve/delta_rad"),
)
def amplitude_to_gap(tree: xr.DataTree) -> Figure:
    """δ against A with the draws of both, their densities along the axes, and the whole curve."""
    parts = snapshots(tree, "posterior/curve_amplitude_rpm")
    lines = 2 + len(parts) + ("limit_rad" in tree.attrs)
    top = 0.28 + layout.LINE_IN * ((lines + 1) // 2)
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, top + 2.9)
    outer = layout.grid(figure, 1, 2, top=top, widths=(1.6, 1.0))
    joint = outer[0, 0].subgridspec(
        2, 2, height_ratios=(1.0, 4.0), width_ratios=(4.0, 1.0), hspace=0.06, wspace=0.06
    )
    main = figure.add_subplot(joint[1, 0])
    above = figure.add_subplot(joint[0, 0], sharex=main)
    side = figure.add_subplot(joint[1, 1], sharey=main)
    _draw_joint(main, above, side, tree, parts)
    overview = figure.add_subplot(outer[0, 1])
    _draw_overview(overview, main, tree, parts)
    style.head_panels([above, overview], ["from amplitude to gap", "the whole curve; grey: (a)"])
    handles, labels = main.get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper left", bbox_to_anchor=(0.01, 1.0), ncols=2)
    return figure


def _draw_joint(
    main: Axes, top: Axes, side: Axes, tree: xr.DataTree, parts: list[Snapshot]
) -> None:
    _draw_curve(main, tree)
    for index, snapshot in enumerate(parts):
        _draw_snapshot(main, tree, snapshot, index)
        _draw_marginals(top, side, snapshot, index)
    _set_view(main, tree, parts)
    for panel in (main, side):
        panels.limit_line(panel, tree)
    main.set_xlabel("Amplitude of the ringing A (rpm)")
    main.set_ylabel("Gap δ (mrad)")
    for panel, spine, axis in ((top, "left", top.yaxis), (side, "bottom", side.xaxis)):
        panel.tick_params(labelbottom=False, labelleft=False)
        panel.spines[spine].set_visible(False)
        axis.set_visible(False)


def _draw_curve(main: Axes, tree: xr.DataTree) -> None:
    curve = group_of(tree, "curve")
    if STACKED not in curve.dims:
        _draw_one_curve(main, curve, "")
        return
    for name in curve[STACKED].values:
        _draw_one_curve(main, curve.sel({STACKED: name}), f" of {name}")


def _draw_one_curve(main: Axes, curve: xr.Dataset, whose: str) -> None:
    amplitude = curve["amplitude"].values
    name = curve_name(curve.attrs["name"])
    main.fill_between(
        amplitude, 1e3 * curve["low_rad"].values, 1e3 * curve["high_rad"].values,
        color="#c8c8c8", linewidth=0.0,
    )  # fmt: skip
    main.plot(
        amplitude, 1e3 * curve["delta_rad"].values, color=style.NEUTRAL, linewidth=0.9,
        label=f"gap curve{whose} ({name}), {panels.band_in_words(curve)}",
    )  # fmt: skip


def _draw_snapshot(main: Axes, tree: xr.DataTree, snapshot: Snapshot, index: int) -> None:
    """Draws, and their median with intervals both ways; hollow and grey where withheld."""
    drawn, gaps = (snapshot.values("posterior", name).ravel() for name in (THROUGH, GAP))
    shown = slice(None, None, max(1, drawn.size // _MOST_SHOWN))
    colour = gap_colour(snapshot, index)
    main.plot(
        drawn[shown], 1e3 * gaps[shown], linestyle="none", marker=".", markersize=1.6,
        markeredgewidth=0.0, color=colour, alpha=0.45, zorder=2.0,
    )  # fmt: skip
    amplitude = credible_interval(tree, drawn)
    delta = credible_interval(tree, 1e3 * gaps)
    main.errorbar(
        [amplitude["median"]],
        [delta["median"]],
        xerr=panels.reach(amplitude),
        yerr=panels.reach(delta),
        capsize=2.0,
        zorder=3.0,
        label=gap_in_words(tree, snapshot),
        **_marker(snapshot, index),
    )


def _marker(snapshot: Snapshot, index: int) -> dict[str, Any]:
    """The look of a snapshot's point; hollow and grey where δ must not be read."""
    colour = gap_colour(snapshot, index)
    face = "white" if snapshot.withheld else colour
    marker = style.look(index).marker
    return {"color": colour, "marker": marker, "markerfacecolor": face, "linestyle": "none"}


def _draw_marginals(top: Axes, side: Axes, snapshot: Snapshot, index: int) -> None:
    own = style.look(index)
    outline: dict[str, Any] = {"linestyle": own.dashes, "linewidth": 0.9}
    panels.density(top, snapshot.values("posterior", AMPLITUDE), own.colour, **outline)
    draws = 1e3 * snapshot.values("posterior", GAP)
    panels.density(side, draws, gap_colour(snapshot, index), orientation="horizontal", **outline)
    if snapshot.withheld:
        side.annotate(
            "withheld",
            (0.75, 1e3 * _median(snapshot, GAP)),
            xycoords=("axes fraction", "data"),
            rotation=90.0,
            va="center",
            fontsize=7.0,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
        )


def _spread(parts: list[Snapshot], name: str) -> tuple[float, float]:
    draws = np.concatenate([p.values("posterior", name).ravel() for p in parts])
    low, high = np.quantile(draws, (0.001, 0.999))
    return float(low), float(high)


def _set_view(main: Axes, tree: xr.DataTree, parts: list[Snapshot]) -> None:
    """Around the posteriors, and up to a limit that is not far away."""
    for name, factor, setter in (
        (AMPLITUDE, 1.0, main.set_xlim),
        (GAP, 1e3, main.set_ylim),
    ):
        low, high = _spread(parts, name)
        margin = max(0.35 * (high - low), 0.12 * high)
        limit = tree.attrs.get("limit_rad")
        bottom, top = max(0.0, low - margin), high + margin
        if limit is not None and name == GAP and low - 3.0 * margin < limit < high + 3.0 * margin:
            bottom, top = min(bottom, 0.97 * float(limit)), max(top, 1.05 * float(limit))
        setter(factor * bottom, factor * top)


def _draw_overview(panel: Axes, main: Axes, tree: xr.DataTree, parts: list[Snapshot]) -> None:
    """The curve over its whole range, with the view of the main panel marked."""
    (left, right), (bottom, top) = main.get_xlim(), main.get_ylim()
    panel.add_patch(
        Rectangle((left, bottom), right - left, top - bottom, color="#e6e6e6", linewidth=0.0)
    )
    _draw_curve(panel, tree)
    panels.limit_line(panel, tree)
    for index, snapshot in enumerate(parts):
        place = _median(snapshot, AMPLITUDE), 1e3 * _median(snapshot, GAP)
        panel.plot(*place, **_marker(snapshot, index))
    panel.set_xlabel("Amplitude of the ringing A (rpm)")
    panel.set_ylabel("Gap δ (mrad)")


def _median(snapshot: Snapshot, name: str) -> float:
    return float(np.median(snapshot.values("posterior", name)))
