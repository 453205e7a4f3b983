"""Laws of the filter that the noise's colour tells: its size, its sign, and nothing of a level."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from places import CONFIGS
from scipy.signal import lfilter

from bayesbl.config.bench import load_bench
from bayesbl.measurement.same_joint import (
    FilterChange,
    NoiseSpectrum,
    change_reason,
    filter_change,
    noise_spectrum,
    same_joint,
)
from bayesbl.noise.process import NoiseModel
from bayesbl.recording.types import MOTOR_CURRENT, MOTOR_SPEED, Recording
from bayesbl.ringing.estimator import Estimator, PointEstimate
from bayesbl.ringing.symbols import FREQUENCY

BENCH = load_bench(CONFIGS / "bench.toml")
SAMPLING_HZ = 500.0
LAG_S = 4e-3
DEVIATIONS = 3.5
"""Fails by chance in 1 of 2000."""


@cache
def recording(
    seed: int,
    noise_rpm: float = 0.5,
    *,
    speed_rpm: float = 2000.0,
    sampling_hz: float = SAMPLING_HZ,
    rotations: float = 5.0,
) -> Recording:
    """By the speed alone."""
    generator = np.random.default_rng(seed)
    noise = replace(BENCH.measurement, speed_noise=NoiseModel(noise_rpm))
    made = replace(BENCH, measurement=noise).simulate(
        8e-4,
        rotations=rotations,
        sampling_hz=sampling_hz,
        reference_speed_rpm=speed_rpm,
        start_angle_rad=generator.uniform(0.0, 6.0),
        seed=generator,
    )
    kept = {name: values for name, values in made.channels.items() if name != MOTOR_CURRENT}
    return replace(made, channels=kept)


def smoothed(made: Recording, time_s: float) -> Recording:
    """Through a first-order filter; of a square window for a negative time."""
    speed = made.motor_speed_rpm
    if time_s > 0.0:
        keep = math.exp(-1.0 / (SAMPLING_HZ * time_s))
        passed = lfilter([1.0 - keep], [1.0, -keep], speed - speed[0]) + speed[0]
    else:
        width = round(-time_s * SAMPLING_HZ)
        passed = lfilter(np.full(width, 1.0 / width), [1.0], speed - speed[0]) + speed[0]
    return replace(made, channels={**made.channels, MOTOR_SPEED: passed})


def point(made: Recording) -> PointEstimate:
    return Estimator().estimate(made, np.random.SeedSequence(1))


def spectrum(made: Recording) -> NoiseSpectrum:
    found = noise_spectrum(point(made))
    assert found is not None
    return found


def between(first: Recording, other: Recording) -> FilterChange:
    found = filter_change(spectrum(first), spectrum(other), DEVIATIONS)
    assert found is not None
    return found


def test_a_filter_that_was_taken_away_is_found_with_what_it_did_to_the_ringing() -> None:
    made = point(recording(2))
    keep = math.exp(-1.0 / (SAMPLING_HZ * LAG_S))
    turn = np.exp(-1j * made.optimum.symbols[FREQUENCY] / SAMPLING_HZ)
    passed = abs((1.0 - keep) / (1.0 - keep * turn))
    found = between(smoothed(recording(1), LAG_S), recording(2))
    assert found.deviations > DEVIATIONS
    assert found.low < -math.log(passed) < found.high
    assert found.high - found.low < 0.05


@pytest.mark.long
def test_the_other_way_round_the_sign_is_the_other() -> None:
    first, other = smoothed(recording(1), LAG_S), recording(2)
    there, back = between(first, other), between(other, first)
    assert back.deviations < -DEVIATIONS
    # The ringing's frequency, by which a filter is measured, differs by a per cent.
    assert back.log_amplitude == pytest.approx(-there.log_amplitude, rel=0.1)


@pytest.mark.long
@pytest.mark.parametrize("noise_rpm", [0.05, 0.5, 1.5])
def test_another_level_of_noise_is_no_other_filter(noise_rpm: float) -> None:
    found = between(recording(1), recording(2, noise_rpm))
    assert abs(found.deviations) < DEVIATIONS


@pytest.mark.long
@pytest.mark.parametrize(
    "other",
    [{"speed_rpm": 1999.5}, {"speed_rpm": -1990.0}, {"sampling_hz": 250.0}, {"rotations": 2.0}],
    ids=str,
)
def test_samples_at_other_places_are_no_other_filter(other: dict[str, float]) -> None:
    """Rotations of a whole number of samples beside others, which are read between samples."""
    first, second = recording(1), recording(2, **other)
    assert abs(between(first, second).deviations) < DEVIATIONS
    assert same_joint([point(first), point(second)], (False, False))["agrees"]


def test_what_shows_no_noise_tells_no_filter() -> None:
    """Without noise, or where all that shows lies below twice the ringing: a blind spot."""
    silent = point(recording(1, 0.0))
    assert noise_spectrum(silent) is None
    slow = replace(spectrum(recording(1)), highest_hz=20.0)
    assert filter_change(slow, spectrum(recording(2)), DEVIATIONS) is None
    check = same_joint([silent, point(recording(2))], (False, False))
    assert "filter_unseen" in {spot["code"] for spot in check["blind_spots"]}


@pytest.mark.parametrize("time_s", [LAG_S, -0.02])
def test_without_a_current_a_changed_filter_is_no_wear(time_s: float) -> None:
    """The same gap, its ringing lower in the first snapshot behind a filter."""
    check = same_joint([point(smoothed(recording(1), time_s)), point(recording(2))], (False, False))
    assert "speed_averaging" in check["could_be"]
    assert "filter_changed" in {one["code"] for one in change_reason(check).values["also"]}


@pytest.mark.long
def test_what_the_noise_cannot_show_is_a_blind_spot() -> None:
    check = same_joint([point(recording(1)), point(recording(2))], (False, False))
    assert check["agrees"]
    assert "small_filter_unseen" in {spot["code"] for spot in check["blind_spots"]}
