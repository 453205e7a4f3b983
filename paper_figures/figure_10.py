"""Figure 10: the two gaps and their change."""

from __future__ import annotations

import sys

import xarray as xr
from common import PaperFigure, Stored, main, picked

from bayesbl.presentation.figures.gap import gap
from bayesbl.presentation.figures.stored_figure import credible_interval, gap_interval, snapshots
from bayesbl.presentation.figures.style import GAP
from bayesbl.presentation.words import with_bounds
from bayesbl.ringing.symbols import AMPLITUDE


def data(stored: Stored) -> xr.DataTree:
    """Draws of A, δ and the change, and the curve between them."""
    return picked(
        stored.tree("wear_swept"),
        posterior=(AMPLITUDE, GAP),
        curve=("delta_rad", "low_rad", "high_rad"),
        change=None,
        diagnostics=(),
    )


def caption(tree: xr.DataTree) -> str:
    """What is seen, with gaps and change."""
    gaps = "; ".join(
        f"{s.name} {with_bounds(gap_interval(tree, s), 'mrad')}" for s in snapshots(tree)
    )
    draws = 1e3 * tree["change"].to_dataset()["change_rad"].values
    return (
        "(a) Gap δ of both recordings, by the amplitude of their ringing and the curve that was "
        f"swept on the bench: {gaps}. (b) The change of the gap, both recordings through the same "
        "draws of the curve: "
        f"{with_bounds(credible_interval(tree, draws), 'mrad')}."
    )


FIGURE = PaperFigure("figure_10", data, gap, caption)

if __name__ == "__main__":
    sys.exit(main(FIGURE))
