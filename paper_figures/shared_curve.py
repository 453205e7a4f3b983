"""The change of the gap through one curve for both recordings, and through one for each."""

from __future__ import annotations

import sys

import numpy as np
import xarray as xr
from common import PaperFigure, Stored, arrays, main, numbers
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesbl.figures.layout import grid
from bayesbl.figures.snapshots import GAP, snapshots
from bayesbl.figures.style import DOUBLE_COLUMN_IN, NEUTRAL, head_panels, look, new_figure

_WAYS = {"shared": "one curve for both", "independent": "a curve for each"}
_LEVEL = 0.9
_BINS = 45


def data(stored: Stored) -> xr.Dataset:
    """Densities of the change of the examples either way; median widths in the study of pairs."""
    tree = stored.tree("wear_tolerances")
    first, last = (1e3 * s.values("posterior", GAP).ravel() for s in snapshots(tree))
    # A draw of the first gap that belongs to another draw of the curve.
    apart = last - np.random.default_rng(8).permutation(first)
    changes = np.array([last - first, apart])
    edges = np.linspace(*np.quantile(apart, (0.0005, 0.9995)), _BINS + 1)
    tail = 0.5 - 0.5 * _LEVEL
    lines = [line for line in stored.table("gap_coverage") if line["change_width_mrad"]]
    widths = [numbers(lines, c) for c in ("change_width_mrad", "if_independent_mrad")]
    return arrays(
        edge_mrad=("edge", edges, "mrad"),
        density_per_mrad=(
            ("way", "bin"), [np.histogram(c, edges, density=True)[0] for c in changes], "1/mrad"
        ),
        interval_mrad=(
            ("way", "bound"), np.quantile(changes, (tail, 0.5, 1.0 - tail), axis=1).T, "mrad"
        ),
        width_mrad=(("way", "row"), widths, "mrad"),
        coverage=("row", numbers(lines, "change_90%"), "1"),
    ).assign_coords(way=list(_WAYS), row=[line["name"] for line in lines])  # fmt: skip


def draw(shown: xr.Dataset) -> Figure:
    """Densities of the change of the examples; widths in the study."""
    figure = new_figure(DOUBLE_COLUMN_IN, 2.5)
    spec = grid(figure, 1, 2, top=0.5, between=(0.0, 1.35))
    example, study = (figure.add_subplot(spec[0, i]) for i in range(2))
    _draw_example(example, shown)
    _draw_study(study, shown)
    titles = ["the two examples, bench known to 5 %", "pairs of simulated recordings"]
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
    rows = np.arange(shown.sizes["row"])
    for index, way in enumerate(_WAYS):
        style, width = look(index), shown["width_mrad"].sel(way=way).values
        panel.barh(
            rows + 0.2 * (2 * index - 1), width, 0.36, color=style.colour,
            hatch="" if index == 0 else "////", edgecolor="white", linewidth=0.0,
        )  # fmt: skip
        for row, value in zip(rows, width, strict=True):
            panel.annotate(
                f"{value:.3f}", (value, row + 0.2 * (2 * index - 1)), xytext=(3.0, 0.0),
                textcoords="offset points", va="center",
            )  # fmt: skip
    told = [
        "bench off\nwithin 5 %" if "off" in str(r) else "bench known" for r in shown["row"].values
    ]
    panel.set_yticks(rows, told)
    panel.tick_params(axis="y", length=0.0)
    panel.invert_yaxis()
    panel.margins(x=0.16)
    panel.locator_params(axis="x", nbins=5)
    panel.axvline(0.0, color=NEUTRAL, linewidth=0.6)
    panel.set_xlabel("Width of the change's 90 % interval (mrad)")


def caption(shown: xr.Dataset) -> str:
    """What is seen, with the widths."""
    widths = np.diff(shown["interval_mrad"].isel(bound=[0, 2]).values, axis=1).ravel()
    study = "; ".join(
        f"{row}: {shared:.3f} mrad shared and {alone:.3f} mrad apart, the shared interval covers "
        f"{100.0 * cover:.0f} %"
        for row, shared, alone, cover in zip(
            shown["row"].values, *shown["width_mrad"].values, shown["coverage"].values, strict=True
        )
    )
    return (
        "One bench stands behind both recordings of a joint, so most of what is wrong with its "
        "curve cancels in the change. (a) Posterior of the change of the example recordings "
        "through the curve of a bench known to 5 %: both through the same draws of the curve "
        f"(90 % interval {widths[0]:.3f} mrad wide) and each through draws of its own "
        f"({widths[1]:.3f} mrad). (b) Median width in a study of pairs; {study}."
    )


FIGURE = PaperFigure("shared_curve", data, draw, caption)

if __name__ == "__main__":
    sys.exit(main(FIGURE))
