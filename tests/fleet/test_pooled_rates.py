"""Rates pooled over a type: they hold the truth as often as said, and are sharper than alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import truncnorm

from bayesbl.fleet.pooled_rates import alarms, pooled

LEVELS = (0.05, 0.95)


def posterior(measured: float, sd: float, generator: np.random.Generator) -> np.ndarray:
    """Draws of a rate that cannot be negative, of a flat prior."""
    low = -measured / sd
    return truncnorm.rvs(low, np.inf, measured, sd, 1000, random_state=generator)


def fleet(
    generator: np.random.Generator, joints: int, median: float, spread: float, error: float
) -> tuple[np.ndarray, list[np.ndarray]]:
    truth = median * np.exp(spread * generator.standard_normal(joints))
    sd = error * median * generator.uniform(0.5, 2.0, joints)
    measured = truth + sd * generator.standard_normal(joints)
    return truth, [posterior(m, s, generator) for m, s in zip(measured, sd, strict=True)]


def held(truth: np.ndarray, draws: list[np.ndarray]) -> np.ndarray:
    bounds = np.array([np.quantile(one, LEVELS) for one in draws])
    return (bounds[:, 0] <= truth) & (truth <= bounds[:, 1])


def width(draws: list[np.ndarray]) -> float:
    bounds = np.array([np.quantile(one, LEVELS) for one in draws])
    return float(np.median(bounds[:, 1] - bounds[:, 0]))


@pytest.mark.parametrize(("spread", "error"), [(0.2, 0.6), (0.6, 0.6), (0.4, 0.15)])
def test_intervals_hold_the_truth_as_often_as_said(spread, error):
    """15 fleets of 20 joints: 90 % of 300 has a standard deviation of 1.7 %, more by fleets."""
    generator = np.random.default_rng(round(100 * spread + error))
    inside, of_type, pooled_width, own_width = [], [], [], []
    for _ in range(15):
        truth, rates = fleet(generator, 20, 4e-4, spread, error)
        found = pooled(rates, generator)
        assert found is not None
        draws = [
            own if which is None else own[which]
            for own, which in zip(rates, found.chosen, strict=True)
        ]
        inside.append(held(truth, draws).mean())
        low, high = np.quantile(found.rates.median_rad_per_year, LEVELS)
        of_type.append(low <= 4e-4 <= high)
        pooled_width.append(width(draws))
        own_width.append(width(rates))
    assert 0.85 <= np.mean(inside) <= 0.95
    assert np.sum(of_type) >= 10  # of 15 at 90 %: fewer have a probability of 0.2 %
    if error > spread:
        assert np.mean(pooled_width) < 0.7 * np.mean(own_width)


def test_what_is_measured_well_stays_as_it_is():
    generator = np.random.default_rng(7)
    rates = [generator.normal(m, 1e-6, 1000) for m in (1e-4, 2e-4, 4e-4, 8e-4)]
    found = pooled(rates, generator)
    assert found is not None
    for own, which in zip(rates, found.chosen, strict=True):
        assert which is not None
        assert np.median(own[which]) == pytest.approx(np.median(own), abs=3e-7)
        assert own[which].std() == pytest.approx(own.std(), rel=0.1)


def test_two_joints_are_no_type():
    generator = np.random.default_rng(8)
    _, rates = fleet(generator, 2, 4e-4, 0.3, 0.5)
    assert pooled(rates, generator) is None


def test_of_the_joints_called_no_more_are_wrong_than_said():
    """500 fleets of 40 joints whose probabilities are right: on average 5 % of the calls."""
    generator = np.random.default_rng(9)
    shares = []
    for _ in range(500):
        probability = generator.beta(0.4, 0.6, 40)
        over = generator.uniform(size=40) < probability
        called = np.array(alarms([float(p) for p in probability]))
        if called.any():
            shares.append(np.mean(~over[called]))
    assert 0.01 < np.mean(shares) < 0.06


def test_no_probability_is_no_call():
    assert alarms([None, 1.0, None, 0.2]) == [False, True, False, False]
    assert alarms([None, 0.4]) == [False, False]
    assert alarms([]) == []
