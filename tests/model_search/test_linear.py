"""Laws of the comparison of sets of hypotheses."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, stats

from bayesbl.model_search.constants import NAMED_AT
from bayesbl.model_search.linear import (
    DiscrepancyGroup,
    Linearised,
    MisfitBand,
    Term,
    orthant,
    search,
)


def view(residual, terms, *, jacobian=None, discrepancy=None, precision=None):
    n = residual.size
    jacobian = np.zeros((n, 0)) if jacobian is None else jacobian
    d = jacobian.shape[1]
    h = np.zeros((n, 0)) if discrepancy is None else discrepancy
    groups = [] if discrepancy is None else [DiscrepancyGroup("smooth", slice(0, h.shape[1]))]
    precision = np.eye(d) if precision is None else precision
    return Linearised(residual, jacobian, precision, np.zeros(d), terms, h, groups)


def smooth(n, count):
    x = np.linspace(0.0, 1.0, n)
    return np.column_stack([np.cos(np.pi * k * x) for k in range(1, count + 1)])


def covariance_evidence(lin, columns):
    """ln N(r; 0, I + J P⁻¹ Jᵀ + C Cᵀ): an independent way to the evidence of normal sizes."""
    n = lin.residual.size
    cov = np.eye(n) + lin.jacobian @ np.linalg.inv(lin.prior_precision) @ lin.jacobian.T
    cov = cov + columns @ columns.T
    return stats.multivariate_normal(np.zeros(n), cov).logpdf(lin.residual)


def test_odds_of_sets_of_normal_sizes_are_those_of_the_covariance():
    rng = np.random.default_rng(1)
    terms = [Term(f"h{i}", rng.standard_normal((30, 1 + i % 2))) for i in range(4)]
    residual = rng.standard_normal(30) + terms[1].columns @ [0.7, -0.2]
    lin = view(residual, terms, jacobian=rng.standard_normal((30, 2)))
    posterior = search(lin, probability={term.hypothesis: 0.25 for term in terms})
    odds = math.log(0.25 / 0.75)
    expected = {}
    for size in range(4):
        for some in itertools.combinations(range(4), size):
            columns = np.hstack([np.zeros((30, 0)), *(terms[i].columns for i in some)])
            expected[some] = size * odds + covariance_evidence(lin, columns)
    top = np.logaddexp.reduce(list(expected.values()))
    for some, probability in posterior.sets.items():
        assert probability == pytest.approx(math.exp(expected[some] - top), abs=2e-4)


@pytest.mark.parametrize("signs", [(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)])
def test_odds_of_half_normal_sizes_are_those_of_numerical_integration(signs):
    rng = np.random.default_rng(2)
    c = rng.standard_normal((12, 2)) * 0.4
    c[:, 1] += 0.6 * c[:, 0]
    residual = c @ (np.array(signs) * 0.6) + rng.standard_normal(12)
    terms = [Term("a", c[:, :1], positive=True), Term("b", c[:, 1:], positive=True)]
    posterior = search(view(residual, terms), probability={"a": 0.4, "b": 0.4})

    def likelihood(a, b):
        e = residual - c @ [a, b]
        return math.exp(-0.5 * e @ e + 0.5 * residual @ residual)

    half = stats.halfnorm.pdf
    alone = [
        integrate.quad(lambda a: likelihood(a, 0.0) * half(a), 0.0, 9.0)[0],
        integrate.quad(lambda b: likelihood(0.0, b) * half(b), 0.0, 9.0)[0],
    ]
    both = integrate.dblquad(lambda b, a: likelihood(a, b) * half(a) * half(b), 0, 9, 0, 9)[0]
    odds = 0.4 / 0.6
    weights = {(): 1.0, (0,): odds * alone[0], (1,): odds * alone[1], (0, 1): odds**2 * both}
    total = sum(weights.values())
    for some, weight in weights.items():
        assert posterior.sets.get(some, 0.0) == pytest.approx(weight / total, abs=0.005)


def test_orthants_agree_with_simulation_and_far_ones_are_finite():
    rng = np.random.default_rng(3)
    root = rng.standard_normal((4, 4))
    cov = root @ root.T + np.eye(4)
    mean = rng.standard_normal(4)
    draws = rng.multivariate_normal(mean, cov, 400_000)
    inside = draws[(draws[:, :3] > 0.0).all(axis=1)]
    positive = np.array([[True, True, True, False]])
    log_p, m, v = orthant(mean[None], np.linalg.inv(cov)[None], positive)
    assert math.exp(log_p[0]) == pytest.approx(len(inside) / len(draws), rel=0.02)
    assert m[0] == pytest.approx(inside.mean(axis=0), abs=0.06)
    assert np.sqrt(np.diag(v[0])) == pytest.approx(inside.std(axis=0), rel=0.06)
    far = orthant(np.array([[-300.0, 2.0]]), np.eye(2)[None], np.array([[True, True]]))[0]
    assert far[0] == pytest.approx(stats.norm.logsf(300.0) + stats.norm.logsf(-2.0), rel=1e-4)


def test_probabilities_hold_where_the_truth_is_drawn_from_the_prior():
    """Calibration: of hypotheses with a probability around p, a share p is there."""
    rng = np.random.default_rng(4)
    n, probabilities, truths, ranks = 80, [], [], []
    for _ in range(150):
        terms = [
            Term(f"h{i}", rng.standard_normal((n, 1)) * 0.35, positive=i % 2 == 0) for i in range(6)
        ]
        jacobian = rng.standard_normal((n, 2)) * 0.3
        there = rng.uniform(size=6) < 0.2
        size = np.where(np.arange(6) % 2 == 0, np.abs(rng.standard_normal(6)), 1.0)
        size = np.where(np.arange(6) % 2, rng.standard_normal(6), size) * there
        u = rng.standard_normal(2)
        residual = jacobian @ u + np.hstack([t.columns for t in terms]) @ size
        lin = view(residual + rng.standard_normal(n), terms, jacobian=jacobian)
        posterior = search(lin, 6, {term.hypothesis: 0.2 for term in terms})
        probabilities += [posterior.inclusion[f"h{i}"] for i in range(6)]
        truths += there.tolist()
        shift = posterior.draw(rng, 300).shift[:, 0]
        precision = jacobian.T @ jacobian + np.eye(2)
        centre = np.linalg.solve(precision, jacobian.T @ lin.residual)
        own = rng.multivariate_normal(centre, np.linalg.inv(precision), 300)[:, 0]
        ranks.append(np.mean(own + shift < u[0]))
    p, t = np.array(probabilities), np.array(truths, dtype=float)
    for low, high in ((0.0, 0.1), (0.1, 0.4), (0.4, 0.8), (0.8, 1.0)):
        inside = (p >= low) & (p <= high)
        spread = math.sqrt((p[inside] * (1.0 - p[inside])).sum()) / inside.sum()
        assert abs(t[inside].mean() - p[inside].mean()) < 3.5 * spread
    assert stats.kstest(ranks, "uniform").pvalue > 0.001


def test_a_hidden_law_beside_the_parameter_is_covered_by_what_it_leaves_open():
    """Always there: the parameter's posterior holds it though the law does not show."""
    rng = np.random.default_rng(5)
    n, z = 200, []
    for _ in range(200):
        jacobian = rng.standard_normal((n, 1)) * 0.5
        law = Term("law", 0.9 * jacobian + 0.05 * rng.standard_normal((n, 1)), True, True)
        u, size = rng.standard_normal(), abs(rng.standard_normal())
        residual = jacobian[:, 0] * u + law.columns[:, 0] * size + rng.standard_normal(n)
        posterior = search(view(residual, [law], jacobian=jacobian))
        shift = posterior.draw(rng, 400).shift[:, 0]
        precision = float(jacobian[:, 0] @ jacobian[:, 0]) + 1.0
        own = float(jacobian[:, 0] @ residual) / precision
        every = own + shift + rng.standard_normal(400) / math.sqrt(precision)
        z.append(np.mean(every < u))
    assert stats.kstest(z, "uniform").pvalue > 0.001


def test_the_scale_of_the_discrepancy_is_learned():
    rng = np.random.default_rng(6)
    h = smooth(2000, 20)
    for scale in (0.3, 3.0, 30.0):
        size = rng.standard_normal(20)
        signal = h @ size * scale / math.sqrt(np.mean((h @ size) ** 2))
        model = search(view(signal + rng.standard_normal(2000), [], discrepancy=h)).models[0]
        assert model.scales[0] == pytest.approx(scale, rel=0.6)
    nothing = search(view(rng.standard_normal(2000), [], discrepancy=h))
    assert nothing.models[0].scales == (0.0,)


def test_the_draws_of_the_discrepancy_are_in_the_callers_unit():
    rng = np.random.default_rng(7)
    h = smooth(500, 6) * 1e-3
    size = rng.standard_normal(6) * 1e4
    draws = search(view(h @ size + rng.standard_normal(500), [], discrepancy=h)).draw(rng, 300)
    error = (draws.discrepancy - size) / draws.discrepancy.std(axis=0)
    assert np.abs(error.mean(axis=0)).max() < 4.0


def test_units_and_the_order_of_columns_change_nothing():
    rng = np.random.default_rng(8)
    n = 150
    jacobian, h = rng.standard_normal((n, 3)), smooth(n, 8)
    terms = [Term(f"h{i}", rng.standard_normal((n, 1 + i % 2)) * 0.3) for i in range(8)]
    residual = terms[3].columns @ [0.9, 0.5] + h @ rng.standard_normal(8) + rng.standard_normal(n)
    lin = view(residual, terms, jacobian=jacobian, discrepancy=h)
    base = search(lin).inclusion
    unit = np.array([1e-6, 1.0, 1e5])
    other = replace(
        lin,
        jacobian=jacobian / unit,
        prior_precision=np.diag(unit**-2.0),
        discrepancy=h * 1e4,
        terms=terms[::-1],
    )
    for name, probability in search(other).inclusion.items():
        assert probability == pytest.approx(base[name], abs=1e-6)


def test_columns_that_are_alike_share_the_probability_and_are_reported_together():
    rng = np.random.default_rng(9)
    column = rng.standard_normal((300, 1))
    terms = [Term(name, column.copy()) for name in "abc"]
    terms.append(Term("other", rng.standard_normal((300, 1))))
    posterior = search(view(column[:, 0] * 1.5 + rng.standard_normal(300), terms))
    assert posterior.named == ()
    assert [set(group) for group in posterior.confounded] == [{"a", "b", "c"}]
    assert posterior.inclusion["a"] == pytest.approx(posterior.inclusion["c"], rel=1e-9)


def test_nothing_hidden_names_nothing_more_often_than_its_prior_says():
    rng = np.random.default_rng(10)
    false, total = 0, 300
    for _ in range(total):
        terms = [Term(f"h{i}", rng.standard_normal((100, 1)), i % 2 == 0) for i in range(15)]
        posterior = search(view(rng.standard_normal(100), terms))
        false += bool(posterior.named or posterior.confounded)
    assert false <= stats.binom.isf(0.001, total, 1.0 - NAMED_AT)


def test_alternatives_and_contained_laws_never_stand_together():
    rng = np.random.default_rng(11)
    terms = [
        Term("line", rng.standard_normal((100, 2)), prior_weight=0.5),
        Term("line", rng.standard_normal((100, 2)), prior_weight=0.5),
        Term("whole", rng.standard_normal((100, 1)), excludes=frozenset({"line"})),
        Term("apart", rng.standard_normal((100, 1))),
    ]
    residual = sum(t.columns.sum(axis=1) for t in terms) + rng.standard_normal(100)
    for some in search(view(residual, terms)).sets:
        assert len(set(some) & {0, 1, 2}) <= 1


def test_what_no_hypothesis_explains_is_held_by_the_discrepancy():
    rng = np.random.default_rng(12)
    h = smooth(1000, 15)
    terms = [Term(f"h{i}", rng.standard_normal((1000, 1))) for i in range(5)]
    size = 2.0 * rng.standard_normal(15)
    posterior = search(view(h @ size + rng.standard_normal(1000), terms, discrepancy=h))
    assert posterior.named == ()
    assert posterior.discrepancy_sd(0) > 1.0
    residual = 3.0 * terms[0].columns[:, 0] + rng.standard_normal(1000)
    posterior = search(view(residual, terms, discrepancy=h))
    assert posterior.named == ("h0",)
    assert posterior.discrepancy_sd(0) < 0.2


def test_draws_of_sizes_keep_their_signs_and_agree_with_expectation_propagation():
    rng = np.random.default_rng(14)
    c = rng.standard_normal((40, 3)) * 0.3
    terms = [Term(f"h{i}", c[:, i : i + 1], i < 2, True) for i in range(3)]
    lin = view(c @ [0.3, 0.1, -0.5] + rng.standard_normal(40), terms)
    sizes = search(lin).draw(rng, 40_000).sizes
    precision = c.T @ c + np.eye(3)
    mean = np.linalg.solve(precision, c.T @ lin.residual)
    positive = np.array([[True, True, False]])
    _, m, v = orthant(mean[None], precision[None], positive)
    assert (sizes[:, :2] >= 0.0).all()
    assert sizes.mean(axis=0) == pytest.approx(m[0], abs=0.03)
    assert sizes.std(axis=0) == pytest.approx(np.sqrt(np.diag(v[0])), rel=0.04)


@pytest.mark.parametrize("signs", [(0.0, 0.0), (0.6, -0.3), (2.5, 0.0)])
def test_a_size_that_may_be_none_is_so_as_often_as_integration_says(signs) -> None:
    """Of two that are there or not: each of the four cases by quadrature of its density."""
    rng = np.random.default_rng(5)
    c = rng.standard_normal((30, 2)) * 0.4
    terms = [Term(f"h{i}", c[:, i : i + 1], True, True, absent=0.5) for i in range(2)]
    lin = view(c @ signs + rng.standard_normal(30), terms)
    gram, pull = c.T @ c + np.eye(2), c.T @ lin.residual

    def density(a: float, b: float) -> float:
        x = np.array([a, b])
        return math.exp(pull @ x - 0.5 * x @ gram @ x)

    half = math.sqrt(2.0 / math.pi)
    one = [
        half * integrate.quad(lambda a: density(a, 0.0), 0.0, 12.0)[0],
        half * integrate.quad(lambda b: density(0.0, b), 0.0, 12.0)[0],
    ]
    both = half**2 * integrate.dblquad(density, 0.0, 12.0, 0.0, 12.0)[0]
    total = 1.0 + sum(one) + both
    sizes = search(lin).draw(rng, 40_000).sizes
    assert (sizes >= 0.0).all()
    for k in range(2):
        there = (one[k] + both) / total
        assert np.mean(sizes[:, k] > 0.0) == pytest.approx(there, abs=0.012)


def test_a_departure_is_not_there_without_what_it_departs_from() -> None:
    rng = np.random.default_rng(15)
    whole, part = rng.standard_normal((2, 100, 1))
    terms = [Term("whole", whole), Term("part", part, requires=frozenset({"whole"}))]
    for size in ([0.0, 2.0], [2.0, 2.0]):
        residual = np.hstack([whole, part]) @ size + rng.standard_normal(100)
        sets = search(view(residual, terms)).sets
        assert (1,) not in sets
        assert sets[(0, 1)] > 0.99
    alone = [replace(terms[1], requires=frozenset({"what no view has"}))]
    assert search(view(2.0 * part[:, 0] + rng.standard_normal(100), alone)).named == ("part",)


def test_a_law_is_not_left_to_a_discrepancy_of_its_size_that_holds_its_shape() -> None:
    """Beside a misfit that the discrepancy must hold, it could hold the law too."""
    rng = np.random.default_rng(16)
    h = smooth(800, 12)
    law = h @ np.array([20.0, *[0.0] * 11])
    misfit = h @ np.array([0.0, *rng.standard_normal(11)]) * 1.5
    residual = law + misfit + rng.standard_normal(800)
    lin = view(residual, [Term("law", law[:, None] / 10.0)], discrepancy=h)
    usual = replace(lin.groups[0], usual=1.0)
    assert search(replace(lin, groups=[usual])).inclusion["law"] > 0.999
    free = search(lin).inclusion["law"]
    assert free < search(replace(lin, groups=[usual])).inclusion["law"]


def test_sets_whose_signs_physics_forbids_do_not_crowd_out_the_others() -> None:
    rng = np.random.default_rng(17)
    column = rng.standard_normal((200, 1))
    wrong = [Term(f"w{i}", -column + 0.1 * rng.standard_normal((200, 1)), True) for i in range(12)]
    right = Term("right", column + 0.3 * rng.standard_normal((200, 1)), True)
    residual = right.columns[:, 0] * 1.2 + rng.standard_normal(200)
    assert search(view(residual, [*wrong, right]), max_terms=3).named == ("right",)


def test_the_scale_of_a_discrepancy_is_told_in_the_callers_unit() -> None:
    rng = np.random.default_rng(18)
    h = smooth(1000, 20) * 1e-2
    size = rng.standard_normal(20) * 50.0
    posterior = search(view(h @ size + rng.standard_normal(1000), [], discrepancy=h))
    assert posterior.discrepancy_sd(0) == pytest.approx(50.0, rel=0.6)


def banded(triangle):
    """A view whose first rows may be off; these rows, or a triangle of them."""
    rng = np.random.default_rng(11)
    everything = rng.standard_normal((60, 7))
    everything[:40, -1] *= 3.0
    rows, freedom = everything[:40], 40
    if triangle:
        rows = np.linalg.qr(rows, mode="r")
    everything = np.concatenate([rows, everything[40:]])
    terms = [Term(f"h{i}", everything[:, 2 + i : 3 + i]) for i in range(4)]
    lin = view(everything[:, -1], terms, jacobian=everything[:, :2])
    return replace(lin, bands=[MisfitBand("low", slice(0, len(rows)), freedom)])


def test_a_misfit_band_is_more_variance_of_its_rows():
    """ln N(r; 0, D + J P⁻¹ Jᵀ) with D the rows' variances: an independent way to the evidence."""
    lin = banded(triangle=False)
    posterior = search(replace(lin, terms=[]), 0)
    expected = []
    for model in posterior.models:
        variance = np.where(np.arange(60) < 40, 1.0 + model.scales[0] ** 2, 1.0)
        cov = np.diag(variance) + lin.jacobian @ lin.jacobian.T
        own = stats.multivariate_normal(np.zeros(60), cov).logpdf(lin.residual)
        absent = model.scales[0] == 0.0
        expected.append(
            own + math.log(0.5 if absent else 0.5 / (len(posterior._grams.lattice) - 1))
        )
    found = np.array([m.log_posterior for m in posterior.models])
    np.testing.assert_allclose(found - found[0], np.array(expected) - expected[0], atol=1e-6)
    assert posterior.models[0].scales[0] == pytest.approx(math.sqrt(8.0), rel=0.5)


def test_a_triangle_of_a_band_says_what_its_rows_say():
    rows, triangle = (search(banded(t), 2) for t in (False, True))
    # The lattice of scales begins at the number of rows: the same to its spacing.
    for some, probability in rows.sets.items():
        assert triangle.sets.get(some, 0.0) == pytest.approx(probability, abs=0.02)


def test_where_a_band_may_be_off_its_rows_name_nothing():
    """A misfit of three standard deviations in forty rows, on which a column happens to lie."""
    lin = banded(triangle=False)
    some = lin.residual[:40] * (np.arange(40) < 4)
    columns = np.zeros((60, 1))
    columns[:40, 0] = some
    lin = replace(lin, terms=[Term("chance", columns)])
    with_band, without = search(lin, 1), search(replace(lin, bands=[]), 1)
    assert without.inclusion["chance"] > NAMED_AT
    assert with_band.inclusion["chance"] < NAMED_AT


def test_noise_of_next_to_nothing_leaves_an_answer() -> None:
    """Collinear parameters and residuals of a million standard deviations: rounding is large."""
    rng = np.random.default_rng(8)
    rows = 300
    base = rng.standard_normal((rows, 1))
    jacobian = 1e6 * (base + 1e-5 * rng.standard_normal((rows, 12)))
    always = Term("always", 1e6 * (base + 1e-6 * rng.standard_normal((rows, 1))), always=True)
    bounded = Term("bounded", 1e6 * base, positive=True, always=True)
    misfit = rng.standard_normal((rows, 150)) + 1e3 * base
    view = Linearised(
        1e4 * rng.standard_normal(rows),
        jacobian,
        np.eye(12),
        np.zeros(12),
        [always, bounded],
        misfit,
        [DiscrepancyGroup("laws", slice(0, 150))],
    )
    drawn = search(view, 0).draw(np.random.default_rng(1), 200)
    assert np.all(np.isfinite(drawn.shift))
    assert np.all(drawn.sizes[:, 1] >= 0.0)


def test_a_set_is_found_however_strong_the_evidence_is():
    column = np.random.default_rng(4).standard_normal((30, 1))
    posterior = search(view(1e9 * column[:, 0], [Term("h", column)]), 1)
    assert posterior.named == ("h",)


@pytest.mark.parametrize("size", [1.0, 1e6])
def test_two_equal_columns_are_one_of_twice_the_prior_variance(size: float) -> None:
    """Between them the data say nothing and the prior remains; neither costs any evidence."""
    rng = np.random.default_rng(3)
    column, other = rng.standard_normal((2, 40, 1))
    residual = rng.standard_normal(40) + size * column[:, 0]
    terms = [Term("h", other)]
    twice = search(view(residual, terms, jacobian=size * np.hstack([column, column])), 1)
    once = search(view(residual, terms, jacobian=math.sqrt(2.0) * size * column), 1)
    assert twice.log_evidence == pytest.approx(once.log_evidence, abs=0.05)
    drawn = twice.draw(np.random.default_rng(1), 2000).fitted
    assert np.std(drawn[:, 0] - drawn[:, 1]) == pytest.approx(math.sqrt(2.0), rel=0.1)


@pytest.mark.parametrize("positive", [True, False])
@pytest.mark.parametrize("always", [True, False])
def test_collinear_terms_of_next_to_no_noise_have_an_answer(positive: bool, always: bool) -> None:
    column = np.random.default_rng(5).standard_normal((40, 1))
    for size in (1e8, 1e9, 1e12):
        terms = [Term(name, size * column, positive, always) for name in ("a", "b")]
        posterior = search(view(size * column[:, 0], [*terms, Term("c", size * column)]), 3)
        assert np.all(np.isfinite(posterior.draw(np.random.default_rng(1), 20).sizes))
        assert np.isfinite(posterior.log_evidence)


def test_the_evidence_is_the_same_wherever_a_linear_view_is_linearised() -> None:
    """A fit that a prior pulls back pays for its deviation, ln N(r; r₀, I + J P⁻¹ Jᵀ)."""
    rng = np.random.default_rng(20)
    jacobian, precision = rng.standard_normal((30, 2)), np.array([[4.0, 1.0], [1.0, 9.0]])
    measured = rng.standard_normal(30) + jacobian @ [1.0, -1.0]
    cov = np.eye(30) + jacobian @ np.linalg.inv(precision) @ jacobian.T
    expected = stats.multivariate_normal(np.zeros(30), cov).logpdf(measured)
    for point in ([0.0, 0.0], [1.0, -1.0], [3.0, 5.0]):
        lin = view(measured - jacobian @ point, [], jacobian=jacobian, precision=precision)
        found = search(replace(lin, prior_pull=-precision @ point)).log_evidence
        assert found - 15.0 * math.log(2.0 * math.pi) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("size", [1e3, 1e6, 1e9, 1e11])
def test_strong_evidence_of_one_law_leaves_that_of_another(size: float) -> None:
    """Beside a law of any size, the odds of a second one are those of the rest of the signal."""
    rng = np.random.default_rng(21)
    strong, weak = rng.standard_normal((2, 50, 1))
    residual = rng.standard_normal(50) + 0.4 * weak[:, 0] + size * strong[:, 0]
    lin = view(residual, [Term("strong", size * strong), Term("weak", weak)])
    rest = np.eye(50) - strong @ strong.T / (strong.T @ strong)
    alone = search(view(rest @ residual, [Term("weak", rest @ weak)]), probability={"weak": 0.25})
    found = search(lin, probability={"strong": 0.25, "weak": 0.25}).inclusion["weak"]
    assert found == pytest.approx(alone.inclusion["weak"], abs=0.02)


def test_draws_do_not_change_with_rounding() -> None:
    """Singular vectors of equal columns are arbitrary; rounding decides on them."""
    rng = np.random.default_rng(17)
    n = 60
    orthogonal = 3.0 * np.linalg.qr(rng.standard_normal((n, 9)))[0]
    residual = rng.standard_normal(n) + orthogonal[:, 4]

    def drawn(rounding: float):
        columns = orthogonal * (1.0 + rounding * rng.standard_normal(orthogonal.shape))
        terms = [Term(f"a{k}", columns[:, k : k + 1], always=True) for k in range(4, 9)]
        lin = view(residual, terms, jacobian=columns[:, :4], discrepancy=0.3 * smooth(n, 6))
        return search(lin).draw(np.random.default_rng(3), 400)

    one, other = drawn(0.0), drawn(1e-14)
    for name in ("sizes", "discrepancy", "shift", "fitted"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), abs=1e-6)
