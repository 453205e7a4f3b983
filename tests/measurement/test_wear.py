"""Laws of wear in time: rates are recovered, dates have no origin, wear does not heal."""

from __future__ import annotations

import io
import re
from datetime import date, timedelta

import numpy as np
import pytest
import xarray as xr
from rich.console import Console
from scipy import stats
from stored_measurement import stored_comparison

from bayesbl.config.measurement import CompareConfig
from bayesbl.measurement.measurement import Answer, Reason
from bayesbl.measurement.wear import (
    HAZARD,
    KINDS,
    LONGEST_YEARS,
    NORMALS,
    SCATTER,
    Laws,
    _fit,
    _growth_needed,
    by_law,
    date_after,
    fall,
    shares,
    since_repair,
    summarise_wear,
    trend,
    wear,
    wear_of,
    years_between,
)
from bayesbl.presentation.figures.gap import path_band, reached
from bayesbl.presentation.figures.gap import wear as wear_figure
from bayesbl.presentation.figures.style import save
from bayesbl.presentation.terminal import print_blocks
from bayesbl.presentation.wear import LAWS as LAWS_IN_WORDS
from bayesbl.presentation.wear import blocks
from bayesbl.sentences import with_sentences

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


def mean_rate(found, years):
    return (found.current_rad - found.first_rad) / (years[-1] - years[0])


def share_of(found, *names):
    """Posterior probability of the laws of these names."""
    return sum(shares(found["law"].values)[name] for name in names)


@pytest.mark.long
@pytest.mark.parametrize("years", [YEARS[[0, 3]], YEARS[:3], YEARS], ids=["two", "three", "five"])
def test_a_known_rate_and_present_gap_are_covered_as_often_as_said(years):
    # From three snapshots on the laws leave room for what is not there: ranks may be too central.
    generator = np.random.default_rng(3)
    rates, currents = [], []
    for number in range(120):
        found = wear(drawn(START + RATE * years, 2e-5, generator), years, seed(number))
        rates.append(rank(RATE, mean_rate(found, years)))
        currents.append(rank(START + RATE * years[-1], found.current_rad))
    for ranks in (np.array(rates), np.array(currents)):
        if years.size == 2:
            assert uniform_p(ranks) > 1e-3, "false alarm 1 in 1000"
        # 120 cases cover with a standard deviation of 2.7 %.
        assert np.mean(np.abs(ranks - 0.5) < 0.45) > 0.9 - 3.1 * 0.0274


@pytest.mark.long
@pytest.mark.parametrize("shared", [0.0, 0.1])
def test_irregular_wear_is_covered_and_found(shared):
    # A curve that is 10 % off hides none of it: its factor is common to all snapshots.
    generator = np.random.default_rng(4)
    # Many dates and small jumps: a few large ones pass for changes of the law as well.
    years, sigma, scatter, currents = np.linspace(0.0, 4.0, 20), 4e-5, [], []
    jump = sigma**2 / RATE
    for number in range(24):
        steps = generator.gamma(RATE * np.diff(years) / jump, jump)
        gaps = 1e-3 + np.r_[0.0, np.cumsum(steps)]
        found = wear(drawn(gaps, 1e-5, generator, shared=shared), years, seed(number))
        currents.append(rank(gaps[-1], found.current_rad))
        scatter.append(np.median(found.scatter_rad_per_root_year) / sigma)
    assert 0.6 < np.median(scatter) < 1.25
    if not shared:
        assert uniform_p(currents) > 1e-3, "false alarm 1 in 1000"
    calm = wear(drawn(1e-3 + RATE * years, 1e-5, generator, shared=shared), years, seed(9))
    assert np.median(calm.scatter_rad_per_root_year) < 0.5 * sigma


@pytest.mark.parametrize(
    ("growth", "names"),
    [
        (lambda t: t**3, ("speeding_up",)),
        (lambda t: np.expm1(3.0 * t) / np.expm1(3.0), ("speeding_up",)),
        (lambda t: t**0.4, ("slowing",)),
    ],
)
def test_a_law_that_shows_is_the_likeliest(growth, names):
    years = np.linspace(0.0, 4.0, 10)
    gaps = drawn(START + 4e-4 * growth(years / 4.0), 2e-6, np.random.default_rng(5))
    assert share_of(wear(gaps, years, seed()), *names) > 0.5


def test_two_snapshots_leave_the_laws_as_they_were_believed():
    # 2048 particles: a share of 0.3 has a standard error of 0.01.
    gaps = drawn([8e-4, 9e-4], 1e-6, np.random.default_rng(6))
    found = wear(gaps, YEARS[[0, 3]], seed(), limit_rad=LIMIT)
    for name, share in by_law(np.array([kind.probability for kind in KINDS])).items():
        assert share_of(found, name) == pytest.approx(share, abs=0.04)
    assert found.width_over_prior == pytest.approx(1.0, abs=0.1)


def test_more_dates_leave_less_of_the_forecast_to_what_was_believed():
    generator = np.random.default_rng(23)
    many = np.linspace(0.0, 3.0, 12)
    few, more = (
        wear(drawn(START + RATE * years, 1e-6, generator), years, seed(), limit_rad=LIMIT)
        for years in (YEARS, many)
    )
    assert more.width_over_prior < few.width_over_prior < 0.8


def test_a_limit_further_ahead_leaves_more_to_changes_that_nothing_shows():
    gaps = drawn(START + RATE * YEARS, 1e-6, np.random.default_rng(24))
    near, far = (wear(gaps, YEARS, seed(), limit_rad=limit) for limit in (1.2e-3, 2e-3))
    assert 0.05 < near.changes_ahead.mean() < far.changes_ahead.mean() < 1.0
    unchanged = far.years_to_limit.values[far.changes_ahead.values == 0.0]
    # Where nothing changes, a joint that was seen to wear evenly goes on to.
    assert np.median(unchanged) == pytest.approx((2e-3 - gaps[-1].mean()) / RATE, rel=0.15)


def test_wear_that_speeds_up_reaches_its_limit_before_the_straight_line():
    # 0.6 + 0.05 t + 0.07 t² mrad is 1.2 mrad after 2.592 years.
    years = np.linspace(0.0, 1.6, 6)
    gaps = 6e-4 + 5e-5 * years + 7e-5 * years**2
    found = wear(drawn(gaps, 3e-6, np.random.default_rng(7)), years, seed(), limit_rad=LIMIT)
    low, early, high = np.quantile(found.years_to_limit, [0.05, 0.1, 0.95])
    assert low < 2.592 - 1.6 < high
    assert early < 2.592 - 1.6
    line = (LIMIT - gaps[-1]) / (trend(drawn(gaps, 1e-9, np.random.default_rng(7)), years).mean())
    assert np.median(found.years_to_limit) < 0.9 * line


@pytest.mark.parametrize("sigma", [1e-6, 5e-5, 2e-4])
def test_path_and_present_gap_are_the_posterior_of_a_linear_system_solved_whole(sigma):
    # Unknown: gap at the first snapshot, growth, gap at each later snapshot; all normal.
    growth = np.array([0.0, 0.1, 0.45, 0.6, 1.0])
    sd = np.array([4e-5, 6e-5, 5e-5, 3e-5, 5e-5])
    measured = np.array([8e-4, 8.7e-4, 8.4e-4, 9.9e-4, 9.6e-4])
    generator = np.random.default_rng(17)
    count = 200_000
    draws = measured[:, None] + sd[:, None] * generator.standard_normal((5, count))
    steps = np.sqrt(np.diff(growth, prepend=0.0))[:, None]
    path = sigma * np.cumsum(steps * generator.standard_normal(draws.shape), axis=0)
    repeated = np.broadcast_to(growth[:, None], draws.shape)
    (first, rate), _ = _fit(draws - path, repeated, sd**2, np.full(count, sigma**2))
    current = first + rate + path[-1]

    seen = np.zeros((5, 6))
    seen[0, 0] = 1.0
    seen[1:, 2:] = np.eye(4)
    steps = np.zeros((4, 6))  # growth of each step less its share of the line
    for step in range(4):
        steps[step, step + 2] = 1.0
        steps[step, step + 1 if step else 0] = -1.0
        steps[step, 1] = -np.diff(growth)[step]
    weights = np.diag(1.0 / (sigma**2 * np.diff(growth)))
    precision = seen.T @ np.diag(sd**-2.0) @ seen + steps.T @ weights @ steps
    covariance = np.linalg.inv(precision)
    mean = covariance @ seen.T @ (measured / sd**2)
    for found, place in ((rate, 1), (current, 5)):
        spread = np.sqrt(covariance[place, place])
        # Five standard errors of 200000 draws: a false alarm in a million.
        assert abs(found.mean() - mean[place]) < 5.0 * spread / np.sqrt(count)
        assert abs(found.std() / spread - 1.0) < 5.0 / np.sqrt(2.0 * count)


def test_the_likelihood_of_a_law_is_that_of_normal_gaps_with_a_flat_prior_on_its_line():
    generator = np.random.default_rng(18)
    growth, own = np.sort(generator.uniform(size=(6, 3)), axis=0), generator.uniform(1.0, 2.0, 6)
    variance, gaps = np.array([0.0, 0.5, 4.0]), generator.normal(size=6)
    _, found = _fit(np.repeat(gaps[:, None], 3, axis=1), growth, own, variance)
    expected = []
    for number in range(3):
        walk = np.minimum.outer(growth[:, number], growth[:, number])
        flat = 1e3 * np.stack([np.ones(6), growth[:, number]])
        covariance = np.diag(own) + variance[number] * walk + flat.T @ flat
        expected.append(stats.multivariate_normal(cov=covariance).logpdf(gaps))
    np.testing.assert_allclose(np.diff(found), np.diff(expected), rtol=1e-3)


def test_forecasts_agree_with_an_independent_sampler_of_the_gamma_process_itself():
    # Importance sampling from the prior, increments drawn as the gamma process has them; what is
    # compared is the past as a normal walk, and tempering: to 10 % of each time.
    years, limit = np.array([0.0, 1.0, 2.2, 3.0]), 1.3e-3
    means, sd = np.array([8.0e-4, 8.4e-4, 9.3e-4, 1.0e-3]), 1.5e-5
    generator = np.random.default_rng(19)
    count = 1_000_000
    draws = means[:, None, None] + sd * generator.standard_normal((4, 2, 4000))
    found = wear(draws, years, seed(), limit_rad=limit)

    laws = Laws.until_now(generator.standard_normal((NORMALS, count)))
    growth = generator.uniform(0.0, 6e-4, count)
    scale = trend(draws, years / 3.0).mean()
    sigma = scale * SCATTER[0] * (SCATTER[1] / SCATTER[0]) ** generator.uniform(size=count)
    jump = sigma**2 / growth
    gap = means[0] + sd * generator.standard_normal(count)  # the likelihood of the first date
    log_weight = np.where(sigma < SCATTER[1] * growth, 0.0, -np.inf)
    before = np.zeros(count)
    for elapsed, mean in zip(years[1:] / 3.0, means[1:], strict=True):
        mean_growth = growth * laws.grown(np.asarray(elapsed))
        gap = gap + jump * generator.gamma((mean_growth - before) / jump)
        before = mean_growth
        log_weight = log_weight - 0.5 * ((gap - mean) / sd) ** 2
    weight = np.exp(log_weight - log_weight.max())
    chosen = generator.choice(count, 8000, p=weight / weight.sum())
    assert weight.sum() ** 2 / np.sum(weight**2) > 1000.0
    growth, jump, gap = (x[chosen] for x in (growth, jump, gap))
    laws = Laws(laws.rows[:, chosen]).and_ahead(generator)
    needed = _growth_needed(limit - gap, jump, generator)
    times = 3.0 * (laws.time_of(1.0 + needed / growth, 1e3) - 1.0)
    levels = [0.05, 0.1, 0.5, 0.75]
    ours, theirs = np.quantile(found.years_to_limit, levels), np.quantile(times, levels)
    np.testing.assert_allclose(ours, theirs, rtol=0.1)
    for name, share in shares(laws.kind()).items():
        assert share_of(found, name) == pytest.approx(share, abs=0.06)


def test_the_time_to_a_limit_is_the_first_passage_of_a_gamma_process():
    # The share of processes at or beyond the limit by their drawn growth is uniform.
    generator = np.random.default_rng(20)
    distance, jump = np.full(4000, 3.0), np.repeat([0.01, 0.3, 1.0, 20.0], 1000)
    needed = _growth_needed(distance, jump, generator)
    for of in np.split(np.arange(4000), 4):
        passed = stats.gamma.sf(distance[of], needed[of] / jump[of], scale=jump[of])
        assert uniform_p(passed) > 1e-3 / 4.0, "false alarm 1 in 1000"
    assert np.all(_growth_needed(-distance, jump, generator) == 0.0)
    smooth = _growth_needed(distance, np.full(4000, 1e-9), generator)
    np.testing.assert_allclose(smooth, distance)


def test_every_law_grows_from_zero_to_one_and_never_falls():
    generator = np.random.default_rng(21)
    laws = Laws.until_now(generator.standard_normal((NORMALS, 2000))).and_ahead(generator)
    elapsed = np.r_[np.linspace(0.0, 1.0, 11), 2.0, 10.0, 1e3]
    path = laws.grown(elapsed[:, None])
    np.testing.assert_allclose(path[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(path[10], 1.0)
    assert np.all(np.diff(path, axis=0) >= 0.0)
    later = laws.grown(np.asarray(1.7))
    np.testing.assert_allclose(laws.time_of(later, 1e4), 1.7, rtol=1e-6)


def test_growth_is_the_integral_of_a_rate_that_is_a_power_of_age_until_it_changes():
    # Age 1 at the first date; the rate is multiplied by 3 at 1.5 spans and falls as 1/age then.
    start = np.log(2.5)
    laws = Laws(np.array([[1.0], [0.0], [start], [2.0], [1e-9], [1.0], [3.0]]))
    elapsed = np.linspace(0.0, 4.0, 400_001)
    age = 1.0 + elapsed
    rate = np.where(elapsed < 1.5, age, 3.0 * 2.5 * 2.5 / age)
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(elapsed)
    growth = np.r_[0.0, np.cumsum(steps)] / 1.5
    np.testing.assert_allclose(laws.grown(elapsed[:, None])[:, 0], growth, atol=1e-4)


def test_changes_ahead_come_as_often_as_stated():
    generator = np.random.default_rng(25)
    laws = Laws.until_now(generator.standard_normal((NORMALS, 20_000)), age=1.0)
    # From an age of 2 to 2e spans, one e-folding; five standard errors.
    share = laws.and_ahead(generator).changes_before(np.asarray(2.0 * np.e - 1.0)).mean()
    assert share == pytest.approx(-np.expm1(-HAZARD), abs=5.0 * 0.5 / 20_000**0.5)


def test_an_age_that_is_known_is_used():
    # Old joints that wear as a power of age wear nearly steadily; new ones speed up.
    gaps = drawn(START + RATE * YEARS[[0, 3]], 1e-6, np.random.default_rng(22))
    late = [
        np.quantile(
            wear(gaps, YEARS[[0, 3]], seed(), limit_rad=2e-3, age_years=age).years_to_limit, 0.3
        )
        for age in (0.0, 40.0)
    ]
    assert late[0] < 0.9 * late[1]


def test_time_has_no_unit_of_its_own():
    gaps = drawn(START + RATE * YEARS, 1e-5, np.random.default_rng(7))
    found = wear(gaps, YEARS, seed(), limit_rad=LIMIT)
    shifted = wear(gaps, YEARS + 64.0, seed(), limit_rad=LIMIT)
    doubled = wear(gaps, 2.0 * YEARS, seed(), limit_rad=LIMIT)
    for name in set(found) - {"years_to_limit"}:
        factor = {
            "rate_now_rad_per_year": 0.5,
            "trend_rad_per_year": 0.5,
            "scatter_rad_per_root_year": 0.5**0.5,
        }.get(name, 1.0)
        np.testing.assert_allclose(shifted[name], found[name], rtol=1e-9)
        np.testing.assert_allclose(doubled[name], factor * found[name], rtol=1e-9)
    within = found.years_to_limit.values < 0.5 * LONGEST_YEARS
    for other, factor in ((shifted, 1.0), (doubled, 2.0)):
        np.testing.assert_allclose(
            other.years_to_limit.values[within],
            factor * found.years_to_limit.values[within],
            rtol=1e-6,
            atol=1e-9,
        )


def test_gaps_of_another_unit_wear_in_that_unit():
    gaps = drawn(START + RATE * YEARS, 1e-5, np.random.default_rng(8))
    rad = wear(gaps, YEARS, seed(), limit_rad=LIMIT)
    other = wear(1024.0 * gaps, YEARS, seed(), limit_rad=1024.0 * LIMIT)
    np.testing.assert_allclose(other.rate_now_rad_per_year, 1024.0 * rad.rate_now_rad_per_year)
    np.testing.assert_allclose(other.years_to_limit, rad.years_to_limit, rtol=1e-6)


def test_what_snapshots_share_widens_the_rate_by_its_factor_alone():
    # A curve off by 10 % leaves 10 % of the rate; independent intervals would leave many times
    # that of the gaps themselves.
    generator = np.random.default_rng(9)
    years = YEARS[:3]
    mixed = drawn(START + RATE * years, 1e-7, generator, shared=0.1, draws=4000)
    shared = mean_rate(wear(mixed, years, seed()), years)
    assert shared.std() / shared.mean() == pytest.approx(0.1, rel=0.1)
    alone = np.stack([generator.permutation(g.ravel()).reshape(g.shape) for g in mixed])
    assert mean_rate(wear(alone, years, seed()), years).std() > 2.5 * shared.std()


def test_without_wear_an_increase_is_as_likely_as_not_and_rarely_reported():
    # Binomial: 400 cases, 5 % nominal; more than 34 false alarms in 1 of 1000 tests.
    generator = np.random.default_rng(10)
    years = YEARS[:3]
    probabilities = [
        float(np.mean(trend(drawn(np.full(3, START), 1e-5, generator), years) > 0.0))
        for _ in range(400)
    ]
    assert uniform_p(probabilities) > 1e-3, "false alarm 1 in 1000"
    assert np.sum(np.array(probabilities) >= 0.95) <= stats.binom.ppf(0.999, 400, 0.05)


def test_no_draw_heals_so_that_a_rate_is_no_sign_of_wear():
    gaps = drawn(np.full(3, START), 1e-5, np.random.default_rng(11))
    found = wear(gaps, YEARS[:3], seed(), limit_rad=LIMIT)
    assert np.all(found.current_rad > found.first_rad)
    assert np.all(found.expected_growth_rad > 0.0)
    assert np.all(found.rate_now_rad_per_year > 0.0)
    shrunk = drawn(START - RATE * YEARS[:3], 1e-6, np.random.default_rng(11))
    assert wear(shrunk, YEARS[:3], seed()) is None


def test_gaps_that_never_fell_are_rarely_said_to_have_fallen():
    # At most 1 in 100 of 1000 cases without wear; more than 21 in 1 of 1000 tests.
    generator = np.random.default_rng(12)
    found = [fall(drawn(np.full(5, START), 1e-5, generator, shared=0.1)) for _ in range(1000)]
    assert sum(each is not None for each in found) <= stats.binom.ppf(0.999, 1000, 0.01)


@pytest.mark.parametrize("shared", [0.0, 0.1])
def test_a_fall_is_named_with_its_size(shared):
    gaps = START + RATE * YEARS
    gaps[3:] -= 2.5e-4
    found = fall(drawn(gaps, 4e-6, np.random.default_rng(13), shared=shared))
    assert found is not None
    snapshot, fall_rad, deviations = found
    assert snapshot == 3
    # False alarm 1 in 10^4.
    expected = gaps[2] - gaps[3]
    assert abs(fall_rad - expected) < 3.9 * fall_rad / deviations


def test_a_limit_that_is_passed_is_reached_in_no_time():
    for years in (YEARS[:2], YEARS):
        gaps = drawn(LIMIT + 2e-4 + RATE * years, 1e-6, np.random.default_rng(12))
        found = wear(gaps, years, seed(), limit_rad=LIMIT)
        assert np.all(found.years_to_limit == 0.0)


def test_a_joint_that_hardly_wears_reaches_its_limit_late_but_at_a_finite_time():
    gaps = drawn([START, START + 1e-12], 1e-13, np.random.default_rng(13))
    found = wear(gaps, np.array([0.0, 1.0]), seed(), limit_rad=LIMIT)
    assert np.median(found.years_to_limit) == LONGEST_YEARS


def test_the_probability_of_passing_the_limit_only_grows_with_the_date():
    gaps = drawn(START + RATE * YEARS, 1e-5, np.random.default_rng(14))
    found = wear(gaps, YEARS, seed(), limit_rad=LIMIT)
    within = [float(np.mean(found.years_to_limit <= t)) for t in (0.0, 0.5, 1.0, 2.0, 1e4)]
    assert within == sorted(within)
    assert within[-1] == 1.0


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


# From dated snapshots to the answer


def compared(
    tmp_path, gaps, days, *, repaired=(), limit=None, before=None, withheld=(), sd=1e-5, number=1,
    known=None,
):  # fmt: skip
    """The tree of a comparison as far as wear needs it, with its summary."""
    (tmp_path / "r.csv").touch()
    names = [f"s{n}" for n in range(len(gaps))]
    start = date(2024, 1, 31)
    config = CompareConfig.model_validate(
        {
            "schema": 1,
            "kind": "compare",
            "run": {"output": str(tmp_path / "out")},
            "joint": {"limit_rad": limit, "decide_before": before},
            "wear": known or {},
            "recordings": [
                {
                    "name": name,
                    "file": str(tmp_path / "r.csv"),
                    "date": start + timedelta(days=day),
                    "repaired": n in repaired,
                }
                for n, (name, day) in enumerate(zip(names, days, strict=True))
            ],
        }
    )
    draws = drawn(gaps, sd, np.random.default_rng(number))
    withheld_by = (Reason("no_baseline"),)
    measured = [
        Answer(name, delta_rad, withheld_by if name in withheld else ())
        for name, delta_rad in zip(names, draws, strict=True)
    ]
    group, reason = wear_of(config, measured, seed(number))
    assert group is not None
    posterior = xr.Dataset(
        {"delta_rad": (("snapshot", "chain", "draw"), draws)}, {"snapshot": names}
    )
    tree = stored_comparison(names, {"amplitude": {"posterior": posterior}}, withheld, wear=group)
    if limit is not None:
        tree.attrs["limit_rad"] = limit
    found = summarise_wear(group, names, config.interval, limit)
    return tree, found | {"reason": None if reason is None else with_sentences(reason.stored)}


def told(found, count):
    console = Console(file=io.StringIO(), width=80, highlight=False, markup=False)
    snapshots = [{"budget": {"noise": 1.0}}] * count
    summary = {"kind": "compare", "snapshots": snapshots, "same_joint": {"blind_spots": []}}
    print_blocks(blocks(summary, found), console)
    return " ".join(console.file.getvalue().split())


def test_dates_and_years_agree():
    first = date(2026, 3, 1)
    assert years_between(first, date.fromisoformat(date_after(first, 2.5))) == pytest.approx(
        2.5, abs=0.5 / 365.25
    )
    assert date_after(first, LONGEST_YEARS) is None


def test_gaps_from_before_a_repair_change_nothing(tmp_path):
    # Seven snapshots and the last three alone, from the same draws.
    gaps, days = [7e-4, 8e-4, 9e-4, 11e-4, 6e-4, 7e-4, 8e-4], [0, 9, 90, 200, 300, 500, 600]
    _, found = compared(tmp_path, gaps, days, repaired=(1, 4), limit=LIMIT)
    assert found["snapshots"] == ["s4", "s5", "s6"]
    draws = drawn(gaps, 1e-5, np.random.default_rng(1))[4:]
    wear_seed = seed(1).spawn(2)[1]
    alone = wear(draws, np.array([300, 500, 600]) / 365.25, wear_seed, limit_rad=LIMIT)
    rates = mean_rate(alone, np.array([300, 600]) / 365.25)
    assert found["rate"]["median"] == pytest.approx(np.median(rates), rel=1e-9)
    times = np.median(alone.years_to_limit)
    assert found["years_to_limit"]["median"] == pytest.approx(times, rel=1e-9)


def test_the_summary_says_one_thing_in_years_and_dates(tmp_path):
    before = date(2026, 6, 1)
    tree, found = compared(
        tmp_path, START + RATE * np.arange(3), [0, 365, 731], limit=LIMIT, before=before
    )
    last = date.fromisoformat(found["last_date"])
    for edge in ("low", "median", "high"):
        day = date.fromisoformat(found["date_of_limit"][edge])
        assert years_between(last, day) == pytest.approx(
            found["years_to_limit"][edge], abs=1.0 / 365.25
        )
    not_before = date.fromisoformat(found["not_before"]["date"])
    group = tree["wear"].to_dataset()
    assert reached(group, np.array([years_between(last, not_before)]))[0] == pytest.approx(
        0.1, abs=0.02
    )
    asked = reached(group, np.array([years_between(last, before)]))[0]
    assert found["probability_before"]["probability"] == pytest.approx(asked)
    assert found["not_before"]["level"] == 0.9
    assert found["probability_before"]["date"] == "2026-06-01"
    assert sum(found["law"].values()) == pytest.approx(1.0)
    assert set(found["law"]) == set(LAWS_IN_WORDS)
    assert found["rate"]["unit"] == "rad/year"
    assert found["rate_at_most_rad_per_year"] < found["rate"]["high"]
    assert found["scatter_rad_per_root_year"] is None


def test_a_rate_is_withheld_with_its_reason(tmp_path):
    cases = [
        ({"gaps": [8e-4, 9e-4, 6e-4], "days": [0, 9, 99], "repaired": (2,)}, "only one snapshot"),
        ({"gaps": [8e-4, 9e-4], "days": [5, 5]}, "snapshots of one day"),
        ({"gaps": [9e-4, 6e-4], "days": [0, 99]}, "cannot shrink a gap"),
        ({"gaps": [8e-4, 9e-4], "days": [0, 99], "withheld": ("s1",)}, "withheld for s1"),
    ]
    for options, reason in cases:
        tree, found = compared(tmp_path, **options, limit=LIMIT)
        assert reason in found["reason"]["text"]
        assert found["rate"] is found["years_to_limit"] is None
        assert reason in told(found, len(options["gaps"]))
        assert wear_figure(tree).axes


def test_the_answer_is_told_with_what_few_snapshots_cannot_tell(tmp_path):
    _, two = compared(tmp_path, [8e-4, 9e-4], [0, 365], limit=LIMIT, before=date(2026, 1, 1))
    text = told(two, 2)
    assert f"does not reach the limit of 1.2 mrad before {two['not_before']['date']}" in text
    assert "by 2026-01-01" in text
    assert "Two snapshots cannot show whether wear is steady" in text
    _, three = compared(tmp_path, START + RATE * np.arange(3), [0, 365, 731])
    assert "cannot distinguish irregular wear" in told(three, 3)
    assert "limit" not in told(three, 3)
    _, five = compared(tmp_path, START + RATE * np.arange(5), [0, 365, 731, 1096, 1461])
    assert "irregular wear" in told(five, 5)
    assert "cannot distinguish" not in told(five, 5)
    assert 'repaired before "s0"' in told(five, 6)


def test_a_gap_that_fell_has_no_rate_and_no_date(tmp_path):
    days = [0, 200, 400, 600]
    gaps = [START + 1e-4 * day / 365.25 for day in days]
    risen = compared(tmp_path, gaps, days, limit=LIMIT)[1]
    assert risen["reason"] is None
    gaps[2] -= 1e-4
    fell = compared(tmp_path, gaps, days, limit=LIMIT)[1]
    assert re.search(
        r"s2 is 0\.\d+ mrad below the snapshot before it \(\d+\.\d standard",
        fell["reason"]["text"],
    )
    assert fell["rate"] is None
    assert fell["date_of_limit"] is None


def test_what_drifts_from_date_to_date_widens_the_answer_and_is_told(tmp_path):
    gaps, days = START + RATE * np.arange(4), [0, 365, 731, 1096]
    steady = compared(tmp_path, gaps, days, limit=LIMIT)[1]
    moved = compared(tmp_path, gaps, days, limit=LIMIT, known={"relative_sd_per_date": 0.05})[1]
    assert steady["drift_widens"] is None
    # 5 % of some 0.95 mrad against 0.01 mrad.
    assert moved["drift_widens"] == pytest.approx(np.hypot(1.0, 4.75), rel=0.15)
    for key in ("rate", "years_to_limit"):
        assert moved[key]["high"] - moved[key]["low"] > steady[key]["high"] - steady[key]["low"]
    assert "by 5 % from date to date" in told(moved, 4)
    assert "Temperature" not in told(steady, 4)


def test_a_passed_limit_and_one_far_ahead_are_told_so(tmp_path):
    _, passed = compared(tmp_path, [1.3e-3, 1.4e-3], [0, 365], limit=LIMIT)
    assert passed["years_to_limit"]["high"] == 0.0
    last = passed["last_date"]
    assert f"The gap passed the limit of 1.2 mrad before {last}." in told(passed, 2)
    assert re.search(rf"date of the limit +before {last} +before {last} Rate", told(passed, 2))
    assert "years" not in told(passed, 2)
    _, far = compared(tmp_path, [8e-4, 8e-4 + 1e-9], [0, 200 * 365], limit=0.05, sd=1e-10)
    assert far["not_before"]["date"] is None
    assert "within 1000 years" in told(far, 2)
    assert "far ahead" in told(far, 2)


def test_a_limit_that_may_have_been_passed_before_is_never_said_to_lie_ahead(tmp_path):
    tree, found = compared(tmp_path, [1e-3, 1.1e-3, 1.2e-3], [0, 365, 730], limit=LIMIT)
    last = found["last_date"]
    assert 0.0 == found["years_to_limit"]["low"] < found["years_to_limit"]["high"]
    text = told(found, 3)
    assert f"may have passed the limit of 1.2 mrad before {last}" in text
    assert "does not reach" not in text
    assert f"before {last} to {found['date_of_limit']['high']}" in text
    legend = wear_figure(tree).axes[1].get_legend()
    shown = [item.get_text() for item in legend.get_texts()]
    assert re.fullmatch(rf"passed before {last}: \d+ %", shown[0])


def test_the_figure_shows_dates_line_and_limit_as_stored(tmp_path):
    days = [0, 365, 400, 765, 1130]
    tree, _ = compared(
        tmp_path, [8e-4, 1e-3, 5e-4, 6e-4, 7e-4], days, repaired=(2,), limit=1e-3,
        before=date(2029, 1, 1),
    )  # fmt: skip
    figure = wear_figure(tree)
    gaps, limit = figure.axes
    drawn_days = sorted(
        float(c.lines[0].get_xdata()[0]) for c in gaps.containers if hasattr(c, "lines")
    )
    first = (date(2024, 1, 31) - date(1970, 1, 1)).days
    assert drawn_days == [first + day for day in days]
    group = tree["wear"].to_dataset()
    (line,) = [item for item in gaps.lines if item.get_label() == "path, median"]
    assert line.get_xdata()[0] == first + 400, "the path starts at the repair"
    ahead = (line.get_xdata() - first - 1130) / 365.25
    np.testing.assert_allclose(line.get_ydata(), 1e3 * path_band(group, ahead, 0.9)[1])
    curve = limit.lines[0].get_ydata()
    assert np.all(np.diff(curve) >= 0.0)
    assert len(save(figure, tmp_path / "figures", "wear", ("png",))) == 1
