"""A stored result as figures read it: one view per snapshot, fits and comparisons alike."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from bayesbl.presentation.figures.style import WITHHELD, look
from bayesbl.recording.types import FloatArray
from bayesbl.results.intervals import interval
from bayesbl.results.store import texts
from bayesbl.ringing.symbols import SYMBOLS

GAP = "delta_rad"


@dataclass(frozen=True, slots=True)
class Snapshot:
    """One recording of a stored result.

    Attributes
    ----------
    name
        Of the recording.
    groups
        Group name to its dataset, without the ``snapshot`` dimension.
    reason
        Why δ is withheld; ``None`` where it is not.
    """

    name: str
    groups: dict[str, xr.Dataset]
    reason: str | None

    def values(self, group: str, variable: str) -> FloatArray:
        """A stored variable, any shape, with the NaN padding of shorter snapshots taken off."""
        stored = np.asarray(self.groups[group][variable].values, dtype=float)
        if stored.ndim == 0:
            return stored
        for axis in range(stored.ndim):
            others = tuple(a for a in range(stored.ndim) if a != axis)
            filled = np.flatnonzero(~np.isnan(stored).all(axis=others))
            stop = filled[-1] + 1 if filled.size else 0
            stored = np.take(stored, np.arange(stop), axis=axis)
        return stored

    def number(self, group: str, variable: str) -> float:
        """A stored scalar."""
        return float(self.groups[group][variable])

    @property
    def symbols(self) -> tuple[str, ...]:
        """Free symbols in the paper's order, δ behind them: all that has draws."""
        free = tuple(n for n in SYMBOLS if n in self.groups["posterior"])
        return (*free, GAP)

    @property
    def withheld(self) -> bool:
        """Whether δ must not be read."""
        return self.reason is not None

    def colour(self, index: int) -> str:
        """Of what shows δ, by the snapshot's place among the others; grey where withheld."""
        return WITHHELD if self.withheld else look(index).colour


def snapshots(tree: xr.DataTree) -> list[Snapshot]:
    """Every snapshot of a fit or a comparison, in the order of the configuration."""
    verdicts = json.loads(tree["diagnostics"].attrs["verdicts"])
    datasets = {name: node.to_dataset() for name, node in tree.children.items()}
    if "snapshot" not in datasets["posterior"].dims:
        (name,) = texts(tree.attrs["recordings"])
        return [Snapshot(name, datasets, verdicts["fit"]["reason"] or None)]
    names = [str(n) for n in datasets["posterior"]["snapshot"].values]
    return [
        Snapshot(
            name,
            {
                group: data.sel(snapshot=name) if "snapshot" in data.dims else data
                for group, data in datasets.items()
            },
            verdicts[name]["reason"] or None,
        )
        for name in names
    ]


def credible_interval(tree: xr.DataTree, draws: FloatArray) -> dict[str, Any]:
    """Median and interval of draws at the level and of the kind of this result."""
    level, kind = float(tree.attrs["interval_level"]), tree.attrs["interval_kind"]
    return interval(draws, level, kind)


def gap_interval(tree: xr.DataTree, snapshot: Snapshot) -> dict[str, Any]:
    """Median and interval of a snapshot's δ, in mrad."""
    return credible_interval(tree, 1e3 * snapshot.values("posterior", GAP))


def interval_in_words(tree: xr.DataTree, found: Mapping[str, float]) -> str:
    """``0.246 mrad (90 % interval 0.211 to 0.281)`` of an interval in mrad."""
    places = max(0, 1 - math.floor(math.log10(max(found["high"] - found["low"], 1e-9))))
    low, middle, high = (f"{found[k]:.{places}f}" for k in ("low", "median", "high"))
    return f"{middle} mrad ({interval_name(tree)} {low} to {high})".replace("-", "−")


def gap_in_words(tree: xr.DataTree, snapshot: Snapshot) -> str:
    """``after: 0.953 mrad (90 % interval 0.927 to 0.981)``, or that δ is withheld."""
    if snapshot.withheld:
        return f"{snapshot.name}: δ withheld"
    return f"{snapshot.name}: {interval_in_words(tree, gap_interval(tree, snapshot))}"


def interval_name(tree: xr.DataTree) -> str:
    """``90 % interval``."""
    kind = "HDI" if tree.attrs["interval_kind"] == "hdi" else "interval"
    return f"{100.0 * float(tree.attrs['interval_level']):g} % {kind}"
