"""Independent draws have the moments of the density that they are of, or there are none."""

from __future__ import annotations

import numpy as np
from scipy.stats import gamma, kstest, truncnorm

from bayesbl.recording.types import FloatArray
from bayesbl.sampling.importance import independent_draws

DRAWS = 2000
FALSE_ALARM = 1e-3


def test_a_poor_guess_of_a_normal_density_in_a_box_is_mended() -> None:
    """Peak and width are guessed wrong; the box cuts a coordinate off at its peak."""
    box = np.array([-np.inf, 0.0]), np.array([np.inf, 3.0])

    def density(points: FloatArray) -> FloatArray:
        return np.asarray(-0.5 * (points[:, 0] - 1.0) ** 2 - 0.5 * points[:, 1] ** 2)

    generator = np.random.default_rng(5)
    found = independent_draws(density, np.ones(2) * 0.5, np.eye(2) * 4.0, box, DRAWS, generator)
    assert found is not None
    points, chosen, _ = found
    draws = points[chosen]
    assert kstest(draws[:, 0], "norm", args=(1.0, 1.0)).pvalue > FALSE_ALARM
    assert kstest(draws[:, 1], truncnorm(0.0, 3.0).cdf).pvalue > FALSE_ALARM


def test_a_bent_density_has_the_moments_that_integration_gives() -> None:
    """y follows x²/10: mean and variance of both within five standard errors."""
    box = np.full(2, -np.inf), np.full(2, np.inf)

    def density(points: FloatArray) -> FloatArray:
        x, y = points.T
        return np.asarray(-0.5 * x**2 - 2.0 * (y - 0.1 * x**2) ** 2)

    generator = np.random.default_rng(6)
    found = independent_draws(density, np.zeros(2), np.diag([1.0, 0.3]), box, DRAWS, generator)
    assert found is not None
    points, chosen, _ = found
    x, y = points[chosen].T
    assert abs(x.mean()) < 5.0 / np.sqrt(DRAWS)
    assert abs(y.mean() - 0.1) < 5.0 * y.std() / np.sqrt(DRAWS)
    assert abs(y.var() - (0.25 + 0.02)) < 5.0 * 0.27 * np.sqrt(4.0 / DRAWS)


def test_two_modes_far_apart_are_left_to_another_sampler() -> None:
    box = np.full(1, -np.inf), np.full(1, np.inf)

    def density(points: FloatArray) -> FloatArray:
        return np.asarray(np.logaddexp(*(-0.5 * ((points[:, 0] - c) / 0.1) ** 2 for c in (-9, 9))))

    generator = np.random.default_rng(7)
    assert independent_draws(density, np.zeros(1), np.eye(1), box, DRAWS, generator) is None


def test_a_density_that_few_draws_hit_gets_more_draws() -> None:
    """Eight factors, each far steeper on one side, so one normal draw in a hundred counts."""
    box = np.full(8, -np.inf), np.full(8, np.inf)

    def density(points: FloatArray) -> FloatArray:
        return np.asarray(np.sum(2.0 * points - np.exp(2.0 * points), axis=1))

    generator = np.random.default_rng(8)
    found = independent_draws(
        density, np.zeros(8), 0.3 * np.eye(8), box, DRAWS, generator, most=256_000
    )
    assert found is not None
    points, chosen, _ = found
    # exp(2 x) is exponential with mean 1
    assert kstest(np.exp(2.0 * points[chosen]).mean(axis=1), gamma(8.0, scale=1 / 8).cdf).pvalue > (
        FALSE_ALARM
    )


def test_a_density_that_no_draw_hits_is_left_to_another_sampler() -> None:
    box = np.full(3, -np.inf), np.full(3, np.inf)

    def density(points: FloatArray) -> FloatArray:
        return np.asarray(-1e8 * np.sum((points - 3.0) ** 2, axis=1))

    generator = np.random.default_rng(9)
    found = independent_draws(density, np.zeros(3), np.eye(3), box, DRAWS, generator, most=4000)
    assert found is None
