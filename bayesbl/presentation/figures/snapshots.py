"""A stored result as figures read it: one view per snapshot, fits and comparisons alike."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from bayesbl.recording.types import FloatArray
from bayesbl.results.intervals import interval
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


def snapshots(tree: xr.DataTree) -> list[Snapshot]:
    """Every snapshot of a fit or a comparison, in the order of the configuration."""
    verdicts = json.loads(tree["diagnostics"].attrs["verdicts"])
    datasets = {name: node.to_dataset() for name, node in tree.children.items()}
    if tree.attrs["kind"] != "compare":
        name = _recording_names(tree)[0]
        return [Snapshot(name, datasets, verdicts["fit"]["reason"] or None)]
    names = [str(n) for n in tree["posterior"].to_dataset()["snapshot"].values]
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


def interval_name(tree: xr.DataTree) -> str:
    """``90 % interval``."""
    kind = "HDI" if tree.attrs["interval_kind"] == "hdi" else "interval"
    return f"{100.0 * float(tree.attrs['interval_level']):g} % {kind}"


def _recording_names(tree: xr.DataTree) -> list[str]:
    names = tree.attrs["recordings"]
    # NetCDF gives a list of one back as a plain string.
    return [names] if isinstance(names, str) else [str(n) for n in names]
