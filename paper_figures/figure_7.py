"""Figure 7: the disturbance at increasing gap."""

from __future__ import annotations

import sys

import xarray as xr
from common import PaperFigure, Stored, main, picked

from bayesbl.presentation.figures.sweep import disturbance, pulse_view
from bayesbl.ringing.symbols import DECAY, FREQUENCY


def data(stored: Stored) -> xr.DataTree:
    """Noise-free speed over one load rotation at some gaps, and the sweep that they belong to."""
    return picked(stored.tree("sweep"), examples=None, sweep=(FREQUENCY, DECAY))


def caption(tree: xr.DataTree) -> str:
    """What is seen."""
    gaps = 1e3 * tree["examples"].to_dataset()["gap_rad"].values
    return (
        f"Motor speed of the virtual bench without noise at {gaps.size} gaps δ from {gaps[0]:.2f} "
        f"to {gaps[-1]:.2f} mrad. (a) One load rotation; (b), (c) the two impacts, shaded in (a), "
        f"{1e3 * pulse_view(tree)[1]:.0f} ms each. The ringing grows with the gap and keeps its "
        "shape; the slow wave under it is gravity, which the speed loop does not suppress fully."
    )


FIGURE = PaperFigure("figure_7", data, disturbance, caption)

if __name__ == "__main__":
    sys.exit(main(FIGURE))
