"""Rates pooled over a type: they hold the truth as often as said, and are sharper than alone."""

from __future__ import annotations

import numpy as np
import pytest
from pooled_coverage import case, fleet, of_rate

from bayesbl.fleet.pooled_rates import alarms, pooled
from bayesbl.measurement.wear import KINDS, WearDraws
from bayesbl.recording.types import FloatArray

PRIOR = [kind.probability for kind in KINDS]


@pytest.mark.long
@pytest.mark.parametrize(("spread", "error"), [(0.2, 0.6), (0.4, 0.15)])
def test_intervals_hold_the_truth_as_often_as_said(spread, error):
    """12 fleets of 20 joints; by fleets 90 % scatters by 2.3 % (``pooled_coverage.csv``)."""
    cases = [case(seed, spread, error) for seed in range(12)]
    means = {key: np.mean([one[key] for one in cases]) for key in cases[0]}
    assert 0.84 <= means["held"] <= 0.97
    assert means["median_held"] >= 7 / 12  # fewer of 12 have a probability of 0.1 %
    if error > spread:
        assert means["width_over_alone"] < 0.7


@pytest.mark.long
def test_joints_under_another_load_are_told_by_what_it_does():
    """12 fleets of 20 joints, rates twice as high for a standard deviation more load."""
    cases = [case(seed, 0.2, 0.6, 0.7) for seed in range(12)]
    means = {key: np.mean([one[key] for one in cases]) for key in cases[0]}
    assert 0.84 <= means["held"] <= 0.97
    assert means["factor_held"] >= 7 / 12
    assert means["width_over_without_load"] < 0.9


@pytest.mark.long
def test_a_load_that_all_joints_share_changes_nothing():
    generator = np.random.default_rng(9)
    _, rates = fleet(generator, 12, 0.3, 0.5)
    joints = [of_rate(own, generator) for own in rates]
    plain, loaded = (
        pooled(joints, np.random.default_rng(3), covariates)
        for covariates in ({}, {"load": np.full(12, 7.0)})
    )
    assert plain is not None
    assert loaded is not None
    assert loaded.rates.factors == {}
    for one, other in zip(plain.joints, loaded.joints, strict=True):
        assert one.chosen is not None
        assert np.array_equal(one.chosen, other.chosen)


def drawn(rate: FloatArray, kind: FloatArray, jump_rad: FloatArray) -> WearDraws:
    return WearDraws(rate, kind, jump_rad, rate)


def jumps(generator: np.random.Generator, middle: float = 1e-6, spread: float = 2.0) -> FloatArray:
    return middle * np.exp(spread * generator.standard_normal(2000))


def test_what_is_measured_well_stays_as_it_is():
    generator = np.random.default_rng(7)
    rates = [generator.normal(m, 1e-6, 1000) for m in (1e-4, 2e-4, 4e-4, 8e-4)]
    found = pooled([of_rate(own, generator) for own in rates], generator)
    assert found is not None
    for own, one in zip(rates, found.joints, strict=True):
        assert one.chosen is not None
        assert np.median(own[one.chosen]) == pytest.approx(np.median(own), abs=3e-7)
        assert own[one.chosen].std() == pytest.approx(own.std(), rel=0.1)


def test_two_joints_are_no_type():
    generator = np.random.default_rng(8)
    _, rates = fleet(generator, 2, 0.3, 0.5)
    assert pooled([of_rate(own, generator) for own in rates], generator) is None


def test_joints_of_a_type_share_its_law_and_those_that_show_another_keep_it():
    """Twenty joints show that they wear evenly, one shows nothing, one that it speeds up."""
    generator = np.random.default_rng(10)
    even = [kind.law for kind in KINDS].index("steady")
    fast = len(KINDS) - 1
    laws = [
        np.where(
            generator.uniform(size=2000) < 0.6, even, generator.choice(len(KINDS), 2000, p=PRIOR)
        )
        for _ in range(20)
    ]
    laws.append(generator.choice(len(KINDS), 2000, p=PRIOR))
    laws.append(np.where(generator.uniform(size=2000) < 0.999, fast, even))
    found = pooled(
        [drawn(generator.normal(3e-4, 2e-5, 2000), law, jumps(generator)) for law in laws],
        generator,
    )
    assert found is not None
    nothing, other = found.joints[-2:]
    assert nothing.chosen is not None
    assert np.mean(laws[-2][nothing.chosen] == even) > 0.6
    assert other.chosen is None or np.mean(laws[-1][other.chosen] == fast) > 0.8
    assert found.rates.law["steady"] > 0.6
    assert sum(found.rates.law.values()) == pytest.approx(1.0)


def test_a_joint_unlike_its_type_keeps_its_answer_and_is_named():
    """Eleven joints wear alike; one wears eight times as fast, with an uncertain rate."""
    generator = np.random.default_rng(11)
    rates = [generator.normal(3e-4, 2e-5, 2000) for _ in range(11)]
    rates.append(generator.normal(2.4e-3, 2.4e-4, 2000))
    found = pooled([of_rate(own, generator) for own in rates], generator)
    assert found is not None
    *alike, strange = found.joints
    assert strange.probability_own > 0.9
    assert strange.chosen is not None
    assert np.median(rates[-1][strange.chosen]) == pytest.approx(2.4e-3, rel=0.05)
    assert max(one.probability_own for one in alike) < 0.2
    assert np.quantile(found.rates.spread, 0.95) < 0.3


@pytest.mark.long
def test_a_joint_with_few_recordings_leans_less_on_a_type_of_strangers():
    """Its law is as wide as the prior; that of the others is one, or each another."""
    generator = np.random.default_rng(12)

    def share_of_first(laws: list[int]) -> float:
        joints = [
            drawn(generator.normal(3e-4, 2e-5, 2000), np.full(2000, law), jumps(generator))
            for law in laws
        ]
        open_law = generator.choice(len(KINDS), 2000, p=PRIOR)
        joints.append(drawn(generator.normal(3e-4, 2e-5, 2000), open_law, jumps(generator)))
        found = pooled(joints, generator)
        assert found is not None
        chosen = found.joints[-1].chosen
        assert chosen is not None
        return float(np.mean(open_law[chosen] == laws[0]))

    alike, mixed = (
        share_of_first([0] * 14),
        share_of_first([0, 0, 0, 0, 0, 0, 0, 1, 2, 3, 4, 1, 2, 3]),
    )
    assert alike > 0.7
    assert PRIOR[0] < mixed < alike - 0.2


def test_how_irregular_wear_is_is_shared_too():
    """Nineteen joints show large jumps; the last one's recordings leave that open."""
    generator = np.random.default_rng(13)
    rates = [generator.normal(3e-4, 2e-5, 2000) for _ in range(20)]
    joints = [
        drawn(own, generator.choice(len(KINDS), 2000, p=PRIOR), jumps(generator, 5e-5, 0.5))
        for own in rates
    ]
    joints[-1] = of_rate(rates[-1], generator)
    found = pooled(joints, generator)
    assert found is not None
    chosen = found.joints[-1].chosen
    assert chosen is not None
    assert np.median(joints[-1].jump_rad) < 1e-6
    assert np.median(joints[-1].jump_rad[chosen]) > 2e-5


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
