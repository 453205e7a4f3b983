"""How close both routes come to the Cramér-Rao bound, over the gap."""

from __future__ import annotations

import sys

import xarray as xr
from common import PaperFigure, Stored, arrays, main, numbers
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesbl.presentation.figures.style import (
    DOUBLE_COLUMN_IN,
    NEUTRAL,
    grid,
    head_panels,
    look,
    new_figure,
    plain_log_axis,
)

_WAYS = {
    "amplitude": "amplitude route (speed)",
    "direct_speed": "direct route, speed alone",
    "direct": "direct route, speed and current",
}
_BOUNDS = {"bound_speed": "bound, speed alone", "bound": "bound, speed and current"}


def data(stored: Stored) -> xr.Dataset:
    """Bounds, posterior sd and actual scatter of δ in percent, and sd over bound, by gap."""
    lines = sorted(stored.table("efficiency"), key=lambda line: float(line["gap_mrad"]))
    bounds = [numbers(lines, f"{name}_%") for name in _BOUNDS]
    sd, scatter, ratio = (
        [numbers(lines, f"{way}{end}") for way in _WAYS]
        for end in ("_sd_%", "_scatter_%", "_sd/bound")
    )
    return arrays(
        gap_mrad=("gap", numbers(lines, "gap_mrad"), "mrad"),
        bound_percent=(("bound", "gap"), bounds, "percent"),
        sd_percent=(("way", "gap"), sd, "percent"),
        scatter_percent=(("way", "gap"), scatter, "percent"),
        over_bound=(("way", "gap"), ratio, "1"),
        cases=("gap", numbers(lines, "cases"), "1"),
    ).assign_coords(way=list(_WAYS), bound=list(_BOUNDS))


def draw(shown: xr.Dataset) -> Figure:
    """Standard deviations against the gap with both bounds; their ratio."""
    figure = new_figure(DOUBLE_COLUMN_IN, 2.9)
    spec = grid(figure, 1, 2, top=0.72, between=(0.0, 0.6))
    widths, ratios = (figure.add_subplot(spec[0, i]) for i in range(2))
    _draw_widths(widths, shown)
    _draw_ratios(ratios, shown)
    for panel in (widths, ratios):
        plain_log_axis(panel.xaxis)
        panel.set_xlim(0.12, 4.2)
        panel.set_xlabel("Gap δ (mrad)")
    head_panels([widths, ratios], ["bounds and posteriors", "posterior over its bound"])
    figure.legend(*widths.get_legend_handles_labels(), loc="upper left", bbox_to_anchor=(0.01, 1.0),
                  ncols=3)  # fmt: skip
    return figure


def _draw_widths(panel: Axes, shown: xr.Dataset) -> None:
    gap = shown["gap_mrad"].values
    for name, dashes in zip(_BOUNDS, ("-", (0.0, (4.0, 2.0))), strict=True):
        panel.plot(
            gap, shown["bound_percent"].sel(bound=name), color=NEUTRAL, linestyle=dashes,
            linewidth=0.9, label=_BOUNDS[name],
        )  # fmt: skip
    for index, (way, label) in enumerate(_WAYS.items()):
        style = look(index)
        panel.plot(
            gap, shown["sd_percent"].sel(way=way), color=style.colour, marker=style.marker,
            linestyle="none", label=label,
        )  # fmt: skip
        panel.plot(
            gap, shown["scatter_percent"].sel(way=way), color=style.colour, marker=style.marker,
            linestyle="none", markerfacecolor="none", markersize=5.5, markeredgewidth=0.5,
            label="the medians' actual scatter" if index == 0 else None,
        )  # fmt: skip
    plain_log_axis(panel.yaxis)
    panel.set_ylabel("Standard deviation of δ (%)")


def _draw_ratios(panel: Axes, shown: xr.Dataset) -> None:
    panel.axhline(1.0, color=NEUTRAL, linewidth=0.9)
    for index, way in enumerate(_WAYS):
        style = look(index)
        panel.plot(
            shown["gap_mrad"], shown["over_bound"].sel(way=way), color=style.colour,
            marker=style.marker, linestyle=style.dashes, linewidth=0.8,
        )  # fmt: skip
    panel.set_ylim(0.0, 1.12 * float(shown["over_bound"].max()))
    panel.set_ylabel("Posterior sd / Cramér-Rao bound")


def caption(shown: xr.Dataset) -> str:
    """What is seen, with the ranges of the ratios."""

    def span(way: str) -> str:
        ratio = shown["over_bound"].sel(way=way)
        return f"{float(ratio.min()):.2f} to {float(ratio.max()):.2f}"

    gain = shown["sd_percent"].sel(way="amplitude") / shown["sd_percent"].sel(way="direct")
    return (
        "Sharpness of both routes against the Cramér-Rao bound, bench known, start angle free, "
        "five rotations at 1 kHz, AR(1) speed noise of sd 1.5 rpm and φ 0.6, white current noise "
        f"of 0.05 A; medians over {int(shown['cases'].min())} recordings at each gap. (a) Bounds, "
        "posterior standard deviations (filled) and what the medians actually scattered (open, "
        "RMS error). (b) Over the bound of the channels that are used: amplitude route "
        f"{span('amplitude')}, direct route {span('direct_speed')} from the speed alone and "
        f"{span('direct')} from speed and current, whose interval is {float(gain.min()):.0f} to "
        f"{float(gain.max()):.0f} times narrower than the amplitude's."
    )


FIGURE = PaperFigure("efficiency", data, draw, caption)

if __name__ == "__main__":
    sys.exit(main(FIGURE))
