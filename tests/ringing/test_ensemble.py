"""Our walk and autocorrelation time are emcee's, which is the independent judge of both."""

from __future__ import annotations

import numpy as np
import pytest

from bayesbl.sampling.convergence import integrated_time
from bayesbl.sampling.ensemble import Ensemble

emcee = pytest.importorskip("emcee")

CENTRE = np.array([1.0, 1.0, 0.0])
COVARIANCE = np.diag([0.04, 0.1, 1.0])
BOX = np.full(3, -5.0), np.full(3, 5.0)
STRETCHES = (40, 110)


def bent(points):
    """A bent valley that ends at a wall."""
    x, y, z = points.T
    density = -0.5 * ((x - 1.0) ** 2 / 0.04 + (y - x**2) ** 2 / 0.1 + z**2)
    return np.where(x > 1.2, -np.inf, density)


def test_ensembles_side_by_side_walk_as_emcee_walks_each_alone():
    seeds = np.random.SeedSequence(5)
    ours = [Ensemble(bent, CENTRE, COVARIANCE, BOX, seed) for seed in seeds.spawn(3)]
    starts = [one._points.copy() for one in ours]
    for steps in STRETCHES:
        Ensemble.walk(ours, steps)
    for one, seed, start in zip(ours, np.random.SeedSequence(5).spawn(3), starts, strict=True):
        _, walk_seed = seed.spawn(2)
        sampler = emcee.EnsembleSampler(
            *start.shape, bent, moves=emcee.moves.DEMove(), vectorize=True
        )
        random = np.random.RandomState(np.random.MT19937(walk_seed)).get_state()
        with np.errstate(invalid="ignore"):  # a walker that starts behind the wall
            state = emcee.State(start, random_state=random)
            sampler.run_mcmc(state, sum(STRETCHES), skip_initial_state_check=True)
        np.testing.assert_array_equal(one.chain, sampler.get_chain())
        assert one.acceptance == pytest.approx(float(sampler.acceptance_fraction.mean()))


def test_a_density_that_is_no_number_ends_the_walk():
    with pytest.raises(ValueError, match="not a number"):
        Ensemble(
            lambda points: np.full(len(points), np.nan),
            CENTRE,
            COVARIANCE,
            BOX,
            np.random.SeedSequence(1),
        )


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9])
def test_the_autocorrelation_time_is_emcees(memory):
    chain = np.random.default_rng(1).standard_normal((900, 16, 2))
    for step in range(1, len(chain)):
        chain[step] += memory * chain[step - 1]
    expected = np.max(emcee.autocorr.integrated_time(chain, tol=0))
    assert integrated_time(chain) == pytest.approx(expected, rel=1e-12)


def test_a_chain_shorter_than_its_memory_is_not_taken_for_one_without():
    """Where no five autocorrelation times are there, all that is there counts."""
    ramp = np.linspace(0.0, 1.0, 12)[:, None, None] + np.zeros((12, 4, 1))
    assert integrated_time(ramp) != 1.0
