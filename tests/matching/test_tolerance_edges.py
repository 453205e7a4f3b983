"""A parameter that the recordings put beyond its tolerance withholds a gap that follows it."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bayesbl.config.bench import reference_bench
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.observed import observed
from bayesbl.matching.posterior import DirectPosterior, sample_direct
from bayesbl.matching.signals import NormalPrior, Unknown, gap_unknown, start_angle_unknown
from bayesbl.recording.types import FloatArray
from bayesbl.sampling.chains import SamplerSettings
from bayesbl.sentences import tolerance_decides

SHAPE = (4, 250)
SD = 0.06
INERTIA = Unknown("motor_inertia_kg_m2", -5.0 * SD, 5.0 * SD, 0.0, SD, logarithmic=True)


def posterior(
    parameter: FloatArray, slope: float, rng: np.random.Generator, unknown: Unknown = INERTIA
) -> DirectPosterior:
    """Draws of a gap that follows the parameter, within 1 % of it."""
    gap = gap_unknown(1e-4, 4e-3)
    unknowns = [gap, unknown]
    prior = NormalPrior.of(
        np.array([u.centre for u in unknowns]),
        np.array([u.sd for u in unknowns]),
        [u.name for u in unknowns],
        None,
    )
    model: Any = SimpleNamespace(
        unknowns=unknowns, normal_prior=prior, index=lambda name, recording: 0
    )
    fit: Any = SimpleNamespace(model=model)
    values = np.log(1e-3) + slope * (parameter - unknown.middle) + rng.normal(0.0, 0.01, SHAPE)
    draws = np.stack([values, parameter], axis=-1)
    nothing: Any = None
    as_it_is = np.ones(draws.shape[-1])
    return DirectPosterior(fit, draws, np.zeros(SHAPE), np.nan, 0, 0, nothing, as_it_is, as_it_is)


@pytest.mark.parametrize(
    ("mean", "sd", "slope", "withheld"),
    [
        (0.0, SD, 3.0, False),  # nothing learned
        (0.5 * SD, 0.2 * SD, 3.0, False),
        (math.sqrt(3.0) * SD, 0.2 * SD, 3.0, False),  # true values reach as far
        (5.0 * SD, 0.7 * SD, 0.0, False),  # wrong, and the gap does not follow it
        (5.0 * SD, 0.7 * SD, 3.0, True),
        (5.0 * SD, 0.01 * SD, 3.0, False),  # wrong, and the recordings know it better
    ],
)
def test_a_gap_is_withheld_where_a_tolerance_decides_it(
    mean: float, sd: float, slope: float, withheld: bool
) -> None:
    rng = np.random.default_rng(1)
    why = posterior(rng.normal(mean, sd, SHAPE), slope, rng).beyond_tolerance("one", 0.9)
    assert (why is not None) is withheld
    assert why is None or "upper edge" in tolerance_decides(**why)


def test_true_values_within_a_tolerance_contradict_it_no_more_often_than_is_said() -> None:
    """Of 2000 joints whose values are uniform within it, or normal as the prior has it."""
    rng = np.random.default_rng(2)
    for truths in (rng.uniform(-math.sqrt(3.0), math.sqrt(3.0), 2000), rng.normal(0.0, 1.0, 2000)):
        told = 0.5 * SD
        shrunk = 1.0 / (1.0 + (told / SD) ** 2)
        means = shrunk * (SD * truths + rng.normal(0.0, told, 2000))
        sd = math.sqrt(shrunk) * told
        wrong = sum(
            posterior(rng.normal(mean, sd, SHAPE), 3.0, rng).beyond_tolerance("one", 0.9)
            is not None
            for mean in means[:400]
        )
        assert wrong <= 8


SHEET = (
    "motor_inertia_kg_m2",
    "load_inertia_kg_m2",
    "shaft_stiffness_nm_per_rad",
    "gravity_torque_nm",
    "torque_constant_nm_per_a",
)


def of_sheet(mean: FloatArray, covariance: FloatArray, rng: np.random.Generator) -> DirectPosterior:
    """Draws of five stated values."""
    unknowns = [replace(INERTIA, name=name) for name in SHEET]
    centre, sd = np.zeros(len(SHEET)), np.full(len(SHEET), SD)
    prior = NormalPrior.of(centre, sd, list(SHEET), None)
    fit: Any = SimpleNamespace(model=SimpleNamespace(unknowns=unknowns, normal_prior=prior))
    draws = rng.multivariate_normal(mean, covariance, SHAPE)
    nothing: Any = None
    as_it_is = np.ones(len(SHEET))
    return DirectPosterior(fit, draws, np.zeros(SHAPE), np.nan, 0, 0, nothing, as_it_is, as_it_is)


def learned(truth: FloatArray, rng: np.random.Generator) -> DirectPosterior:
    """What recordings say that see the ratio of the values to the last one, as all torques have
    one, to a tenth of the tolerance."""
    rows = np.eye(len(SHEET)) - np.eye(len(SHEET))[-1]
    told = 0.1 * SD
    covariance = np.linalg.inv(rows.T @ rows / told**2 + np.eye(len(SHEET)) / SD**2)
    measured = rows @ truth + told * rng.standard_normal(len(SHEET))
    return of_sheet(covariance @ (rows.T @ measured) / told**2, covariance, rng)


def test_true_values_contradict_a_sheet_together_no_more_often_than_is_said() -> None:
    """Of 600 joints, 1 % by chance; 13 or more would be one in a hundred."""
    rng = np.random.default_rng(3)
    reach = math.sqrt(3.0) * SD
    wrong = sum(
        bool(learned(rng.uniform(-reach, reach, len(SHEET)), rng).contradicted_together())
        for _ in range(600)
    )
    assert wrong <= 12


def test_one_wrong_value_is_a_wrong_value_and_several_are_something_else() -> None:
    rng = np.random.default_rng(4)
    one, several = np.array([8.0, 0.5, -0.5, 0.3, -1.0]), np.array([4.0, -0.5, -4.0, 3.5, 1.0])
    assert not learned(SD * one, rng).contradicted_together()
    names = learned(SD * several, rng).contradicted_together()
    assert set(names[:3]) == {SHEET[0], SHEET[2], SHEET[3]}


def test_values_that_recordings_hardly_tell_contradict_no_sheet() -> None:
    """Half a standard deviation off, as laws of one sign pull them, nearly as wide as stated."""
    rng = np.random.default_rng(5)
    mean = SD * np.array([0.5, -0.5, 0.5, 0.5, -0.5])
    covariance = 0.9 * SD**2 * np.eye(len(SHEET))
    assert not any(of_sheet(mean, covariance, rng).contradicted_together() for _ in range(20))


@pytest.mark.parametrize(("low_s", "withheld"), [(2e-4, False), (4e-3, True)])
def test_below_a_range_is_no_more_than_zero(low_s: float, withheld: bool) -> None:
    """A lag at the lower edge of 0.2 to 10 ms can be shorter by 0.2 ms, and no more."""
    rng = np.random.default_rng(1)
    lag = Unknown("current_loop_lag__time_s", low_s, 1e-2)
    found = posterior(low_s + rng.exponential(3e-5, SHAPE), 10.0, rng, lag)
    assert (found.beyond_tolerance("one", 0.9) is not None) is withheld


def test_draws_of_a_fit_far_off_are_as_wide_as_the_fit_has_them() -> None:
    """The end of the gap's range stops the fit hundreds of standard deviations short."""
    bench, name = reference_bench(), "far"
    made = bench.simulate(9e-4, rotations=3, start_angle_rad=0.4, seed=np.random.default_rng(1))
    seen = replace(observed(made, bench), name=name)
    fit = fit_aligned(bench, [seen], [gap_unknown(1e-4, 5e-4), start_angle_unknown(name)])
    seed, settings = np.random.SeedSequence(1), SamplerSettings(ensembles=2)
    drawn = sample_direct(fit, settings, seed, withheld=True).draws
    # Half of a normal distribution has a standard deviation of √(1 − 2/π), 0.60 of the whole's.
    spread = drawn.std(axis=(0, 1)) / np.sqrt(np.diag(fit.covariance))
    assert np.all((spread > 0.5) & (spread < 1.1))
