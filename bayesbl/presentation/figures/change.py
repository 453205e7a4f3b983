"""The distribution of the change of the gap."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from bayesbl.presentation.figures.snapshots import Snapshot, credible_interval, interval_name
from bayesbl.presentation.figures.style import NEUTRAL, WITHHELD, look
from bayesbl.recording.types import FloatArray
from bayesbl.results.intervals import Interval

_BINS = 40
_STEPS = "each step in the colour of its later snapshot"


def draw_change(panel: Axes, tree: xr.DataTree, parts: list[Snapshot]) -> None:
    """Change from first to last snapshot with its interval; each step too where there are more."""
    change = tree["change"].to_dataset()
    hidden = parts[0].withheld or parts[-1].withheld
    _draw_total(panel, tree, 1e3 * change["change_rad"].values, hidden)
    if change.sizes["step"] > 1:
        _draw_steps(panel, change, {p.name: p.withheld for p in parts})
    panel.axvline(0.0, color=NEUTRAL, linewidth=0.8, linestyle=(0.0, (3.0, 2.0)))
    panel.set_ylim(0.0, 1.1 * panel.get_ylim()[1])
    panel.set_xlabel("Change of the gap δ (mrad)")
    panel.set_ylabel("Posterior density (1/mrad)")
    # The whole change is grey, as no snapshot is: colours are those of the panels beside it.
    panel.legend(
        loc="lower left", bbox_to_anchor=(-0.05, 1.12), borderaxespad=0.0, alignment="left",
        title=_STEPS if change.sizes["step"] > 1 else None,
    )  # fmt: skip


def legend_lines(tree: xr.DataTree) -> int:
    """How many lines the legend of the change has."""
    steps = tree["change"].to_dataset().sizes["step"]
    return 1 if steps == 1 else 2 + steps


def _draw_total(panel: Axes, tree: xr.DataTree, mrad: FloatArray, hidden: bool) -> None:
    """Distribution, and above it the median with its interval; grey and without where withheld."""
    colour = WITHHELD if hidden else NEUTRAL
    counts, edges = np.histogram(mrad, _BINS, density=True)
    panel.stairs(
        counts, edges, fill=True, color=colour, alpha=0.3,
        label="withheld" if hidden else None,
    )  # fmt: skip
    panel.stairs(counts, edges, color=colour, linewidth=1.0)
    if hidden:
        return
    found = credible_interval(tree, mrad)
    panel.errorbar(
        [found["median"]], [1.06 * counts.max()],
        xerr=[[found["median"] - found["low"]], [found["high"] - found["median"]]],
        color=colour, marker="o", linestyle="none", capsize=2.5, label=told(tree, found),
    )  # fmt: skip


def _draw_steps(panel: Axes, change: xr.Dataset, withheld: Mapping[str, bool]) -> None:
    for step in range(change.sizes["step"]):
        first, last = (str(change[k].values[step]) for k in ("step_from", "step_to"))
        hidden, style = withheld[first] or withheld[last], look(step + 1)
        mrad = 1e3 * change["step_change_rad"].values[step]
        counts, edges = np.histogram(mrad, _BINS, density=True)
        panel.stairs(
            counts, edges, color=WITHHELD if hidden else style.colour, linestyle=style.dashes,
            linewidth=1.0, label=f"{first} to {last}" + (": withheld" if hidden else ""),
        )  # fmt: skip


def told(tree: xr.DataTree, found: Interval) -> str:
    """``0.246 mrad (90 % interval 0.211 to 0.281)``."""
    places = max(0, 1 - math.floor(math.log10(max(found["high"] - found["low"], 1e-9))))
    low, middle, high = (f"{found[k]:.{places}f}" for k in ("low", "median", "high"))
    return f"{middle} mrad ({interval_name(tree)} {low} to {high})".replace("-", "−")
