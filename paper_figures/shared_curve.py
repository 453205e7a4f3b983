"""The change of the gap through one curve for both recordings, and through one for each."""

from __future__ import annotations

import sys

import numpy as np
import xarray as xr
from common import PaperFigure, Stored, arrays, main
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesbl.presentation.figures.stored_figure import snapshots
from bayesbl.presentation.figures.style import (
    DOUBLE_COLUMN_IN,
    GAP,
    grid,
    head_panels,
    look,
    new_figure,
)

_WAYS = {"shared": "one curve for both", "independent": "a curve for each"}
_LEVEL = 0.9
_EDGES_MRAD = np.linspace(0.15, 0.37, 45)
"""Around the change of the examples, 0.25 mrad; fixed, so that bins do not move with the draws."""


def data(stored: Stored) -> xr.Dataset:
    """Densities of the change of the examples either way; median widths in the study of pairs."""
    tree = stored.tree("wear_tolerances")
    first, last = (1e3 * s.values("posterior", GAP).ravel() for s in snapshots(tree))
    # A draw of the first gap that belongs to another draw of the curve.
    apart = last - np.random.default_rng(8).permutation(first)
    changes = np.array([last - first, apart])
    density = [np.histogram(change, _EDGES_MRAD, density=True)[0] for change in changes]
    tail = 0.5 - 0.5 * _LEVEL
    (line,) = stored.table("shared_curve")
    widths = [_numbers(line[f"{way}_width_mrad"]) for way in ("shared", "apart")]
    return arrays(
        edge_mrad=("edge", _EDGES_MRAD, "mrad"),
        density_per_mrad=(("way", "bin"), density, "1/mrad"),
        interval_mrad=(
            ("way", "bound"), np.quantile(changes, (tail, 0.5, 1.0 - tail), axis=1).T, "mrad"
        ),
        change_mrad=("pair", _numbers(line["changes_mrad"]), "mrad"),
        width_mrad=(("way", "pair"), widths, "mrad"),
        coverage=("way", [float(line[f"{way}_90%"]) for way in ("shared", "apart")], "1"),
    ).assign_coords(way=list(_WAYS)).assign_attrs(cases=int(line["cases"]))  # fmt: skip


def _numbers(cell: str) -> np.ndarray:
    return np.array(cell.split(), dtype=float)


def draw(shown: xr.Dataset) -> Figure:
    """Densities of the change of the examples; widths in the study."""
    figure = new_figure(DOUBLE_COLUMN_IN, 2.5)
    spec = grid(figure, 1, 2, top=0.5, between=(0.0, 0.7))
    example, study = (figure.add_subplot(spec[0, i]) for i in range(2))
    _draw_example(example, shown)
    _draw_study(study, shown)
    titles = ["the two examples, bench known to 5 %", "simulated pairs from 0.8 mrad on"]
    head_panels([example, study], titles)
    handles, labels = example.get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper left", bbox_to_anchor=(0.01, 1.0), ncols=2)
    return figure


def _draw_example(panel: Axes, shown: xr.Dataset) -> None:
    edges, top = shown["edge_mrad"].values, float(shown["density_per_mrad"].max())
    for index, (way, label) in enumerate(_WAYS.items()):
        style, part = look(index), shown.sel(way=way)
        density = part["density_per_mrad"].values
        panel.stairs(density, edges, fill=True, color=style.colour, alpha=0.18)
        panel.stairs(density, edges, color=style.colour, linestyle=style.dashes, linewidth=1.0)
        low, middle, high = part["interval_mrad"].values
        panel.errorbar(
            [middle], [top * (1.08 + 0.1 * index)], xerr=[[middle - low], [high - middle]],
            color=style.colour, marker=style.marker, capsize=2.5, linestyle=style.dashes,
            label=label,
        )  # fmt: skip
        panel.annotate(
            f"{high - low:.3f} mrad", (high, top * (1.08 + 0.1 * index)), xytext=(5.0, 0.0),
            textcoords="offset points", va="center",
        )  # fmt: skip
    panel.set_ylim(0.0, 1.28 * top)
    panel.locator_params(axis="x", nbins=5)
    panel.set_xlabel("Change of the gap δ (mrad)")
    panel.set_ylabel("Posterior density (1/mrad)")


def _draw_study(panel: Axes, shown: xr.Dataset) -> None:
    for index, way in enumerate(_WAYS):
        style = look(index)
        panel.plot(
            shown["change_mrad"], shown["width_mrad"].sel(way=way), color=style.colour,
            linestyle=style.dashes, marker=style.marker,
        )  # fmt: skip
    panel.set_ylim(bottom=0.0)
    panel.set_xlabel("True change of the gap δ (mrad)")
    panel.set_ylabel("Width of its 90 % interval (mrad)")


def caption(shown: xr.Dataset) -> str:
    """What is seen, with the widths."""
    widths = np.diff(shown["interval_mrad"].isel(bound=[0, 2]).values, axis=1).ravel()
    at_rest, worn = (shown["width_mrad"].isel(pair=i).values for i in (0, -1))
    return (
        "Both recordings of a joint come from one bench, so what is wrong with its curve "
        "cancels in a small change. (a) Posterior of the change of the example recordings through "
        "the curve of a bench known to 5 %: both through the same draws of the curve (90 % "
        f"interval {widths[0]:.3f} mrad wide) and each through draws of its own ({widths[1]:.3f} "
        "mrad). (b) Median width in a study of pairs from 0.8 mrad on, with the bench off within "
        f"its tolerances: {at_rest[0]:.3f} against {at_rest[1]:.3f} mrad without a change, "
        f"{worn[0]:.2f} against {worn[1]:.2f} mrad at the largest. Of {shown.attrs['cases']} "
        f"intervals each, {100.0 * float(shown['coverage'][0]):.0f} and "
        f"{100.0 * float(shown['coverage'][1]):.0f} % hold the change."
    )


FIGURE = PaperFigure("shared_curve", data, draw, caption)

if __name__ == "__main__":
    sys.exit(main(FIGURE))
