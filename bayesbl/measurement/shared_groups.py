"""Groups and variables of ``result.nc`` that every route of measurement stores.

Each route has a group of its own name, with ArviZ's groups inside (``posterior``, ``sample_stats``,
``observed_data``, …) and those of its science. At the root are ``gap``, the draws of the route that
answers, and of a comparison ``change``, and ``wear`` where the recordings are dated. In a
comparison all that is of one recording has a dimension ``snapshot`` in front.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import xarray as xr

from bayesbl.config.sections import Interval as IntervalConfig
from bayesbl.recording.types import CHANNELS, Recording
from bayesbl.results.intervals import Interval, interval
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


OBSERVED = Group("observed_data", named=_channel)
"""Channels that the route goes by, as they were compared."""

CONSTANT = Group(
    "constant_data",
    table("""
        time_s (sample) | s | time
        excluded? (sample) | 1 | sample that was lost or cannot be trusted (1), bridged and left
            out of the fit
        file? (sample) | 1 | number of the file, of a snapshot of several
    """),
    named=_channel,
)
"""Time, and all other channels of the recording: later figures lay simulations over them."""

BUDGET = Group(
    "budget",
    table("share (source) | 1 | share of the variance of ln δ"),
    (labels("source", "source of the uncertainty of δ"),),
)

GAP = Group("gap", (DELTA,), (CHAIN, DRAW), optional=True)
"""The draws of δ of the route that answers; absent without a curve."""

CHANGE = Group(
    "change",
    table("""
        change_rad? (chain, draw) | rad | change of the backlash gap from first to last
        step_change_rad? (step, chain, draw) | rad
            | change of the backlash gap between neighbouring snapshots
        ringing_change? (ringing_chain, ringing_draw) | 1
            | change of the ringing's amplitude from first to last, as a share of the first
    """),
    table("""
        step_from? (step) | text | snapshot before the step
        step_to? (step) | text | snapshot after the step
    """),
)


def recorded(
    recording: Recording, observed: Mapping[str, object], **beside: object
) -> dict[str, xr.Dataset]:
    """Groups :data:`OBSERVED`, with what a route went by, and :data:`CONSTANT`, with all else.

    ``beside``: further variables of :data:`CONSTANT`.
    """
    excluded = np.zeros(recording.samples) if recording.excluded is None else recording.excluded
    others = {name: row for name, row in recording.channels.items() if name not in observed}
    values = {"excluded": np.asarray(excluded, dtype=np.float64), **beside}
    constant = {"time_s": recording.time_s, **others, **values}
    return {
        OBSERVED.name: dataset(OBSERVED, observed),
        CONSTANT.name: dataset(CONSTANT, constant),
    }


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


def budget_group(budget: Mapping[str, float]) -> xr.Dataset:
    """Share of each source in the variance of ln δ."""
    return dataset(BUDGET, {"share": list(budget.values())}, {"source": list(budget)})


def intervals(
    posterior: xr.Dataset, names: Iterable[str], of: IntervalConfig
) -> dict[str, Interval]:
    """Interval of each of these variables of a posterior, as configured."""
    return {name: interval(posterior[name].values, of.level, of.kind) for name in names}


def excluded_samples(recording: Recording) -> int:
    """Samples that were lost or cannot be trusted."""
    return 0 if recording.excluded is None else int(recording.excluded.sum())


def sampling_summary(diagnostics: Diagnostics) -> dict[str, float]:
    """How the sampling ended, by the worst of all symbols."""
    worst = np.fmax.reduce(list(diagnostics.r_hat.values()))
    fewest = np.fmin.reduce(list(diagnostics.ess_bulk.values()))
    return {"r_hat": float(worst), "ess_bulk": float(fewest)}
