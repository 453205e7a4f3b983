"""After what time a recording repeats, against benches whose rotation is known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from bayesbl.config.bench import reference_bench
from bayesbl.errors import ConfigError
from bayesbl.matching.observed import SURELY_OTHER, observed
from bayesbl.recording.repetition import Repetition, repetition
from bayesbl.recording.types import MOTOR_SPEED, FloatArray, Recording

BENCH = reference_bench()
ROTATION_S = BENCH.rotation_period_s()
HZ = 500.0
SURE = 4.0
"""Standard deviations: one value in 16,000 is farther off."""
PERIOD_SD = 5.4e-5
"""Of a period, relative: root mean square over forty seeds of such recordings."""


def recorded(speed_rpm: float = 2000.0, seed: int = 3, rotations: float = 3.3) -> Recording:
    return BENCH.with_parameters(reference_speed_rpm=speed_rpm).simulate(
        8e-4,
        rotations=rotations,
        sampling_hz=HZ,
        start_angle_rad=1.0,
        seed=np.random.default_rng(seed),
    )


def slowed(recording: Recording, share: float) -> Recording:
    """As a clock writes it that is fast by this share."""
    return replace(recording, time_s=recording.time_s * (1.0 + share))


def found(speed_rpm: FloatArray, stated_s: float = ROTATION_S) -> Repetition:
    answer = repetition(speed_rpm, HZ, stated_s)
    assert answer is not None
    return answer


@pytest.mark.parametrize("seed", range(4))
def test_a_recording_as_stated_is_found_as_stated(seed: int) -> None:
    """By a χ² of 25 once in 30,000 recordings, of those that repeat less than these do."""
    answer = found(recorded(seed=seed).motor_speed_rpm)
    assert answer.gain < SURELY_OTHER**2
    assert answer.period_s == pytest.approx(ROTATION_S, rel=SURE * PERIOD_SD)
    assert abs(answer.mean_rpm - 2000.0) < SURE * answer.mean_sd_rpm
    assert answer.motor_turns == pytest.approx(BENCH.value("gear_ratio"), rel=SURE * PERIOD_SD)


@pytest.mark.parametrize("off", [-0.01, -0.002, 0.002, 0.01])
def test_the_period_is_found_wherever_it_was_stated(off: float) -> None:
    speed = recorded().motor_speed_rpm
    answer = found(speed, ROTATION_S * (1.0 + off))
    assert answer.period_s == pytest.approx(found(speed).period_s, rel=2e-5)
    assert answer.gain > SURELY_OTHER**2


def test_neither_direction_nor_unit_matter() -> None:
    speed = recorded().motor_speed_rpm
    same, other = found(speed), found(-speed)
    assert (other.period_s, other.gain) == pytest.approx((same.period_s, same.gain), rel=1e-9)
    assert other.mean_rpm == same.mean_rpm
    # A time that is counted in other units is found in these.
    assert repetition(speed, 10.0 * HZ, 0.1 * ROTATION_S) is not None


@pytest.mark.parametrize("order", [1, 5])
def test_a_line_of_the_motor_is_not_taken_for_the_load(order: int) -> None:
    """Beside a gear ratio of 120.4 it repeats after 120 turns, 0.3 % early."""
    ratio = 120.4
    bench = BENCH.with_parameters(gear_ratio=ratio)
    made = bench.simulate(8e-4, rotations=3.3, sampling_hz=HZ, seed=np.random.default_rng(2))
    speed = made.motor_speed_rpm
    angle = np.cumsum(speed) / HZ * math.pi / 30.0
    answer = found(speed + 4.0 * np.cos(order * angle), bench.rotation_period_s())
    assert answer.motor_turns == pytest.approx(ratio, rel=SURE * PERIOD_SD)


@pytest.mark.parametrize("seed", range(4))
def test_a_machine_that_shakes_the_joint_moves_no_period(seed: int) -> None:
    """At 7.3 Hz its wave repeats best 1.1 % early, with a χ² of 214 or more if it counted."""
    speed = recorded(seed=seed).motor_speed_rpm
    shaken = speed + 6.0 * np.cos(2.0 * math.pi * 7.3 / HZ * np.arange(speed.size) + seed)
    answer = repetition(shaken, HZ, ROTATION_S)
    assert answer is None or answer.gain < SURELY_OTHER**2


def test_noise_repeats_after_no_time() -> None:
    speed = 2000.0 + np.random.default_rng(4).standard_normal(6000)
    answer = repetition(speed, HZ, ROTATION_S)
    assert answer is None or answer.gain < SURELY_OTHER**2
    assert repetition(speed[:3000], HZ, ROTATION_S) is None


def test_what_is_compared_does_not_depend_on_the_recorders_clock() -> None:
    made = recorded()
    right, late = observed(made, BENCH), observed(slowed(made, 8e-4), BENCH)
    assert right.notes == ()
    assert "% later" in late.notes[0]
    assert late.sampling_hz == pytest.approx(right.sampling_hz, rel=SURE * PERIOD_SD)
    assert late.reference_speed_rpm == right.reference_speed_rpm
    assert late.lag == right.lag


def test_a_mean_speed_that_is_not_the_stated_one_is_the_reference() -> None:
    made = recorded(speed_rpm=1993.0)
    seen = observed(made, BENCH)
    assert seen.reference_speed_rpm == pytest.approx(1993.0, abs=0.2)
    assert seen.sampling_hz == pytest.approx(HZ, rel=SURE * PERIOD_SD)
    assert "1993" in seen.notes[0]


def test_a_controller_without_integral_keeps_no_mean() -> None:
    """Friction, or a load that is not in balance, then takes it off its reference."""
    made = recorded()
    off = {**made.channels, MOTOR_SPEED: made.motor_speed_rpm - 3.0}
    bench = BENCH.with_parameters(integral_gain_nm_per_rad=0.0)
    seen = observed(replace(made, channels=off), bench)
    assert seen.reference_speed_rpm == 2000.0


def test_a_gear_ratio_that_was_rounded_is_refused_with_the_right_one() -> None:
    bench = BENCH.with_parameters(gear_ratio=120.3)
    with pytest.raises(ConfigError, match=r"gear_ratio.*120\.3") as refused:
        observed(recorded(), bench)
    assert refused.value.found is not None
    turns = float(refused.value.found.split()[0])
    assert turns == pytest.approx(120.0, rel=SURE * PERIOD_SD)
