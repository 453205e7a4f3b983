"""Laws of the study of forecasts: true laws end at the limit, what is counted is what is said."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from places import ROOT

from bayesbl.runs.study import load_study

LAWS = (
    *("linear", "running_in", "quadratic", "power", "exponential", "logistic", "gamma", "steps"),
    *("square_root", "power_0.6", "kink", "bathtub", "slowing"),
)


@pytest.fixture(scope="module")
def study():
    return load_study(ROOT / "experiments/forecasts.py")


def row_of(study, law="linear", dates=(3,)):
    return study.row({"name": law, "law": law, "dates": list(dates), "cases": 2})


@pytest.mark.parametrize("law", LAWS)
def test_a_true_law_never_falls_and_one_without_chance_ends_at_the_limit(study, law):
    generator = np.random.default_rng(1)
    ages = np.linspace(0.0, 1.0, 101)
    for _ in range(20):
        grown = study.module.law_of(law, generator)(ages)
        assert np.all(np.diff(grown) >= 0.0)
        assert grown[0] == pytest.approx(0.0, abs=1e-12)
        if law not in ("gamma", "steps"):
            # Running in of the bathtub leaves e^(−1/duration), 5e-5 of 0.3 at most.
            assert grown[-1] == pytest.approx(1.0, rel=2e-5 if law == "bathtub" else 1e-6)


@pytest.mark.parametrize("law", ["linear", "steps"])
def test_a_case_has_all_its_columns_and_a_limit_that_is_ahead(study, law):
    row = row_of(study, law, (2, 4))
    case = study.module.run_case(row, 1, np.random.SeedSequence(2))
    assert set(case) == set(study.module.COLUMNS)
    assert case["dates"] == 4.0
    assert case["remaining"] > 0.0
    assert case["low"] <= case["not_before"] <= case["median"] <= case["high"]


def test_shares_are_counted_by_dates_and_without_what_is_withheld(study):
    size = 8
    dates = np.repeat([2.0, 3.0], 4)
    ones = np.ones(size)
    cases = xr.Dataset(
        {
            "dates": ("case", dates),
            "last_at": ("case", np.full(size, 0.5)),
            "remaining": ("case", ones),
            "low": ("case", np.array([0.5, 0.5, 1.5, 0.5, 0.5, 0.5, 0.5, np.nan])),
            "median": ("case", 1.2 * ones),
            "high": ("case", 2.0 * ones),
            "not_before": ("case", np.array([0.7, 0.7, 1.6, 1.1, 0.7, 0.7, 0.7, np.nan])),
            "near_remaining": ("case", np.array([0.6, 0.6, 0.2, 0.2, 0.6, 0.6, 0.6, np.nan])),
            "near_life": ("case", 0.6 * ones),
            "withheld": ("case", np.array([0.0] * 7 + [1.0])),
        }
    )
    line = study.module.summarise(row_of(study, dates=(2, 3)), cases)
    assert line["withheld"] == 1.0 / 8.0
    assert line["covered_by_dates"] == "0.75 1"
    assert line["not_before_right_by_dates"] == "0.5 1"
    assert line["limit_earlier_by_dates"] == "0.25 0"
    assert line["alpha_lambda_by_dates"] == "0.5 1"
    assert line["median_by_dates"] == "1.2 1.2"
