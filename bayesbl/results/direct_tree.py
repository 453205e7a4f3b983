"""Layout of ``result.nc`` for the direct route: the groups of one snapshot.

As in :mod:`bayesbl.results.tree`, arviz's groups stand at the root: ``posterior`` (δ, start angle,
bench parameters with a tolerance), ``sample_stats`` and ``observed_data``. Beside them
``predictive`` (simulation and residual by channel), ``optimum`` (with the Cramér-Rao bound),
``noise``, ``predictive_check``, ``diagnostics``, ``gap`` and ``amplitude_route``, what the
amplitude of the ringing says of the same recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from bayesbl.bench.effects import EFFECT_BY_NAME
from bayesbl.bench.parameters import PARAMETER_INFO
from bayesbl.matching.posterior import DirectPosterior
from bayesbl.matching.predictive_check import Disagreement
from bayesbl.matching.signals import GAP, Unknown
from bayesbl.measurement.change import Gap
from bayesbl.recording.types import FloatArray, Recording
from bayesbl.results.tree import Variables, dataset, observed_group
from bayesbl.ringing.estimator import Fit
from bayesbl.ringing.symbols import AMPLITUDE
from bayesbl.units import unit_of

DELTA = "delta_rad"
NEITHER = np.full((1, 1), np.nan)
"""Draws of the amplitude route where it has none."""


@dataclass(frozen=True, slots=True)
class AmplitudeRoute:
    """What the amplitude route says of a recording; ``reason`` where it has no answer."""

    fit: Fit | None
    gap: Gap | None
    reason: str | None


def direct_groups(
    posterior: DirectPosterior,
    recording: Recording,
    index: int,
    check: Sequence[Disagreement],
    beside: AmplitudeRoute,
) -> dict[str, xr.Dataset]:
    """All groups of one snapshot, without a ``snapshot`` dimension.

    Parameters
    ----------
    index
        Place of the recording in the posterior's model.
    check
        Entries of the predictive check that belong to this recording.
    """
    return {
        "posterior": _posterior(posterior, recording.name),
        "sample_stats": _sample_stats(posterior),
        "observed_data": observed_group(recording),
        "predictive": _predictive(posterior, index),
        "optimum": _optimum(posterior, recording.name),
        "noise": _noise(posterior, index),
        "predictive_check": _check(check),
        "diagnostics": _diagnostics(posterior, index),
        "gap": _gap(posterior, recording.name),
        "amplitude_route": _beside(beside),
    }


def result_name(unknown: Unknown) -> str:
    """Name of an unknown in results, ``delta_rad`` for the gap."""
    return DELTA if unknown.name == GAP else unknown.name


def unit_and_meaning(name: str) -> tuple[str, str]:
    """Unit and long name of an unknown by its name in results."""
    if name == DELTA:
        return "rad", "backlash gap"
    if name in PARAMETER_INFO:
        return PARAMETER_INFO[name].unit or "1", PARAMETER_INFO[name].meaning
    if "__" in name:
        effect, parameter = name.split("__")
        for item in EFFECT_BY_NAME[effect].parameters:
            if item.name == parameter:
                return item.unit or "1", f"{item.meaning} of {effect}"
    return "rad", "load angle at the first sample, 0 hangs straight down"


def own_unknowns(posterior: DirectPosterior, recording: str) -> dict[str, int]:
    """Name in results to place in a point, of everything that a recording depends on."""
    return {
        result_name(u): i
        for i, u in enumerate(posterior.fit.model.unknowns)
        if u.recording in (None, recording)
    }


def _posterior(posterior: DirectPosterior, recording: str) -> xr.Dataset:
    unknowns = posterior.fit.model.unknowns
    chains, count, _ = posterior.draws.shape
    return dataset(
        {
            name: (("chain", "draw"), unknowns[i].value(posterior.draws[..., i]),
                   *unit_and_meaning(name))
            for name, i in own_unknowns(posterior, recording).items()
        },
        {"chain": np.arange(chains), "draw": np.arange(count)},
    )  # fmt: skip


def _sample_stats(posterior: DirectPosterior) -> xr.Dataset:
    lp = -0.5 * (posterior.chi_square - np.nanmin(posterior.chi_square))
    what = "log likelihood less its largest, by full simulation, all recordings together"
    return dataset(
        {
            "lp": (("chain", "draw"), lp, "1", what),
            "acceptance_rate": (
                ("chain",),
                posterior.diagnostics.acceptance,
                "1",
                "accepted share of proposals",
            ),
        }
    )


def _predictive(posterior: DirectPosterior, index: int) -> xr.Dataset:
    fit = posterior.fit
    seen = fit.model.recordings[index]
    simulated = fit.model.signals(fit.point, index)[0]
    variables: dict[str, tuple[tuple[str, ...], FloatArray, str, str]] = {
        "rotation_period_s": ((), np.array(seen.rotation_period_s), "s", "one load rotation")
    }
    for channel, measured, model in zip(seen.channels, seen.signals, simulated, strict=True):
        unit = unit_of(channel)
        variables[f"simulated_{channel}"] = (("sample",), model, unit, "simulation at the optimum")
        variables[f"residual_{channel}"] = (
            ("sample",),
            measured - model,
            unit,
            "recording minus simulation",
        )
    return dataset(variables)


def _optimum(posterior: DirectPosterior, recording: str) -> xr.Dataset:
    """Values at the optimum; the bound in each parameter's own unit, of δ in rad."""
    fit = posterior.fit
    places = own_unknowns(posterior, recording)
    values = {name: float(fit.model.unknowns[i].value(fit.point[i])) for name, i in places.items()}
    slopes = np.array(
        [values[n] if fit.model.unknowns[i].logarithmic else 1.0 for n, i in places.items()]
    )
    index = np.array(list(places.values()))
    variables: dict[str, tuple[tuple[str, ...], FloatArray, str, str]] = {
        name: ((), np.array(value), *unit_and_meaning(name)) for name, value in values.items()
    }
    variables |= {
        "cramer_rao_sd": (
            ("parameter",),
            slopes * fit.bound[index],
            "each parameter's own",
            "Cramér-Rao bound on the standard deviation, priors left out",
        ),
        "covariance": (
            ("parameter", "parameter_"),
            np.outer(slopes, slopes) * fit.covariance[np.ix_(index, index)],
            "products of the parameters' units",
            "covariance of the normal approximation, priors included",
        ),
    }
    return dataset(variables, {"parameter": list(places), "parameter_": list(places)})


def _noise(posterior: DirectPosterior, index: int) -> xr.Dataset:
    noise = posterior.fit.model.noise[index]
    channels = list(posterior.fit.model.recordings[index].channels)
    return dataset(
        {
            "sd": (("channel",), noise.sd, "each channel's own", "standard deviation of the noise"),
            "order": ((), np.array(float(noise.order)), "1", "autoregressive order, 0 is white"),
            "coefficients": (
                ("lag", "channel", "channel_"),
                noise.coefficients,
                "ratios of the channels' units",
                "vector autoregressive coefficients",
            ),
            "innovation_root": (
                ("channel", "channel_"),
                noise.root,
                "each channel's own",
                "lower triangular root of the innovations' covariance",
            ),
            "differences": (
                (),
                np.array(float(noise.differences)),
                "1",
                "samples with a counterpart one rotation later",
            ),
        },
        {"channel": channels, "channel_": channels},
    )


def _check(check: Sequence[Disagreement]) -> xr.Dataset:
    """Ratio and probability by channel and band; see :mod:`bayesbl.matching.predictive_check`."""
    channels = list(dict.fromkeys(entry.channel for entry in check))
    orders = list(dict.fromkeys(entry.highest_order for entry in check))
    shape = (len(channels), len(orders))
    names = ("channel", "highest_order")
    return dataset(
        {
            "ratio": (
                names,
                np.array([entry.ratio for entry in check]).reshape(shape),
                "1",
                "power that repeats every rotation over what noise leaves of it",
            ),
            "probability": (
                names,
                np.array([entry.probability for entry in check]).reshape(shape),
                "1",
                "probability of a ratio as large from noise alone",
            ),
        },
        {"channel": channels, "highest_order": orders},
    )


def _diagnostics(posterior: DirectPosterior, index: int) -> xr.Dataset:
    found = posterior.diagnostics
    names = list(found.r_hat)
    seen = posterior.fit.model.recordings[index]
    scalars = {
        "autocorrelation_steps": (found.autocorrelation_steps, "autocorrelation time"),
        "steps": (float(found.steps), "steps after burn-in"),
        "effective": (posterior.effective, "effective draws after full simulation"),
        "simulated": (float(posterior.simulated), "draws simulated in full"),
        "refits": (float(posterior.refits), "times the surrogate was fitted again"),
        "rotations": (seen.samples / seen.sampling_hz / seen.rotation_period_s, "load rotations"),
    }
    variables: Variables = {
        "r_hat": (
            ("symbol",),
            np.array([found.r_hat[n] for n in names]),
            "1",
            "rank-normalised split R-hat over independent ensembles",
        ),
        "ess_bulk": (
            ("symbol",),
            np.array([found.ess_bulk[n] for n in names]),
            "1",
            "bulk effective sample size",
        ),
    } | {name: ((), np.array(value), "1", told) for name, (value, told) in scalars.items()}
    return dataset(variables, {"symbol": names})


def _gap(posterior: DirectPosterior, recording: str) -> xr.Dataset:
    """How much of the variance of ln δ would be there if the bench were known exactly."""
    fit = posterior.fit
    place = own_unknowns(posterior, recording)[DELTA]
    free = np.array([i for i, u in enumerate(fit.model.unknowns) if u.recording is not None])
    curvature = fit.jacobian.T @ fit.jacobian
    alone = np.linalg.inv(curvature[np.ix_(free, free)])
    noise = float(alone[list(free).index(place), list(free).index(place)])
    share = min(1.0, noise / float(posterior.draws[..., place].var()))
    known = free.size == len(fit.model.unknowns)
    budget = {"noise": 1.0} if known else {"noise": share, "bench": 1.0 - share}
    return dataset(
        {
            "budget": (
                ("source",),
                np.array(list(budget.values())),
                "1",
                "share of the variance of ln δ",
            )
        },
        {"source": list(budget)},
    )


def _beside(route: AmplitudeRoute) -> xr.Dataset:
    delta = NEITHER if route.gap is None else route.gap.delta_rad
    amplitude = NEITHER
    if route.fit is not None:
        amplitude = route.fit.posterior.draws[AMPLITUDE]
        if route.gap is not None:
            amplitude = amplitude.ravel()[route.gap.index]
    names = ("amplitude_chain", "amplitude_draw")
    return dataset(
        {
            DELTA: (names, delta, "rad", "backlash gap by the amplitude and the gap curve"),
            AMPLITUDE: (names, amplitude, "rpm", "amplitude of the impact ringing"),
        }
    )
