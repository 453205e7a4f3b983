"""From draws of A to δ: the curve, what is uncertain about it, and the change it gives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bayesbl.config.measurement import KnownGap
from bayesbl.curve.gap_curve import GapCurve, Ringing, published_curve
from bayesbl.errors import CurveError
from bayesbl.measurement.gap_by_curve import MeasuredRinging, gaps
from bayesbl.measurement.stored import change_group
from bayesbl.sentences import sentence

PAPER_AMPLITUDES_RPM = np.array([30.9033, 39.2197])
PAPER_GAPS_RAD = np.array([6.8539e-4, 9.5394e-4])


def curve(
    power: float = 1.0,
    sources: Mapping[str, np.ndarray] | None = None,
    start_angle_sd_rpm: float = 0.0,
    span_rpm: tuple[float, float] = (5.0, 100.0),
) -> GapCurve:
    """δ = 2e-5 A^power over ``span_rpm``."""
    knots = np.geomspace(*span_rpm, 40)
    coefficients = np.zeros(4)
    coefficients[int(power)] = 2e-5
    draws = {name: np.broadcast_to(d[:, None], (d.size, 40)) for name, d in (sources or {}).items()}
    return GapCurve(
        name="test",
        coefficients=coefficients,
        knots_rpm=knots,
        correction=np.zeros(40),
        sources=draws,
        start_angle_sd_rpm=np.full(40, start_angle_sd_rpm),
    )


def measured(centre_rpm: float, sd_rpm: float, seed: int, draws: int = 2000) -> MeasuredRinging:
    generator = np.random.default_rng(seed)
    amplitude = centre_rpm + sd_rpm * generator.standard_normal((2, draws))
    return MeasuredRinging(amplitude, np.array([centre_rpm, 4.0, 2.5]), np.eye(3) * sd_rpm**2)


def seed(number: int = 1) -> np.random.SeedSequence:
    return np.random.SeedSequence(number)


def test_the_published_curve_gives_the_gaps_of_its_printed_coefficients() -> None:
    found = published_curve().gap(PAPER_AMPLITUDES_RPM)
    np.testing.assert_allclose(found, [6.8654e-4, 9.5627e-4], atol=0.5e-8)


def test_the_rounding_of_the_published_coefficients_holds_the_papers_own_gaps() -> None:
    drawn = published_curve().draw(4000, np.random.default_rng(1))
    for amplitude, gap in zip(PAPER_AMPLITUDES_RPM, PAPER_GAPS_RAD, strict=True):
        possible = drawn.gap(np.full(4000, amplitude))
        assert possible.min() < gap < possible.max()
        # Half a unit of the last printed digit, and nothing more: 0.2 to 0.4 % here.
        assert np.ptp(possible) < 0.01 * gap


def test_one_rounded_digit_explains_both_of_the_papers_gaps() -> None:
    powers = PAPER_AMPLITUDES_RPM[:, None] ** np.arange(4)
    exact = 1e-4 * powers @ [-0.138809, 0.138764, 0.003122, -0.00000939]
    np.testing.assert_allclose(exact, PAPER_GAPS_RAD, rtol=3e-5)


def test_the_gap_grows_with_the_amplitude_everywhere() -> None:
    published = published_curve()
    amplitude = np.geomspace(0.1, 1000.0, 3000)
    gap = published.gap(amplitude)
    assert np.all(np.diff(gap) > 0.0)
    assert np.all(published.gap(np.array([0.0, -3.0])) == 0.0)
    low, high = published.gap_range_rad
    np.testing.assert_allclose([low, high], [1e-4, 4e-3], rtol=1e-9)


def test_a_curve_that_turns_back_is_refused() -> None:
    knots = np.linspace(5.0, 50.0, 40)
    for coefficients in ([0.0, 1e-4, -1.5e-6], [-6e-4, 1e-4]):
        with pytest.raises(CurveError, match="does not grow"):
            GapCurve("bad", np.array(coefficients), knots, np.zeros(40), {}, np.zeros(40))


def test_a_curve_goes_on_as_the_power_law_of_its_ends() -> None:
    published = published_curve()
    for end in published.amplitude_range_rpm:
        beside = published.gap(end * np.array([1.0 - 1e-9, 1.0, 1.0 + 1e-9]))
        np.testing.assert_allclose(beside, beside[1], rtol=1e-8)
        slopes = published.log_slope(end * np.array([1.0 - 1e-4, 1.0 + 1e-4]))
        np.testing.assert_allclose(slopes[0], slopes[1], rtol=5e-3)
    low, high = published.amplitude_range_rpm
    for beyond in (low * np.array([0.2, 0.4, 0.8]), high * np.array([1.25, 2.5, 5.0])):
        exponents = np.diff(np.log(published.gap(beyond))) / np.diff(np.log(beyond))
        np.testing.assert_allclose(exponents, exponents[0], rtol=1e-9)
    np.testing.assert_array_equal(
        published.outside(np.array([0.5 * low, low, high, 2.0 * high])), [-1.0, 0.0, 0.0, 1.0]
    )


def test_the_log_slope_is_the_derivative_of_the_log_gap() -> None:
    published = published_curve()
    low, high = published.amplitude_range_rpm
    amplitude = np.geomspace(0.3 * low, 3.0 * high, 500)
    amplitude = amplitude[np.abs(np.log(amplitude / low)) > 0.01]
    amplitude = amplitude[np.abs(np.log(amplitude / high)) > 0.01]
    step = 1e-5 * amplitude
    numeric = np.log(published.gap(amplitude + step) / published.gap(amplitude - step)) / (2 * step)
    np.testing.assert_allclose(published.log_slope(amplitude), numeric, rtol=2e-3)
    assert np.all(published.log_slope(np.array([0.0, -1.0])) == 0.0)


def test_the_prior_is_flat_in_the_logarithm_of_the_gap() -> None:
    # Nothing measured: A uniform over the whole range. Every draw of the gap is then a draw of its
    # prior. Kolmogorov-Smirnov at 0.1 %; draws repeat, which the effective number allows for.
    published = published_curve()
    low, high = published.amplitude_range_rpm
    generator = np.random.default_rng(3)
    flat = generator.uniform(low, high, (4, 20_000))
    anything = MeasuredRinging(flat, np.zeros(3), np.eye(3))
    (found,) = gaps(published, [anything], seed())
    lowest, highest = np.log(published.gap_range_rad)
    uniform = (np.log(found.delta_rad.ravel()) - lowest) / (highest - lowest)
    weights = published.log_slope(flat)
    effective = weights.sum() ** 2 / (weights**2).sum()
    distance = stats.kstest(uniform, "uniform").statistic
    assert distance < 1.95 / np.sqrt(effective)
    # A flat prior in δ instead would be told apart by far.
    linear = (found.delta_rad.ravel() - 1e-4) / (4e-3 - 1e-4)
    assert stats.kstest(linear, "uniform").statistic > 0.2


def test_every_gap_belongs_to_the_posterior_draw_it_names() -> None:
    snapshot = measured(40.0, 4.0, 1)
    (found,) = gaps(curve(), [snapshot], seed())
    np.testing.assert_allclose(
        found.delta_rad, 2e-5 * snapshot.amplitude_rpm.ravel()[found.index], rtol=1e-12
    )
    for chain, index in enumerate(found.index):
        assert np.all(index // snapshot.amplitude_rpm.shape[1] == chain)


def test_what_is_wrong_with_the_curve_is_shared_and_largely_cancels_in_the_change() -> None:
    # 10 % unknown scale of the curve, amplitudes known to 0.1 rpm.
    scale = 0.1 * np.random.default_rng(4).standard_normal(3000)
    uncertain = curve(sources={"bench": scale})
    first, last = measured(40.0, 0.1, 1), measured(44.0, 0.1, 2)
    together = gaps(uncertain, [first, last], seed(1))
    alone = [gaps(uncertain, [first], seed(1))[0], gaps(uncertain, [last], seed(2))[0]]
    for shared, single in zip(together, alone, strict=True):
        assert np.isclose(shared.delta_rad.std(), single.delta_rad.std(), rtol=0.1)
    tight, loose = (last.delta_rad - first.delta_rad for first, last in (together, alone))
    # A shared scale leaves 10 % of the change; independent ones 10 % of both gaps.
    assert np.isclose(tight.mean(), 2e-5 * 4.0, rtol=0.05)
    assert tight.std() < 0.2 * loose.std()
    assert np.mean(tight > 0.0) > 0.99
    assert np.mean(loose > 0.0) < 0.9


def test_a_known_gap_calibrates_a_curve_whose_scale_is_wrong() -> None:
    # Twice too large a curve of 30 % unknown scale; 1 % of noise, the known gap to 2 %.
    scale = 0.3 * np.random.default_rng(4).standard_normal(3000)
    snapshots = [measured(40.0, 0.4, 1), measured(44.0, 0.44, 2)]
    known = [KnownGap(delta_rad=4e-4, sd_rad=8e-6), None]
    first, last = gaps(curve(sources={"bench": scale}), snapshots, seed(), known)
    assert np.isclose(np.median(first.curve_scale), 0.5, rtol=0.05)
    # Its own gap is what is known of it; the other has the noise of both ringings as well.
    for gap, delta_rad, relative_sd in ((first, 4e-4, 0.02), (last, 4.4e-4, np.sqrt(6e-4))):
        assert np.isclose(gap.delta_rad.mean(), delta_rad, rtol=0.003)
        assert np.isclose(np.log(gap.delta_rad).std(), relative_sd, rtol=0.05)
        assert gap.reasons == ()
    assert set(first.budget) == {"noise", "bench", "known_gap"}
    assert first.budget["known_gap"] > 0.999
    assert np.isclose(last.budget["known_gap"], 2.0 / 3.0, rtol=0.05)
    assert last.budget["bench"] < 1e-3, "what is wrong by a factor cancels"


@pytest.mark.parametrize(("second_rad", "agrees"), [(4.4e-4, True), (6e-4, False)])
def test_known_gaps_have_to_be_on_one_curve(second_rad: float, agrees: bool) -> None:
    snapshots = [measured(40.0, 0.4, 1), measured(44.0, 0.44, 2)]
    known = [KnownGap(delta_rad=4e-4, sd_rad=8e-6), KnownGap(delta_rad=second_rad, sd_rad=9e-6)]
    for gap in gaps(curve(), snapshots, seed(), known):
        codes = {reason.code for reason in gap.notes}
        assert codes == ({"curve_scaled"} if agrees else {"curve_scaled", "known_gaps_disagree"})


def test_start_angle_scatter_belongs_to_each_snapshot_alone() -> None:
    scattered = curve(start_angle_sd_rpm=0.5)
    first, last = (gaps(scattered, [measured(40.0, 1e-3, n)], seed(n))[0] for n in (1, 2))
    pair = gaps(scattered, [measured(40.0, 1e-3, 1), measured(40.0, 1e-3, 2)], seed(3))
    sd = 2e-5 * 0.5
    for found in (first, last, *pair):
        assert np.isclose(found.delta_rad.std(), sd, rtol=0.1)
    difference = pair[1].delta_rad - pair[0].delta_rad
    assert np.isclose(difference.std(), np.sqrt(2.0) * sd, rtol=0.1)


def test_an_answer_beyond_the_curve_is_withheld_with_a_one_sided_bound() -> None:
    high = curve().gap_range_rad[1]
    snapshot = measured(120.0, 5.0, 1)
    (withheld,) = gaps(curve(), [snapshot], seed())
    (reason,) = withheld.reasons
    assert f"δ is above {high:.3g} rad with 90" in sentence(reason.stored)
    assert np.mean(withheld.outside_curve == 1.0) > 0.99
    (asked_for,) = gaps(curve(), [snapshot], seed(), allow_extrapolation=True)
    assert asked_for.reasons == ()
    np.testing.assert_array_equal(asked_for.delta_rad, withheld.delta_rad)

    (below,) = gaps(curve(), [measured(2.0, 0.2, 1)], seed())
    (reason,) = below.reasons
    assert "δ is below 0.0001 rad with 90" in sentence(reason.stored)
    assert below.upper_bound_rad == np.quantile(below.delta_rad, 0.95)
    assert withheld.upper_bound_rad is None, "a gap that is told from none has no bound"


@pytest.mark.parametrize(("far", "expected"), [(0.0, 0.01), (1.0, 1.0)])
def test_a_ringing_is_of_another_bench_if_chance_hardly_makes_it(
    far: float, expected: float
) -> None:
    """Not only if no drawn bench comes near it: one of a thousand lies where ``far`` is."""
    generator = np.random.default_rng(7)
    benches = generator.uniform(-0.1, 0.1, (2, 1000, 1)) * np.ones(40)
    benches[:, 0] = 1.0
    line, scatter = np.zeros(40), np.zeros((40, 3, 3))
    own = replace(curve(), ringing=Ringing(line, line, *benches, scatter))
    contradicted = []
    for number in range(200):
        rings = benches[:, generator.integers(1, 1000), 0] if not far else np.full(2, far)
        rings = rings + 0.02 * generator.standard_normal(2)
        asked = MeasuredRinging(
            measured(20.0, 0.1, number, 100).amplitude_rpm,
            np.array([20.0, *rings]),
            np.diag([1e-2, 4e-4, 4e-4]),
        )
        contradicted.append(bool(gaps(own, [asked], seed(number))[0].reasons))
    # 2 ± 1.4 of 200 by chance.
    assert np.mean(contradicted) == pytest.approx(expected, abs=0.025)


def test_a_few_draws_beyond_the_curve_are_kept() -> None:
    # 97.2 rpm is 2.8 sd below the end, where 0.26 % of the draws lie beyond.
    (found,) = gaps(curve(), [measured(97.2, 1.0, 1, draws=20_000)], seed())
    assert found.reasons == ()
    assert 0.0 < np.mean(found.outside_curve == 1.0) < 0.01
    assert found.delta_rad.max() > curve().gap_range_rad[1]


def test_the_budget_names_every_source_and_sums_to_one() -> None:
    generator = np.random.default_rng(5)
    sources = {
        "bench": 0.02 * generator.standard_normal(4000),
        "regression": 0.01 * generator.standard_normal(4000),
    }
    full = curve(sources=sources, start_angle_sd_rpm=0.4)
    (found,) = gaps(full, [measured(40.0, 1.2, 1)], seed())
    assert set(found.budget) == {"noise", "start_angle", "bench", "regression"}
    assert np.isclose(sum(found.budget.values()), 1.0)
    variances = {"noise": 0.03**2, "start_angle": 0.01**2, "bench": 0.02**2, "regression": 0.01**2}
    for name, variance in variances.items():
        expected = variance / sum(variances.values())
        assert np.isclose(found.budget[name], expected, rtol=0.15), name
    assert np.isclose(np.log(found.delta_rad).std(), np.sqrt(sum(variances.values())), rtol=0.1)


def test_changes_go_from_first_to_last_and_step_by_step() -> None:
    drawn = {
        name: np.full((2, 3), value) for name, value in zip("abc", (1.0, 3.0, 2.0), strict=True)
    }
    stored = change_group(drawn, None)
    assert np.all(stored["change_rad"] == 1.0)
    steps = zip(*(stored[name].values.tolist() for name in ("step_from", "step_to")), strict=True)
    assert list(steps) == [("a", "b"), ("b", "c")]
    assert np.all(stored["step_change_rad"][0] == 2.0)
    assert np.all(stored["step_change_rad"][1] == -1.0)


def test_the_same_seed_gives_the_same_gaps() -> None:
    snapshot = measured(40.0, 2.0, 1)
    first, again, other = (
        gaps(published_curve(), [snapshot], seed(n))[0].delta_rad for n in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
