"""An ensemble draws from its target, whatever moves it makes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import truncnorm

from bayesbl.sampling.ensemble import Ensemble, anew


def test_proposals_that_forget_are_all_accepted_where_they_are_the_target():
    """q(old)/q(new) times the target's ratio is then 1; Student's t of 5 written out here."""
    root = np.array([[2.0, 0.0], [1.5, 0.3]])
    centre = np.array([1.0, -4.0])
    inverse = np.linalg.inv(root @ root.T)

    def log_target(points: np.ndarray) -> np.ndarray:
        away = points - centre
        return -3.5 * np.log(1.0 + np.einsum("mi,ij,mj->m", away, inverse, away) / 5.0)

    random = np.random.RandomState(1)
    points = centre + 3.0 * random.standard_normal((50, 2))
    found, log_ratio = anew(centre, root)(points, random)
    assert np.ptp(found, axis=0).min() > 1.0
    np.testing.assert_allclose(log_ratio, log_target(points) - log_target(found), atol=1e-12)


@pytest.mark.parametrize("cut", [-1.0, 1.5])
def test_a_normal_cut_off_by_its_range_is_drawn_from_though_the_start_knows_nothing_of_it(cut):
    """Two coordinates of correlation 0.95, the first above ``cut``.

    About 4,000 independent draws: bounds are five standard errors.
    """
    covariance = np.array([[1.0, 0.95], [0.95, 1.0]])
    inverse = np.linalg.inv(covariance)

    def target(points: np.ndarray) -> np.ndarray:
        value = -0.5 * np.einsum("mi,ij,mj->m", points, inverse, points)
        return np.where(points[:, 0] >= cut, value, -np.inf)

    low, high = np.array([cut, -np.inf]), np.array([np.inf, np.inf])
    centre = np.array([max(cut, 0.0) + 0.1, 0.0])
    ensemble = Ensemble(target, centre, covariance, (low, high), np.random.SeedSequence(5))
    ensemble.run(1500)
    draws = ensemble.chain[300:].reshape(-1, 2)
    known = truncnorm(cut, np.inf)
    assert draws[:, 0].mean() == pytest.approx(known.mean(), abs=5.0 * known.std() / 4000**0.5)
    assert draws[:, 0].std() == pytest.approx(known.std(), rel=0.06)
    assert draws[:, 1].mean() == pytest.approx(0.95 * known.mean(), abs=0.06)
