"""Noise as real recordings have it: outliers, rounding, drift, uneven rotations, any sampling."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bayesbl.bench.simulation import Measurement
from bayesbl.config.bench import reference_bench
from bayesbl.noise.process import NoiseModel
from bayesbl.noise.quantisation import speed_steps
from bayesbl.noise.rotation_noise import (
    _difference_density,
    estimate_noise,
    rotation_difference,
    tails,
)
from bayesbl.recording.types import MOTOR_SPEED, Recording
from bayesbl.ringing.cleaning import without_drift
from bayesbl.ringing.estimator import Estimator, PointEstimate
from bayesbl.ringing.objective import Objective
from bayesbl.ringing.search import refine
from bayesbl.ringing.symbols import AMPLITUDE, ROTATION
from bayesbl.ringing.waveform import impacts
from bayesbl.units import RPM_PER_RAD_PER_S

BENCH = replace(reference_bench(), measurement=Measurement())
NOISE = NoiseModel(1.5, (0.6,))
OUTLIERS = NoiseModel(1.5, (0.6,), 3.0)


def seeded(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def recorded(speed_rpm: np.ndarray, like: Recording) -> Recording:
    return replace(like, channels={MOTOR_SPEED: speed_rpm})


@pytest.fixture(scope="module")
def quiet() -> PointEstimate:
    """A bench recording without noise, and its optimum."""
    recording = BENCH.simulate(2e-3, start_angle_rad=1.0)
    return Estimator().estimate(recording, np.random.SeedSequence(1))


def around(quiet: PointEstimate, speed_rpm: np.ndarray) -> PointEstimate:
    """A recording of the same joint at the same angles, near the optimum that is known."""
    recording = recorded(speed_rpm, quiet.recording)
    objective = Objective(quiet.optimum.model, recording.time_s, speed_rpm)
    point = refine(objective, quiet.optimum.searched)
    symbols, solution = objective.solved(point)
    optimum = replace(
        quiet.optimum,
        symbols=symbols,
        baseline_rpm=solution.coefficients[0, 1:-1],
        sum_of_squares=float(solution.sum_of_squares[0]),
    )
    return Estimator().around(recording, objective, optimum)


def amplitude(point: PointEstimate) -> float:
    return point.optimum.symbols[AMPLITUDE]


def error(point: PointEstimate, quiet: PointEstimate) -> float:
    """Error of A in its own standard deviations."""
    return (amplitude(point) - amplitude(quiet)) / math.sqrt(point.spread.sandwich[0, 0])


# Rotations of any length


def test_noise_is_told_from_misfit_where_a_rotation_is_not_a_whole_number_of_samples() -> None:
    reference_speed_rpm = 1996.67  # 901.5 samples a rotation
    recording = BENCH.simulate(
        2e-3, sampling_hz=250.0, start_angle_rad=1.0, reference_speed_rpm=reference_speed_rpm
    )
    noise = NoiseModel(0.3, (0.6,)).draw(recording.samples, seeded(1))
    noisy = recorded(recording.motor_speed_rpm + noise, recording)
    point = Estimator().estimate(noisy, np.random.SeedSequence(1))
    turn = point.optimum.symbols[ROTATION] * 250.0
    assert abs(turn - round(turn)) > 0.4
    # Standard error about 2 %.
    assert math.isclose(point.noise.sd_rpm, 0.3, rel_tol=0.06)
    lag = round(turn)
    nearest = (point.residual_rpm[lag:] - point.residual_rpm[:-lag]).std() / math.sqrt(2.0)
    assert nearest > 1.1 * point.noise.sd_rpm


@pytest.mark.parametrize("turn", [900.0, 900.25, 900.5, 901.9])
def test_a_shift_by_parts_of_a_sample_leaves_noise_as_it_is(turn: float) -> None:
    white = NoiseModel(1.0).draw(9000, seeded(2))
    found = estimate_noise(white, turn, 1.0)
    assert found.order == 0
    assert math.isclose(found.sd_rpm, 1.0, rel_tol=0.03)


def test_a_smooth_misfit_cancels_whatever_the_length_of_a_rotation() -> None:
    time_s = np.arange(5000) / 250.0
    for rotation_s in (3.6, 3.6017, 3.598):
        misfit = 3.0 * np.sin(2.0 * np.pi * 36.0 * time_s / rotation_s)
        left = rotation_difference(misfit, rotation_s, 1.0 / 250.0)
        # What the record's two ends do not share leaks a little way in from them.
        assert np.sqrt(np.mean(left**2)) < 0.01


def test_lost_samples_do_not_change_what_is_found_of_the_noise() -> None:
    noise = OUTLIERS.draw(18_000, seeded(12))
    lost = seeded(13).uniform(size=noise.size) < 0.01
    for rotation_s in (3.6, 3.6004):
        found = estimate_noise(np.where(lost, np.nan, noise), rotation_s, 1e-3)
        assert found.kind == "student_t"
        assert found.order == 1
        assert math.isclose(found.sd_rpm, noise.std(), rel_tol=0.05)


# Outliers


def test_the_difference_of_two_cauchy_variables_is_cauchy_with_twice_the_scale() -> None:
    log_z, log_density = _difference_density(1.0)
    np.testing.assert_allclose(
        log_density, stats.cauchy.logpdf(np.sinh(log_z), scale=2.0), atol=1e-5
    )


@pytest.mark.parametrize("freedom", [2.6, 3.0, 5.0])
def test_outliers_are_recognised_and_their_degrees_of_freedom_found(freedom: float) -> None:
    noise = NoiseModel(1.5, (0.6,), freedom).draw(18_000, seeded(3))
    misfit = 3.0 * np.sin(2.0 * np.pi * np.arange(18_000) / 3600.0 * 9.0)
    found = estimate_noise(noise + misfit, 3.6, 1e-3)
    assert found.kind == "student_t"
    assert found.order == 1
    assert found.degrees_of_freedom == pytest.approx(freedom, rel=0.2)
    assert found.student_t_evidence > 100.0


def test_normal_noise_is_not_taken_for_one_with_outliers() -> None:
    # The evidence is about −10 of normal noise, and passes 0 in fewer than one of 200.
    evidence = []
    for seed in range(30):
        x = seeded(seed).standard_normal(18_000)
        evidence.append(tails(x[3600:] - x[:-3600])[1])
    assert max(evidence) < 0.0


def test_the_kind_of_noise_can_be_given_and_changes_no_width() -> None:
    normal, heavy = (model.draw(18_000, seeded(4)) for model in (NOISE, OUTLIERS))
    asked = estimate_noise(normal, 3.6, 1e-3, "student_t")
    assert asked.kind == "student_t"
    assert asked.student_t_evidence < 0.0
    refused = estimate_noise(heavy, 3.6, 1e-3, "ar", 1)
    assert refused.kind == "ar"
    assert refused.degrees_of_freedom is None
    found = estimate_noise(heavy, 3.6, 1e-3)
    assert found.sd_rpm == refused.sd_rpm


# Rounding


def encoder_speed(recording: Recording, counts: int, begin_rad: float) -> np.ndarray:
    """Speed differentiated from the counts of an encoder that turns as the recording tells."""
    rate = recording.motor_speed_rpm / RPM_PER_RAD_PER_S * recording.sampling_period_s
    count = 2.0 * np.pi / counts
    position = np.r_[begin_rad, begin_rad + np.cumsum(rate)]
    counted = np.rint(position / count) * count
    return np.diff(counted) * RPM_PER_RAD_PER_S / recording.sampling_period_s


def test_steps_of_a_speed_are_found_and_told_apart(quiet: PointEstimate) -> None:
    smooth = quiet.recording.motor_speed_rpm
    printed = speed_steps(np.round(np.round(smooth / 0.4578) * 0.4578, 2))
    assert printed is not None
    assert printed.size_rpm == pytest.approx(0.4578, rel=1e-3)
    assert speed_steps(smooth + NOISE.draw(smooth.size, seeded(5))) is None
    rounded = speed_steps(np.round(smooth / 0.5) * 0.5)
    assert rounded is not None
    assert rounded.size_rpm == pytest.approx(0.5)
    counted = encoder_speed(quiet.recording, 4096, 0.3)
    bridged = seeded(6).choice(counted.size, 180, replace=False)
    counted[bridged] += seeded(7).normal(0.0, 3.0, 180)  # what is bridged lies between
    found = speed_steps(counted)
    assert found is not None
    assert found.size_rpm == pytest.approx(60.0 * 1000.0 / 4096)
    assert found.differentiated
    assert found.sd_rpm == pytest.approx((counted - smooth).std(), rel=0.1)


@pytest.mark.long
def test_rounding_that_repeats_every_rotation_is_counted_in_the_width(
    quiet: PointEstimate,
) -> None:
    # A rotation is 3600 samples and a whole number of counts: the rounding cancels in differences.
    errors, claimed = [], []
    for begin_rad in seeded(7).uniform(0.0, 2.0 * np.pi, 40):
        point = around(quiet, encoder_speed(quiet.recording, 4096, begin_rad))
        errors.append(amplitude(point) - amplitude(quiet))
        claimed.append(math.sqrt(point.spread.sandwich[0, 0]))
        assert point.noise.sd_rpm < 0.5 * point.noise.hidden_sd_rpm
    actual = math.sqrt(np.mean(np.square(errors)))
    # Known to 11 %; the rounding is not quite even.
    assert 0.6 < np.mean(claimed) / actual < 1.6


@pytest.mark.long
def test_rotations_whose_rounding_is_alike_are_left_alone(quiet: PointEstimate) -> None:
    # Between rotations there is next to no noise, by which anything would look uneven.
    for begin_rad in (0.1, 1.3, 2.9):
        speed = encoder_speed(quiet.recording, 4096, begin_rad)
        point = Estimator().estimate(recorded(speed, quiet.recording), np.random.SeedSequence(1))
        assert point.notes == ()
        assert point.noise.rounding_repeats
        assert abs(error(point, quiet)) < 3.3


# Rotations that differ


def test_nothing_is_mended_that_is_not_broken(quiet: PointEstimate) -> None:
    # The false alarm is 1e-5.
    assert quiet.notes == ()
    smooth = quiet.recording.motor_speed_rpm
    for seed in range(6):
        for model in (NOISE, OUTLIERS):
            point = around(quiet, smooth + model.draw(smooth.size, seeded(seed)))
            assert without_drift(point.recording, point.optimum, point.residual_rpm) is None


def in_impacts(point: PointEstimate) -> list[slice]:
    """Samples of the window of every impact."""
    time_s = point.recording.time_s
    found = impacts(point.optimum.symbols, time_s[0], time_s[-1], point.objective.period_s)
    ends = [np.searchsorted(time_s, (start, start + 0.204)) for _, start, _ in found]
    return [slice(*pair) for pair in ends]


def test_noise_that_is_the_same_everywhere_hardly_widens_an_interval(quiet: PointEstimate) -> None:
    smooth = quiet.recording.motor_speed_rpm
    wider = []
    for seed in range(12):
        spread = around(quiet, smooth + NOISE.draw(smooth.size, seeded(seed))).spread
        wider.append(spread.factors.min() ** -0.5)  # what is not widened is the least of them
        assert np.quantile(spread.impact_sd_rpm, 0.5) == 0.0
    assert np.mean(wider) < 1.1


def test_noise_that_is_louder_around_impacts_widens_the_interval(quiet: PointEstimate) -> None:
    smooth = quiet.recording.motor_speed_rpm
    louder = np.ones(smooth.size)
    for inside in in_impacts(quiet):
        louder[inside] = 5.0
    widths, errors = [], []
    for seed in range(12):
        noise = louder * NOISE.draw(smooth.size, seeded(seed))
        point = around(quiet, smooth + noise)
        widths.append(math.sqrt(point.spread.sandwich[0, 0]))
        errors.append(amplitude(point) - amplitude(quiet))
    assert np.sqrt(np.mean(np.square(errors))) < 1.5 * np.mean(widths)
    # By the RMS of the whole recording alone, half as wide.
    assert np.mean(widths) < 2.5 * np.sqrt(np.mean(np.square(errors)))


def test_what_impacts_differ_by_is_told(quiet: PointEstimate) -> None:
    smooth = quiet.recording.motor_speed_rpm
    without = smooth - quiet.optimum.predict(quiet.recording.time_s)
    share = 0.15
    unlike = smooth.copy()
    ringing = smooth - without - np.mean(smooth)
    factors = seeded(3).standard_normal(len(in_impacts(quiet)))
    factors *= share / factors.std(ddof=1)
    for factor, inside in zip(factors, in_impacts(quiet), strict=True):
        unlike[inside] += factor * ringing[inside]
    point = around(quiet, unlike + NOISE.draw(smooth.size, seeded(4)))
    low, high = np.quantile(point.spread.impact_sd_rpm, [0.05, 0.95]) / amplitude(quiet)
    assert low < share < high
    assert high < 4.0 * share
    assert abs(error(point, quiet)) < 3.3


def drifting(quiet: PointEstimate, share: float, *, of_the_motor: bool) -> np.ndarray:
    """Speed that rises by a share of itself, and the impacts coming sooner with it."""
    time_s = quiet.recording.time_s
    drift = share * (time_s / time_s[-1] - 0.5)
    reached_s = time_s + np.r_[0.0, np.cumsum(0.5 * (drift[1:] + drift[:-1]))] * 1e-3
    fine = BENCH.simulate(2e-3, start_angle_rad=1.0, sampling_hz=10_000.0, rotations=5.1)
    at = reached_s if of_the_motor else time_s
    # Before the begin, the end of the same rotation.
    at = np.where(at < 0.0, at + 3.6, at)
    return np.interp(at, fine.time_s, fine.motor_speed_rpm) + 2000.0 * drift


@pytest.mark.parametrize("of_the_motor", [True, False])
def test_a_drift_is_taken_out_and_what_it_does_to_the_impacts_is_given_back(
    quiet: PointEstimate, of_the_motor: bool
) -> None:
    speed = drifting(quiet, 0.004, of_the_motor=of_the_motor)
    noise = NOISE.draw(speed.size, seeded(9))
    for added in (0.0 * noise, noise):
        point = around(quiet, speed + added)
        found = without_drift(point.recording, point.optimum, point.residual_rpm)
        assert found is not None
        steady, note = found
        assert "drifts by 8" in note
        again = around(quiet, steady.motor_speed_rpm)
        centre, covariance = again.ringing
        if of_the_motor:
            assert amplitude(again) < amplitude(quiet) - 1.0
        if added.any():
            sd = math.sqrt(covariance[0, 0])
            assert abs(centre[0] - amplitude(quiet)) < 3.3 * sd
            plain = around(quiet, quiet.recording.motor_speed_rpm + noise)
            assert sd < 2.0 * math.sqrt(plain.ringing[1][0, 0])
        else:
            assert centre[0] == pytest.approx(amplitude(quiet), rel=0.01)


def test_what_uneven_rotations_take_is_given_back(quiet: PointEstimate) -> None:
    time_s = quiet.recording.time_s
    noise = NOISE.draw(time_s.size, seeded(15))
    fine = BENCH.simulate(2e-3, start_angle_rad=1.0, sampling_hz=10_000.0, rotations=5.1)
    delay_s = np.interp(time_s, 3.6 * np.arange(6), [0.0, 6e-3, -6e-3, 4e-3, -6e-3, 0.0])
    at = np.clip(time_s - delay_s, 0.0, None)
    point = around(quiet, np.interp(at, fine.time_s, fine.motor_speed_rpm) + noise)
    reference = around(quiet, quiet.recording.motor_speed_rpm + noise)
    sd = math.sqrt(reference.spread.sandwich[0, 0])
    centre, covariance = point.ringing
    assert amplitude(point) < amplitude(reference) - sd
    assert abs(centre[0] - amplitude(reference)) < 1.5 * sd
    assert abs(centre[0] - amplitude(reference)) < 2.0 * math.sqrt(covariance[0, 0])
    assert reference.ringing[0][0] == pytest.approx(amplitude(reference), rel=1e-3)


@pytest.mark.long
def test_the_estimator_mends_and_says_so(quiet: PointEstimate) -> None:
    noise = NOISE.draw(quiet.recording.samples, seeded(11))
    measured = recorded(drifting(quiet, 0.002, of_the_motor=True) + noise, quiet.recording)
    point = Estimator().estimate(measured, np.random.SeedSequence(1))
    assert len(point.notes) == 1
    assert "drifts by" in point.notes[0]
    assert abs(error(point, quiet)) < 3.3
