"""Why curve and recording must share an estimator: the error of δ where they do not."""

from __future__ import annotations

import sys

import numpy as np
import xarray as xr
from common import PaperFigure, Stored, arrays, main
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullLocator

from bayesbl.presentation.figures.style import (
    DOUBLE_COLUMN_IN,
    NEUTRAL,
    grid,
    head_panels,
    look,
    new_figure,
    plain_log_axis,
)

ESTIMATORS = {
    "same": "the sweep's own",
    "long_window": "window 0.306 s",
    "generalised": "generalised least squares",
    "short_window": "window 0.102 s",
    "no_baseline": "no baseline",
}
_QUANTILE_95 = 1.645


def data(stored: Stored) -> xr.Dataset:
    """Mean error of δ by estimator and gap with its standard error, and the claimed sd."""
    lines = stored.table("estimator_mismatch")
    error, standard_error = (
        [[_numbers(line[f"{name}{end}"]) for name in ESTIMATORS] for line in lines]
        for end in ("_%", "_se_%")
    )
    dims = ("noise", "estimator", "gap")
    return arrays(
        gap_mrad=("gap", _numbers(lines[0]["gaps_mrad"]), "mrad"),
        error_percent=(dims, error, "percent"),
        standard_error_percent=(dims, standard_error, "percent"),
        claimed_sd_percent=(
            ("noise", "gap"), [_numbers(line["claimed_sd_%"]) for line in lines], "percent"
        ),
    ).assign_coords(noise=[line["name"] for line in lines], estimator=list(ESTIMATORS))  # fmt: skip


def _numbers(cell: str) -> np.ndarray:
    return np.array(cell.split(), dtype=float)


def draw(shown: xr.Dataset) -> Figure:
    """A panel for each noise: error of δ against δ, and what the interval would claim."""
    figure = new_figure(DOUBLE_COLUMN_IN, 3.0)
    spec = grid(figure, 1, 2, left=0.62, top=0.55, between=(0.0, 0.3))
    left = figure.add_subplot(spec[0, 0])
    panels = [left, figure.add_subplot(spec[0, 1], sharey=left)]
    for panel, noise in zip(panels, shown["noise"].values, strict=True):
        _draw_errors(panel, shown.sel(noise=noise))
    panels[1].tick_params(labelleft=False)
    left.set_ylabel("Error of δ (%)")
    head_panels(panels, [str(name) for name in shown["noise"].values])
    figure.legend(*left.get_legend_handles_labels(), loc="upper left", bbox_to_anchor=(0.01, 1.0),
                  ncols=6, columnspacing=1.0)  # fmt: skip
    return figure


def _draw_errors(panel: Axes, shown: xr.Dataset) -> None:
    gap, half = shown["gap_mrad"].values, _QUANTILE_95 * shown["claimed_sd_percent"].values
    panel.fill_between(gap, -half, half, color="#dcdcdc", linewidth=0.0, label="90 % claimed")
    panel.axhline(0.0, color=NEUTRAL, linewidth=0.6)
    for index, (name, label) in enumerate(ESTIMATORS.items()):
        style, part = look(index), shown.sel(estimator=name)
        panel.errorbar(
            gap * 1.012 ** (index - 2), part["error_percent"], part["standard_error_percent"],
            color=style.colour, linestyle=style.dashes, marker=style.marker, markersize=3.2,
            linewidth=0.8, elinewidth=0.6, label=label,
        )  # fmt: skip
    panel.set_yscale("symlog", linthresh=2.0, linscale=1.2)
    panel.set_ylim(-100.0, 700.0)
    ticks = [-100, -30, -10, -2, 0, 2, 10, 30, 100, 500]
    panel.set_yticks(ticks)
    panel.yaxis.set_major_formatter(
        FuncFormatter(lambda y, _: f"{y:+g}".replace("-", "−") if y else "0")
    )
    panel.yaxis.set_minor_locator(NullLocator())
    plain_log_axis(panel.xaxis)
    panel.set_xlabel("Gap δ (mrad)")


def caption(shown: xr.Dataset) -> str:
    """What is seen, with the range of each estimator's error."""

    def span(noise: int, name: str) -> str:
        error = shown["error_percent"].isel(noise=noise).sel(estimator=name)
        return f"{float(error.min()):+.1f} to {float(error.max()):+.1f} %"

    told = "; ".join(f"{label} {span(0, name)}" for name, label in ESTIMATORS.items())
    return (
        "Error of δ where a recording is fitted by another estimator than the recordings that the "
        "curve was swept with; all are read through the same curve, the same recordings in each "
        "panel; means with standard errors, grey the 90 % interval that the sweep's own estimator "
        f"claims. (a) {shown['noise'].values[0]}: {told}. (b) {shown['noise'].values[1]}: "
        f"generalised least squares {span(1, 'generalised')}. No amount of data cures this: with "
        "less noise the intervals shrink and the error stays."
    ).replace(" -", " −")


FIGURE = PaperFigure("shared_estimator", data, draw, caption)

if __name__ == "__main__":
    sys.exit(main(FIGURE))
