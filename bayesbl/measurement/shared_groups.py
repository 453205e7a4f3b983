"""Groups and variables of ``result.nc`` that both routes of measurement store.

A fit has arviz's groups at the root (``posterior``, ``sample_stats``, ``observed_data``) and
groups of its route beside them. A comparison has the same with a dimension ``snapshot`` in front,
and ``change``; where the recordings are dated also ``wear``. ``curve`` holds the gap curve over its
range in both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr

from bayesbl.measurement.change import Change
from bayesbl.recording.types import CHANNELS, FloatArray, Recording
from bayesbl.results.variables import Group, Variable, dataset, labels, table
from bayesbl.sampling.convergence import Diagnostics
from bayesbl.units import unit_of

DRAWS = ("chain", "draw")
(DELTA, ACCEPTANCE, NOISE_ORDER, DIFFERENCES) = table("""
    delta_rad (chain, draw) | rad | backlash gap
    acceptance_rate (chain) | 1 | accepted share of proposals
    order | 1 | autoregressive order, 0 is white
    differences | 1 | samples with a counterpart one rotation later
""")

(CHAIN, DRAW) = table("""
    chain (chain) | 1 | number of the independent ensemble
    draw (draw) | 1 | number of the draw
""")

SAMPLING = table("""
    r_hat (symbol) | 1 | rank-normalised split R-hat over independent ensembles
    ess_bulk (symbol) | 1 | bulk effective sample size
    autocorrelation_steps | 1 | longest integrated autocorrelation time
    steps | 1 | steps after burn-in
    rotations | 1 | load rotations in the recording
""")
"""What ``diagnostics`` holds of the sampling by every route; see :func:`sampling_values`."""

SAMPLED_SYMBOLS = labels("symbol", "name of what was sampled")


def _channel(name: str) -> Variable:
    return Variable(name, ("sample",), unit_of(name), CHANNELS.get(name, name))


OBSERVED = Group(
    "observed_data",
    table("""
        time_s (sample) | s | time
        excluded? (sample) | 1 | sample that was lost or cannot be trusted (1), bridged and left
            out of the fit
        file? (sample) | 1 | number of the file, of a snapshot of several
    """),
    named=_channel,
)

GAP = Group(
    "gap",
    table("budget (source) | 1 | share of the variance of ln δ"),
    (labels("source", "source of the uncertainty of δ"),),
)

CHANGE = Group(
    "change",
    table("""
        change_rad? (chain, draw) | rad | change of the backlash gap from first to last
        step_change_rad? (step, chain, draw) | rad
            | change of the backlash gap between neighbouring snapshots
        ringing_change? (chain, draw) | 1
            | change of the ringing's amplitude from first to last, as a share of the first
    """),
    table("""
        step_from? (step) | text | snapshot before the step
        step_to? (step) | text | snapshot after the step
    """),
)


def observed_group(recording: Recording, **beside: object) -> xr.Dataset:
    """Every channel that was recorded: later figures lay simulations over them.

    ``beside``: further variables of :data:`OBSERVED`.
    """
    excluded = np.zeros(recording.samples) if recording.excluded is None else recording.excluded
    channels = {"time_s": recording.time_s, **recording.channels}
    values = {"excluded": np.asarray(excluded, dtype=np.float64), **beside}
    return dataset(OBSERVED, channels | values)


def sampling_values(diagnostics: Diagnostics, rotations: float) -> dict[str, object]:
    """Values of :data:`SAMPLING`."""
    return {
        "r_hat": list(diagnostics.r_hat.values()),
        "ess_bulk": [diagnostics.ess_bulk[name] for name in diagnostics.r_hat],
        "autocorrelation_steps": diagnostics.autocorrelation_steps,
        "steps": diagnostics.steps,
        "rotations": rotations,
    }


def numbered(shape: tuple[int, ...]) -> dict[str, object]:
    """Coordinates ``chain`` and ``draw`` of draws of shape (chain, draw)."""
    return {"chain": np.arange(shape[0]), "draw": np.arange(shape[1])}


def gap_group(budget: Mapping[str, float]) -> xr.Dataset:
    """Share of each source in the variance of ln δ."""
    return dataset(GAP, {"budget": list(budget.values())}, {"source": list(budget)})


def change_group(
    total: Change | None, steps: Sequence[Change], ringing_change: FloatArray | None
) -> xr.Dataset:
    """Draws of the change from first to last, and of each step; what there is not is left out."""
    values: dict[str, object] = {"ringing_change": ringing_change}
    if total is None:
        return dataset(CHANGE, values)
    values["change_rad"] = total.change_rad
    values["step_change_rad"] = np.stack([step.change_rad for step in steps])
    return dataset(
        CHANGE,
        values,
        {
            "step_from": [step.first for step in steps],
            "step_to": [step.last for step in steps],
        },
    )
