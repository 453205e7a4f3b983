"""Figure 10: the two gaps and their change."""

from __future__ import annotations

import sys

import xarray as xr
from common import PaperFigure, Stored, main, picked

from bayesbl.presentation.figures import gap
from bayesbl.presentation.figures.change import told
from bayesbl.presentation.figures.snapshots import GAP, credible_interval, snapshots
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
        f"{s.name} {told(tree, credible_interval(tree, 1e3 * s.values('posterior', GAP)))}"
        for s in snapshots(tree)
    )
    draws = 1e3 * tree["change"]["change_rad"].values
    return (
        "(a) Amplitude A and gap δ of both recordings on the curve that was swept on the bench, "
        f"with their posterior distributions along the axes: {gaps}. (b) The change of the gap, "
        "both recordings through the same draws of the curve: "
        f"{told(tree, credible_interval(tree, draws))}. (c) The whole curve."
    )


FIGURE = PaperFigure("figure_10", data, gap, caption)

if __name__ == "__main__":
    sys.exit(main(FIGURE))
