"""Groups of ``result.nc`` by which the direct route stores a snapshot.

``posterior`` holds δ, the start angle and bench parameters with a tolerance; ``predictive`` the
simulation and the residual by channel; ``optimum`` also the Cramér-Rao bound; ``amplitude_route``
what the amplitude of the ringing says of the same recording.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import xarray as xr

from bayesbl.bench.effects import EFFECT_BY_NAME
from bayesbl.bench.learned import LEARNED_TERMS
from bayesbl.bench.parameters import PARAMETER_INFO
from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.motions import flank_changes
from bayesbl.matching.observed import begin_of
from bayesbl.matching.posterior import DirectPosterior
from bayesbl.matching.predictive_check import RepeatingPower
from bayesbl.matching.signals import GAP as GAP_UNKNOWN
from bayesbl.matching.signals import REFERENCE_DELAY, Unknown
from bayesbl.measurement import shared_groups as shared
from bayesbl.measurement.other_route import AMPLITUDE_ROUTE
from bayesbl.recording.types import Recording
from bayesbl.results.variables import Group, Variable, attributes, dataset, labels, table
from bayesbl.units import unit_of

DELTA = shared.DELTA.name


DRIFT = "drift__"
"""Before the name of what may have drifted since the first snapshot."""


def result_name(unknown: Unknown) -> str:
    """Name of an unknown in results, ``delta_rad`` for the gap."""
    if unknown.added:
        return DRIFT + unknown.name
    return DELTA if unknown.name == GAP_UNKNOWN else unknown.name


def unit_and_meaning(name: str) -> tuple[str, str]:
    """Unit and long name of an unknown by its name in results."""
    if name.startswith(DRIFT):
        unit, meaning = unit_and_meaning(name.removeprefix(DRIFT))
        return unit, f"change since the first snapshot of: {meaning}"
    if name == DELTA:
        return shared.DELTA.unit, shared.DELTA.meaning
    if name == REFERENCE_DELAY:
        return "s", "how much later the controller was given its reference than is recorded"
    if name in PARAMETER_INFO:
        return PARAMETER_INFO[name].unit or "1", PARAMETER_INFO[name].meaning
    learned = {term.block: term for term in LEARNED_TERMS}.get(name.partition("__")[0])
    if learned is not None:
        what = learned.block.replace("_", " ")
        if name == learned.shift_slot:
            return "1", f"where the variable of the {what} is at the first sample, rad or s"
        return learned.unit, f"coefficient of the {what}: {name.partition('__')[2]}"
    if "__" in name:
        effect, parameter = name.split("__")
        for item in EFFECT_BY_NAME[effect].parameters:
            if item.name == parameter:
                return item.unit or "1", f"{item.meaning} of {effect}"
    return "rad", "load angle at the first sample, 0 hangs straight down"


def _unknown(*dims: str) -> Callable[[str], Variable]:
    """Declares each unknown by its name in results."""
    return lambda name: Variable(name, dims, *unit_and_meaning(name))


def _predicted(name: str) -> Variable | None:
    kind, _, channel = name.partition("_")
    meanings = {"simulated": "simulation at the optimum", "residual": "recording minus simulation"}
    if kind not in meanings:
        return None
    return Variable(name, ("sample",), unit_of(channel), meanings[kind])


POSTERIOR = Group(
    "posterior", (shared.DELTA,), (shared.CHAIN, shared.DRAW), named=_unknown(*shared.DRAWS)
)

SAMPLE_STATS = Group(
    "sample_stats",
    (
        *table("""
            lp (chain, draw) | 1 | log likelihood less its largest, by full simulation,
                all recordings together
        """),
        shared.ACCEPTANCE,
    ),
)

PREDICTIVE = Group(
    "predictive",
    table("""
        rotation_period_s | s | one load rotation, or one cycle of a motion
        reference_speed_rpm? (sample) | rpm | what the motor of a motion was asked for
        compared_from_s? | s | begin of what was compared of a motion, from the first sample
        repeats? | 1 | 1 where a motion repeats, 0 where it does not
        flank_changes? | 1 | how often the load passed from one flank to the other
        flank_left_s? (flank) | s | when the teeth parted, from the first sample
        flank_met_s? (flank) | s | when they met on the other side
        flank_side? (flank) | 1 | flank met: 1 where the motor pushes forward, −1 backward
    """),
    named=_predicted,
)

OPTIMUM = Group(
    "optimum",
    table("""
        cramer_rao_sd (parameter) | each parameter's own
            | Cramér-Rao bound on the standard deviation, priors left out
        covariance (parameter, parameter_) | products of units
            | covariance of the normal approximation, priors included
    """),
    (labels("parameter", "unknown"), labels("parameter_", "unknown")),
    named=_unknown(),
)

NOISE = Group(
    "noise",
    (
        *table("""
            sd (channel) | each channel's own | standard deviation of the noise
            coefficients (lag, channel, channel_) | ratios of units
                | vector autoregressive coefficients
            innovation_root (channel, channel_) | each channel's own
                | lower triangular root of the innovations' covariance
        """),
        shared.NOISE_ORDER,
        shared.DIFFERENCES,
    ),
    (labels("channel", "channel"), labels("channel_", "channel")),
)

PREDICTIVE_CHECK = Group(
    "predictive_check",
    table("""
        ratio (channel, highest_order) | 1 | power that repeats every rotation over that of noise
        probability (channel, highest_order) | 1 | probability of a ratio as large from noise alone
    """),
    (
        labels("channel", "channel"),
        *table("highest_order (highest_order) | 1 | highest load order of the band"),
    ),
)

DIAGNOSTICS = Group(
    "diagnostics",
    (
        *shared.SAMPLING,
        *table("""
            effective | 1 | effective draws after full simulation
            simulated | 1 | draws simulated in full
            refits | 1 | times the surrogate was fitted again
        """),
    ),
    (shared.SAMPLED_SYMBOLS,),
)

GROUPS = (
    POSTERIOR,
    SAMPLE_STATS,
    shared.OBSERVED,
    PREDICTIVE,
    OPTIMUM,
    NOISE,
    PREDICTIVE_CHECK,
    DIAGNOSTICS,
    shared.GAP,
    AMPLITUDE_ROUTE,
)


def direct_groups(
    posterior: DirectPosterior,
    recording: Recording,
    index: int,
    check: Sequence[RepeatingPower],
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
        "observed_data": shared.observed_group(recording),
        "predictive": _predictive(posterior, index),
        "optimum": _optimum(posterior, recording.name),
        "noise": _noise(posterior, index),
        "predictive_check": _check(check),
        "diagnostics": _diagnostics(posterior, index),
        "gap": shared.gap_group(_budget(posterior, recording.name)),
    }


def own_unknowns(posterior: DirectPosterior, recording: str) -> dict[str, int]:
    """Name in results to place in a point, of everything that a recording depends on."""
    return {
        result_name(u): i
        for i, u in enumerate(posterior.fit.model.unknowns)
        if u.recording in (None, recording)
    }


def _posterior(posterior: DirectPosterior, recording: str) -> xr.Dataset:
    unknowns = posterior.fit.model.unknowns
    places = own_unknowns(posterior, recording)
    draws = {name: unknowns[i].value(posterior.draws[..., i]) for name, i in places.items()}
    return dataset(POSTERIOR, draws, shared.numbered(posterior.draws.shape))


def _sample_stats(posterior: DirectPosterior) -> xr.Dataset:
    return dataset(
        SAMPLE_STATS,
        {
            "lp": -0.5 * (posterior.chi_square - np.nanmin(posterior.chi_square)),
            "acceptance_rate": posterior.diagnostics.acceptance,
        },
    )


def _predictive(posterior: DirectPosterior, index: int) -> xr.Dataset:
    fit = posterior.fit
    seen = fit.model.recordings[index]
    simulated = fit.model.signals(fit.point, index)[0]
    values: dict[str, object] = {"rotation_period_s": seen.rotation_period_s, **_motion(fit, index)}
    for channel, measured, model in zip(seen.channels, seen.signals, simulated, strict=True):
        values[f"simulated_{channel}"] = model
        values[f"residual_{channel}"] = measured - model
    return dataset(PREDICTIVE, values)


def _motion(fit: SimulatedFit, index: int) -> dict[str, object]:
    """What a motion has beside: its reference, what was compared, its changes of flank."""
    seen = fit.model.recordings[index]
    if seen.motion is None:
        return {}
    changes = flank_changes(fit, index)
    found: dict[str, object] = {
        "reference_speed_rpm": seen.motion.speed_rpm(np.arange(seen.samples) / seen.sampling_hz),
        "compared_from_s": begin_of(seen) / seen.sampling_hz,
        "repeats": float(seen.cycle is not None),
        "flank_changes": float(len(changes)),
    }
    if changes:
        found["flank_left_s"] = np.array([change.left_s for change in changes])
        found["flank_met_s"] = np.array([change.met_s for change in changes])
        found["flank_side"] = np.array([float(change.side) for change in changes])
    return found


def _optimum(posterior: DirectPosterior, recording: str) -> xr.Dataset:
    """Values at the optimum; the bound in each parameter's own unit, of δ in rad."""
    fit = posterior.fit
    places = own_unknowns(posterior, recording)
    values = {name: float(fit.model.unknowns[i].value(fit.point[i])) for name, i in places.items()}
    slopes = np.array(
        [values[n] if fit.model.unknowns[i].logarithmic else 1.0 for n, i in places.items()]
    )
    index = np.array(list(places.values()))
    return dataset(
        OPTIMUM,
        {
            **values,
            "cramer_rao_sd": slopes * fit.bound[index],
            "covariance": np.outer(slopes, slopes) * fit.covariance[np.ix_(index, index)],
        },
        {"parameter": list(places), "parameter_": list(places)},
    )


def _noise(posterior: DirectPosterior, index: int) -> xr.Dataset:
    noise = posterior.fit.model.noise[index]
    channels = list(posterior.fit.model.recordings[index].channels)
    return dataset(
        NOISE,
        {
            **attributes(NOISE, noise),
            "innovation_root": noise.root,
            "channel": channels,
            "channel_": channels,
        },
    )


def _check(check: Sequence[RepeatingPower]) -> xr.Dataset:
    """Ratio and probability by channel and band; see :mod:`bayesbl.matching.predictive_check`."""
    channels = list(dict.fromkeys(entry.channel for entry in check))
    orders = list(dict.fromkeys(entry.highest_order for entry in check))
    shape = (len(channels), len(orders))
    return dataset(
        PREDICTIVE_CHECK,
        {
            "ratio": np.array([entry.ratio for entry in check]).reshape(shape),
            "probability": np.array([entry.probability for entry in check]).reshape(shape),
        },
        {"channel": channels, "highest_order": orders},
    )


def _diagnostics(posterior: DirectPosterior, index: int) -> xr.Dataset:
    seen = posterior.fit.model.recordings[index]
    rotations = seen.samples / seen.sampling_hz / seen.rotation_period_s
    return dataset(
        DIAGNOSTICS,
        {
            **attributes(DIAGNOSTICS, posterior),
            **shared.sampling_values(posterior.diagnostics, rotations),
        },
        {"symbol": list(posterior.diagnostics.r_hat)},
    )


def _budget(posterior: DirectPosterior, recording: str) -> dict[str, float]:
    """Shares of the variance of ln δ: by noise, were the bench known exactly; by laws that it may
    lack and by drift; the rest by what it states with a tolerance."""
    fit = posterior.fit
    place = own_unknowns(posterior, recording)[DELTA]
    beside = 1.0 - min(1.0, float(posterior.model_widening[place]) ** -2.0)
    free = np.array([i for i, u in enumerate(fit.model.unknowns) if u.recording is not None])
    if free.size == len(fit.model.unknowns):
        return {"noise": 1.0 - beside, "laws_and_drift": beside}
    known = fit.curvature + fit.model.prior_precision()
    alone = np.linalg.inv(known[np.ix_(free, free)])
    noise = float(alone[list(free).index(place), list(free).index(place)])
    share = min(1.0 - beside, noise / float(posterior.draws[..., place].var()))
    return {"noise": share, "laws_and_drift": beside, "bench": 1.0 - beside - share}
