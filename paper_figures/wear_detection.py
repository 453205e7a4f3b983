"""How much a joint must wear before a comparison reports it: detection curves."""

from __future__ import annotations

import sys

import numpy as np
import xarray as xr
from common import PaperFigure, Stored, arrays, main, numbers
from matplotlib.figure import Figure
from scipy.stats import binom, norm

from bayesbl.presentation.figures.style import DOUBLE_COLUMN_IN, NEUTRAL, grid, look, new_figure

POWER = 0.95
NOMINAL = 0.05
_LINEAR = 1e-3
"""Change in mrad up to which the axis is linear, so that none has a place on it."""


def data(stored: Stored) -> xr.Dataset:
    """Share reported at each true change, and the fitted curve's middle and width, by row."""
    lines = stored.table("wear_detection")
    change, share = (
        [np.array(line[c].split(), dtype=float) for line in lines]
        for c in ("changes_mrad", "reported")
    )
    longest = max(len(part) for part in change)
    padded = [
        [np.pad(p, (0, longest - len(p)), constant_values=np.nan) for p in parts]
        for parts in (change, share)
    ]
    columns = {
        "half_found_mrad": "mrad", "curve_width_mrad": "mrad", "smallest_mrad": "mrad",
        "pairs_per_change": "1", "pairs_without_wear": "1", "false_alarms": "1",
    }  # fmt: skip
    return arrays(
        change_mrad=(("row", "change"), padded[0], "mrad"),
        reported=(("row", "change"), padded[1], "1"),
        **{name: ("row", numbers(lines, name), unit) for name, unit in columns.items()},
    ).assign_coords(
        row=[line["name"] for line in lines],
        route=("row", [line["route"] for line in lines]),
        recorded=("row", [line["name"].partition(", ")[2] for line in lines]),
    )


def draw(shown: xr.Dataset) -> Figure:
    """Shares with 90 % binomial bands, and the curve through them.

    A look for each way to record; markers are open for the direct route.
    """
    figure = new_figure(DOUBLE_COLUMN_IN, 2.9)
    panel = figure.add_subplot(grid(figure, 1, 1, right=2.35, top=0.12)[0, 0])
    largest = float(shown["change_mrad"].max())
    fine = np.concatenate(
        [np.linspace(0.0, _LINEAR, 30), np.geomspace(_LINEAR, 1.15 * largest, 300)]
    )
    ways = list(dict.fromkeys(shown["recorded"].values))
    for index, name in enumerate(shown["row"].values):
        part = shown.sel(row=name).dropna("change")
        way, direct = str(part["recorded"].values), part["route"] == "direct"
        style, share = look(ways.index(way)), part["reported"].values
        size = np.where(
            part["change_mrad"] == 0.0, part["pairs_without_wear"], part["pairs_per_change"]
        )
        band = np.abs(binom.ppf([[0.05], [0.95]], size, share) / size - share)
        panel.errorbar(
            _apart(part["change_mrad"].values, index), share, band, color=style.colour,
            marker=style.marker, markerfacecolor="white" if direct else style.colour,
            linestyle="none", capsize=2.0, elinewidth=0.7,
        )  # fmt: skip
        middle, width = float(part["half_found_mrad"]), float(part["curve_width_mrad"])
        label = None if direct else f"{way}:\n{_smallest(shown, way)}"
        panel.plot(
            fine, norm.cdf((fine - middle) / width), color=style.colour, linestyle=style.dashes,
            marker=style.marker, markevery=[], label=label,
        )  # fmt: skip
    for level, told in ((POWER, "95 %"), (NOMINAL, "5 %")):
        panel.axhline(level, color=NEUTRAL, linewidth=0.6, linestyle=(0.0, (3.0, 2.0)))
        panel.annotate(
            told, (1.0, level), xycoords=("axes fraction", "data"), xytext=(2.0, 0.0),
            textcoords="offset points", va="center",
        )  # fmt: skip
    panel.set_xscale("symlog", linthresh=_LINEAR, linscale=0.6)
    ticks = [0.0, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2]
    panel.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    panel.set_xticks([], minor=True)
    panel.set_xlim(-1e-4, 1.15 * largest)
    panel.set_ylim(0.0, 1.03)
    panel.set_xlabel("True change of the gap δ (mrad)")
    panel.set_ylabel("Share of pairs in which wear is reported")
    panel.legend(
        loc="center left", bbox_to_anchor=(1.08, 0.5),
        title="smallest change found in 95 %,\nby amplitude (full), direct (open)",
        title_fontsize="medium", labelspacing=0.9, alignment="left",
    )  # fmt: skip
    return figure


def _smallest(shown: xr.Dataset, way: str) -> str:
    """Of both routes, where both were studied."""
    alike = shown.isel(row=np.flatnonzero(shown["recorded"].values == way))
    found = [f"{value:.2g}" for value in alike.sortby("route")["smallest_mrad"].values]
    return f"{', '.join(found)} mrad"


def _apart(change: np.ndarray, index: int) -> np.ndarray:
    """False alarms of the rows beside one another, not on top."""
    return np.where(change == 0.0, 9e-5 * index, change)


def caption(shown: xr.Dataset) -> str:
    """What is seen, with the smallest changes and the false alarms."""
    found = "; ".join(
        f"{name} {float(shown['smallest_mrad'].sel(row=name)):.2g} mrad"
        for name in shown["row"].values
    )
    pairs = shown["pairs_without_wear"]
    alarms = float((shown["false_alarms"] * pairs).sum())
    return (
        "Share of pairs of simulated recordings in which wear is reported (probability of an "
        "increase at least 95 %) against the true change, with 90 % binomial bands, and the curve "
        "fitted to it. Without a change a report is a false alarm, nominally 5 %: "
        f"{alarms:.0f} in {float(pairs.sum()):.0f} pairs. Smallest change that "
        f"is found in 95 % of pairs: {found}."
    )


FIGURE = PaperFigure("wear_detection", data, draw, caption)

if __name__ == "__main__":
    sys.exit(main(FIGURE))
