"""Where the width of the gap's interval comes from, and how that changes along the curve."""

from __future__ import annotations

import sys

import numpy as np
import xarray as xr
from common import PaperFigure, Stored, arrays, main, numbers
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesbl.measurement.curves import SOURCE_PREFIX, curve_from_dataset
from bayesbl.presentation.figures.stored_figure import snapshots
from bayesbl.presentation.figures.style import (
    DOUBLE_COLUMN_IN,
    GAP,
    grid,
    head_panels,
    look,
    new_figure,
    plain_log_axis,
)
from bayesbl.presentation.words import in_words

CURVES = {
    "wear_published": "eq. 4 as printed",
    "wear_swept": "sweep, bench known",
    "wear_tolerances": "sweep, bench to 5 %",
}
SOURCES = {
    "noise": ("#8c8c8c", ""),
    "start_angle": ("#cc79a7", "xxxx"),
    "rounding": ("#f0e442", "...."),
    "regression": ("#0072b2", ""),
    "lack_of_fit": ("#56b4e9", "\\\\\\\\"),
    "bench": ("#e69f00", "////"),
}
"""Colour and hatching of each source."""


def data(stored: Stored) -> xr.Dataset:
    """Share of each source in the variance of ln δ, and its standard deviation along the curve."""
    trees = {label: stored.tree(name) for name, label in CURVES.items()}
    shares = xr.concat(
        [
            t["amplitude/budget"]["share"].reindex(source=list(SOURCES), fill_value=0.0)
            for t in trees.values()
        ],
        dim=xr.DataArray(list(trees), dims="curve", name="curve"),
        coords="minimal", compat="override", join="outer",
    ).transpose("curve", "snapshot", "source")  # fmt: skip
    sd = [
        [np.log(s.values("posterior", GAP)).std() for s in snapshots(tree)]
        for tree in trees.values()
    ]
    group = stored.tree("sweep_tolerances")["curve"].to_dataset()
    curve, knots = curve_from_dataset(group, ""), group["knots_rpm"].values
    start = curve.log_slope(knots) * curve.start_angle_sd(knots)
    fit, lack, bench = (
        group[f"{SOURCE_PREFIX}{source}"].values.std(axis=0)
        for source in ("regression", "lack_of_fit", "bench")
    )
    along = {"bench": bench, "start_angle": start, "fit": np.hypot(fit, lack)}
    lines = stored.table("efficiency")
    return arrays(
        share=(("curve", "snapshot", "source"), shares.values, "1"),
        log_sd=(("curve", "snapshot"), sd, "1"),
        knot_mrad=("knot", 1e3 * curve.gap(knots), "mrad"),
        along_percent=(("along", "knot"), 100.0 * np.array(list(along.values())), "percent"),
        gap_mrad=("gap", numbers(lines, "gap_mrad"), "mrad"),
        noise_percent=("gap", numbers(lines, "amplitude_sd_%"), "percent"),
    ).assign_coords(
        curve=list(trees), snapshot=shares["snapshot"].values, source=list(SOURCES),
        along=list(along),
    )  # fmt: skip


def draw(shown: xr.Dataset) -> Figure:
    """Stacked shares for the two recordings by each curve; each source's size against the gap."""
    figure = new_figure(DOUBLE_COLUMN_IN, 2.9)
    spec = grid(figure, 1, 2, left=1.35, top=0.55, between=(0.0, 1.15), widths=(1.25, 1.0))
    shares, along = (figure.add_subplot(spec[0, i]) for i in range(2))
    _draw_shares(shares, shown)
    _draw_along(along, shown)
    head_panels([shares, along], ["share of the variance of ln δ", "size along the curve"])
    handles, labels = shares.get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper left", bbox_to_anchor=(0.01, 1.0), ncols=6,
                  columnspacing=1.0, handlelength=1.4)  # fmt: skip
    return figure


def _draw_shares(panel: Axes, shown: xr.Dataset) -> None:
    row = 0.0
    labels: dict[float, str] = {}
    for curve in shown["curve"].values:
        for snapshot in shown["snapshot"].values:
            part, left = shown.sel(curve=curve, snapshot=snapshot), 0.0
            for source, (colour, hatch) in SOURCES.items():
                width = 100.0 * float(part["share"].sel(source=source))
                panel.barh(
                    row, width, 0.8, left, color=colour, hatch=hatch, edgecolor="black",
                    linewidth=0.4 if width > 0.1 else 0.0,
                    label=None if row else _SHORT[source],
                )  # fmt: skip
                left += width
            panel.text(
                101.0, row, f"± {100.0 * float(part['log_sd']):.1f} %", va="center", ha="left"
            )
            labels[row] = f"{curve}:\n{snapshot}" if len(labels) % 2 == 0 else str(snapshot)
            row += 1.0
        row += 0.4
    panel.set_yticks(list(labels), list(labels.values()))
    panel.invert_yaxis()
    panel.set_xlim(0.0, 100.0)
    panel.tick_params(axis="y", length=0.0)
    panel.set_xlabel("Share of the variance (%); right: one sd of δ")


def _draw_along(panel: Axes, shown: xr.Dataset) -> None:
    panel.plot(shown["gap_mrad"], shown["noise_percent"], color="black", marker="o", markersize=3.0)
    for index, source in enumerate(shown["along"].values):
        panel.plot(
            shown["knot_mrad"], shown["along_percent"].sel(along=source),
            color=SOURCES.get(str(source), SOURCES["regression"])[0], linestyle=look(index).dashes,
        )  # fmt: skip
    for gap, percent, told, side in (
        (0.115, 0.9, "noise, 5 rotations", "left"),
        (3.8, 6.5, "bench to 5 %", "right"),
        (3.8, 0.045, "start angle", "right"),
        (3.8, 0.0016, "fit of the curve", "right"),
    ):
        panel.text(gap, percent, told, ha=side, va="bottom")
    plain_log_axis(panel.xaxis)
    plain_log_axis(panel.yaxis, (1.0,))
    panel.set_xlim(0.1, 4.0)
    panel.set_ylim(1e-3, 20.0)
    panel.set_xlabel("Gap δ (mrad)")
    panel.set_ylabel("One standard deviation of δ (%)")


_SHORT = {
    "noise": "noise", "start_angle": "start angle", "rounding": "rounding of eq. 4",
    "regression": "coefficients", "lack_of_fit": "lack of fit", "bench": "bench",
}  # fmt: skip


def caption(shown: xr.Dataset) -> str:
    """What is seen, with the largest share for each curve."""
    told = []
    for curve in shown["curve"].values:
        last = shown.sel(curve=curve).isel(snapshot=-1)
        largest = last["share"].idxmax("source").item()
        share = 100.0 * float(last["share"].sel(source=largest))
        told.append(
            f"{curve}: one standard deviation of {100.0 * float(last['log_sd']):.1f} %, "
            f"{share:.0f} % of its variance from the {in_words(str(largest))}"
        )
    return (
        "Where the interval of δ comes from. (a) Share of each source in the variance of ln δ for "
        "the two example recordings, read through three curves; at the right one standard "
        f"deviation of δ. Of the recording {shown['snapshot'].values[-1]}, {'; '.join(told)}. (b) "
        "The standard deviation that each source brings along the curve; noise as measured on "
        "simulated recordings of five rotations (noise sd 1.5 rpm, AR(1) 0.6)."
    )


FIGURE = PaperFigure("uncertainty_budget", data, draw, caption)

if __name__ == "__main__":
    sys.exit(main(FIGURE))
