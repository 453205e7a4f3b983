"""Laws of the study of the noise's kind: what each kind makes of noise that is known."""

from __future__ import annotations

import csv

import numpy as np
import pytest
import xarray as xr
from places import ROOT

from bayesbl.config.loading import load_config
from bayesbl.runs.study import load_study, prepare

SMALL = {"name": "small", "cases": 1, "rotations": 2.5, "sampling_hz": 500.0}


@pytest.fixture(scope="module")
def study():
    return load_study(ROOT / "experiments/noise_choice.py")


@pytest.fixture(scope="module")
def coloured(study):
    return study.run_case(SMALL | {"coefficients": [0.6]}, 0, np.random.SeedSequence([71, 1]))


def test_coloured_noise_taken_for_white_is_too_narrow_and_scatter_gives_some_back(coloured):
    # Below its corner AR(1) noise has (1 + φ)/(1 − φ) = 4 times the power of white noise of its
    # variance, so white noise alone makes half of the width. Impacts then scatter by more than
    # that, which widens the interval, as far as a few impacts can tell.
    assert 0.5 < coloured["white_sd_rpm"] / coloured["true_sd_rpm"] < 1.0


def test_the_right_kind_gives_the_width_of_the_truth_and_student_t_changes_none(coloured):
    assert (coloured["kind"], coloured["order"]) == (1.0, 1.0)
    assert coloured["auto_sd_rpm"] == coloured["student_t_sd_rpm"] == coloured["ar_sd_rpm"]
    # φ of some 2600 differences has a standard error of 0.02, the width one of 3 %.
    assert coloured["auto_sd_rpm"] == pytest.approx(coloured["true_sd_rpm"], rel=0.1)


def test_outliers_are_told_and_leave_the_width_to_the_variance(study):
    row = SMALL | {"degrees_of_freedom": 3.0}
    found = study.run_case(row, 0, np.random.SeedSequence([71, 2]))
    assert (found["kind"], found["order"]) == (2.0, 0.0)
    assert found["auto_sd_rpm"] == found["white_sd_rpm"]


def test_a_line_counts_right_choices_and_intervals_that_hold(study):
    error = np.array([0.1, -0.1, 1.0, -3.0])
    names = ("auto", "white", "ar", "ar1", "student_t", "true")
    columns = {"kind": [1.0, 1.0, 0.0, 2.0], "order": [1.0, 2.0, 0.0, 1.0], "error_rpm": error}
    columns |= {f"{name}_sd_rpm": np.ones(4) for name in names}
    columns["white_sd_rpm"] = np.full(4, 0.5)
    cases = xr.Dataset({name: ("case", np.asarray(v, float)) for name, v in columns.items()})
    line = study.summarise(SMALL | {"coefficients": [0.6]}, cases)
    assert (line["true_kind"], line["kind_right"], line["order_right"]) == ("ar", 0.5, 0.5)
    assert [line[f"chosen_{kind}"] for kind in ("white", "ar", "student_t")] == [0.25, 0.5, 0.25]
    assert (line["auto_cover_90%"], line["white_cover_90%"]) == (0.75, 0.5)
    assert (line["auto_width"], line["white_width"]) == (1.0, 0.5)


def test_the_table_that_is_shipped_is_that_of_the_shipped_rows_and_is_drawn(study):
    _, rows = prepare(load_config(ROOT / "configs/noise_choice.toml"))
    with open(ROOT / "experiments/results/noise_choice.csv", newline="") as file:
        table = list(csv.DictReader(file))
    assert [line["name"] for line in table] == [row.name for row in rows]
    assert [int(line["cases"]) for line in table] == [row.count for row in rows]
    chosen, *_ = study.module.figure(table, {}).axes
    assert [label.get_text() for label in chosen.get_yticklabels()] == [row.name for row in rows]
