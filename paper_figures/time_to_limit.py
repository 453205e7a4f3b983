"""When the gap reaches its limit: dated snapshots of a joint with a repair between them."""

from __future__ import annotations

import sys
from typing import cast

import xarray as xr
from common import PaperFigure, Stored, main, picked

from bayesbl.measurement.summary_types import ComparisonSummary
from bayesbl.presentation.figures.gap import wear
from bayesbl.presentation.figures.style import GAP
from bayesbl.presentation.wear import sentences, with_rate
from bayesbl.results.store import summary_of


def data(stored: Stored) -> xr.DataTree:
    """Draws of δ by date, of the wear's path and of the time to the limit."""
    tree = stored.tree("wear_dates")
    found = with_rate(cast(ComparisonSummary, summary_of(tree)))
    assert found is not None, "the snapshots are dated, and the gap grows"
    kept = picked(tree, posterior=(GAP,), wear=None, diagnostics=())
    kept.attrs["answer"] = " ".join(sentences(found))
    return kept


def caption(tree: xr.DataTree) -> str:
    """What is seen, with the answer as the report words it."""
    group = tree["wear"].to_dataset()
    used = int(group["used"].values.sum())
    return (
        f"(a) The gap δ at {group['used'].size} dates with its interval, and its path through the "
        f"{used} since the last repair (open: before it); recordings simulated on the virtual "
        "bench, amplitude route, one curve for all. (b) Probability that the limit is reached by a "
        f"date. {tree.attrs['answer']}"
    )


FIGURE = PaperFigure("time_to_limit", data, wear, caption)

if __name__ == "__main__":
    sys.exit(main(FIGURE))
