"""Laws of wear in time: rates are recovered, dates have no origin, wear does not heal."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from bayesbl.gap.wear import LONGEST_YEARS, probability_before, since_repair, wear

RATE, START, LIMIT = 1e-4, 8e-4, 1.2e-3
YEARS = np.array([0.0, 0.5, 1.25, 2.0, 3.0])


def seed(number: int = 1) -> np.random.SeedSequence:
    return np.random.SeedSequence(number)


def drawn(gaps, sd, generator, *, shared=0.0, draws=1000):
    """Joint draws as a measurement gives them: centres off by the noise, a factor in common."""
    gaps = np.asarray(gaps, dtype=float)
    centres = gaps + sd * generator.standard_normal(gaps.size)
    noise = sd * generator.standard_normal((gaps.size, 2, draws // 2))
    factor = np.exp(shared * generator.standard_normal((2, draws // 2)))
    return (centres[:, None, None] + noise) * factor


def rank(truth, draws):
    return float(np.mean(draws < truth))


def uniform_p(ranks):
    return stats.kstest(ranks, "uniform").pvalue


@pytest.mark.parametrize("years", [YEARS[[0, 3]], YEARS[:3], YEARS], ids=["two", "three", "five"])
def test_a_known_rate_and_present_gap_are_covered_as_often_as_said(years):
    # Ranks of the truth among the draws are uniform; false alarm of each test 1 in 1000. From
    # four snapshots on the prior leaves room for scatter that is not there: ranks may be too
    # central, but not off centre.
    generator = np.random.default_rng(3)
    rates, currents = [], []
    for number in range(300):
        found = wear(drawn(START + RATE * years, 2e-5, generator), years, seed(number))
        rates.append(rank(RATE, found.rate_rad_per_year))
        currents.append(rank(START + RATE * years[-1], found.current_rad))
    for ranks in (np.array(rates), np.array(currents)):
        if years.size < 4:
            assert uniform_p(ranks) > 1e-3
        assert abs(np.mean(ranks > 0.5) - 0.5) < 3.3 * 0.5 / np.sqrt(ranks.size)
        # 300 cases cover with a standard deviation of 1.7 %.
        assert np.mean(np.abs(ranks - 0.5) < 0.45) > 0.9 - 3.1 * 0.0173


def test_irregular_wear_is_covered_and_found():
    generator = np.random.default_rng(4)
    years, sigma = np.linspace(0.0, 4.0, 9), 1e-4
    ranks, share_above = [], []
    for number in range(150):
        walk = np.cumsum(sigma * np.sqrt(np.diff(years, prepend=0.0)) * generator.normal(size=9))
        found = wear(drawn(1e-3 + RATE * years + walk, 1e-5, generator), years, seed(number))
        ranks.append(rank(RATE, found.rate_rad_per_year))
        share_above.append(np.median(found.scatter_rad_per_root_year) / sigma)
    assert uniform_p(ranks) > 1e-3, "false alarm 1 in 1000"
    assert 0.8 < np.median(share_above) < 1.25
    calm = wear(drawn(1e-3 + RATE * years, 1e-5, generator), years, seed(9))
    assert np.median(calm.scatter_rad_per_root_year) < 0.2 * sigma


def test_fewer_than_four_snapshots_tell_no_scatter():
    found = wear(drawn(START + RATE * YEARS[:3], 1e-5, np.random.default_rng(5)), YEARS[:3], seed())
    assert np.all(found.scatter_rad_per_root_year == 0.0)


def test_two_snapshots_give_the_change_over_the_time_draw_by_draw():
    gaps = drawn([8e-4, 9e-4], 1e-5, np.random.default_rng(6), shared=0.05)
    found = wear(gaps, np.array([0.0, 0.5]), seed(), limit_rad=LIMIT)
    np.testing.assert_allclose(found.rate_rad_per_year, (gaps[1] - gaps[0]) / 0.5, rtol=1e-9)
    np.testing.assert_allclose(found.current_rad, gaps[1], rtol=1e-12)
    np.testing.assert_allclose(
        found.years_to_limit,
        np.where(found.heals, np.nan, np.maximum(LIMIT - gaps[1], 0.0) / found.rate_rad_per_year),
        rtol=1e-9,
    )


@pytest.mark.parametrize("years", [YEARS[:2], YEARS], ids=["two", "five"])
def test_dates_have_no_origin_and_time_no_unit_of_its_own(years):
    gaps = drawn(START + RATE * years, 1e-5, np.random.default_rng(7))
    found = wear(gaps, years, seed(), limit_rad=LIMIT)
    shifted = wear(gaps, years + 2026.0, seed(), limit_rad=LIMIT)
    doubled = wear(gaps, 2.0 * years, seed(), limit_rad=LIMIT)
    np.testing.assert_allclose(shifted.rate_rad_per_year, found.rate_rad_per_year, rtol=1e-8)
    np.testing.assert_allclose(shifted.years_to_limit, found.years_to_limit, rtol=1e-7)
    np.testing.assert_allclose(doubled.rate_rad_per_year, found.rate_rad_per_year / 2.0)
    np.testing.assert_allclose(doubled.years_to_limit, 2.0 * found.years_to_limit)
    np.testing.assert_allclose(
        doubled.scatter_rad_per_root_year, found.scatter_rad_per_root_year / np.sqrt(2.0)
    )
    np.testing.assert_allclose(doubled.current_rad, found.current_rad)


def test_gaps_of_another_unit_wear_in_that_unit():
    gaps = drawn(START + RATE * YEARS, 1e-5, np.random.default_rng(8))
    rad = wear(gaps, YEARS, seed(), limit_rad=LIMIT)
    mrad = wear(1e3 * gaps, YEARS, seed(), limit_rad=1e3 * LIMIT)
    np.testing.assert_allclose(mrad.rate_rad_per_year, 1e3 * rad.rate_rad_per_year, rtol=1e-6)
    np.testing.assert_allclose(mrad.years_to_limit, rad.years_to_limit, rtol=1e-6)


def test_what_snapshots_share_widens_the_rate_by_its_factor_alone():
    # A curve off by 10 % leaves 10 % of the rate; independent intervals would leave many times
    # that of the gaps themselves.
    generator = np.random.default_rng(9)
    years = YEARS[:3]
    gaps = START + RATE * years
    shared = wear(drawn(gaps, 1e-7, generator, shared=0.1, draws=4000), years, seed())
    relative = shared.rate_rad_per_year.std() / shared.rate_rad_per_year.mean()
    assert relative == pytest.approx(0.1, rel=0.1)
    mixed = drawn(gaps, 1e-7, generator, shared=0.1, draws=4000)
    alone = np.stack([generator.permutation(g.ravel()).reshape(g.shape) for g in mixed])
    assert wear(alone, years, seed()).rate_rad_per_year.std() > 3.0 * shared.rate_rad_per_year.std()


def test_without_wear_an_increase_is_as_likely_as_not_and_rarely_reported():
    # Binomial: 400 cases, 5 % nominal; more than 34 false alarms in 1 of 1000 tests.
    generator = np.random.default_rng(10)
    years = YEARS[:3]
    probabilities, rates = [], []
    for number in range(400):
        found = wear(drawn(np.full(3, START), 1e-5, generator), years, seed(number))
        probabilities.append(found.probability_wear)
        rates.append(np.median(found.rate_rad_per_year[~found.heals]))
    assert uniform_p(probabilities) > 1e-3, "false alarm 1 in 1000"
    assert np.sum(np.array(probabilities) >= 0.95) <= stats.binom.ppf(0.999, 400, 0.05)
    # Ruling out healing reports a rate above 0 where there is none: rates are no sign of wear.
    assert np.all(np.array(rates) > 0.0)


def test_a_draw_that_heals_has_no_time_to_the_limit():
    found = wear(
        drawn(np.full(2, START), 1e-5, np.random.default_rng(11)),
        YEARS[:2],
        seed(),
        limit_rad=LIMIT,
    )
    assert 0.02 < found.heals.mean() < 0.98
    np.testing.assert_array_equal(np.isnan(found.years_to_limit), found.heals)


def test_a_limit_that_is_passed_is_reached_in_no_time():
    for years in (YEARS[:2], YEARS):
        gaps = drawn(LIMIT + 2e-4 + RATE * years, 1e-6, np.random.default_rng(12))
        found = wear(gaps, years, seed(), limit_rad=LIMIT)
        assert np.all(found.years_to_limit[~found.heals] == 0.0)
        assert probability_before(found.years_to_limit, 0.0) == 1.0


def test_a_joint_that_hardly_wears_reaches_its_limit_late_but_at_a_finite_time():
    gaps = drawn([START, START + 1e-12], 1e-13, np.random.default_rng(13))
    found = wear(gaps, np.array([0.0, 1.0]), seed(), limit_rad=LIMIT)
    assert np.all(found.years_to_limit[~found.heals] == LONGEST_YEARS)


def test_the_probability_of_passing_the_limit_only_grows_with_the_date():
    gaps = drawn(START + RATE * YEARS, 1e-5, np.random.default_rng(14))
    found = wear(gaps, YEARS, seed(), limit_rad=LIMIT)
    within = [probability_before(found.years_to_limit, t) for t in (0.0, 0.5, 1.0, 2.0, 1e4)]
    assert within == sorted(within)
    assert within[-1] == 1.0
    # 0.1 mrad are left at 0.1 mrad a year.
    assert within[0] < 0.05
    assert np.nanmedian(found.years_to_limit) == pytest.approx(1.0, rel=0.2)


def test_times_of_irregular_wear_are_those_of_a_walk_with_drift():
    # Snapshots so exact that rate and scatter are as good as known; an independent simulation.
    generator = np.random.default_rng(15)
    years = np.linspace(0.0, 60.0, 241)
    sigma = 1.5e-4
    steps = RATE * 0.25 + sigma * 0.5 * generator.standard_normal(years.size - 1)
    gaps = 5e-4 + np.r_[0.0, np.cumsum(steps)]
    found = wear(drawn(gaps, 1e-8, generator, draws=4000), years, seed(), limit_rad=gaps[-1] + 4e-4)
    keep = ~found.heals
    rates = found.rate_rad_per_year[keep][:2000]
    sigmas = found.scatter_rad_per_root_year[keep][:2000]
    fine = 0.02
    position = np.zeros(rates.size)
    times = np.full(rates.size, np.inf)
    for step in range(2000):
        position += rates * fine + sigmas * np.sqrt(fine) * generator.standard_normal(rates.size)
        times[(position >= 4e-4) & np.isinf(times)] = (step + 1) * fine
    exact = np.minimum(found.years_to_limit[keep], 40.0)
    # False alarm 1 in 1000; the fine walk passes late by about 0.6 √fine σ, one percent here.
    assert stats.ks_2samp(exact, np.minimum(times, 40.0)).pvalue > 1e-3


@pytest.mark.parametrize(
    ("repaired", "first"),
    [([False] * 3, 0), ([True, False, False], 0), ([False, True, False, True, False], 3)],
)
def test_a_repair_starts_anew(repaired, first):
    assert since_repair(repaired) == slice(first, len(repaired))


def test_the_same_seed_gives_the_same_wear():
    gaps = drawn(START + RATE * YEARS, 1e-5, np.random.default_rng(16))
    first, again = (wear(gaps, YEARS, seed(3), limit_rad=LIMIT) for _ in range(2))
    np.testing.assert_array_equal(first.years_to_limit, again.years_to_limit)
