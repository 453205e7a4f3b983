"""Noise as stated, within false-alarm rates that are stated too; the encoder; recordings."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bayesbl.bench.simulation import Measurement
from bayesbl.bench.steady import noise_through_loop
from bayesbl.config.bench import reference_bench
from bayesbl.errors import BenchError
from bayesbl.noise.process import NoiseModel
from bayesbl.noise.rotation_noise import autocorrelation
from bayesbl.recording.types import MOTOR_CURRENT, MOTOR_POSITION, MOTOR_SPEED

BENCH = reference_bench()
NOISES = [
    NoiseModel(1.5),
    NoiseModel(1.5, (0.6,)),
    NoiseModel(0.3, (0.9,)),
    NoiseModel(4.0, (1.2, -0.5)),
    NoiseModel(1.0, (0.3, 0.2, 0.1, -0.2)),
]
LENGTH = 200_000
# Each comparison may fail by chance once in ten thousand seeds; the seed is fixed.
LIMIT = float(stats.norm.isf(0.5e-4))


@pytest.mark.parametrize("noise", NOISES, ids=lambda noise: str(noise.coefficients))
def test_noise_has_the_stated_standard_deviation(noise: NoiseModel) -> None:
    drawn = noise.draw(LENGTH, np.random.default_rng(1))
    rho = autocorrelation(np.asarray(noise.coefficients), 2001)
    # Bartlett: var of the sample variance is 2σ⁴/n Σ ρ_k²; half of that, relatively, for the sd.
    error = math.sqrt(0.5 * (1.0 + 2.0 * np.sum(rho[1:] ** 2)) / LENGTH)
    assert abs(drawn.std() / noise.standard_deviation - 1.0) < LIMIT * error
    mean_error = noise.standard_deviation * math.sqrt((1.0 + 2.0 * np.sum(rho[1:])) / LENGTH)
    assert abs(drawn.mean()) < LIMIT * mean_error


@pytest.mark.parametrize("noise", NOISES, ids=lambda noise: str(noise.coefficients))
def test_noise_has_the_stated_autocorrelation(noise: NoiseModel) -> None:
    drawn = noise.draw(LENGTH, np.random.default_rng(2)) / noise.standard_deviation
    rho = autocorrelation(np.asarray(noise.coefficients), 2001)
    around = np.concatenate((rho[:0:-1], rho))
    centre = rho.size - 1
    for lag in (1, 2, 3, 5, 10):
        sample = float(np.mean(drawn[lag:] * drawn[:-lag]))
        # Bartlett: var r_k = 1/n Σ_j ρ_j² + ρ_{j+k} ρ_{j−k} for known mean and variance
        shifted = around[2 * lag :] * around[: around.size - 2 * lag]
        error = math.sqrt((np.sum(around**2) + np.sum(shifted)) / LENGTH)
        assert abs(sample - around[centre + lag]) < LIMIT * error


def test_student_t_noise_has_its_law_and_the_stated_standard_deviation() -> None:
    drawn = NoiseModel(1.5, degrees_of_freedom=3.0).draw(20_000, np.random.default_rng(4))
    assert stats.kstest(drawn / 1.5 * math.sqrt(3.0), stats.t(3.0).cdf).pvalue > 1e-4
    coloured = NoiseModel(1.5, (0.6,), 8.0).draw(LENGTH, np.random.default_rng(5))
    # A variance's relative error: √((kurtosis − 1) / n_eff), below 1 % here; half for the sd.
    assert math.isclose(coloured.std(), 1.5, rel_tol=0.02)
    innovations = coloured[1:] - 0.6 * coloured[:-1]
    scaled = innovations[:20_000] / (1.5 * 0.8) * math.sqrt(8.0 / 6.0)
    assert stats.kstest(scaled, stats.t(8.0).cdf).pvalue > 1e-4


def test_noise_without_a_variance_is_refused() -> None:
    with pytest.raises(BenchError, match="degrees of freedom"):
        NoiseModel(1.0, degrees_of_freedom=2.0)


def test_noise_is_stationary_from_the_first_sample_on() -> None:
    noise = NoiseModel(1.0, (1.2, -0.5))
    rng = np.random.default_rng(3)
    first = np.array([noise.draw(3, rng) for _ in range(4000)])
    # a variance's relative standard error is √(2/n)
    assert np.all(np.abs(first.var(axis=0) - 1.0) < LIMIT * math.sqrt(2.0 / 4000))


def test_impossible_noise_is_refused() -> None:
    for coefficients in ((1.0,), (1.2, 0.1), (0.5, 0.5)):
        with pytest.raises(BenchError, match="grows without bound"):
            NoiseModel(1.0, coefficients)
    with pytest.raises(BenchError, match="standard deviation"):
        NoiseModel(-1.0)


def test_recordings_hold_the_bench_noise_and_repeat_with_the_seed() -> None:
    clean = BENCH.simulate(8e-4)
    noisy = BENCH.simulate(8e-4, seed=np.random.default_rng(4))
    again = BENCH.simulate(8e-4, seed=np.random.default_rng(4))
    assert clean.samples == 18_001
    assert clean.duration_s == pytest.approx(18.001)
    for channel in (MOTOR_SPEED, MOTOR_CURRENT):
        assert np.array_equal(noisy.channels[channel], again.channels[channel])
    speed = noisy.motor_speed_rpm - clean.motor_speed_rpm
    current = noisy.channels[MOTOR_CURRENT] - clean.channels[MOTOR_CURRENT]
    assert speed.std() == pytest.approx(1.5, rel=0.05)
    assert np.corrcoef(speed[1:], speed[:-1])[0, 1] == pytest.approx(0.6, abs=0.03)
    assert current.std() == pytest.approx(0.05, rel=0.03)
    assert abs(np.corrcoef(speed, current)[0, 1]) < 0.05


def test_position_begins_at_zero_in_whole_counts() -> None:
    position = BENCH.simulate(8e-4, rotations=0.5).channels[MOTOR_POSITION]
    counts = position * 16384 / (2.0 * math.pi)
    assert position[0] == 0.0
    assert np.max(np.abs(counts - np.rint(counts))) < 1e-6
    ideal = replace(BENCH, measurement=Measurement()).simulate(8e-4, rotations=0.5)
    assert np.max(np.abs(position - ideal.channels[MOTOR_POSITION])) <= math.pi / 16384 + 1e-12


def test_absolute_position_begins_where_it_is_said_to() -> None:
    bench = replace(BENCH, measurement=Measurement())
    absolute = bench.simulate(8e-4, rotations=0.2, start_angle_rad=1.0, motor_start_angle_rad=7.0)
    relative = bench.simulate(8e-4, rotations=0.2, start_angle_rad=1.0)
    lead = absolute.channels[MOTOR_POSITION] - relative.channels[MOTOR_POSITION]
    assert np.ptp(lead) < 1e-9
    # θ_m at Δθ = 0 is 7 rad; the teeth are in contact, so the motor leads by N Δθ
    assert abs(lead[0] - 7.0) < 120.0 * (8e-4 + 425.0 / 1.2e5)


def test_speed_from_the_encoder_is_its_difference() -> None:
    bench = replace(BENCH, measurement=Measurement(encoder_counts=16384, speed_source="encoder"))
    recording = bench.simulate(8e-4, rotations=0.5)
    step = np.diff(recording.channels[MOTOR_POSITION]) * 1000.0 * 60.0 / (2.0 * math.pi)
    assert np.allclose(recording.motor_speed_rpm[1:], step)


def test_noise_through_the_controller_reaches_the_current() -> None:
    noise = NoiseModel(1.5, (0.6,)).draw(20_000, np.random.default_rng(5))
    motion, answer = noise_through_loop(BENCH.vector()[0], noise, 1e-3)
    # At once the proportional gain, K_p n / K_t with the sign against the noise; later the loop.
    proportional = -0.185 * noise * 2.0 * math.pi / 60.0 / 0.5
    assert np.corrcoef(answer, proportional)[0, 1] > 0.9
    assert 0.0 < motion.std() < noise.std()
    # The integral answers a constant offset in full: the motor runs slower by it.
    motion, answer = noise_through_loop(BENCH.vector()[0], np.full(20_000, 3.0), 1e-3)
    assert motion[-1] == pytest.approx(-3.0, abs=1e-6)
    assert answer[-1] == pytest.approx(0.0, abs=1e-6)


def test_noise_inside_the_loop_comes_with_the_recording() -> None:
    inside = Measurement(speed_noise=NoiseModel(1.5, (0.6,)), noise_through_controller=True)
    outside = Measurement(speed_noise=NoiseModel(1.5, (0.6,)))
    spread = [
        replace(BENCH, measurement=measurement)
        .simulate(8e-4, rotations=1.0, seed=np.random.default_rng(6))
        .channels[MOTOR_CURRENT]
        - BENCH.simulate(8e-4, rotations=1.0).channels[MOTOR_CURRENT]
        for measurement in (inside, outside)
    ]
    assert spread[0].std() > 0.02
    assert spread[1].std() == 0.0


def test_a_sweep_sees_the_speed_of_the_encoder_as_a_recording_does() -> None:
    """To what counts of a millionth of a turn leave."""
    seen = replace(BENCH, measurement=Measurement(encoder_counts=2**20, speed_source="encoder"))
    settings = {"rotations": 0.5, "sampling_hz": 250.0, "start_angle_rad": 0.4}
    recorded = seen.simulate(8e-4, **settings).motor_speed_rpm
    simulated = seen.simulate_many(8e-4, **settings)[0]
    assert np.max(np.abs(recorded - simulated)[1:]) < 0.02
    assert np.max(np.abs(BENCH.simulate_many(8e-4, **settings)[0] - simulated)) > 1.0
