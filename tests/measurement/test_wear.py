"""Laws of wear in time: rates are recovered, dates have no origin, wear does not heal."""

from __future__ import annotations

import io
import json
import re
from dataclasses import asdict
from datetime import date, timedelta

import numpy as np
import pytest
import xarray as xr
from rich.console import Console
from scipy import stats

from bayesbl.config.measurement import CompareConfig
from bayesbl.measurement.dated_wear import date_after, summarise_wear, wear_of, years_between
from bayesbl.measurement.measurement import Snapshot
from bayesbl.measurement.verdict import Verdict
from bayesbl.measurement.wear import (
    LONGEST_YEARS,
    _lines,
    probability_before,
    since_repair,
    straightness,
    wear,
)
from bayesbl.presentation.figures.style import save
from bayesbl.presentation.figures.wear import line_band, reached
from bayesbl.presentation.figures.wear import wear as wear_figure
from bayesbl.presentation.terminal import print_blocks
from bayesbl.presentation.wear import blocks

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
    for number in range(200):
        found = wear(drawn(START + RATE * years, 2e-5, generator), years, seed(number))
        rates.append(rank(RATE, found.rate_rad_per_year))
        currents.append(rank(START + RATE * years[-1], found.current_rad))
    for ranks in (np.array(rates), np.array(currents)):
        if years.size < 4:
            assert uniform_p(ranks) > 1e-3
        assert abs(np.mean(ranks > 0.5) - 0.5) < 3.3 * 0.5 / np.sqrt(ranks.size)
        # 200 cases cover with a standard deviation of 2.1 %.
        assert np.mean(np.abs(ranks - 0.5) < 0.45) > 0.9 - 3.1 * 0.0212


@pytest.mark.parametrize("shared", [0.0, 0.1])
def test_irregular_wear_is_covered_and_found(shared):
    # A curve that is 10 % off hides none of it: its factor is common to all snapshots.
    generator = np.random.default_rng(4)
    years, sigma = np.linspace(0.0, 4.0, 9), 1e-4
    rates, currents, relative, widths = [], [], [], []
    for number in range(150):
        walk = np.cumsum(sigma * np.sqrt(np.diff(years, prepend=0.0)) * generator.normal(size=9))
        gaps = 1e-3 + RATE * years + walk
        found = wear(drawn(gaps, 1e-5, generator, shared=shared), years, seed(number))
        rates.append(rank(RATE, found.rate_rad_per_year))
        currents.append(rank(gaps[-1], found.current_rad))
        relative.append(np.median(found.scatter_rad_per_root_year) / sigma)
        widths.append(found.current_rad.std() / gaps[-1])
    assert 0.8 < np.median(relative) < 1.25
    if not shared:
        assert uniform_p(rates) > 1e-3, "false alarm 1 in 1000"
        assert uniform_p(currents) > 1e-3, "false alarm 1 in 1000"
        # The present gap was measured: to 1e-5 rad of some 1.4e-3, however irregular the wear.
        assert np.median(widths) < 1.2 * 1e-5 / 1.4e-3
    calm = wear(drawn(1e-3 + RATE * years, 1e-5, generator, shared=shared), years, seed(9))
    assert np.median(calm.scatter_rad_per_root_year) < 0.2 * sigma


@pytest.mark.parametrize("sigma", [1e-6, 5e-5, 2e-4])
def test_line_and_present_gap_are_the_posterior_of_a_linear_system_solved_whole(sigma):
    # Unknown: gap at the first snapshot, growth, gap at each later snapshot; all normal.
    elapsed = np.array([0.0, 0.1, 0.45, 0.6, 1.0])
    sd = np.array([4e-5, 6e-5, 5e-5, 3e-5, 5e-5])
    measured = np.array([8e-4, 8.7e-4, 8.4e-4, 9.9e-4, 9.6e-4])
    generator = np.random.default_rng(17)
    count = 200_000
    draws = measured[:, None] + sd[:, None] * generator.standard_normal((5, count))
    rate, current = _lines(draws, sd**2, elapsed, np.full(count, sigma), generator)

    seen = np.zeros((5, 6))
    seen[0, 0] = 1.0
    seen[1:, 2:] = np.eye(4)
    steps = np.zeros((4, 6))  # growth of each step less its share of the line
    for step in range(4):
        steps[step, step + 2] = 1.0
        steps[step, step + 1 if step else 0] = -1.0
        steps[step, 1] = -np.diff(elapsed)[step]
    weights = np.diag(1.0 / (sigma**2 * np.diff(elapsed)))
    precision = seen.T @ np.diag(sd**-2.0) @ seen + steps.T @ weights @ steps
    covariance = np.linalg.inv(precision)
    mean = covariance @ seen.T @ (measured / sd**2)
    for found, place in ((rate, 1), (current, 5)):
        spread = np.sqrt(covariance[place, place])
        # Five standard errors of 200000 draws: a false alarm in a million.
        assert abs(found.mean() - mean[place]) < 5.0 * spread / np.sqrt(count)
        assert abs(found.std() / spread - 1.0) < 5.0 / np.sqrt(2.0 * count)


@pytest.mark.parametrize("shared", [0.0, 0.1])
@pytest.mark.parametrize("count", [3, 5])
def test_gaps_on_a_line_are_called_bent_as_rarely_as_said(count, shared):
    # The probabilities are uniform; false alarm of this test 1 in 1000. A curve that is 10 % off
    # for all snapshots bends nothing.
    generator = np.random.default_rng(8)
    gaps = START + RATE * YEARS[:count]
    found = [
        straightness(drawn(gaps, 2e-5, generator, shared=shared), YEARS[:count]) for _ in range(400)
    ]
    assert uniform_p([line.probability for line in found]) > 1e-3


@pytest.mark.parametrize("count", [3, 5])
@pytest.mark.parametrize("excess", [9e-5, -9e-5])
def test_a_gap_off_the_line_is_named_with_its_excess(count, excess):
    gaps = START + RATE * YEARS[:count]
    gaps[1] += excess
    line = straightness(drawn(gaps, 4e-6, np.random.default_rng(9)), YEARS[:count])
    assert not line.is_straight
    assert line.snapshot == 1
    # Both the gap's and the line's own error, with a false alarm of 1 in 10^4.
    assert abs(line.excess_rad - excess) < 3.9 * abs(line.excess_rad) / line.standard_deviations
    assert line.standard_deviations > 10.0


def test_three_gaps_are_off_by_the_middle_one_from_its_neighbours_line():
    gaps = drawn([8e-4, 1.1e-3, 1e-3], 1e-5, np.random.default_rng(10), draws=4000)
    years = np.array([0.0, 0.25, 1.0])
    line = straightness(gaps, years)
    bend = gaps[1] - 0.75 * gaps[0] - 0.25 * gaps[2]
    assert line.excess_rad == pytest.approx(bend.mean(), rel=1e-9)
    z = abs(bend.mean()) / bend.std(ddof=1)
    assert line.standard_deviations == pytest.approx(z, rel=1e-6)
    assert line.probability == pytest.approx(2.0 * stats.norm.sf(z), rel=1e-6)


def test_two_snapshots_or_two_days_are_always_straight():
    assert straightness(drawn([8e-4, 1e-3], 1e-5, np.random.default_rng(1)), YEARS[:2]) is None
    three = drawn([8e-4, 1e-3, 1.2e-3], 1e-5, np.random.default_rng(1))
    assert straightness(three, np.array([0.0, 1.0, 1.0])) is None


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


@pytest.mark.parametrize("rate", [1e-6, 1e-4, 1e-3])
def test_times_of_irregular_wear_are_first_passages_of_a_walk_with_drift(rate):
    # SciPy's inverse Gaussian of each draw's own distance, rate and scatter turns its time into
    # a uniform number; false alarm 1 in 1000.
    generator = np.random.default_rng(15)
    years = np.linspace(0.0, 4.0, 9)
    steps = rate * 0.5 + 1e-4 * np.sqrt(0.5) * generator.standard_normal(8)
    gaps = 8e-4 + np.r_[0.0, np.cumsum(steps)]
    limit = gaps[-1] + 3e-4
    found = wear(drawn(gaps, 1e-5, generator, draws=4000), years, seed(), limit_rad=limit)
    keep = ~found.heals & (found.scatter_rad_per_root_year > 1e-6)
    r, s = found.rate_rad_per_year[keep], found.scatter_rad_per_root_year[keep]
    distance, times = limit - found.current_rad[keep], found.years_to_limit[keep]
    shape = (distance / s) ** 2
    cut = times == LONGEST_YEARS
    share = stats.invgauss.cdf(times, distance / r / shape, scale=shape)
    last = stats.invgauss.cdf(LONGEST_YEARS, distance / r / shape, scale=shape)
    share[cut] = generator.uniform(last[cut], 1.0)
    assert np.count_nonzero(keep) > 1000
    assert uniform_p(share) > 1e-3


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
    tmp_path, gaps, days, *, repaired=(), limit=None, before=None, withheld=(), sd=1e-5, number=1
):
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
    verdicts = {
        n: Verdict("withheld", ("Withheld.",), "Withheld.")
        if n in withheld
        else Verdict("converged", (), None)
        for n in names
    }
    measured = [
        Snapshot(name, delta_rad, verdicts[name], {})
        for name, delta_rad in zip(names, draws, strict=True)
    ]
    group = wear_of(config, measured, seed(number))
    assert group is not None
    posterior = xr.Dataset(
        {"delta_rad": (("snapshot", "chain", "draw"), draws)}, {"snapshot": names}
    )
    tree = xr.DataTree.from_dict(
        {
            "posterior": posterior,
            "diagnostics": xr.Dataset(),
            "curve": xr.Dataset(attrs={"name": "published"}),
            "wear": group,
        }
    )
    stored = {name: asdict(verdict) for name, verdict in verdicts.items()}
    tree["diagnostics"].attrs = {"verdicts": json.dumps(stored)}
    tree.attrs = {"kind": "compare", "interval_level": 0.9, "interval_kind": "equal_tailed"}
    if limit is not None:
        tree.attrs["limit_rad"] = limit
    return tree, summarise_wear(tree, names)


def told(found, count):
    console = Console(file=io.StringIO(), width=80, highlight=False, markup=False)
    print_blocks(blocks({"wear": found, "snapshots": [None] * count}), console)
    return " ".join(console.file.getvalue().split())


def test_dates_and_years_agree():
    first = date(2026, 3, 1)
    assert years_between(first, date_after(first, 2.5)) == pytest.approx(2.5, abs=0.5 / 365.25)
    assert date_after(first, LONGEST_YEARS) is None


def test_gaps_from_before_a_repair_change_nothing(tmp_path):
    # Seven snapshots and the last three alone, from the same draws.
    gaps, days = [7e-4, 8e-4, 9e-4, 11e-4, 6e-4, 7e-4, 8e-4], [0, 9, 90, 200, 300, 500, 600]
    _, found = compared(tmp_path, gaps, days, repaired=(1, 4), limit=LIMIT)
    assert found["snapshots"] == ["s4", "s5", "s6"]
    draws = drawn(gaps, 1e-5, np.random.default_rng(1))[4:]
    alone = wear(draws, np.array([300, 500, 600]) / 365.25, seed(1), limit_rad=LIMIT)
    rates = alone.rate_rad_per_year[~alone.heals]
    assert found["rate_rad_per_year"]["median"] == pytest.approx(np.median(rates), rel=1e-9)
    times = np.nanmedian(alone.years_to_limit)
    assert found["years_to_limit"]["median"] == pytest.approx(times, rel=1e-9)


def test_the_summary_says_one_thing_in_years_and_dates(tmp_path):
    before = date(2026, 6, 1)
    tree, found = compared(
        tmp_path, START + RATE * np.arange(3), [0, 365, 731], limit=LIMIT, before=before
    )
    last = date.fromisoformat(found["last_date"])
    for edge in ("low", "median", "high"):
        day = date.fromisoformat(found["limit_date"][edge])
        assert years_between(last, day) == pytest.approx(
            found["years_to_limit"][edge], abs=1.0 / 365.25
        )
    not_before = date.fromisoformat(found["limit_not_before"])
    group = tree["wear"].to_dataset()
    assert reached(group, np.array([years_between(last, not_before)]))[0] == pytest.approx(
        0.1, abs=0.02
    )
    asked = reached(group, np.array([years_between(last, before)]))[0]
    assert found["probability_limit_before"] == pytest.approx(asked)
    assert found["rate_at_most_rad_per_year"] < found["rate_rad_per_year"]["high"]
    assert found["scatter_rad_per_root_year"] is None


def test_a_rate_is_withheld_with_its_reason(tmp_path):
    cases = [
        ({"gaps": [8e-4, 9e-4, 6e-4], "days": [0, 9, 99], "repaired": (2,)}, "only one snapshot"),
        ({"gaps": [8e-4, 9e-4], "days": [5, 5]}, "snapshots of one day"),
        ({"gaps": [9e-4, 6e-4], "days": [0, 99]}, "does not heal"),
        ({"gaps": [8e-4, 9e-4], "days": [0, 99], "withheld": ("s1",)}, "withheld for s1"),
    ]
    for options, reason in cases:
        tree, found = compared(tmp_path, **options, limit=LIMIT)
        assert reason in found["reason"]
        assert found["rate_rad_per_year"] is found["years_to_limit"] is None
        assert reason in told(found, len(options["gaps"]))
        assert wear_figure(tree).axes


def test_the_answer_is_told_with_what_few_snapshots_cannot_tell(tmp_path):
    _, two = compared(tmp_path, [8e-4, 9e-4], [0, 365], limit=LIMIT, before=date(2026, 1, 1))
    text = told(two, 2)
    assert f"does not reach the limit of 1.2 mrad before {two['limit_not_before']}" in text
    assert "by 2026-01-01" in text
    assert "Two snapshots cannot show whether wear is steady" in text
    _, three = compared(tmp_path, START + RATE * np.arange(3), [0, 365, 731])
    assert "cannot tell irregular wear" in told(three, 3)
    assert "limit" not in told(three, 3)
    _, five = compared(tmp_path, START + RATE * np.arange(5), [0, 365, 731, 1096, 1461])
    assert "irregular wear" in told(five, 5)
    assert "cannot tell" not in told(five, 5)
    assert 'repaired before "s0"' in told(five, 6)


@pytest.mark.parametrize("count", [3, 5])
def test_gaps_off_a_line_are_told_where_the_date_stands(count, tmp_path):
    days = [0, 200, 400, 600, 800][:count]
    gaps = [START + 1e-4 * day / 365.25 for day in days]
    told_straight = compared(tmp_path, gaps, days, limit=LIMIT)[1]
    assert told_straight["line"]["is_straight"]
    assert "straight line" not in told(told_straight, count)
    gaps[1] += 9e-5
    bent = compared(tmp_path, gaps, days, limit=LIMIT)[1]
    assert bent["line"]["snapshot"] == "s1"
    text = told(bent, count)
    assert re.search(r"\(s1 lies 0\.\d+ mrad above that of the others, \d+\.\d standard", text)
    assert ("do not rely on" in text) == (count == 3)
    assert ("allow for irregular wear" in text) == (count == 5)


def test_a_passed_limit_and_one_far_ahead_are_told_so(tmp_path):
    _, passed = compared(tmp_path, [1.3e-3, 1.4e-3], [0, 365], limit=LIMIT)
    assert passed["years_to_limit"]["high"] == 0.0
    last = passed["last_date"]
    assert f"The gap passed the limit of 1.2 mrad before {last}." in told(passed, 2)
    assert re.search(rf"date of the limit +before {last} +before {last} Wear", told(passed, 2))
    assert "years" not in told(passed, 2)
    _, far = compared(tmp_path, [8e-4, 8e-4 + 1e-9], [0, 365], limit=0.05, sd=1e-10)
    assert far["limit_not_before"] is None
    assert "within 1000 years" in told(far, 2)
    assert "far ahead" in told(far, 2)


def test_a_limit_that_may_have_been_passed_before_is_never_said_to_lie_ahead(tmp_path):
    tree, found = compared(tmp_path, [1e-3, 1.1e-3, 1.2e-3], [0, 365, 730], limit=LIMIT)
    last = found["last_date"]
    assert 0.0 == found["years_to_limit"]["low"] < found["years_to_limit"]["high"]
    text = told(found, 3)
    assert f"may have passed the limit of 1.2 mrad before {last}" in text
    assert "does not reach" not in text
    assert f"before {last} to {found['limit_date']['high']}" in text
    shown = [item.get_text() for item in wear_figure(tree).axes[1].texts]
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
    (line,) = [item for item in gaps.lines if item.get_label() == "line, median"]
    assert line.get_xdata()[0] == first + 400, "the line starts at the repair"
    ahead = (line.get_xdata() - first - 1130) / 365.25
    np.testing.assert_allclose(line.get_ydata(), 1e3 * line_band(group, ahead, 0.9)[1])
    curve = limit.lines[0].get_ydata()
    assert np.all(np.diff(curve) >= 0.0)
    assert len(save(figure, tmp_path / "figures", "wear")) == 2
