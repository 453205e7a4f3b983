"""Gaps that are matched one by one: paired through their bench they change as if matched together.

The world of these tests is linear and normal, where the joint posterior is known: z is the bench in
coordinates with a standard normal prior, ln δ_i = a_i + b·z + noise, and each recording tells some
directions of z well and others hardly.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from bayesbl.bench.parameters import JointNormal
from bayesbl.fleet.shared_bench import MatchedAlone, as_normal, other_benches, paired_gaps
from bayesbl.matching.signals import Unknown
from bayesbl.probabilities import FALSE_ALARM

NAMES = ["stiffness", "inertia", "gain"]
TOLD_SD = np.array([0.05, 0.4, 8.0])
"""Scatter of what one recording tells of each direction; the last is hardly told at all."""
SLOPES = np.array([0.01, 0.03, 0.02])
OWN_SD = 0.002


def exact(told: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of z by all recordings, shape (direction,) each."""
    precision = 1.0 + len(told) / TOLD_SD**2
    return (told / TOLD_SD**2).sum(axis=0) / precision, precision**-0.5


def alone(
    generator: np.random.Generator, centre: float, told: np.ndarray, slopes: np.ndarray
) -> MatchedAlone:
    """A thousand draws of one recording's posterior."""
    variance = 1.0 / (1.0 + 1.0 / TOLD_SD**2)
    mean = variance * told / TOLD_SD**2
    bench = mean[:, None] + np.sqrt(variance)[:, None] * generator.standard_normal((3, 1000))
    noise = OWN_SD * generator.standard_normal(1000)
    return MatchedAlone(np.exp(centre + slopes @ bench + noise), bench)


def recordings(
    generator: np.random.Generator, count: int, shift: float = 0.0
) -> tuple[list[MatchedAlone], np.ndarray]:
    """Of one bench, but for the last, whose stiffness is ``shift`` away; and what each told."""
    truth = np.tile(generator.standard_normal(3), (count, 1))
    truth[-1, 0] += shift
    told = truth + TOLD_SD * generator.standard_normal((count, 3))
    slopes = [SLOPES * (1.0 + 0.1 * number) for number in range(count)]
    made = [
        alone(generator, -7.0 + 0.1 * number, told[number], slopes[number])
        for number in range(count)
    ]
    return made, told


@pytest.mark.parametrize("count", [2, 3, 12])
def test_a_change_is_as_wide_as_by_the_joint_posterior(count):
    """Over 40 joints never sharper; a little blunter, as what is hardly told is left out."""
    generator = np.random.default_rng(count)
    ratios, apart, blunt = [], [], []
    for _ in range(40):
        made, told = recordings(generator, count)
        gaps = np.log(paired_gaps(made, 4000, generator))
        change = gaps[-1] - gaps[0]
        mean, sd = exact(told)
        slope = SLOPES * 0.1 * (count - 1)
        expected = 0.1 * (count - 1) + slope @ mean
        width = np.sqrt((slope**2 * sd**2).sum() + 2.0 * OWN_SD**2)
        ratios.append(change.std() / width)
        apart.append((change.mean() - expected) / width)
        blunt.append(
            np.hypot(np.log(made[0].gap_rad).std(), np.log(made[-1].gap_rad).std()) / width
        )
    assert 0.97 < np.mean(ratios) < 1.1
    assert np.abs(np.mean(apart)) < 0.1
    assert np.std(apart) < 0.5
    assert np.mean(blunt) > 1.5 if count == 2 else np.mean(blunt) > 1.1


def test_gaps_alone_are_not_made_sharper_than_all_recordings_tell():
    generator = np.random.default_rng(1)
    made, told = recordings(generator, 8)
    gaps = np.log(paired_gaps(made, 4000, generator))
    _, sd = exact(told)
    expected = [
        np.hypot(np.linalg.norm(SLOPES * (1.0 + 0.1 * number) * sd), OWN_SD) for number in range(8)
    ]
    np.testing.assert_allclose(gaps.std(axis=1), expected, rtol=0.12)


def test_without_anything_unknown_of_the_bench_gaps_are_independent():
    generator = np.random.default_rng(2)
    made = [
        MatchedAlone(np.exp(0.01 * generator.standard_normal(1000)), np.empty((0, 1000)))
        for _ in range(2)
    ]
    gaps = paired_gaps(made, 4000, generator)
    assert abs(np.corrcoef(gaps)[0, 1]) < 0.05
    assert other_benches(made, []) == {}


def test_a_recording_of_another_bench_is_found_and_named():
    generator = np.random.default_rng(3)
    found = [other_benches(recordings(generator, 4, shift=0.5)[0], NAMES) for _ in range(20)]
    assert sum(3 in one and one[3][0] == "stiffness" for one in found) >= 19


def test_recordings_of_one_bench_are_seldom_said_to_differ():
    """300 joints at a false alarm of 1 %: more than 8 have a probability of 0.4 %."""
    generator = np.random.default_rng(4)
    found = [other_benches(recordings(generator, 3)[0], NAMES) for _ in range(300)]
    assert FALSE_ALARM == 0.01
    assert sum(map(bool, found)) <= 8


def test_every_prior_becomes_standard_normal():
    generator = np.random.default_rng(5)
    unknowns = [Unknown("a", 2.0, 6.0), Unknown("b", centre=3.0, sd=0.5)]
    draws = [generator.uniform(2.0, 6.0, 20_000), generator.normal(3.0, 0.5, 20_000)]
    for row in as_normal(unknowns, draws, None):
        assert row.mean() == pytest.approx(0.0, abs=0.03)
        assert row.std() == pytest.approx(1.0, abs=0.03)
    assert np.isfinite(as_normal(unknowns[:1], [np.array([2.0, 6.0])], None)).all()


def test_a_joint_prior_becomes_standard_normal_beside_what_it_leaves_alone():
    """Two identified parameters, nearly one by their ratio, around one known by its tolerance."""
    generator = np.random.default_rng(6)
    covariance = np.array([[0.04, 0.0396], [0.0396, 0.04]])
    joint = JointNormal(("load_inertia_kg_m2", "shaft_stiffness_nm_per_rad"), covariance)
    factors = joint.draw(generator, 20_000).T
    of_joint = (0.2 * factors[0], 9e3 * factors[1])
    unknowns = [
        _identified("load_inertia_kg_m2", 0.2, joint),
        Unknown("a", 2.0, 6.0),
        _identified("shaft_stiffness_nm_per_rad", 9e3, joint),
    ]
    draws = [of_joint[0], generator.uniform(2.0, 6.0, 20_000), of_joint[1]]
    normal = as_normal(unknowns, draws, joint)
    np.testing.assert_allclose(normal.mean(axis=1), 0.0, atol=0.03)
    np.testing.assert_allclose(np.cov(normal), np.eye(3), atol=0.04)


def _identified(name: str, value: float, joint: JointNormal) -> Unknown:
    middle = math.log(value)
    reach = 5.0 * joint.sd(name)
    return Unknown(name, middle - reach, middle + reach, middle, joint.sd(name), logarithmic=True)
