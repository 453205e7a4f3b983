"""Estimates that are made wider by what no posterior knows."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bayesbl.diagnosis.diagnosis import Estimate

SD, FACTOR, MORE = 0.02, 3.0, 0.05


def of_gap(draws: int) -> Estimate:
    """A gap of 1 mrad known to 2 %, with its draws in four chains."""
    made = Estimate(math.log(1e-3), SD, logarithmic=True)
    shuffled = np.random.default_rng(1).permutation(made.normal_draws(draws))
    return Estimate(made.value, SD, shuffled.reshape(4, -1), logarithmic=True)


def test_an_independent_error_adds_its_variance_to_value_and_draws() -> None:
    wider = of_gap(4000).widened(FACTOR, MORE)
    expected = math.hypot(FACTOR * SD, MORE)
    assert wider.sd == pytest.approx(expected)
    assert wider.draws is not None
    logs = np.log(wider.draws)
    # 4000 draws know a standard deviation to 1.1 %, a mean to 1.6 % of it: four times that
    assert logs.std() == pytest.approx(expected, rel=0.045)
    assert abs(logs.mean() - math.log(1e-3)) < 0.065 * expected


def test_a_value_in_its_own_unit_is_widened_by_its_share() -> None:
    wider = Estimate(2.0, 0.1).widened(1.0, MORE)
    assert wider.sd == pytest.approx(math.hypot(0.1, 2.0 * MORE))


def test_the_normal_approximation_has_its_mean_and_deviation() -> None:
    draws = np.log(Estimate(1.0, SD, logarithmic=True).normal_draws(1000))
    assert draws.mean() == pytest.approx(1.0)
    assert draws.std() == pytest.approx(SD, rel=0.01)
