"""Independent ensembles: the law of what they draw, their independence, their autocorrelation."""

from __future__ import annotations

import numpy as np
import pytest
from emcee.autocorr import integrated_time as emcee_integrated_time

from bayesbl.recording.types import FloatArray
from bayesbl.sampling.chains import Ensembles, thinned
from bayesbl.sampling.convergence import integrated_time

COVARIANCE = np.array([[1.0, 0.9], [0.9, 4.0]])
BOX = np.full(2, -np.inf), np.full(2, np.inf)


def log_density(points: FloatArray) -> FloatArray:
    return -0.5 * np.einsum("ni,ij,nj->n", points, np.linalg.inv(COVARIANCE), points)


def ensembles(count: int, seed: int = 1, steps: int = 3000) -> Ensembles:
    made = Ensembles.around(
        log_density, np.zeros(2), COVARIANCE, BOX, count, np.random.SeedSequence(seed)
    )
    made.run(steps)
    return made


def test_a_normal_distribution_is_drawn_with_its_mean_and_covariance():
    """Within 5 standard errors at the autocorrelation time found: one case in a million fails."""
    found = ensembles(4)
    chains = found.chains[:, 300:]
    tau = max(integrated_time(chain) for chain in chains)
    draws = chains.reshape(-1, 2)
    effective = len(draws) / tau
    sd = np.sqrt(np.diag(COVARIANCE))
    assert np.all(np.abs(draws.mean(axis=0)) < 5.0 * sd / np.sqrt(effective))
    error = 5.0 * np.sqrt(2.0 / effective) * np.outer(sd, sd)
    assert np.all(np.abs(np.cov(draws.T) - COVARIANCE) < error)
    assert np.all((found.acceptance > 0.1) & (found.acceptance < 0.9))


def test_an_ensemble_never_sees_another_one():
    """One a million standard deviations away, where all others would rather be, stays alone."""

    def two_peaks(points: FloatArray) -> FloatArray:
        far = np.round(points / 1e6)
        return log_density(points - far * 1e6) + 1e4 * far[:, 0]

    near = np.random.default_rng(2).standard_normal((2, 32, 2))
    near[1] += 1e6
    made = Ensembles(two_peaks, near, np.zeros(2), COVARIANCE, np.random.SeedSequence(3))
    made.run(500)
    spread = made.chains[:, 250:].std(axis=(1, 2))
    assert np.all(spread < 5.0)


def test_a_stretch_goes_on_where_the_last_one_ended():
    whole, parts = ensembles(2, steps=60), ensembles(2, steps=20)
    parts.run(40)
    np.testing.assert_array_equal(whole.chains, parts.chains)


@pytest.mark.parametrize("memory", [0.5, 0.9])
def test_the_autocorrelation_time_is_that_of_theory_and_of_emcee(memory):
    """(1 + φ)/(1 − φ) of a first-order process, within 5 %."""
    rng = np.random.default_rng(4)
    chain = rng.standard_normal((4000, 32, 2))
    for k in range(1, len(chain)):
        chain[k] += memory * chain[k - 1]
    found = integrated_time(chain)
    assert found == pytest.approx((1.0 + memory) / (1.0 - memory), rel=0.05)
    assert found == pytest.approx(float(emcee_integrated_time(chain).max()))


@pytest.mark.parametrize("steps", [500, 1000, 1013, 2000])
def test_what_is_kept_is_of_all_walkers_whatever_the_number_of_steps(steps):
    """1000 draws of 32 walkers: each has about 31, its steps as far apart as they can be."""
    walker, step = np.meshgrid(np.arange(32.0), np.arange(float(steps)))
    kept = thinned(np.stack([step, walker], axis=-1), 1000)
    assert np.bincount(kept[:, 1].astype(int), minlength=32).min() >= 20
    own = np.unique(kept[kept[:, 1] == 5.0, 0])
    assert np.diff(own).min() >= steps // 32 - 1


def test_a_walker_that_never_moves_has_no_autocorrelation_time():
    chain = np.random.default_rng(5).standard_normal((100, 8, 2))
    chain[:, 3] = 0.0
    assert integrated_time(chain) == np.inf
