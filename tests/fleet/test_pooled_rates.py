"""Rates pooled over a type: they hold the truth as often as said, and are sharper than alone."""

from __future__ import annotations

import numpy as np
import pytest
from pooled_coverage import case, fleet

from bayesbl.fleet.pooled_rates import alarms, pooled
from bayesbl.measurement.wear_laws import KINDS


@pytest.mark.parametrize(("spread", "error"), [(0.2, 0.6), (0.4, 0.15)])
def test_intervals_hold_the_truth_as_often_as_said(spread, error):
    """12 fleets of 20 joints; by fleets 90 % scatters by 2.3 % (``pooled_coverage.csv``)."""
    cases = [case(seed, spread, error) for seed in range(12)]
    means = {key: np.mean([one[key] for one in cases]) for key in cases[0]}
    assert 0.84 <= means["held"] <= 0.97
    assert means["median_held"] >= 7 / 12  # fewer of 12 have a probability of 0.1 %
    if error > spread:
        assert means["width_over_alone"] < 0.7


def test_what_is_measured_well_stays_as_it_is():
    generator = np.random.default_rng(7)
    rates = [generator.normal(m, 1e-6, 1000) for m in (1e-4, 2e-4, 4e-4, 8e-4)]
    found = pooled(rates, [np.zeros(1000, int)] * 4, generator)
    assert found is not None
    for own, which in zip(rates, found.chosen, strict=True):
        assert which is not None
        assert np.median(own[which]) == pytest.approx(np.median(own), abs=3e-7)
        assert own[which].std() == pytest.approx(own.std(), rel=0.1)


def test_two_joints_are_no_type():
    generator = np.random.default_rng(8)
    _, rates = fleet(generator, 2, 0.3, 0.5)
    assert pooled(rates, [np.zeros(1000, int)] * 2, generator) is None


def test_joints_of_a_type_share_its_law_and_those_that_show_another_keep_it():
    """Ten joints show that they wear evenly, one shows nothing, one that it speeds up."""
    generator = np.random.default_rng(10)
    prior = [kind.probability for kind in KINDS]
    even = [kind.law for kind in KINDS].index("linear")
    fast = [kind.law for kind in KINDS].index("exponential")
    rates = [generator.normal(3e-4, 2e-5, 2000) for _ in range(12)]
    laws = [
        np.where(generator.uniform(size=2000) < 0.6, even, generator.choice(7, 2000, p=prior))
        for _ in range(10)
    ]
    laws.append(generator.choice(7, 2000, p=prior))
    laws.append(np.where(generator.uniform(size=2000) < 0.999, fast, even))
    found = pooled(rates, laws, generator)
    assert found is not None
    nothing, other = found.chosen[-2:]
    assert nothing is not None
    assert np.mean(laws[-2][nothing] == even) > 0.6
    assert other is None or np.mean(laws[-1][other] == fast) > 0.8
    assert found.rates.law["linear"] > 0.6
    assert sum(found.rates.law.values()) == pytest.approx(1.0)


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
