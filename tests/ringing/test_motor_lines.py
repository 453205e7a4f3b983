"""A line of the motor is no ringing: with it and without, the same amplitude comes out."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from places import CONFIGS

from bayesbl.bench.steady import contact_rates
from bayesbl.config.bench import load_bench
from bayesbl.recording.types import MOTOR_SPEED, Recording
from bayesbl.ringing.cleaning import without_motor_lines
from bayesbl.ringing.estimator import Estimator
from bayesbl.units import RPM_PER_RAD_PER_S

BENCH = load_bench(CONFIGS / "bench.toml")
SPEED_RPM = 900.0
"""15 turns a second: the motor's first order is beside the ringing, of some 11 Hz."""

SLOWEST_DECAY_PER_S = 1.0
LOAD_SIDE = {
    "load_inertia_kg_m2": 2,
    "shaft_stiffness_nm_per_rad": 2,
    "shaft_damping_nm_s_per_rad": 2,
    "gravity_torque_nm": 1,
}
"""With the power of the gear ratio that they go with, seen at the motor."""


def made(
    sampling_hz: float = 500.0, noise_rpm: float = 0.3, speed_rpm: float = SPEED_RPM
) -> Recording:
    bench = BENCH.with_parameters(reference_speed_rpm=speed_rpm)
    recording = bench.simulate(
        1.2e-3, rotations=3.2, sampling_hz=sampling_hz, start_angle_rad=0.4, name="made"
    )
    noise = np.random.default_rng(1).normal(0.0, noise_rpm, recording.samples)
    return replace(recording, channels={MOTOR_SPEED: recording.motor_speed_rpm + noise})


def with_line(recording: Recording, order: int, size_rpm: float) -> Recording:
    speed = recording.motor_speed_rpm
    angle = np.cumsum(speed) * recording.sampling_period_s / RPM_PER_RAD_PER_S
    line = size_rpm * np.sin(order * angle + 0.7)
    return replace(recording, channels={MOTOR_SPEED: speed + line})


@pytest.mark.parametrize(("order", "size_rpm"), [(1, 12.0), (2, 6.0)])
def test_a_line_of_the_motor_moves_no_amplitude(order: int, size_rpm: float) -> None:
    plain = made()
    seed = np.random.SeedSequence(1)
    alone, beside = (
        Estimator().estimate(each, seed) for each in (plain, with_line(plain, order, size_rpm))
    )
    (amplitude, *_), covariance = alone.ringing
    assert beside.ringing[0][0] == pytest.approx(amplitude, abs=2.0 * math.sqrt(covariance[0, 0]))
    (note,) = beside.notes
    assert f"motor order {order}" in note
    assert not alone.notes


@pytest.mark.parametrize("noise_rpm", [0.0, 0.3, 3.0])
@pytest.mark.parametrize("speed_rpm", [SPEED_RPM, -2000.0])
def test_ringing_is_no_line(noise_rpm: float, speed_rpm: float) -> None:
    assert without_motor_lines(made(noise_rpm=noise_rpm, speed_rpm=speed_rpm))[1] == ()


@pytest.mark.parametrize("gear_ratio", [6.0, 8.0, 10.0])
def test_ringing_that_fills_the_few_turns_of_a_low_ratio_is_no_line(gear_ratio: float) -> None:
    """Joints that ring as the bench does, but for a factor of two, and whose ringing ends."""
    rng, share = np.random.default_rng(0), gear_ratio / BENCH.value("gear_ratio")
    for _ in range(20):
        scaled = {
            name: BENCH.value(name) * share**power * 2.0 ** rng.uniform(-1.0, 1.0)
            for name, power in LOAD_SIDE.items()
        }
        bench = BENCH.with_parameters(gear_ratio=gear_ratio, **scaled)
        rates = contact_rates(bench.vector())[0].real
        if rates[np.abs(rates) > 1e-6].max() > -SLOWEST_DECAY_PER_S:
            continue
        recording = bench.simulate(
            8e-4 / share, rotations=6.0, reference_speed_rpm=float(rng.choice([1000.0, 2000.0]))
        )
        assert without_motor_lines(recording)[1] == ()


@pytest.mark.parametrize("size_rpm", [3.0, 10.0])
def test_a_line_is_taken_out_whole(size_rpm: float) -> None:
    """Also at 125 Hz, with 8 samples a turn, backwards, and another line beside it."""
    for rate_hz, speed_rpm in ((125.0, SPEED_RPM), (1000.0, -2000.0)):
        plain = made(rate_hz, speed_rpm=speed_rpm)
        cleaned, lines = without_motor_lines(with_line(with_line(plain, 1, size_rpm), 2, size_rpm))
        left = cleaned.motor_speed_rpm - plain.motor_speed_rpm
        assert np.sqrt(np.mean(left**2)) < 0.05 * size_rpm
        assert [line.order for line in lines] == [1, 2]
        for line in lines:
            assert line.size_rpm == pytest.approx(size_rpm, rel=0.05)


def test_a_recording_of_a_few_turns_shows_no_line() -> None:
    plain = with_line(made(), 1, 12.0)
    few = slice(0, 500)
    short = replace(
        plain, time_s=plain.time_s[few], channels={MOTOR_SPEED: plain.motor_speed_rpm[few]}
    )
    assert without_motor_lines(short)[1] == ()
