"""How well polynomials of each degree describe the sweep: whether a cubic does is a result."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator
from numpy.polynomial import polynomial

from bayesbl.curve.regression import relative_fit
from bayesbl.presentation.figures import layout, panels, style
from bayesbl.presentation.figures.snapshots import values
from bayesbl.presentation.figures.stored_figure import holding, stored_figure
from bayesbl.recording.types import FloatArray


@stored_figure(
    "How well polynomials of other degrees describe the sweep.", 70, holding("degrees", "sweep")
)
def degrees(tree: xr.DataTree) -> Figure:
    """Departure by degree, along the curve for the degrees around the one used, and evidence."""
    used = int(tree.attrs["degree"])
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, 2.2)
    spec = layout.grid(figure, 1, 3, between=(0.0, 0.62), widths=(1.0, 1.5, 1.0))
    by_degree, along, evidence = (figure.add_subplot(spec[0, i]) for i in range(3))
    _draw_by_degree(by_degree, tree, used)
    _draw_along(along, tree, used)
    _draw_evidence(evidence, tree, used)
    style.head_panels([by_degree, along, evidence], ["", "", ""])
    return figure


def departure_of_degree(tree: xr.DataTree, degree: int) -> tuple[FloatArray, FloatArray]:
    """Mean amplitude at each gap, and δ of that degree's polynomial over the gap, (g,), percent."""
    amplitude = values(tree, "sweep", "amplitude_rpm").mean(axis=1)
    gap = values(tree, "sweep", "gap_rad")
    fitted = polynomial.polyval(amplitude, relative_fit(amplitude, gap, degree))
    return amplitude, np.asarray(100.0 * (fitted / gap - 1.0))


def _draw_by_degree(panel: Axes, tree: xr.DataTree, used: int) -> None:
    degree = values(tree, "degrees", "degree")
    for index, (name, label) in enumerate(
        (("largest_departure", "largest"), ("rms_departure", "RMS"))
    ):
        own = style.look(index)
        panel.plot(
            degree, 100.0 * values(tree, "degrees", name), color=own.colour,
            linestyle=own.dashes, marker=own.marker, label=label,
        )  # fmt: skip
    panel.set_yscale("log")
    panel.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    panel.set_ylabel("Departure of δ (%)")
    _mark(panel, degree, used)
    style.legend_above(panel)


def _draw_along(panel: Axes, tree: xr.DataTree, used: int) -> None:
    stored = set(values(tree, "degrees", "degree"))
    for index, degree in enumerate(d for d in (used - 1, used, used + 1) if d in stored):
        amplitude, departure = departure_of_degree(tree, degree)
        own = style.look(index)
        panel.plot(
            amplitude, departure, color=own.colour, linestyle=own.dashes,
            marker=own.marker, markersize=2.5, linewidth=0.8, label=f"degree {degree}",
        )  # fmt: skip
    panel.axhline(0.0, color=style.NEUTRAL, linewidth=0.6)
    panel.set_xlabel("Amplitude of the ringing A (rpm)")
    panel.set_ylabel("Departure of δ (%)")
    style.legend_above(panel)


def _draw_evidence(panel: Axes, tree: xr.DataTree, used: int) -> None:
    degree, evidence = (values(tree, "degrees", n) for n in ("degree", "log_evidence"))
    panel.plot(
        degree, evidence.max() - evidence, color=style.MEASURED, marker="o", linewidth=0.7,
        markersize=3.0,
    )  # fmt: skip
    panel.set_yscale("symlog", linthresh=10.0)
    panel.yaxis.set_minor_locator(NullLocator())
    panel.set_ylim(bottom=-1.0)
    panel.set_ylabel("Log evidence below the best")
    _mark(panel, degree, used)


def _mark(panel: Axes, degree: FloatArray, used: int) -> None:
    panels.shade(panel, used - 0.3, used + 0.3)
    panel.xaxis.set_major_locator(FixedLocator([float(d) for d in degree]))
    panel.set_xlabel("Degree (shaded: used)")
