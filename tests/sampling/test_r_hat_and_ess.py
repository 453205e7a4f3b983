"""R̂ and effective sample size are those of ArviZ."""

from __future__ import annotations

import numpy as np
import pytest
from arviz_stats.base import array_stats

from bayesbl.sampling.convergence import rank_r_hat_and_ess

SHAPES = [(4, 5000), (2, 51), (1, 100), (3, 8), (4, 9), (2, 5), (1, 4), (3, 3)]


def chains(kind: str, shape: tuple[int, int]) -> np.ndarray:
    noise = np.random.default_rng(1).standard_normal(shape)
    if kind == "walk":
        return np.cumsum(noise, axis=1)
    if kind == "ties":
        return np.round(noise, 1)
    if kind == "stuck":
        return np.tile(noise[:, :1], (1, shape[1]))
    if kind == "alike":
        return np.zeros(shape)
    if kind == "unknown":
        return np.where(noise > 2.0, np.nan, noise)
    return noise


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("kind", ["noise", "walk", "ties", "stuck", "alike", "unknown"])
def test_diagnostics_are_those_of_arviz(kind, shape):
    draws = chains(kind, shape)
    r_hat, ess = rank_r_hat_and_ess({"x": draws})
    assert r_hat["x"] == pytest.approx(
        float(array_stats.rhat(draws, method="rank")), rel=1e-10, nan_ok=True
    )
    expected = float(array_stats.ess(draws, method="bulk"))
    assert ess["x"] == pytest.approx(expected, rel=1e-10, nan_ok=True)
