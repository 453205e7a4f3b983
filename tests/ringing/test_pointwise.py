"""Log likelihood by rotation is that of the noise model; what is predicted scatters like it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arviz_stats.base import array_stats
from made_recordings import synthetic_recording
from scipy import stats
from scipy.special import logsumexp
from synthetic_ringing import QUICK

from bayesbl.noise.process import NoiseModel
from bayesbl.noise.rotation_noise import innovation_share, innovations
from bayesbl.recording.types import MOTOR_SPEED
from bayesbl.ringing.estimator import Estimator, PointEstimate
from bayesbl.ringing.pointwise import (
    _innovations,
    innovation_sd,
    likelihood_draws,
    log_likelihood,
    predicted,
    rotations_of,
)
from bayesbl.ringing.symbols import AMPLITUDE, DECAY, MEAN
from bayesbl.ringing.waveform import model_speed


@pytest.fixture(scope="module")
def point() -> PointEstimate:
    recording = synthetic_recording(
        QUICK, NoiseModel(1.5, (0.6,)), np.random.default_rng(1), rotations=4.2, sampling_hz=250.0
    )
    return Estimator().estimate(recording, np.random.SeedSequence(1))


def draws_around(point: PointEstimate) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Three settings of A and τ, and of the baseline."""
    best = point.optimum
    draws = {
        AMPLITUDE: best.symbols[AMPLITUDE] + np.array([0.0, 1.0, -2.0]),
        DECAY: best.symbols[DECAY] * np.array([1.0, 1.1, 0.9]),
    }
    return draws, np.tile(best.baseline_rpm, (3, 1)) + np.array([[0.0], [0.2], [-0.1]])


def by_hand(point: PointEstimate, symbols: dict[str, float], baseline: np.ndarray) -> np.ndarray:
    """By NumPy and SciPy, one rotation after the other."""
    objective, noise = point.objective, point.noise
    rest = objective.speed_rpm - model_speed(objective.time_s, symbols, baseline.tolist())
    order = len(noise.coefficients)
    sd = noise.sd_rpm * np.sqrt(innovation_share(noise.coefficients))
    if noise.degrees_of_freedom is None:
        law = stats.norm(scale=sd)
    else:
        freedom = noise.degrees_of_freedom
        law = stats.t(freedom, scale=sd * np.sqrt((freedom - 2.0) / freedom))
    each = law.logpdf(innovations(rest, noise.coefficients))
    return np.bincount(rotations_of(point)[order:], each)


@pytest.mark.parametrize("freedom", [None, 5.0])
def test_the_log_likelihood_is_that_of_the_noise_s_innovations(point, freedom):
    own = replace(point, noise=replace(point.noise, degrees_of_freedom=freedom))
    draws, baseline = draws_around(own)
    found = log_likelihood(own, draws, baseline)
    assert found.shape == (3, 4), "a rest of a fifth belongs to the rotation before"
    for n in range(3):
        symbols = own.optimum.symbols | {name: float(v[n]) for name, v in draws.items()}
        np.testing.assert_allclose(found[n], by_hand(own, symbols, baseline[n]), rtol=1e-8)


def test_samples_that_are_left_out_add_nothing(point):
    draws, baseline = draws_around(point)
    left_out = np.zeros(point.objective.samples, dtype=bool)
    left_out[400:420] = True
    cut = replace(point, recording=replace(point.recording, excluded=left_out))
    less = log_likelihood(cut, draws, baseline)
    whole = log_likelihood(point, draws, baseline)
    changed = np.flatnonzero(~np.isclose(less[0], whole[0]))
    assert list(changed) == [int(rotations_of(point)[400])]


def test_the_innovations_of_a_differentiated_process_are_those_of_the_process(point):
    """A white process of sd 1 changes from sample to sample with the variance 2."""
    white = replace(point.noise, sd_rpm=np.sqrt(2.0), coefficients=np.zeros(0), differentiated=True)
    assert innovation_sd(white) == pytest.approx(1.0)


def test_lost_samples_of_a_differentiated_process_do_not_add_up(point):
    """Its innovations are as large with lost samples as without."""
    white = replace(point.noise, sd_rpm=np.sqrt(2.0), coefficients=np.zeros(0), differentiated=True)
    lost = np.arange(point.objective.samples) % 50 == 25
    own = replace(point, noise=white, recording=replace(point.recording, excluded=lost))
    counts = np.diff(np.random.default_rng(1).standard_normal(lost.size + 1))
    assert _innovations(own, counts[None])[0][~lost].std() == pytest.approx(1.0, abs=0.05)


def test_a_differentiated_process_shows_the_mean_speed_by_the_position(point):
    """The slope of n positions with white noise of sd 1 has the standard error √(12/n³)."""
    white = replace(point.noise, sd_rpm=np.sqrt(2.0), coefficients=np.zeros(0), differentiated=True)
    counts = np.diff(np.random.default_rng(5).standard_normal(point.objective.samples + 1))
    speed = point.optimum.predict(point.objective.time_s) + counts
    own = replace(
        point, noise=white, recording=replace(point.recording, channels={MOTOR_SPEED: speed})
    )
    draws, *_ = likelihood_draws(own, np.zeros_like, 1000, np.random.default_rng(4))
    error = np.sqrt(12.0 / point.objective.samples**3)
    assert draws[MEAN].std() == pytest.approx(error, rel=0.3)
    assert abs(draws[MEAN].mean() - point.optimum.symbols[MEAN]) < 4.0 * error


def test_recordings_that_are_predicted_scatter_like_the_noise(point):
    draws = {AMPLITUDE: np.full(40, point.optimum.symbols[AMPLITUDE])}
    baseline = np.tile(point.optimum.baseline_rpm, (40, 1))
    found = predicted(point, draws, baseline, np.random.default_rng(2))
    assert found.shape == (40, point.objective.samples)
    # 40 recordings of 1470 samples: the standard deviation is known to 0.6 % with AR(1) 0.6.
    assert found.std(axis=0).mean() == pytest.approx(point.noise.sd_rpm, rel=0.03)
    assert np.abs(found.mean(axis=0) - point.optimum.predict(point.objective.time_s)).mean() < 1.0


def test_draws_of_the_likelihood_are_worth_as_many_parameters_as_the_waveform_has():
    """Of twenty rotations, leaving one out is what Pareto-smoothed weights can tell."""
    recording = synthetic_recording(
        QUICK, NoiseModel(1.5, (0.6,)), np.random.default_rng(3), rotations=20.0, sampling_hz=250.0
    )
    point = Estimator().estimate(recording, np.random.SeedSequence(1))
    generator = np.random.default_rng(4)
    draws, baseline, by_rotation = likelihood_draws(point, np.zeros_like, 1000, generator)
    assert by_rotation == pytest.approx(log_likelihood(point, draws, baseline), rel=1e-12)
    free = len(point.spread.names)
    # −2 ln L less its least is χ² of so many degrees of freedom: its mean is known to 0.045 √(2f).
    deviance = 2.0 * (by_rotation.sum(axis=1).max() - by_rotation.sum(axis=1))
    assert deviance.mean() == pytest.approx(free, rel=0.2)
    smoothed = [array_stats.psislw(own) for own in by_rotation.T]
    assert sum(tail > 0.7 for _, tail in smoothed) <= 1
    left_out = sum(logsumexp(w + own) for (w, _), own in zip(smoothed, by_rotation.T, strict=True))
    with_all = np.sum(logsumexp(by_rotation, axis=0) - np.log(len(by_rotation)))
    assert with_all - left_out == pytest.approx(free, rel=0.5)
