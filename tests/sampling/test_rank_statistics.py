"""R̂ and effective draws: as ArviZ has them, which is not imported for a fit."""

from __future__ import annotations

import math

import numpy as np
import pytest
from arviz_stats.base import array_stats

from bayesbl.sampling.rank_statistics import bulk_ess, rank_r_hat


def chains(kind: str, count: int, steps: int) -> np.ndarray:
    noise = np.random.default_rng(count * steps).standard_normal((count, steps))
    if kind == "walk":
        return np.cumsum(noise, axis=1)
    if kind == "with ties":
        return np.round(noise)
    memory = {"independent": 0.0, "correlated": 0.95, "antithetic": -0.9}[kind]
    for step in range(1, steps):
        noise[:, step] += memory * noise[:, step - 1]
    return noise


@pytest.mark.parametrize("kind", ["independent", "correlated", "antithetic", "walk", "with ties"])
@pytest.mark.parametrize(("count", "steps"), [(2, 4), (2, 7), (4, 9), (4, 1000), (3, 501)])
def test_both_are_those_of_arviz(kind, count, steps):
    draws = chains(kind, count, steps)
    r_hat, ess = array_stats.rhat(draws, method="rank"), array_stats.ess(draws, method="bulk")
    assert rank_r_hat(draws) == pytest.approx(float(r_hat), rel=1e-12, nan_ok=True)
    assert bulk_ess(draws) == pytest.approx(float(ess), rel=1e-12)


def test_draws_that_are_all_the_same_say_nothing_of_convergence():
    draws = np.ones((4, 100))
    assert math.isnan(rank_r_hat(draws))
    assert bulk_ess(draws) == draws.size


@pytest.mark.parametrize("draws", [np.ones((1, 100)), np.ones((4, 3)), np.full((4, 100), np.nan)])
def test_too_few_draws_and_what_is_no_number_have_neither(draws):
    assert math.isnan(rank_r_hat(draws))
    assert math.isnan(bulk_ess(draws))
