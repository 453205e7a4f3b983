"""The independent simulator of the study and the package's own agree, and share only equations."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bayesbl.bench.kernel import Slot
from bayesbl.bench.parameters import BENCH_PARAMETERS
from bayesbl.config.bench import reference_bench

BENCH = reference_bench()
# What has a default, the other simulator has one of its own for, or lacks.
VALUES = {
    info.name: BENCH.value(info.name)
    for info in BENCH_PARAMETERS
    if BENCH.value(info.name) != info.default
}
RUN = {"gap_rad": 8e-4, "start_angle_rad": 0.4, "reference_speed_rpm": -1200.0}
ROTATIONS = 1.1
OUTSIDE = {
    "time torque": {"outside__time_torque_nm": 0.1},
    "belt": {"outside__belt_torque_nm": 0.3},
    "second gap": {"outside__second_gap_rad": 4e-4},
}


@pytest.fixture(scope="module")
def plain(independent):
    return both(independent, {})


def both(independent, effects):
    """Position, speed, current of the package and of the independent simulator."""
    motor = {"motor_start_angle_rad": 0.9}
    package = BENCH.simulate_many(
        **RUN, **motor, **effects, rotations=ROTATIONS, channels="all", accuracy_rpm=1e-3
    )[0]
    made = independent.plant({**VALUES, **RUN, **motor, **effects})
    return package, independent.noise_free(made, ROTATIONS)


def effect(independent, name):
    return {f"{name}__{key}": value for key, value in independent.TYPICAL[name].items()}


def test_without_effects_the_simulators_agree(plain):
    package, own = plain
    assert np.max(np.abs(package - own), axis=1) == pytest.approx([0, 0, 0], abs=1e-3)


@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    [
        "load_coulomb_friction",
        "gear_mesh_friction",
        "gear_transmission_error",
        "encoder_eccentricity",
        "shaft_hysteresis",
        "current_loop_lag",
        "friction_drift",
        "channel_time_skew",
    ],
)
def test_with_an_effect_they_differ_by_far_less_than_it_does(independent, plain, name):
    package, own = both(independent, effect(independent, name))
    change = np.max(np.abs(package - plain[0]), axis=1)
    apart = np.max(np.abs(package - own), axis=1)
    assert np.all(apart[1:] < 0.01 * change[1:])
    assert apart[1] < 0.01


@pytest.mark.long
@pytest.mark.parametrize("time_s", [1e-3, 4e-3, 7.3e-3])
def test_both_average_the_speed_alike(independent, plain, time_s):
    package, own = both(independent, {"speed_averaging__time_s": time_s})
    change = np.max(np.abs(package - plain[0]), axis=1)
    apart = np.max(np.abs(package - own), axis=1)
    assert np.all(apart < 0.005)
    assert apart[1] < 0.01 * change[1]
    assert np.all(change[[0, 2]] < 1e-4)


def test_it_has_no_parameter_that_the_package_has_not_and_twenty_of_its_effects(independent):
    own = {name for name in independent.Plant._fields if not name.startswith("outside__")}
    assert own <= {slot.name for slot in Slot}
    assert len(independent.TYPICAL) >= 20


def test_a_smaller_step_changes_nothing_that_matters(independent, plain):
    made = independent.plant({**VALUES, **RUN, "motor_start_angle_rad": 0.9})
    finer = independent.noise_free(made, ROTATIONS, step_s=1e-5)
    assert np.max(np.abs(finer[1] - plain[1][1])) < 1e-3


@pytest.mark.parametrize("name", OUTSIDE)
def test_what_no_catalogue_holds_is_in_the_signals(independent, plain, name):
    made = independent.plant({**VALUES, **RUN, "motor_start_angle_rad": 0.9, **OUTSIDE[name]})
    change = independent.noise_free(made, ROTATIONS)[1] - plain[1][1]
    assert np.max(np.abs(change)) > 0.3


@pytest.mark.long
def test_a_torque_periodic_in_time_is_a_line_at_its_frequency(independent):
    settings = {**VALUES, **RUN, "gap_rad": 0.0, "gravity_torque_nm": 0.0}
    settings |= {"outside__time_torque_nm": 0.1}
    speed = independent.noise_free(independent.plant(settings), 5.0)[1, :-1]
    spectrum = np.abs(np.fft.rfft(speed - speed.mean()))
    assert np.argmax(spectrum) / (speed.size * 1e-3) == pytest.approx(7.3, abs=0.02)


@pytest.mark.long
def test_a_belt_defect_comes_once_per_belt_turn_and_brakes_nothing_on_average(independent):
    settings = {**VALUES, **RUN, "gap_rad": 0.0, "gravity_torque_nm": 0.0}
    settings |= {"outside__belt_torque_nm": 0.3}
    signals = independent.noise_free(independent.plant(settings), 5.0)[:, :-1]
    spectrum = np.abs(np.fft.rfft(signals[1] - signals[1].mean()))
    strongest = np.argmax(spectrum) / (signals.shape[1] * 1e-3)
    order = strongest * 60.0 / 1200.0
    assert order * 1.37 == pytest.approx(round(order * 1.37), abs=2e-3)
    assert abs(np.mean(signals[2])) < 1e-3


def test_noise_has_the_stated_size_and_colour_and_only_the_truth_knows_the_rest(independent):
    rng = np.random.default_rng(5)
    made = independent.random_recordings(VALUES, {}, rng, speeds_rpm=(2000.0,), rotations=4.0)[0]
    speed = made.recording.channels["motor_speed_rpm"] - made.clean[1]
    current = made.recording.channels["motor_current_a"] - made.clean[2]
    # 14 400 samples: five standard errors of a standard deviation and of a correlation
    assert np.std(speed) == pytest.approx(1.5, rel=0.05)
    assert np.mean(speed[1:] * speed[:-1]) / np.var(speed) == pytest.approx(0.6, abs=0.04)
    assert np.std(current) == pytest.approx(0.05, rel=0.03)
    count = 2.0 * math.pi / 16384
    counts = made.recording.channels["motor_position_rad"] / count
    assert np.allclose(counts, np.round(counts), atol=1e-6)
    assert not made.recording.metadata


def test_lost_samples_are_in_the_recorded_speed_alone(independent):
    settings = {**VALUES, **RUN, "outside__dropouts_per_s": 2.0}
    rng = np.random.default_rng(6)
    quiet = independent.Noise(0.0, 0.0, 0.0)
    made = independent.simulate(independent.plant(settings), rng, rotations=1.0, noise=quiet)
    fallen = np.abs(made.recording.channels["motor_speed_rpm"] - made.clean[1]) > 50.0
    assert 0.001 < np.mean(fallen) < 0.03
    assert np.array_equal(made.recording.channels["motor_current_a"], made.clean[2])
