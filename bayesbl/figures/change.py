"""The distribution of the change of the gap."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from bayesbl.figures.snapshots import Snapshot, credible_interval, interval_name
from bayesbl.figures.style import NEUTRAL, WITHHELD, look

_BINS = 40
_TOTAL = "#0072b2"


def draw_change(panel: Axes, tree: xr.DataTree, parts: list[Snapshot]) -> None:
    """Change from first to last snapshot with its interval; each step too where there are more."""
    change = tree["change"].to_dataset()
    draws = change["change_rad"].values
    withheld = parts[0].withheld or parts[-1].withheld
    _draw_total(panel, tree, 1e3 * draws, withheld)
    if change.sizes["step"] > 1:
        _draw_steps(panel, change, {p.name: p.withheld for p in parts})
    panel.axvline(0.0, color=NEUTRAL, linewidth=0.8, linestyle=(0.0, (3.0, 2.0)))
    panel.set_ylim(0.0, 1.35 * panel.get_ylim()[1])
    panel.set_xlabel(f"δ({parts[-1].name}) − δ({parts[0].name}) (mrad)")
    panel.set_ylabel("Posterior density (1/mrad)")
    _tell(panel, tree, 1e3 * draws, withheld)


def _draw_total(panel: Axes, tree: xr.DataTree, mrad: np.ndarray, withheld: bool) -> None:
    colour = WITHHELD if withheld else _TOTAL
    counts, edges = np.histogram(mrad, _BINS, density=True)
    panel.stairs(counts, edges, fill=True, color=colour, alpha=0.3)
    panel.stairs(counts, edges, color=colour, linewidth=1.0)
    if withheld:
        return
    found = credible_interval(tree, mrad)
    panel.errorbar(
        [found["median"]], [1.06 * counts.max()],
        xerr=[[found["median"] - found["low"]], [found["high"] - found["median"]]],
        color=colour, marker="o", capsize=2.5,
    )  # fmt: skip


def _draw_steps(panel: Axes, change: xr.Dataset, withheld: dict[str, bool]) -> None:
    for step in range(change.sizes["step"]):
        first, last = (str(change[k].values[step]) for k in ("step_from", "step_to"))
        hidden, style = withheld[first] or withheld[last], look(step + 1)
        counts, edges = np.histogram(
            1e3 * change["step_change_rad"].values[step], _BINS, density=True
        )
        panel.stairs(
            counts, edges, color=WITHHELD if hidden else style.colour, linestyle=style.dashes,
            label=f"{first} to {last}" + (" (withheld)" if hidden else ""),
        )  # fmt: skip
    panel.legend(loc="upper right")


def _tell(panel: Axes, tree: xr.DataTree, mrad: np.ndarray, withheld: bool) -> None:
    if withheld:
        text = "withheld"
    else:
        found = credible_interval(tree, mrad)
        low, middle, high = (f"{found[k]:.3f}" for k in ("low", "median", "high"))
        text = f"{middle} mrad\n{interval_name(tree)} {low} to {high}"
    panel.text(0.04, 0.98, text, transform=panel.transAxes, va="top")
