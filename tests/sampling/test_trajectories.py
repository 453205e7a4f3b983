"""Trajectories draw a bent density, and one in a corner, in as few steps as a normal one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import kstest, norm

from bayesbl.recording.types import FloatArray
from bayesbl.sampling.chains import SamplerSettings, Walk, walk
from bayesbl.sampling.importance import truncated_normal
from bayesbl.sampling.trajectories import Trajectories
from bayesbl.sentences import flaws_in_words

ENSEMBLES, WALKERS = 4, 32
FALSE_ALARM = 1e-3


def test_a_bent_density_of_forty_dimensions_is_drawn_in_a_few_hundred_steps() -> None:
    """x₂ = x₁²/2 + noise, the others normal; the walk ends by itself. A false alarm in 1000."""
    d = 40

    def target(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        slope = -points
        bend = points[:, 1] - 0.5 * points[:, 0] ** 2
        slope[:, 1] = -bend
        slope[:, 0] += bend * points[:, 0]
        rest = np.sum(points[:, 2:] ** 2, axis=1)
        return -0.5 * (points[:, 0] ** 2 + bend**2 + rest), slope

    box = np.full(d, -np.inf), np.full(d, np.inf)
    starts = np.random.default_rng(5).standard_normal((ENSEMBLES, WALKERS, d))
    made = Trajectories(target, starts, np.eye(d), box, np.random.SeedSequence(1))
    walked = walk(
        made, SamplerSettings(), lambda chains: np.quantile(chains[..., 1], [0.05, 0.95]), 1.0
    )
    assert walked.stable
    assert walked.steps < 500
    apart = np.concatenate(walked.chains, axis=1)[
        :: int(np.ceil(4.0 * walked.autocorrelation_steps))
    ]
    assert kstest(apart[..., 0].ravel(), norm.cdf).pvalue > FALSE_ALARM
    noise = apart[..., 1] - 0.5 * apart[..., 0] ** 2
    assert kstest(noise.ravel(), norm.cdf).pvalue > FALSE_ALARM
    assert kstest(apart[..., -1].ravel(), norm.cdf).pvalue > FALSE_ALARM


def test_draws_in_a_corner_are_those_of_the_truncated_distribution() -> None:
    """Six correlated coordinates, three of them bounded; within 5 standard errors."""
    generator = np.random.default_rng(0)
    root = generator.standard_normal((6, 6))
    covariance = root @ root.T
    precision, peak = np.linalg.inv(covariance), np.array([-1.0, 3.0, 0.0, 0.0, 0.0, 0.0])
    low, high = np.full(6, -np.inf), np.full(6, np.inf)
    low[:3], high[1] = (0.0, 0.5, -1.0), 2.0

    def target(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        slope = (peak - points) @ precision
        return 0.5 * np.sum((points - peak) * slope, axis=1), slope

    expected = truncated_normal(peak, covariance, (low, high), 4000, generator)
    starts = expected[: ENSEMBLES * WALKERS].reshape(ENSEMBLES, WALKERS, 6)
    made = Trajectories(target, starts, covariance, (low, high), np.random.SeedSequence(1))
    made.run(200)
    found = made.chains.reshape(-1, 6)
    assert np.all((found >= low) & (found <= high))
    error = 5.0 * expected.std(axis=0) * np.sqrt(1.0 / 4000 + 10.0 / len(found))
    assert np.all(np.abs(found.mean(axis=0) - expected.mean(axis=0)) < error)
    assert np.all(np.abs(found.std(axis=0) - expected.std(axis=0)) < error)


def test_walkers_that_cannot_move_end_soon() -> None:
    """With a density that is nowhere finite, the step shrinks to its least, not towards zero."""
    calls = 0

    def target(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        nonlocal calls
        calls += 1
        return np.full(len(points), np.nan), np.zeros_like(points)

    box = np.full(2, -np.inf), np.full(2, np.inf)
    made = Trajectories(target, np.zeros((1, 2, 2)), np.eye(2), box, np.random.SeedSequence(1))
    made.run(10)
    assert calls < 6000
    assert np.all(made.chains == 0.0)
    assert np.all(made.acceptance == 0.0)


@pytest.mark.parametrize("most", [1000, 20_000])
def test_more_steps_are_advised_only_where_a_setting_allows_them(most: int) -> None:
    draws = np.random.default_rng(1).standard_normal((2, 500))
    diagnostics = Walk((), 40.0, 750, np.ones(2), True).judged({"gap": draws}, most_steps=most)
    (said,) = (s for s in flaws_in_words(diagnostics.reasons) if "The chain is short: 750" in s)
    assert ("max_steps = 4000" in said) == (most > 4000)
