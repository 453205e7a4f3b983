"""Draws crowd at the edge of a tolerance where the true value lies beyond it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm, truncnorm

from bayesbl.sampling.chains import chance_at_edge


@pytest.mark.parametrize("beyond", [0.5, 1.3, 3.0])
def test_the_chance_is_that_of_a_peak_so_far_beyond(beyond):
    """s/width (φ(t) − t Q(t)): the average over true values within a tolerance of ten sd."""
    draws = truncnorm(beyond, np.inf, loc=-beyond).rvs(200_000, random_state=1)
    true_values = np.linspace(0.0, 10.0, 20_001)
    expected = float(np.mean(norm.cdf(-beyond - true_values)))
    assert chance_at_edge(draws, 10.0) == pytest.approx(expected, rel=0.2)


def test_draws_around_a_peak_within_the_tolerance_are_not_pressed():
    draws = np.abs(np.random.default_rng(2).normal(0.0, 1.0, 10_000)) + 0.1
    assert chance_at_edge(draws, 100.0) == 1.0


@pytest.mark.parametrize("sd", [0.05, 0.3])
def test_the_false_alarm_rate_is_the_nominal_one(sd):
    """2000 true values within a tolerance of one: 20 alarms are expected, 99 % have 9 to 32."""
    rng = np.random.default_rng(3)
    peaks = rng.uniform(0.0, 1.0, 2000) + sd * rng.normal(size=2000)
    alarms = 0
    for peak in peaks[peaks < 0.1]:  # others lie within and never alarm
        draws = truncnorm(-peak / sd, np.inf, loc=peak, scale=sd).rvs(4000, random_state=rng)
        alarms += chance_at_edge(draws, 1.0) < 0.01
    assert 9 <= alarms <= 32
