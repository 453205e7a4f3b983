"""Results as xarray trees: the layout of ``result.nc`` for a fit and for compared snapshots.

A fit has arviz's groups at the root (``posterior``, ``sample_stats``, ``observed_data``) and beside
them ``predictive``, ``optimum``, ``search_history``, ``noise``, ``misfit``, ``diagnostics``,
``gap`` and, where it was asked for, ``sampler_check``. A comparison has the same groups with a
``snapshot`` dimension in front, shorter ones padded with NaN, and ``change``; where the recordings
are dated also ``wear`` (:mod:`bayesbl.results.wear`). ``curve`` holds the gap curve over its range
in both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr

from bayesbl.curve.gap_curve import GapCurve
from bayesbl.measurement.change import Change, Gap
from bayesbl.recording.types import CHANNELS, FloatArray, Recording
from bayesbl.ringing.estimator import Fit
from bayesbl.ringing.jacobian import jacobian_columns
from bayesbl.ringing.second_sampler import SamplerCheck
from bayesbl.ringing.symbols import ROTATION, SYMBOLS
from bayesbl.units import unit_of

PREDICTIVE_DRAWS = 100

Variables = Mapping[str, tuple[tuple[str, ...], FloatArray, str, str]]
"""Name to (dimensions, values, unit, long name)."""


def dataset(variables: Variables, coordinates: Mapping[str, object] | None = None) -> xr.Dataset:
    """A dataset in which every variable carries its unit and long name."""
    return xr.Dataset(
        {
            name: (dims, values, {"units": unit, "long_name": long_name})
            for name, (dims, values, unit, long_name) in variables.items()
        },
        coords=None if coordinates is None else dict(coordinates),
    )


def fit_groups(fit: Fit, gap: Gap, level: float) -> dict[str, xr.Dataset]:
    """All groups of one fit, without a ``snapshot`` dimension."""
    checked = {} if fit.check is None else {"sampler_check": _sampler_check(fit.check)}
    return {
        **checked,
        "posterior": _posterior(fit, gap),
        "sample_stats": _sample_stats(fit, gap),
        "observed_data": observed_group(fit.point.recording),
        "predictive": _predictive(fit, level),
        "optimum": _optimum(fit),
        "search_history": _history(fit),
        "noise": _noise(fit),
        "misfit": _misfit(fit),
        "diagnostics": _diagnostics(fit),
        "gap": _gap(gap),
    }


def stack_snapshots(groups: Mapping[str, Mapping[str, xr.Dataset]]) -> dict[str, xr.Dataset]:
    """Groups of several fits by snapshot name, stacked along ``snapshot``, padded with NaN."""
    names = list(groups)
    stacked = {}
    for group in next(iter(groups.values())):
        parts = _padded([groups[name][group] for name in names])
        stacked[group] = xr.concat(
            parts,
            dim=xr.Variable("snapshot", names),
            data_vars="all",
            coords="minimal",
            compat="override",
            join="outer",
            combine_attrs="drop_conflicts",
        )
    return stacked


def change_group(total: Change, steps: Sequence[Change]) -> xr.Dataset:
    """Draws of the change from first to last, and of each step."""
    return dataset(
        {
            "change_rad": (
                ("chain", "draw"),
                total.change_rad,
                "rad",
                f"change of the backlash gap from {total.first} to {total.last}",
            ),
            "step_change_rad": (
                ("step", "chain", "draw"),
                np.stack([step.change_rad for step in steps]),
                "rad",
                "change of the backlash gap between neighbouring snapshots",
            ),
        },
        {
            "step_from": ("step", [step.first for step in steps]),
            "step_to": ("step", [step.last for step in steps]),
        },
    )


def curve_group(curve: GapCurve, level: float, seed: np.random.SeedSequence) -> xr.Dataset:
    """The gap curve over its range with the band of its draws."""
    low, high = curve.amplitude_range_rpm
    amplitude = np.geomspace(low, high, 200)
    count = 1000
    draws = curve.draw(count, np.random.default_rng(seed))
    table = np.stack([draws.gap(np.full(count, a)) for a in amplitude])
    edges = np.quantile(table, [0.5 - 0.5 * level, 0.5 + 0.5 * level], axis=1)
    result = dataset(
        {
            "delta_rad": (("amplitude",), curve.gap(amplitude), "rad", "backlash gap, nominal"),
            "low_rad": (("amplitude",), edges[0], "rad", "lower bound of the curve's band"),
            "high_rad": (("amplitude",), edges[1], "rad", "upper bound of the curve's band"),
            "coefficients": (
                ("power",),
                curve.coefficients,
                "rad / rpm^k",
                "coefficient of A^k in the gap curve",
            ),
        },
        {
            "amplitude": (
                "amplitude",
                amplitude,
                {"units": "rpm", "long_name": "amplitude of the impact ringing"},
            )
        },
    )
    result.attrs = {"name": curve.name, "warnings": list(curve.warnings), "level": level}
    return result


def _posterior(fit: Fit, gap: Gap) -> xr.Dataset:
    draws: dict[str, tuple[tuple[str, ...], FloatArray, str, str]] = {
        name: (("chain", "draw"), values.ravel()[gap.index], SYMBOLS[name].unit, _long(name))
        for name, values in fit.posterior.draws.items()
    }
    terms_of_draw = fit.posterior.baseline_rpm.reshape(gap.index.size, -1)
    draws["baseline_rpm"] = (
        ("chain", "draw", "baseline_term"),
        terms_of_draw[gap.index],
        "rpm",
        "load-angle harmonics of the speed",
    )
    draws["delta_rad"] = (("chain", "draw"), gap.delta_rad, "rad", "backlash gap")
    terms = [n for n in jacobian_columns(fit.point.optimum.model) if n not in SYMBOLS]
    chains, count = gap.delta_rad.shape
    return dataset(
        draws,
        {"chain": np.arange(chains), "draw": np.arange(count), "baseline_term": terms},
    )


def _long(symbol: str) -> str:
    return SYMBOLS[symbol].long_name


def _sample_stats(fit: Fit, gap: Gap) -> xr.Dataset:
    return dataset(
        {
            "lp": (
                ("chain", "draw"),
                fit.posterior.log_likelihood.ravel()[gap.index],
                "1",
                "log likelihood less its largest, linear symbols at their best",
            ),
            "acceptance_rate": (
                ("chain",),
                fit.posterior.diagnostics.acceptance,
                "1",
                "accepted share of proposals",
            ),
            "outside_curve": (
                ("chain", "draw"),
                gap.outside,
                "1",
                "amplitude below (-1), inside (0) or above (1) the range of the gap curve",
            ),
        }
    )


def observed_group(recording: Recording) -> xr.Dataset:
    """Every channel that was recorded: later figures lay simulations over them."""
    channels: dict[str, tuple[tuple[str, ...], FloatArray, str, str]] = {
        name: (("sample",), values, unit_of(name), CHANNELS.get(name, name))
        for name, values in recording.channels.items()
    }
    left_out = np.zeros(recording.samples) if recording.excluded is None else recording.excluded
    channels["excluded"] = (
        ("sample",),
        np.asarray(left_out, dtype=np.float64),
        "1",
        "sample that was lost or cannot be trusted (1), bridged and left out of the fit",
    )
    return dataset({"time_s": (("sample",), recording.time_s, "s", "time")} | channels)


def _predictive(fit: Fit, level: float) -> xr.Dataset:
    """Optimum, and the band in which a new recording of the same joint would lie."""
    from scipy.stats import norm

    point = fit.point
    model = point.optimum.predict(point.objective.time_s)
    spread = np.sqrt(_prediction_variance(fit) + point.noise.sd_rpm**2)
    half = float(norm.ppf(0.5 + 0.5 * level)) * spread
    names = ("sample",)
    return dataset(
        {
            "model_rpm": (names, model, "rpm", "motor speed of the RMSE optimum"),
            "residual_rpm": (names, point.residual_rpm, "rpm", "recording minus optimum"),
            "low_rpm": (names, model - half, "rpm", "lower bound of the predictive band"),
            "high_rpm": (names, model + half, "rpm", "upper bound of the predictive band"),
        }
    )


def _prediction_variance(fit: Fit) -> FloatArray:
    """Variance of h(t) over the posterior, shape (n,), rpm²."""
    point = fit.point
    objective, posterior = point.objective, fit.posterior
    flat = {name: values.ravel() for name, values in posterior.draws.items()}
    baseline = posterior.baseline_rpm.reshape(-1, posterior.baseline_rpm.shape[-1])
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
    variables: dict[str, tuple[tuple[str, ...], FloatArray, str, str]] = {
        name: ((), np.array(value), SYMBOLS[name].unit, SYMBOLS[name].long_name)
        for name, value in optimum.symbols.items()
    }
    variables |= {
        "baseline_rpm": (
            ("baseline_term",),
            optimum.baseline_rpm,
            "rpm",
            "load-angle harmonics of the speed",
        ),
        "rmse_rpm": ((), np.array(optimum.rmse_rpm), "rpm", "root mean square error"),
        "relative_rmse": (
            (),
            np.array(optimum.relative_rmse),
            "1",
            "RMSE over the standard deviation of the speed",
        ),
        "evaluations": ((), np.array(float(optimum.evaluations)), "1", "model evaluations"),
        "search_seconds": ((), np.array(optimum.seconds), "s", "time of the search"),
        "covariance": (
            ("parameter", "parameter_"),
            spread.sandwich,
            "products of the parameters' units",
            "sandwich covariance of the optimum",
        ),
        "rival_amplitude_rpm": (
            ("rival",),
            np.array([r.symbols["amplitude_rpm"] for r in optimum.rivals]),
            "rpm",
            "amplitude at other local optima",
        ),
        "rival_rmse_rpm": (
            ("rival",),
            np.sqrt(np.array([r.sum_of_squares for r in optimum.rivals]) / optimum.samples),
            "rpm",
            "root mean square error at other local optima",
        ),
    }
    names = list(spread.names)
    result = dataset(variables, {"parameter": names, "parameter_": names})
    result.attrs["method"] = optimum.method
    result["start"] = ((), fit.point.start, {"units": "", "long_name": "start of the search"})
    return result


def _history(fit: Fit) -> xr.Dataset:
    history = fit.point.optimum.history
    names = ("iteration",)
    return dataset(
        {
            "run": (names, history.run, "1", "start that the iteration belongs to"),
            "evaluations": (names, history.evaluations, "1", "model evaluations in the run"),
            "rmse_rpm": (names, history.rmse_rpm, "rpm", "best RMSE so far in the run"),
        }
    )


def _noise(fit: Fit) -> xr.Dataset:
    noise = fit.point.noise
    return dataset(
        {
            "sd_rpm": ((), np.array(noise.sd_rpm), "rpm", "standard deviation of the noise"),
            "order": ((), np.array(float(noise.order)), "1", "autoregressive order, 0 is white"),
            "coefficients": (("lag",), noise.coefficients, "1", "autoregressive coefficients"),
            "differentiated": (
                (),
                np.array(float(noise.differentiated)),
                "1",
                "1 where the noise is the change from sample to sample of such a process",
            ),
            "degrees_of_freedom": (
                (),
                np.array(noise.degrees_of_freedom or np.inf),
                "1",
                "of Student-t innovations, infinite for normal ones",
            ),
            "student_t_evidence": (
                (),
                np.array(noise.student_t_evidence),
                "1",
                "gain in log likelihood of Student-t over normal innovations, less 1/2 ln n",
            ),
            "hidden_sd_rpm": (
                (),
                np.array(noise.hidden_sd_rpm),
                "rpm",
                "standard deviation of the rounding that repeats every rotation",
            ),
            "bic": (
                ("candidate_order",),
                noise.bic,
                "1",
                "Bayesian information criterion less its smallest",
            ),
            "differences": (
                (),
                np.array(float(noise.differences)),
                "1",
                "samples with a counterpart one rotation later",
            ),
        }
    )


def _misfit(fit: Fit) -> xr.Dataset:
    misfit = fit.point.misfit
    result = dataset(
        {
            "mean_rpm": (
                ("phase_rad",),
                misfit.mean_rpm,
                "rpm",
                "residual that repeats every load rotation",
            ),
            "standard_error_rpm": (
                ("phase_rad",),
                misfit.standard_error_rpm,
                "rpm",
                "standard error of the repeating residual",
            ),
            "rms_rpm": ((), np.array(misfit.rms_rpm), "rpm", "RMS of what repeats"),
        },
        {
            "phase_rad": (
                "phase_rad",
                misfit.phase_rad,
                {"units": "rad", "long_name": "load phase from the begin of the recording"},
            )
        },
    )
    return result


def _diagnostics(fit: Fit) -> xr.Dataset:
    diagnostics = fit.posterior.diagnostics
    names = list(diagnostics.r_hat)
    return dataset(
        {
            "r_hat": (
                ("symbol",),
                np.array([diagnostics.r_hat[n] for n in names]),
                "1",
                "rank-normalised split R-hat over independent ensembles",
            ),
            "ess_bulk": (
                ("symbol",),
                np.array([diagnostics.ess_bulk[n] for n in names]),
                "1",
                "bulk effective sample size",
            ),
            "autocorrelation_steps": (
                (),
                np.array(diagnostics.autocorrelation_steps),
                "1",
                "longest integrated autocorrelation time",
            ),
            "steps": ((), np.array(float(diagnostics.steps)), "1", "steps after burn-in"),
            "rotations": (
                (),
                np.array(fit.point.objective.duration_s / fit.point.optimum.symbols[ROTATION]),
                "1",
                "load rotations in the recording",
            ),
        },
        {"symbol": names},
    )


def _sampler_check(check: SamplerCheck) -> xr.Dataset:
    names = list(check.width_ratio)
    return dataset(
        {
            "difference_sd": (
                ("symbol",),
                np.array([check.difference_sd[n] for n in names]),
                "1",
                "mean of the nested sampler less emcee's, in standard deviations",
            ),
            "width_ratio": (
                ("symbol",),
                np.array([check.width_ratio[n] for n in names]),
                "1",
                "standard deviation of the nested sampler over emcee's",
            ),
            "differs": (
                ("symbol",),
                np.array([float(n in check.differing) for n in names]),
                "1",
                "1 where the samplers disagree",
            ),
            "evaluations": (
                (),
                np.array(float(check.evaluations)),
                "1",
                "posterior evaluations by the nested sampler",
            ),
        },
        {"symbol": names},
    )


def _gap(gap: Gap) -> xr.Dataset:
    sources = list(gap.budget)
    return dataset(
        {
            "budget": (
                ("source",),
                np.array([gap.budget[s] for s in sources]),
                "1",
                "share of the variance of ln δ",
            )
        },
        {"source": sources},
    )


def _padded(parts: Sequence[xr.Dataset]) -> list[xr.Dataset]:
    """All dimensions without labels brought to their longest, NaN behind."""
    longest: dict[str, int] = {}
    for part in parts:
        for dim, size in part.sizes.items():
            if dim not in part.coords:
                longest[str(dim)] = max(longest.get(str(dim), 0), size)
    return [
        part.pad(
            {dim: (0, size - part.sizes[dim]) for dim, size in longest.items() if dim in part.sizes}
        )
        for part in parts
    ]
