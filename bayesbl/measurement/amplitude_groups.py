"""Groups of ``result.nc`` by which the amplitude route stores a snapshot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayesbl.measurement.as_printed import gap_as_printed_rad, has_pulses_of_optimum
from bayesbl.measurement.change import Gap
from bayesbl.measurement.other_route import DIRECT_ROUTE
from bayesbl.measurement.shared_groups import (
    ACCEPTANCE,
    CHAIN,
    DELTA,
    DIFFERENCES,
    DRAW,
    DRAWS,
    GAP,
    NOISE_ORDER,
    OBSERVED,
    SAMPLED_SYMBOLS,
    SAMPLING,
    gap_group,
    numbered,
    observed_group,
    sampling_values,
)
from bayesbl.probabilities import normal_isf
from bayesbl.recording.types import FloatArray
from bayesbl.results.variables import Group, Variable, attributes, dataset, labels, table
from bayesbl.ringing.estimator import Fit, PointEstimate
from bayesbl.ringing.jacobian import jacobian_columns
from bayesbl.ringing.second_sampler import SamplerCheck
from bayesbl.ringing.symbols import ROTATION, SYMBOLS
from bayesbl.ringing.table_2 import BoxSearch

PREDICTIVE_DRAWS = 100


def _symbol(*dims: str) -> Callable[[str], Variable | None]:
    """Declares each symbol of the disturbance model over these dimensions."""

    def declared(name: str) -> Variable | None:
        if name not in SYMBOLS:
            return None
        return Variable(name, dims, SYMBOLS[name].unit, SYMBOLS[name].long_name)

    return declared


POSTERIOR = Group(
    "posterior",
    (
        *table(
            "baseline_rpm (chain, draw, baseline_term) | rpm | load-angle harmonics of the speed"
        ),
        replace(DELTA, optional=True),
    ),
    (CHAIN, DRAW, labels("baseline_term", "term of the load-angle baseline")),
    named=_symbol(*DRAWS),
)

SAMPLE_STATS = Group(
    "sample_stats",
    (
        *table("""
            lp (chain, draw) | 1 | log likelihood less its largest, linear symbols at their best
            outside_curve? (chain, draw) | 1 | amplitude below (-1), inside (0) or above (1)
                the range of the gap curve
        """),
        ACCEPTANCE,
    ),
)

PREDICTIVE = Group(
    "predictive",
    table("""
        model_rpm (sample) | rpm | motor speed of the RMSE optimum
        residual_rpm (sample) | rpm | recording minus optimum
        low_rpm (sample) | rpm | lower bound of the predictive band
        high_rpm (sample) | rpm | upper bound of the predictive band
    """),
)

OPTIMUM = Group(
    "optimum",
    table("""
        baseline_rpm (baseline_term) | rpm | load-angle harmonics of the speed
        rmse_rpm | rpm | root mean square error
        relative_rmse | 1 | RMSE over the standard deviation of the speed
        evaluations | 1 | model evaluations
        search_seconds | s | time of the search
        covariance (parameter, parameter_) | products of units | sandwich covariance of the optimum
        rival_amplitude_rpm (rival) | rpm | amplitude at other local optima
        rival_rmse_rpm (rival) | rpm | root mean square error at other local optima
        start? | text | start of the search
    """),
    (labels("parameter", "free parameter"), labels("parameter_", "free parameter")),
    named=_symbol(),
)

BOX_SEARCH = Group(
    "box_search",
    table("""
        rmse_rpm | rpm | root mean square error where the search in Table 2's ranges ended
        gap_as_printed_rad | rad | eq. 4 at the amplitude found there
        has_pulses_of_optimum | 1 | 1 where its impacts are those of the optimum
    """),
    named=_symbol(),
    optional=True,
)

SEARCH_HISTORY = Group(
    "search_history",
    table("""
        run (iteration) | 1 | start that the iteration belongs to
        evaluations (iteration) | 1 | model evaluations in the run
        rmse_rpm (iteration) | rpm | best RMSE so far in the run
    """),
)

NOISE = Group(
    "noise",
    (
        *table("""
            sd_rpm | rpm | standard deviation of the noise
            coefficients (lag) | 1 | autoregressive coefficients
            differentiated | 1 | 1 where the noise is the change from sample to sample of such
                a process
            degrees_of_freedom | 1 | of Student-t innovations, infinite for normal ones
            student_t_evidence | 1 | gain in log likelihood of Student-t over normal innovations,
                less 1/2 ln n
            hidden_sd_rpm | rpm | standard deviation of the rounding that repeats every rotation
            bic (candidate_order) | 1 | Bayesian information criterion less its smallest
        """),
        NOISE_ORDER,
        DIFFERENCES,
    ),
)

MISFIT = Group(
    "misfit",
    table("""
        mean_rpm (phase_rad) | rpm | residual that repeats every load rotation
        standard_error_rpm (phase_rad) | rpm | standard error of the repeating residual
        rms_rpm | rpm | RMS of the repeating residual
    """),
    table("phase_rad (phase_rad) | rad | load phase from the start of the recording"),
)

DIAGNOSTICS = Group("diagnostics", SAMPLING, (SAMPLED_SYMBOLS,))

SAMPLER_CHECK = Group(
    "sampler_check",
    table("""
        difference_sd (symbol) | 1 | mean of the nested sampler less emcee's, in standard deviations
        width_ratio (symbol) | 1 | standard deviation of the nested sampler over emcee's
        differs (symbol) | 1 | 1 where the samplers disagree
        evaluations | 1 | posterior evaluations by the nested sampler
    """),
    (SAMPLED_SYMBOLS,),
    optional=True,
)

GROUPS = (
    POSTERIOR,
    SAMPLE_STATS,
    OBSERVED,
    PREDICTIVE,
    OPTIMUM,
    BOX_SEARCH,
    SEARCH_HISTORY,
    NOISE,
    MISFIT,
    DIAGNOSTICS,
    GAP,
    SAMPLER_CHECK,
    DIRECT_ROUTE,
)


def amplitude_groups(fit: Fit, gap: Gap | None, level: float) -> dict[str, xr.Dataset]:
    """All groups of one snapshot, without a ``snapshot`` dimension; no ``gap`` without a curve."""
    checked = {} if fit.check is None else {"sampler_check": _sampler_check(fit.check)}
    box = fit.point.optimum.box_search
    searched = {} if box is None else {"box_search": _box_search(box, fit.point)}
    return {
        **checked,
        **searched,
        "posterior": _posterior(fit, gap),
        "sample_stats": _sample_stats(fit, gap),
        "observed_data": observed_group(fit.point.recording),
        "predictive": _predictive(fit, level),
        "optimum": _optimum(fit),
        "search_history": _of(SEARCH_HISTORY, fit.point.optimum.history),
        "noise": _noise(fit),
        "misfit": _of(MISFIT, fit.point.misfit),
        "diagnostics": _diagnostics(fit),
        "gap": gap_group({} if gap is None else gap.budget),
    }


def _of(group: Group, source: object) -> xr.Dataset:
    return dataset(group, attributes(group, source))


def _index(fit: Fit, gap: Gap | None) -> NDArray[np.int64]:
    """Which of the posterior's draws is stored at each place, shape (chain, draw)."""
    if gap is not None:
        return gap.index
    shape = fit.posterior.log_likelihood.shape
    return np.arange(fit.posterior.log_likelihood.size).reshape(shape)


def _posterior(fit: Fit, gap: Gap | None) -> xr.Dataset:
    index = _index(fit, gap)
    draws = {name: v.ravel()[index] for name, v in fit.posterior.draws.items()}
    baseline = fit.posterior.baseline_rpm.reshape(index.size, -1)
    terms = [n for n in jacobian_columns(fit.point.optimum.model) if n not in SYMBOLS]
    return dataset(
        POSTERIOR,
        {
            **draws,
            "baseline_rpm": baseline[index],
            "delta_rad": None if gap is None else gap.delta_rad,
        },
        {**numbered(index.shape), "baseline_term": terms},
    )


def _sample_stats(fit: Fit, gap: Gap | None) -> xr.Dataset:
    return dataset(
        SAMPLE_STATS,
        {
            "lp": fit.posterior.log_likelihood.ravel()[_index(fit, gap)],
            "acceptance_rate": fit.posterior.diagnostics.acceptance,
            "outside_curve": None if gap is None else gap.outside,
        },
    )


def _predictive(fit: Fit, level: float) -> xr.Dataset:
    """Optimum, and the band in which a new recording of the same joint would lie.

    What repeats every rotation and the model lacks repeats there too: the band is around both.
    """

    point = fit.point
    time_s = point.objective.time_s
    model = point.optimum.predict(time_s)
    repeating, error = point.misfit.at(time_s - time_s[0], point.optimum.symbols[ROTATION])
    expected = model + repeating
    spread = np.sqrt(_prediction_variance(fit) + error**2 + point.noise.sd_rpm**2)
    half = normal_isf(0.5 - 0.5 * level) * spread
    return dataset(
        PREDICTIVE,
        {
            "model_rpm": model,
            "residual_rpm": point.residual_rpm,
            "low_rpm": expected - half,
            "high_rpm": expected + half,
        },
    )


def _prediction_variance(fit: Fit) -> FloatArray:
    """Variance of h(t) over the posterior, shape (n,), rpm²."""
    point = fit.point
    objective, posterior = point.objective, fit.posterior
    flat = {name: values.ravel() for name, values in posterior.draws.items()}
    chains, draws, terms = posterior.baseline_rpm.shape
    baseline = posterior.baseline_rpm.reshape(chains * draws, terms)  # no -1: it may have no terms
    picked = np.linspace(0, len(baseline) - 1, PREDICTIVE_DRAWS).round().astype(int)
    total, square = np.zeros(objective.samples), np.zeros(objective.samples)
    centre = point.optimum.predict(objective.time_s)
    for i in picked:
        symbols = {**point.optimum.symbols, **{n: float(v[i]) for n, v in flat.items()}}
        columns = objective.columns(symbols)
        linear = np.r_[symbols["mean_speed_rpm"], baseline[i], symbols["amplitude_rpm"]]
        difference = columns @ linear - centre
        total += difference
        square += difference**2
    return np.asarray(square / picked.size - (total / picked.size) ** 2)


def _optimum(fit: Fit) -> xr.Dataset:
    optimum, spread = fit.point.optimum, fit.point.spread
    rival_squares = np.array([rival.sum_of_squares for rival in optimum.rivals])
    result = dataset(
        OPTIMUM,
        {
            **attributes(OPTIMUM, optimum),
            **optimum.symbols,
            "search_seconds": optimum.seconds,
            "covariance": spread.sandwich,
            "rival_amplitude_rpm": [r.symbols["amplitude_rpm"] for r in optimum.rivals],
            "rival_rmse_rpm": np.sqrt(rival_squares / optimum.samples),
            "start": fit.point.start,
        },
        {"parameter": list(spread.names), "parameter_": list(spread.names)},
    )
    result.attrs["method"] = optimum.method
    return result


def _box_search(box: BoxSearch, point: PointEstimate) -> xr.Dataset:
    values = {
        **box.symbols,
        "rmse_rpm": box.rmse_rpm,
        "gap_as_printed_rad": gap_as_printed_rad(box),
        "has_pulses_of_optimum": float(has_pulses_of_optimum(box, point)),
    }
    result = dataset(BOX_SEARCH, values)
    result.attrs["searched"] = box.searched
    return result


def _noise(fit: Fit) -> xr.Dataset:
    noise = fit.point.noise
    freedom = noise.degrees_of_freedom or np.inf
    return dataset(NOISE, attributes(NOISE, noise) | {"degrees_of_freedom": freedom})


def _diagnostics(fit: Fit) -> xr.Dataset:
    found = fit.posterior.diagnostics
    rotations = fit.point.objective.duration_s / fit.point.optimum.symbols[ROTATION]
    return dataset(DIAGNOSTICS, sampling_values(found, rotations), {"symbol": list(found.r_hat)})


def _sampler_check(check: SamplerCheck) -> xr.Dataset:
    names = list(check.width_ratio)
    return dataset(
        SAMPLER_CHECK,
        {
            "difference_sd": [check.difference_sd[n] for n in names],
            "width_ratio": [check.width_ratio[n] for n in names],
            "differs": [float(n in check.differing) for n in names],
            "evaluations": check.evaluations,
        },
        {"symbol": names},
    )
