"""How much a joint must wear before a comparison reports it: detection curves."""

from __future__ import annotations

import sys

import numpy as np
import xarray as xr
from common import PaperFigure, Stored, arrays, main, numbers
from matplotlib.figure import Figure
from scipy.stats import binom, norm

from bayesbl.figures.layout import grid
from bayesbl.figures.style import DOUBLE_COLUMN_IN, NEUTRAL, look, new_figure

POWER = 0.95
NOMINAL = 0.05
_LINEAR = 4e-3
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
        "pairs_per_change": "1", "false_alarms": "1",
    }  # fmt: skip
    if all("pairs_without_wear" in line for line in lines):
        columns["pairs_without_wear"] = "1"
    return arrays(
        change_mrad=(("row", "change"), padded[0], "mrad"),
        reported=(("row", "change"), padded[1], "1"),
        **{name: ("row", numbers(lines, name), unit) for name, unit in columns.items()},
    ).assign_coords(row=[line["name"] for line in lines])


def draw(shown: xr.Dataset) -> Figure:
    """Shares with 90 % binomial bands, and the curve through them, a look a row."""
    figure = new_figure(DOUBLE_COLUMN_IN, 2.9)
    panel = figure.add_subplot(grid(figure, 1, 1, right=2.75, top=0.12)[0, 0])
    largest = float(shown["change_mrad"].max())
    fine = np.concatenate(
        [np.linspace(0.0, _LINEAR, 30), np.geomspace(_LINEAR, 1.15 * largest, 300)]
    )
    for index, name in enumerate(shown["row"].values):
        style, part = look(index), shown.sel(row=name).dropna("change")
        size, share = float(part["pairs_per_change"]), part["reported"].values
        size = np.where(part["change_mrad"] == 0.0, float(_without_wear(part)), size)
        band = np.abs(binom.ppf([[0.05], [0.95]], size, share) / size - share)
        panel.errorbar(
            _apart(part["change_mrad"].values, index), share, band, color=style.colour,
            marker=style.marker, linestyle="none", capsize=2.0, elinewidth=0.7,
        )  # fmt: skip
        middle, width = float(part["half_found_mrad"]), float(part["curve_width_mrad"])
        panel.plot(
            fine, norm.cdf((fine - middle) / width), color=style.colour, linestyle=style.dashes,
            label=f"{name}:\n{float(part['smallest_mrad']):.2g} mrad",
        )  # fmt: skip
    for level, told in ((POWER, "95 %"), (NOMINAL, "5 %")):
        panel.axhline(level, color=NEUTRAL, linewidth=0.6, linestyle=(0.0, (3.0, 2.0)))
        panel.annotate(
            told, (1.0, level), xycoords=("axes fraction", "data"), xytext=(2.0, 0.0),
            textcoords="offset points", va="center",
        )  # fmt: skip
    panel.set_xscale("symlog", linthresh=_LINEAR, linscale=0.4)
    ticks = [0.0, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2]
    panel.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    panel.set_xticks([], minor=True)
    panel.set_xlim(-3e-4, 1.15 * largest)
    panel.set_ylim(0.0, 1.03)
    panel.set_xlabel("True change of the gap δ (mrad)")
    panel.set_ylabel("Share of pairs in which wear is reported")
    panel.legend(
        loc="center left", bbox_to_anchor=(1.12, 0.5), title="smallest change found in 95 %",
        title_fontsize="medium", labelspacing=0.9, alignment="left",
    )  # fmt: skip
    return figure


def _without_wear(shown: xr.Dataset) -> xr.DataArray:
    """Pairs without a change, by row; older tables have as many as at each change."""
    return shown.get("pairs_without_wear", shown["pairs_per_change"])


def _apart(change: np.ndarray, index: int) -> np.ndarray:
    """False alarms of the rows beside one another, not on top."""
    return np.where(change == 0.0, 2.2e-4 * index, change)


def caption(shown: xr.Dataset) -> str:
    """What is seen, with the smallest changes and the false alarms."""
    found = "; ".join(
        f"{name} {float(shown['smallest_mrad'].sel(row=name)):.2g} mrad"
        for name in shown["row"].values
    )
    alarms = float((shown["false_alarms"] * _without_wear(shown)).sum())
    return (
        "Share of pairs of simulated recordings in which wear is reported (probability of an "
        "increase at least 95 %) against the true change, with 90 % binomial bands, and the curve "
        "fitted to it. Without a change a report is a false alarm, nominally 5 %: "
        f"{alarms:.0f} in {float(_without_wear(shown).sum()):.0f} pairs. Smallest change that "
        f"is found in 95 % of pairs: {found}."
    )


FIGURE = PaperFigure("wear_detection", data, draw, caption)

if __name__ == "__main__":
    sys.exit(main(FIGURE))
