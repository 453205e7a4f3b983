"""A joint that is shaken from outside: the line is found, taken out and allowed for."""

from __future__ import annotations

import math
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from bayesbl.config.bench import reference_bench
from bayesbl.errors import RecordingError
from bayesbl.measurement.direct_route import require_unshaken
from bayesbl.noise.impact_scatter import FACTORS, early_and_late
from bayesbl.noise.outside_lines import OutsideLine, without_outside_lines
from bayesbl.recording.types import MOTOR_SPEED, Recording
from bayesbl.ringing.estimator import Estimator
from bayesbl.ringing.symbols import AMPLITUDE

BENCH = reference_bench()
NOISE_RPM = 1.5


def turning(seed: int, gear_ratio: float = BENCH.value("gear_ratio")) -> Recording:
    bench = BENCH.with_parameters(gear_ratio=gear_ratio)
    made = bench.simulate(8e-4, rotations=5.0, sampling_hz=500.0, start_angle_rad=0.4 + seed)
    noise = np.random.default_rng(seed).normal(0.0, NOISE_RPM, made.samples)
    return replace(made, channels={MOTOR_SPEED: made.motor_speed_rpm + noise})


def lines_of(recording: Recording) -> list[tuple[float, float]]:
    _, lines = without_outside_lines(recording.channels, recording.sampling_period_s)
    return [(line.frequency_hz, line.size_rpm) for line in lines]


def shaken(recording: Recording, size_rpm: float, frequency_hz: float) -> Recording:
    line = size_rpm * np.sin(2.0 * np.pi * frequency_hz * recording.time_s + 0.7)
    return replace(recording, channels={MOTOR_SPEED: recording.motor_speed_rpm + line})


@pytest.mark.parametrize("seed", range(6))
def test_ringing_and_noise_are_no_line(seed: int) -> None:
    assert lines_of(turning(seed)) == []
    assert lines_of(turning(seed, gear_ratio=30.0)) == []


@pytest.mark.parametrize(("size_rpm", "frequency_hz"), [(1.5, 9.7), (8.0, 11.2), (20.0, 17.0)])
def test_a_line_is_found_with_its_frequency_and_size(size_rpm: float, frequency_hz: float) -> None:
    ((frequency, size),) = lines_of(shaken(turning(1), size_rpm, frequency_hz))
    assert frequency == pytest.approx(frequency_hz, abs=0.01)
    assert size == pytest.approx(size_rpm, rel=0.1, abs=0.2)


def test_a_long_recording_sharpens_the_frequency() -> None:
    time_s = np.arange(0.0, 900.0, 2e-3)
    noise = np.random.default_rng(1).normal(0.0, NOISE_RPM, time_s.size)
    speed = 2000.0 + noise + 2.0 * np.sin(2.0 * np.pi * 13.2345 * time_s)
    _, ((line),) = without_outside_lines({MOTOR_SPEED: speed}, 2e-3)
    assert line.frequency_hz == pytest.approx(13.2345, abs=1e-5)
    assert line.size_rpm == pytest.approx(2.0, rel=0.02)


def test_a_line_on_top_leaves_the_amplitude_where_it_was_and_widens_it() -> None:
    seed = np.random.SeedSequence(1)
    alone, beside = (
        Estimator().estimate(made, seed) for made in (turning(1), shaken(turning(1), 8.0, 9.7))
    )
    assert not alone.shaking
    (note,) = beside.notes
    assert "at 9.7 Hz" in note
    sd = math.sqrt(alone.spread.sandwich[0, 0])
    assert beside.optimum.symbols[AMPLITUDE] == pytest.approx(
        alone.optimum.symbols[AMPLITUDE], abs=2.0 * sd
    )
    assert math.sqrt(beside.ringing[1][0, 0]) == pytest.approx(8.0 / math.sqrt(2.0), rel=0.2)


def test_errors_by_shaking_and_by_early_and_late_impacts_are_independent() -> None:
    """Together as wide as independent errors; if they were ordered alike, they would add up."""
    point = Estimator().estimate(turning(1), np.random.SeedSequence(1))
    delays = np.tile([1.0, -1.0], 10)
    losses = 0.05 * early_and_late(delays, 0.01 * np.eye(20), np.zeros(20), np.ones(FACTORS))
    late = replace(point, spread=replace(point.spread, losses=losses))
    size_rpm = 0.05 * point.optimum.symbols[AMPLITUDE]
    errors = late.shaken((OutsideLine(9.7, size_rpm),)).spread.losses - losses
    chance = 1.0 / math.sqrt(FACTORS)
    assert abs(np.corrcoef(losses, errors)[0, 1]) < 3.0 * chance


@pytest.mark.long
@pytest.mark.parametrize(("torque_nm", "frequency_hz"), [(10.0, 9.7), (15.0, 11.2), (20.0, 9.7)])
def test_a_joint_that_is_shaken_is_not_surely_wrong(
    independent: ModuleType, torque_nm: float, frequency_hz: float
) -> None:
    """Within three standard deviations of the amplitude without shaking."""
    values = {name: item.value for name, item in BENCH.parameters.items()}
    truth = independent.plant(values | {"gap_rad": 8e-4, "start_angle_rad": 0.4})
    by = {"outside__shaking_nm": torque_nm, "outside__shaking_hz": frequency_hz}
    still, moved = (
        independent.simulate(made, np.random.default_rng(2), sampling_hz=500.0).recording
        for made in (truth, truth._replace(**by))
    )
    seed = np.random.SeedSequence(1)
    amplitude = Estimator().estimate(still, seed).optimum.symbols[AMPLITUDE]
    centre, covariance = Estimator().estimate(moved, seed).ringing
    assert abs(centre[0] - amplitude) < 3.0 * math.sqrt(covariance[0, 0])


def test_the_direct_route_says_what_shakes_it() -> None:
    require_unshaken(turning(1), BENCH)
    with pytest.raises(RecordingError, match=r"9\.7\d* Hz"):
        require_unshaken(shaken(turning(1), 3.0, 9.7), BENCH)
    # At an order of the load it repeats with it: the simulation's to explain.
    order = 35.0 / BENCH.rotation_period_s()
    require_unshaken(shaken(turning(1), 3.0, order), BENCH)
