"""Tails and their inverses are those of scipy.stats."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from bayesbl import probabilities as own

RARE = [0.5, 1e-2, 1e-6]


@pytest.mark.parametrize("probability", RARE)
def test_every_inverse_is_that_of_scipy_stats(probability):
    assert own.normal_isf(probability) == pytest.approx(stats.norm.isf(probability), abs=1e-12)
    for freedom in (1, 2, 30, 4000):
        expected = stats.chi2.isf(probability, freedom)
        assert own.chi2_isf(probability, freedom) == pytest.approx(expected)
        assert own.chi2_sf(expected, freedom) == pytest.approx(probability)
        value = stats.f.isf(probability, freedom, 50)
        assert own.f_sf(value, freedom, 50) == pytest.approx(probability, rel=1e-6)


def test_several_values_at_once():
    values, freedom = np.array([0.0, 1.0, 9.0]), np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(own.chi2_sf(values, freedom), stats.chi2.sf(values, freedom))
    assert own.normal_sf(1.3) == pytest.approx(stats.norm.sf(1.3))
