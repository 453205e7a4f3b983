"""Generated motions: they arrive, and stay within what the drive was given."""

from __future__ import annotations

import numpy as np
import pytest

from bayesbl.bench.kernel import RPM
from bayesbl.bench.motion import cycle, torque_ramps

RATIO, SPEED_RPM, ACCELERATION = 100.0, 1500.0, 6000.0
POINTS = [0.0, 0.9, -0.3]


def kinematics(motion) -> tuple[np.ndarray, ...]:
    """Load angle in rad, motor speed, acceleration and jerk in rpm and s, on a fine grid."""
    time = np.arange(0.0, motion.duration_s, 1e-4)
    speed = motion.speed_rpm(time)
    acceleration = np.gradient(speed, time)
    return motion.position_rad(time) / RATIO, speed, acceleration, np.gradient(acceleration, time)


@pytest.mark.parametrize("jerk", [None, 2e4, 6e4, 1e6])
@pytest.mark.parametrize("points", [POINTS, [0.0, 0.02]], ids=["long", "short"])
def test_a_cycle_reaches_its_points_within_its_limits(jerk, points) -> None:
    motion = cycle(RATIO, points, SPEED_RPM, ACCELERATION, 0.2, 12.0, jerk)
    angle, speed, acceleration, change = kinematics(motion)
    rests = np.abs(speed) < 1e-9
    assert set(np.round(angle[rests], 6)) == set(points)
    assert np.max(np.abs(speed)) <= SPEED_RPM * (1.0 + 1e-9)
    assert np.max(np.abs(acceleration)) <= ACCELERATION * (1.0 + 1e-6)
    if jerk is not None:
        assert np.max(np.abs(change)) <= jerk * (1.0 + 1e-6)


def test_s_curves_are_no_slower_than_their_limits_ask() -> None:
    # A ramp to a speed v at acceleration a and jerk j takes v/a + a/j, where it reaches a.
    jerk = 6e4
    motion = cycle(RATIO, (0.0, 1.0), SPEED_RPM, ACCELERATION, 0.0, 1.5, jerk)
    ramp = SPEED_RPM / ACCELERATION + ACCELERATION / jerk
    whole = RATIO * 1.0 / (SPEED_RPM / RPM) + ramp
    assert motion.speed_rpm(np.array([ramp]))[0] == pytest.approx(SPEED_RPM)
    assert motion.position_rad(np.array([whole]))[0] == pytest.approx(RATIO)
    assert motion.speed_rpm(np.array([0.999 * ramp]))[0] < SPEED_RPM


def test_s_curves_of_a_large_jerk_are_trapezoids() -> None:
    time = np.arange(0.0, 6.0, 1e-3)
    plain = cycle(RATIO, (-0.4, 0.5), SPEED_RPM, ACCELERATION, 0.1, 6.0)
    rounded = cycle(RATIO, (-0.4, 0.5), SPEED_RPM, ACCELERATION, 0.1, 6.0, 1e9)
    assert rounded.position_rad(time) == pytest.approx(plain.position_rad(time), abs=0.01)


@pytest.mark.parametrize("pace", [0.3, 1.0, 2.0])
def test_at_another_pace_a_motion_goes_the_same_way(pace: float) -> None:
    motion = cycle(RATIO, (-0.4, 0.5), SPEED_RPM, ACCELERATION, 0.1, 3.0, 4e4)
    other = motion.at_pace(pace)
    time = np.arange(0.0, 3.0, 1e-3)
    assert other.duration_s == pytest.approx(3.0 / pace)
    assert other.position_rad(time / pace) == pytest.approx(motion.position_rad(time), abs=1e-9)
    assert other.speed_rpm(time / pace) == pytest.approx(pace * motion.speed_rpm(time), abs=1e-6)


def test_torque_goes_to_each_amplitude_and_back() -> None:
    motion = torque_ramps([0.5, 2.0], 3, 4.0)
    torque = motion.speed_rpm(np.array([0.0, 1.0, 2.0, 3.0, 4.0, 13.0, 15.0, 24.0])) / RPM
    assert torque == pytest.approx([0.0, 0.5, 0.0, -0.5, 0.0, 2.0, -2.0, 0.0], abs=1e-12)
    assert motion.duration_s == 24.0
    assert motion.output_held
