"""The result of the README's first command holds the paper's method whole, every number again.

CMA-ES finds the RMSE optimum of the seven symbols, emcee samples the posterior around it under a
noise model, and the draws of A go through the curve, with its own uncertainty, to draws of δ and of
its change. Each clause is made again here from what is stored.
"""

from __future__ import annotations

import json
import re
import warnings
from pathlib import Path

import arviz
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from places import CONFIGS, ROOT
from quick import without_figures
from scipy.stats import norm

import bayesbl
from bayesbl import cli
from bayesbl.noise.rotation_noise import estimate_noise
from bayesbl.results.store import read_tree
from bayesbl.ringing.symbols import SYMBOLS
from bayesbl.ringing.waveform import model_speed

pytestmark = pytest.mark.long

SEVEN = [name for name in SYMBOLS if name not in ("window_start_s", "window_end_s")]
TRUE_GAPS_RAD = {"before": 6.8539e-4, "after": 9.5394e-4}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """The output folder of the README's first command, without its figures."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    command = re.findall(r"bayesbl run (configs/\S+\.toml)", readme)[0]
    out = tmp_path_factory.mktemp("readme") / "wear"
    with without_figures():
        assert cli.status(["run", str(ROOT / command), "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def tree(folder) -> xr.DataTree:
    return read_tree(folder)


@pytest.fixture(scope="module")
def summary(folder) -> dict:
    return json.loads((folder / "summary.json").read_text())


@pytest.fixture(scope="module")
def result(folder):
    return bayesbl.read_result(folder)


def names(tree) -> list[str]:
    return [str(name) for name in tree["amplitude/posterior"]["snapshot"].values]


def test_the_optimum_has_seven_symbols_and_the_error_of_the_formula(tree, summary):
    for name in names(tree):
        optimum = tree["amplitude/optimum"].to_dataset().sel(snapshot=name)
        time = tree["amplitude/constant_data"]["time_s"].sel(snapshot=name).values
        speed = tree["amplitude/observed_data"]["motor_speed_rpm"].sel(snapshot=name).values
        symbols = {symbol: float(optimum[symbol]) for symbol in SYMBOLS}
        model = model_speed(time, symbols, optimum["baseline_rpm"].values.tolist())
        rmse = np.sqrt(np.mean((speed - model) ** 2))
        assert float(optimum["rmse_rpm"]) == pytest.approx(rmse, rel=1e-6)
        assert float(optimum["relative_rmse"]) == pytest.approx(rmse / speed.std(), rel=1e-6)
        (part,) = [p for p in summary["snapshots"] if p["name"] == name]
        told = part["routes"]["amplitude"]
        assert set(SEVEN) <= set(told["optimum"])
        assert told["rmse_rpm"] == float(optimum["rmse_rpm"])
        assert tree["amplitude/optimum"].attrs["method"] == "guess", "found by CMA-ES"


def test_the_posterior_has_draws_of_the_seven_symbols_by_independent_ensembles(tree, summary):
    posterior = tree["amplitude/posterior"].to_dataset()
    for symbol in SEVEN:
        assert posterior[symbol].dims == ("snapshot", "chain", "draw")
        assert posterior[symbol].sizes["chain"] == 4
        assert posterior[symbol].attrs["units"] == SYMBOLS[symbol].unit
    for part in summary["snapshots"]:
        stored = posterior["amplitude_rpm"].sel(snapshot=part["name"]).values
        told = part["routes"]["amplitude"]["parameters"]["amplitude_rpm"]
        assert told["median"] == pytest.approx(float(np.median(stored)), rel=1e-12)


def test_the_noise_is_that_of_what_does_not_repeat(tree):
    for name in names(tree):
        stored = tree["amplitude/noise"].to_dataset().sel(snapshot=name)
        time = tree["amplitude/constant_data"]["time_s"].sel(snapshot=name).values
        residual = tree["amplitude/predictive"]["residual_rpm"].sel(snapshot=name).values
        rotation = float(tree["amplitude/optimum"]["rotation_period_s"].sel(snapshot=name))
        again = estimate_noise(residual, rotation, (time[-1] - time[0]) / (time.size - 1))
        assert float(stored["sd_rpm"]) == pytest.approx(again.sd_rpm, rel=1e-9)
        order = int(stored["order"])
        assert stored["coefficients"].values[:order] == pytest.approx(again.coefficients)


def test_the_draws_of_the_gap_are_the_curve_at_the_draws_of_the_amplitude(tree):
    curve = tree["amplitude/curve"].to_dataset()
    logs = np.log(curve["knots_rpm"].values)
    for name in names(tree):
        drawn = tree["amplitude/posterior"].to_dataset().sel(snapshot=name)
        through = drawn["curve_amplitude_rpm"].values
        at = np.log(np.clip(through, *curve["knots_rpm"].values[[0, -1]]))
        departure = np.interp(at, logs, curve["correction"].values)
        for variable in (str(v) for v in curve.data_vars if str(v).startswith("row_")):
            source = curve[variable.replace("row_", "source_")].values
            rows = curve[variable].values
            each = zip(at.ravel(), rows.ravel(), strict=True)
            own = [np.interp(x, logs, source[row]) for x, row in each]
            departure += np.reshape(own, at.shape)
        cubic = np.polynomial.polynomial.polyval(through, curve["coefficients"].values)
        # The curve's draws are stored to seven digits.
        np.testing.assert_allclose(drawn["delta_rad"].values, cubic * np.exp(departure), rtol=1e-6)
        scatter = through - drawn["amplitude_rpm"].values
        at_median = np.interp(np.median(through), curve["knots_rpm"], curve["start_angle_sd_rpm"])
        assert scatter.std() == pytest.approx(at_median, rel=0.2)


def test_the_curve_has_coefficients_with_their_covariance_and_draws(tree):
    curve = tree["amplitude/curve"].to_dataset()
    assert curve["coefficients"].size == 4, "a cubic, as in eq. 4"
    drawn = curve["coefficient_draws"].values
    np.testing.assert_allclose(np.cov(drawn, rowvar=False), curve["covariance"].values, rtol=1e-9)
    sd = np.sqrt(np.diag(curve["covariance"].values))
    assert np.all(np.abs(drawn.mean(axis=0) - curve["coefficients"].values) < sd)


def test_the_budget_of_every_route_adds_up_and_has_noise_bench_and_regression(tree, summary):
    for part in summary["snapshots"]:
        for route, told in part["routes"].items():
            stored = tree[f"{route}/budget"].to_dataset().sel(snapshot=part["name"])
            shares = dict(zip(stored["source"].values, stored["share"].values, strict=True))
            assert told["budget"] == pytest.approx(shares)
            assert sum(shares.values()) == pytest.approx(1.0)
        assert {"noise", "bench", "regression"} <= set(part["routes"]["amplitude"]["budget"])
        assert 0.0 < part["routes"]["direct"]["budget"]["bench"] < 1.0


def test_the_change_is_the_difference_of_the_answers_draws(tree, summary):
    answer = tree.attrs["route"]
    gaps = tree["gap"]["delta_rad"].values
    assert np.array_equal(gaps, tree[f"{answer}/posterior"]["delta_rad"].values)
    assert np.array_equal(tree["change"]["change_rad"].values, gaps[-1] - gaps[0])
    for route, told in summary["routes"].items():
        drawn = tree[f"{route}/posterior"]["delta_rad"].values
        middle = float(np.median(drawn[-1] - drawn[0]))
        assert told["change_rad"]["median"] == pytest.approx(middle, rel=1e-12)


def test_both_routes_are_whole_and_one_line_says_which_answers(tree, summary, result):
    assert summary["answer"]["route"] == tree.attrs["route"]
    assert summary["answer"]["code"] == tree.attrs["route_code"]
    for part in summary["snapshots"]:
        assert set(part["routes"]) == {"direct", "amplitude"}
        for told in part["routes"].values():
            assert {
                "delta_rad", "parameters", "optimum", "noise", "budget", "diagnostics", "reason",
                "delta_upper_bound_rad", "model_check",
            } <= set(told)  # fmt: skip
        assert part["delta_rad"] == part["routes"][summary["answer"]["route"]]["delta_rad"]
    assert str(result).count("The answer is the estimate by") == 1


def test_the_example_has_a_bench_that_is_not_exact_and_dates(summary):
    bench = bayesbl.load_bench(CONFIGS / "joint.toml")
    true = bayesbl.load_bench(CONFIGS / "bench.toml")
    assert len(bench.tolerances) > 5
    for name, width in bench.tolerances.items():
        assert 0.0 < abs(bench.value(name) - true.value(name)) <= width
    assert summary["wear"]["rate"]["median"] > 0.0
    assert summary["wear"]["date_of_limit"]["median"] > summary["wear"]["last_date"]


def test_the_paper_s_route_holds_both_true_gaps(summary):
    for part in summary["snapshots"]:
        gap = part["routes"]["amplitude"]["delta_rad"]
        assert gap["low"] < TRUE_GAPS_RAD[part["name"]] < gap["high"]


# From Python, and for ArviZ


def test_a_result_gives_its_routes_and_their_groups_by_name(result, tree):
    drawn = result.amplitude.posterior["amplitude_rpm"]
    assert drawn.dims == ("snapshot", "chain", "draw")
    assert np.array_equal(drawn, tree["amplitude/posterior"]["amplitude_rpm"])
    assert "delta_rad" in result.direct.posterior
    assert result.curve["coefficients"].size == 4
    assert "sd" in result.noise or "sd_rpm" in result.noise
    assert set(result.amplitude.to_datatree().children) == set(tree["amplitude"].children)
    assert result.to_datatree() is result.to_xarray()
    with pytest.raises(AttributeError, match="amplitude"):
        _ = result.torque_ramp


GROUPS = (
    "posterior", "sample_stats", "noise_posterior", "log_likelihood", "log_prior", "prior",
    "prior_predictive", "posterior_predictive", "observed_data", "constant_data",
)  # fmt: skip


def test_both_routes_have_the_same_groups_for_arviz(tree):
    for group in GROUPS:
        ours, others = (tree[f"{route}/{group}"].to_dataset() for route in ("amplitude", "direct"))
        if "predictive" in group or group == "observed_data":
            assert {"motor_speed_rpm"} <= set(ours.data_vars) & set(others.data_vars)
    for group in ("noise_posterior", "log_likelihood", "log_prior"):
        sizes = [tree[f"{route}/{group}"].to_dataset().sizes for route in ("amplitude", "direct")]
        assert sizes[0]["chain"] == sizes[1]["chain"]


def test_the_log_likelihood_of_rotations_is_that_of_the_stored_noise_and_draws(tree):
    """AR(1) innovations of recording less waveform, by NumPy, all from what is stored."""
    for name in names(tree):
        route = {
            group: tree[f"amplitude/{group}"].to_dataset().sel(snapshot=name)
            for group in ("noise", "noise_posterior", "log_likelihood", "optimum")
        }
        assert int(route["noise"]["order"]) == 1
        phi = float(route["noise"]["coefficients"].values[0])
        sd = float(route["noise"]["sd_rpm"]) * np.sqrt(1.0 - phi**2)
        time = tree["amplitude/constant_data"]["time_s"].sel(snapshot=name).values
        speed = tree["amplitude/observed_data"]["motor_speed_rpm"].sel(snapshot=name).values
        rotation_s = float(route["optimum"]["rotation_period_s"])
        drawn = route["noise_posterior"].isel(chain=1, draw=7)
        symbols = {s: float((drawn if s in drawn else route["optimum"])[s]) for s in SYMBOLS}
        rest = speed - model_speed(time, symbols, drawn["baseline_rpm"].values.tolist())
        each = norm.logpdf(rest[1:] - phi * rest[:-1], scale=sd)
        rotation = np.minimum((time[1:] - time[0]) // rotation_s, 4).astype(int)
        stored = route["log_likelihood"]["recording"].isel(chain=1, draw=7).values
        assert stored == pytest.approx(np.bincount(rotation, each), rel=1e-6)


@pytest.mark.parametrize("route", ["amplitude", "direct"])
def test_arviz_summarises_compares_and_plots_what_is_returned(result, route):
    for name in TRUE_GAPS_RAD:
        one = getattr(result, route).snapshot(name)
        shown = ["delta_rad", *SEVEN] if route == "amplitude" else ["delta_rad", "start_angle_rad"]
        assert set(arviz.summary(one.posterior[shown]).index) == set(shown)
        data, of_noise = one.to_arviz(), one.to_arviz(noise_only=True)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Estimated shape parameter of Pareto")
            found = arviz.loo(of_noise, pointwise=True)
        tails = np.asarray(found.pareto_k)
        # Draws of another posterior than the likelihood's have 20 effective parameters and k of 2.
        free = sum(v.size for v in one.noise_posterior.isel(chain=0, draw=0).values())
        assert 0.0 < float(found.p_loo if hasattr(found, "p_loo") else found.p) < 1.5 * free
        # Few rotations: by the ringing, the first and the last hold 60 % each of what is known of
        # T_w.
        assert tails.max() < 1.5
        plots = [("plot_trace_dist", "plot_trace"), ("plot_ppc_dist", "plot_ppc")]
        for new, old in plots:
            plot = getattr(arviz, new, None) or getattr(arviz, old)
            options = {"var_names": ["delta_rad"]} if "trace" in old else {}
            assert plot(data, **options) is not None
            plt.close("all")
    assert "log_likelihood" not in (data.children if hasattr(data, "children") else data.groups())


def test_what_the_page_of_the_paper_names_is_in_the_result(tree):
    page = (ROOT / "docs" / "paper.md").read_text(encoding="utf-8")
    for path in set(re.findall(r"`(amplitude/\w+/\w+)`", page)):
        group, _, variable = path.rpartition("/")
        assert variable in tree[group].to_dataset(), path


def test_each_figure_is_one_call_on_what_is_read(result):
    assert {"signal", "amplitude_to_gap", "corner", "gap", "wear", "simulation"} <= set(
        dir(result.plot)
    )
    for name in dir(result.plot):
        assert getattr(result.plot, name)().axes, name


def test_the_prior_is_flat_in_the_logarithm_of_the_gap(tree):
    drawn = np.log(tree["amplitude/prior"]["delta_rad"].sel(snapshot="before").values.ravel())
    low, high = np.log(tree["amplitude/curve"]["delta_rad"].values[[0, -1]])
    share = np.sort((drawn - low) / (high - low))
    # Kolmogorov and Smirnov's distance of 1000 draws: above 0.062 once in 1000 seeds.
    assert np.abs(share - np.linspace(0.0, 1.0, share.size)).max() < 0.062


def test_a_result_of_an_earlier_version_is_refused_with_the_command_that_makes_it_again(
    tmp_path, monkeypatch
):
    from bayesbl.results import store

    monkeypatch.setattr(store, "FORMAT_VERSION", 2)
    tree = xr.DataTree()
    tree.attrs = {"kind": "fit", "outcome": "converged", "bayesbl_version": "0.3.0"}
    store.write_tree(tree, tmp_path / "result.nc")
    monkeypatch.undo()
    with pytest.raises(bayesbl.UserError, match=r"bayesbl run \S+config\.toml --force"):
        read_tree(tmp_path / "result.nc")
