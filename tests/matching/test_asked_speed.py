"""The reference speed of a recording for which nobody has stated it."""

from __future__ import annotations

import numpy as np
import pytest

from bayesbl.config.bench import reference_bench
from bayesbl.matching.observed import asked_speed
from bayesbl.recording.types import Recording


def recorded(speed_rpm: float, start_angle_rad: float) -> Recording:
    """3.4 rotations: gravity sways the speed once in each, by more than the mean may be off."""
    bench = reference_bench().with_parameters(reference_speed_rpm=speed_rpm)
    return bench.simulate(
        8e-4,
        rotations=3.4,
        sampling_hz=500.0,
        start_angle_rad=start_angle_rad,
        seed=np.random.default_rng(1),
    )


@pytest.mark.parametrize("start_angle_rad", [0.0, 2.0, 4.0])
@pytest.mark.parametrize("speed_rpm", [1200.0, -700.0])
def test_the_reference_is_the_mean_over_whole_rotations(
    speed_rpm: float, start_angle_rad: float
) -> None:
    made = recorded(speed_rpm, start_angle_rad)
    assert asked_speed(made, reference_bench())[0] == speed_rpm


def test_the_benchs_own_speed_needs_no_guess() -> None:
    assert asked_speed(recorded(-2000.0, 1.0), reference_bench()) == (None, "")


def test_a_mean_that_is_no_whole_number_is_taken_as_it_is() -> None:
    speed, told = asked_speed(recorded(1200.5, 1.0), reference_bench())
    assert speed == pytest.approx(1200.5, abs=0.1)
    assert "mean speed" in told
