"""A recording that is not of the curve's bench, nor of its speed or clock."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import bayesbl
from bayesbl.config.bench import reference_bench
from bayesbl.matching.observed import observed
from bayesbl.recording.types import MOTOR_CURRENT, MOTOR_SPEED, Recording

BENCH = reference_bench()
GAP_RAD = 8e-4


def made(heavier: float = 1.0, speed_rpm: float = 2000.0, noise_rpm: float = 0.3) -> Recording:
    gravity = heavier * BENCH.value("gravity_torque_nm")
    bench = BENCH.with_parameters(gravity_torque_nm=gravity, reference_speed_rpm=speed_rpm)
    clean = bench.simulate(GAP_RAD, rotations=3.0, sampling_hz=500.0, start_angle_rad=0.4)
    rng = np.random.default_rng(1)
    noisy = {
        MOTOR_SPEED: clean.motor_speed_rpm + noise_rpm * rng.standard_normal(clean.samples),
        MOTOR_CURRENT: clean.channels[MOTOR_CURRENT] + 0.02 * rng.standard_normal(clean.samples),
    }
    return replace(clean, channels=noisy)


def fitted(recording: Recording) -> dict:
    columns = {"time_s": recording.time_s, **recording.channels}
    return bayesbl.fit(columns, bench=BENCH, route="amplitude", seed=1).summary


@pytest.mark.long
def test_another_gravity_than_the_benchs_withholds_what_the_curve_says() -> None:
    right, wrong = fitted(made()), fitted(made(heavier=1.05))
    assert right["delta_rad"]["low"] < GAP_RAD < right["delta_rad"]["high"]
    assert wrong["delta_rad"] is None
    assert wrong["reason"]["code"] == "other_bench"
    assert "gravity_torque_nm" in wrong["model_check"]["could_be"]
    assert "load order 1" in wrong["reason"]["text"]


@pytest.mark.parametrize("speed_rpm", [2100.0, -1900.0, 1200.0])
def test_the_speed_is_the_recordings_own_and_it_is_told(speed_rpm: float) -> None:
    seen = observed(made(speed_rpm=speed_rpm), BENCH)
    assert seen.reference_speed_rpm == pytest.approx(speed_rpm, rel=1e-4)
    assert any(f"{speed_rpm:g} rpm" in note for note in seen.notes)


def test_uneven_time_stamps_are_taken_as_they_are() -> None:
    """The signals at an even grid, to a tenth of what they change in a sampling period."""
    even = made(noise_rpm=0.0)
    rng = np.random.default_rng(2)
    time_s = even.time_s + rng.uniform(-0.4, 0.4, even.samples) * even.sampling_period_s
    time_s[[0, -1]] = even.time_s[[0, -1]]
    fine = BENCH.simulate(GAP_RAD, rotations=3.0, sampling_hz=8000.0, start_angle_rad=0.4)
    speed = np.interp(time_s, fine.time_s, fine.motor_speed_rpm)
    uneven = replace(even, time_s=time_s, channels={MOTOR_SPEED: speed})
    seen = observed(uneven, BENCH)
    assert "evenly spaced" in seen.notes[0]
    left = seen.signals[0] - even.motor_speed_rpm
    assert np.std(left) < 0.1 * np.std(np.diff(even.motor_speed_rpm))
