"""Draws within a box have the moments that integration gives, in a corner of it too."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi, kstest, truncnorm

from bayesbl.sampling.importance import truncated_normal

DRAWS = 4000
FALSE_ALARM = 1e-3


def drawn(
    peak: list[float], covariance: np.ndarray, low: list[float], high: list[float]
) -> np.ndarray:
    box = np.array(low), np.array(high)
    return truncated_normal(np.array(peak), covariance, box, DRAWS, np.random.default_rng(3))


@pytest.mark.parametrize("beyond", [-3.0, 0.0, 3.0, 20.0])
def test_one_range_of_independent_coordinates_gives_its_own_truncated_normal(beyond: float) -> None:
    """Peaks inside and outside a range; a false alarm in 1000 each."""
    found = drawn([beyond, 0.0], np.eye(2), [-5.0, -np.inf], [0.0, np.inf])
    assert kstest(found[:, 0], truncnorm(-5.0 - beyond, -beyond, loc=beyond).cdf).pvalue > (
        FALSE_ALARM
    )
    assert kstest(found[:, 1], "norm").pvalue > FALSE_ALARM


def test_correlated_coordinates_in_a_corner_have_the_mean_of_an_integral() -> None:
    """By a grid of their density; within 5 standard errors."""
    covariance = np.array([[1.0, 0.95], [0.95, 1.0]])
    peak = np.array([4.0, -1.0])
    found = drawn(list(peak), covariance, [-2.0, -2.0], [0.5, 0.0])
    x, y = np.meshgrid(np.linspace(-2.0, 0.5, 1001), np.linspace(-2.0, 0.0, 1001), indexing="ij")
    off = np.stack([x - peak[0], y - peak[1]])
    exponent = -0.5 * np.einsum("ijk,il,ljk->jk", off, np.linalg.inv(covariance), off)
    density = np.exp(exponent - exponent.max())
    mean = np.array([np.sum(x * density), np.sum(y * density)]) / density.sum()
    error = found.std(axis=0) / np.sqrt(DRAWS)
    assert np.all(np.abs(found.mean(axis=0) - mean) < 5.0 * error)
    assert np.all((found >= [-2.0, -2.0]) & (found <= [0.5, 0.0]))


def test_a_range_that_a_peak_is_far_beyond_holds_draws_of_its_tail() -> None:
    """Beside shorter ranges, of coordinates that are correlated with its own."""
    covariance = np.full((6, 6), 0.99) + 0.01 * np.eye(6)
    low = [*[-20.0] * 5, 0.0]
    found = drawn([*[0.0] * 5, -4.0], covariance, low, [*[20.0] * 5, 100.0])
    assert kstest(found[:, 5], truncnorm(4.0, 104.0, loc=-4.0).cdf).pvalue > FALSE_ALARM
    assert np.unique(found[:, 5]).size > 0.9 * DRAWS


def test_without_a_box_it_is_the_normal_distribution() -> None:
    covariance = np.array([[2.0, -0.6], [-0.6, 0.5]])
    found = drawn([1.0, 2.0], covariance, [-np.inf] * 2, [np.inf] * 2)
    white = np.linalg.solve(np.linalg.cholesky(covariance), (found - [1.0, 2.0]).T)
    assert kstest(white.ravel(), "norm").pvalue > FALSE_ALARM


def test_a_narrow_corner_where_only_a_sum_is_known_holds_draws_that_differ() -> None:
    """Four parts, none below zero, each known to 1 and their sum to 1e-3.

    The sum over its standard deviation is χ with four degrees of freedom, and a fifth coordinate
    that follows the first part keeps its own scatter; a false alarm in 1000 each.
    """
    sd, known = 1e-3, np.linalg.inv(np.eye(4) + np.ones((4, 4)) / 1e-6)
    covariance = np.zeros((5, 5))
    covariance[:4, :4] = known
    covariance[4, :4] = covariance[:4, 4] = known[0]
    covariance[4, 4] = known[0, 0] + 1.0
    found = drawn([0.0] * 5, covariance, [*[0.0] * 4, -np.inf], [np.inf] * 5)
    assert kstest(found[:, :4].sum(axis=1) / sd, chi(4).cdf).pvalue > FALSE_ALARM
    assert kstest(found[:, 4] - found[:, 0], "norm").pvalue > FALSE_ALARM
    assert np.unique(found[:, 0]).size == DRAWS
