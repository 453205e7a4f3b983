"""Groups and variables of ``result.nc`` that every route of measurement stores.

Each route has a group of its own name, which contains ArviZ's groups (``posterior``,
``sample_stats``, ``observed_data``, …) and those of its physics. The root holds ``gap`` (draws of
the route that answers), and for a comparison ``change``, and ``wear`` if the recordings are dated.
In a comparison, everything that belongs to one recording has a leading dimension ``snapshot``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from bayesbl.config.sections import Interval as IntervalConfig
from bayesbl.measurement.summary_types import NoiseSummary
from bayesbl.recording.types import CHANNELS, FloatArray, Recording
from bayesbl.results.store import Interval, interval
from bayesbl.results.variables import Group, Variable, datasets, labels, table
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

DIAGNOSTICS = Group(
    "diagnostics",
    table("""
        r_hat (symbol) | 1 | rank-normalised split R-hat over independent ensembles
        ess_bulk (symbol) | 1 | bulk effective sample size
        autocorrelation_steps | 1 | longest integrated autocorrelation time
        steps | 1 | steps after burn-in
        rotations | 1 | load rotations in the recording
        effective? | 1 | effective draws after full simulation
        simulated? | 1 | draws simulated in full
        refits? | 1 | times the surrogate was fitted again
    """),
    (labels("symbol", "name of what was sampled"),),
)


def _channel(name: str) -> Variable:
    return Variable(name, ("sample",), unit_of(name), CHANNELS.get(name, name))


OBSERVED = Group("observed_data", named=_channel)
"""Channels that the route used, as they were compared."""

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
"""Time, and all other channels of the recording: figures plot simulations over them."""

BUDGET = Group(
    "budget",
    table("share (source) | 1 | share of the variance of ln δ"),
    (labels("source", "source of the uncertainty of δ"),),
)

LOG_LIKELIHOOD = Group(
    "log_likelihood",
    table("""
        recording (chain, draw, rotation) | 1 | log density of one load rotation, all channels, by
            the noise alone
    """),
    (CHAIN, DRAW, *table("rotation (rotation) | 1 | number of the load rotation")),
)


def _replicate(name: str) -> Variable:
    return replace(_channel(name), dims=(*DRAWS, "sample"))


POSTERIOR_PREDICTIVE = Group("posterior_predictive", (), (CHAIN, DRAW), named=_replicate)
PRIOR_PREDICTIVE = Group("prior_predictive", (), (CHAIN, DRAW), named=_replicate)

PRIOR_DRAWS = 1000
NOISE_DRAWS = 500
"""Draws of the posterior by the noise alone, over all chains."""


def of_noise_alone(
    named: Callable[[str], Variable | None],
    variables: tuple[Variable, ...] = (),
    coordinates: tuple[Variable, ...] = (),
    prior: tuple[Variable, ...] = (),
) -> dict[str, Group]:
    """Groups of the model with its noise alone, by name: prior, likelihood, predictions.

    ``named`` declares each unknown. Log likelihood and predictions belong to ``noise_posterior``,
    prior times likelihood, which is not widened as the answer is.
    """
    axes = (CHAIN, DRAW)
    groups = (
        Group("noise_posterior", variables, (*axes, *coordinates), named),
        LOG_LIKELIHOOD,
        Group("log_prior", (), axes, named),
        Group("prior", prior, axes, named),
        PRIOR_PREDICTIVE,
        POSTERIOR_PREDICTIVE,
    )
    return {group.name: group for group in groups}


def replicates(channels: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Predicted recordings, one per chain, each as long as the fitted one; channels (chain, n)."""
    return {name: rows[:, None].astype(np.float32) for name, rows in channels.items()}


GAP = Group("gap", (DELTA,), (CHAIN, DRAW))
"""Draws of δ of the route that answers; absent without a curve."""

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


def common_groups(
    recording: Recording,
    observed: Iterable[str],
    diagnostics: Diagnostics,
    budget: Mapping[str, float],
    rotations: float = 0.0,
    *,
    file: FloatArray | None = None,
    **simulated: float,
) -> dict[Group, object]:
    """Data of the groups that every route stores for a recording, without ``snapshot``.

    ``recording``: as it was compared. ``observed``: names of the channels that the route used; all
    others are constant data. ``budget``: share of each source in the variance of ln δ.
    ``rotations``: load rotations in the recording; 0 if the route counts none. ``file``: file
    number of each sample, for a snapshot of several files; shape (n,). ``simulated``: optional
    variables of :data:`DIAGNOSTICS` for draws that were simulated in full.
    """
    names = list(observed)
    excluded = np.zeros(recording.samples) if recording.excluded is None else recording.excluded
    constant: dict[str, object] = {
        "time_s": recording.time_s,
        **{name: row for name, row in recording.channels.items() if name not in names},
        "excluded": np.asarray(excluded, dtype=np.float64),
        "file": file,
    }
    sampled = {
        "r_hat": list(diagnostics.r_hat.values()),
        "ess_bulk": [diagnostics.ess_bulk[name] for name in diagnostics.r_hat],
        "autocorrelation_steps": diagnostics.autocorrelation_steps,
        "steps": diagnostics.steps,
        "rotations": rotations,
        "symbol": list(diagnostics.r_hat),
        **simulated,
    }
    return {
        OBSERVED: {name: recording.channels[name] for name in names},
        CONSTANT: constant,
        DIAGNOSTICS: sampled,
        BUDGET: {"share": list(budget.values()), "source": list(budget)},
    }


def stored(
    groups: Mapping[Group, object], of: IntervalConfig
) -> tuple[dict[str, xr.Dataset], dict[str, Any]]:
    """Groups of a recording as datasets, and the keys of ``summary.json`` that follow from them.

    These are ``parameters`` (the interval of every parameter in the posterior but δ), all variables
    that are declared as told, and those of :func:`common_groups`. Draws and other arrays become
    their interval. What is NaN is no parameter, and a key of it is ``None``.
    """

    def told(values: FloatArray) -> Interval | float | None:
        if not np.isfinite(values).all():
            return None
        return interval(values, of.level, of.kind) if values.ndim else float(values)

    made = datasets(groups)
    parameters: dict[str, Any] = {}
    keys: dict[str, Any] = {}
    for group in groups:
        for name, data in made[group.name].data_vars.items():
            declared = group.variable(str(name))
            is_parameter = declared.dims == DRAWS and not declared.optional and name != DELTA.name
            if group.name == "posterior" and is_parameter:
                parameters[str(name)] = told(data.values)
            if declared.told:
                keys[str(name)] = told(data.values)
    found = {name: value for name, value in parameters.items() if value is not None}
    return made, {**keys, "parameters": found, **_common_numbers(made)}


def _common_numbers(groups: Mapping[str, xr.Dataset]) -> dict[str, Any]:
    """Contents of :func:`common_groups` for ``summary.json``; diagnostics of the worst symbol."""
    sampled, budget = groups[DIAGNOSTICS.name], groups[BUDGET.name]
    diagnostics: dict[str, float] = {
        "r_hat": float(np.fmax.reduce(sampled["r_hat"].values)),
        "ess_bulk": float(np.fmin.reduce(sampled["ess_bulk"].values)),
    }
    if "effective" in sampled:
        diagnostics |= {
            "effective_after_simulation": float(sampled["effective"]),
            "simulated_draws": round(float(sampled["simulated"])),
            "surrogate_refits": round(float(sampled["refits"])),
        }
    return {
        "rotations": float(sampled["rotations"]),
        "excluded_samples": int(groups[CONSTANT.name]["excluded"].sum()),
        "budget": dict(zip(*(budget[n].values.tolist() for n in ("source", "share")), strict=True)),
        "diagnostics": diagnostics,
    }


def no_speed_noise(kind: str) -> NoiseSummary:
    """Noise of a route that compares no speed."""
    return dict(kind=kind, order=0, sd_rpm=0.0, coefficients=[], degrees_of_freedom=None)
