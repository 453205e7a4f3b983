"""What several figures draw alike: densities, intervals, the limit, the rotation of the load."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from bayesbl.presentation.figures.style import LIMIT
from bayesbl.recording.types import FloatArray
from bayesbl.results.intervals import Interval

TURN = 2.0 * np.pi
"""A rotation of the load in rad."""

_BINS = 40
LIMIT_DASHES = (0.0, (6.0, 2.0, 1.0, 2.0))


def density(
    panel: Axes,
    draws: FloatArray,
    colour: str,
    *,
    bins: int = _BINS,
    filled: bool = True,
    orientation: Literal["vertical", "horizontal"] = "vertical",
    **outline: Any,
) -> tuple[FloatArray, FloatArray]:
    """The histogram of draws as a density, filled and outlined; its heights and edges."""
    heights, edges = np.histogram(draws, bins, density=True)
    if filled:
        panel.stairs(heights, edges, orientation=orientation, fill=True, color=colour, alpha=0.3)
    panel.stairs(heights, edges, orientation=orientation, color=colour, **outline)
    return heights, edges


def reach(interval: Interval, scale: float = 1.0) -> list[list[float]]:
    """How far an interval reaches below and above its median, as error bars ask for it."""
    below = interval["median"] - interval["low"]
    above = interval["high"] - interval["median"]
    return [[scale * below], [scale * above]]


def band_in_words(curve: xr.Dataset) -> str:
    """``90 % band ± 0.02 %``: of a curve, at its widest; too narrow to be seen, as a rule."""
    reach = 0.5 * (curve["high_rad"].values - curve["low_rad"].values) / curve["delta_rad"].values
    return f"{100.0 * float(curve.attrs['level']):g} % band ± {100.0 * float(reach.max()):.2g} %"


def limit_line(panel: Axes, tree: xr.DataTree) -> None:
    """The limit across a panel whose vertical axis is the gap in mrad, if there is one."""
    if "limit_rad" in tree.attrs:
        limit = 1e3 * float(tree.attrs["limit_rad"])
        panel.axhline(
            limit,
            color=LIMIT,
            linewidth=0.9,
            linestyle=LIMIT_DASHES,
            label=f"limit {limit:g} mrad",
        )


def shade(panel: Axes, start: float, end: float) -> None:
    """A stretch of the horizontal axis on a tinted ground."""
    panel.axvspan(start, end, color="#f5edc0", linewidth=0.0, zorder=0.0)


def rotation_axis(panel: Axes, label: str) -> None:
    """One rotation of the load along the horizontal axis, in quarters."""
    panel.set_xlim(0.0, TURN)
    panel.set_xticks(TURN * np.arange(5) / 4.0, ["0", "π/2", "π", "3π/2", "2π"])
    panel.set_xlabel(label)
