"""A recording reduced to its mean rotation: what repeats, the noise about it, and its message."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from watch_memory import CONFIG

from bayesbl.config.fleet import FleetConfig
from bayesbl.config.loading import load_config
from bayesbl.fleet.inventory import digest_of_file, find_recordings, read_joints
from bayesbl.fleet.mean_rotation import (
    ROTATION_MESSAGE,
    MeanRotation,
    decoded_rotation,
    encoded_rotation,
    mean_rotation,
    store_rotation,
)
from bayesbl.fleet.measured_joint import JointJob, RecordingAnswer
from bayesbl.fleet.message import decoded, encoded
from bayesbl.runs.fleet import job_maker

ROTATION_S, SAMPLING_HZ, ROTATIONS = 3.6012, 500.0, 20
NOISE_SD, PHI = 1.5, 0.6
UNKNOWN = RecordingAnswer("withheld", "Too noisy.")


def wave(time_s: np.ndarray) -> np.ndarray:
    phase = 2.0 * math.pi * time_s / ROTATION_S
    return 2000.0 + 3.0 * np.sin(phase) + 5.0 * np.cos(9.0 * phase + 0.3)


def job_of(
    folder: Path, speed_rpm: np.ndarray, gear_ratio: str = "", current_a_per_rpm: float = 1e-3
) -> JointJob:
    """A joint's one recording of this speed, with a current that is proportional to it."""
    place = folder / "data/J1/2026-03-01.csv"
    place.parent.mkdir(parents=True)
    time_s = np.arange(speed_rpm.size) / SAMPLING_HZ
    rows = np.column_stack([time_s, speed_rpm, current_a_per_rpm * speed_rpm])
    head = "time_s,motor_speed_rpm,motor_current_a"
    np.savetxt(place, rows, fmt="%.9g", delimiter=",", header=head, comments="")
    (folder / "joints.csv").write_text(f"joint,gear_ratio\nJ1,{gear_ratio}\n")
    (folder / "plant.toml").write_text(CONFIG)
    config = load_config(folder / "plant.toml")
    assert isinstance(config, FleetConfig)
    joints = read_joints(config.fleet)
    (one,) = find_recordings(config.fleet, joints)
    digest, _ = digest_of_file(one.file)
    return job_maker(config)(joints[0], [one], [digest])


def noisy(rng: np.random.Generator) -> np.ndarray:
    time_s = np.arange(round(ROTATIONS * ROTATION_S * SAMPLING_HZ)) / SAMPLING_HZ
    shocks = NOISE_SD * math.sqrt(1.0 - PHI**2) * rng.standard_normal(time_s.size)
    noise = np.zeros(time_s.size)
    for n in range(1, time_s.size):
        noise[n] = PHI * noise[n - 1] + shocks[n]
    return wave(time_s) + noise


@pytest.fixture(scope="module")
def reduced(tmp_path_factory: pytest.TempPathFactory) -> MeanRotation:
    job = job_of(tmp_path_factory.mktemp("plant"), noisy(np.random.default_rng(8)))
    found = mean_rotation(job, 0, replace(UNKNOWN, optimum={"rotation_period_s": ROTATION_S}))
    assert found is not None
    return found


def test_what_repeats_stays_within_the_noise_of_the_mean(reduced):
    speed = reduced.channels["motor_speed_rpm"]
    assert reduced.rotations == ROTATIONS - 1 or reduced.rotations == ROTATIONS
    assert speed.mean.size == round(ROTATION_S * SAMPLING_HZ)
    left = speed.mean - wave(ROTATION_S / speed.mean.size * np.arange(speed.mean.size))
    # 1800 samples of AR(1) noise of 0.6 count as 850 for a variance, (1 − φ²)/(1 + φ²) of them, so
    # this scatters by 2.4 %: three times that. Reading between samples loses up to a fifth of the
    # variance where noise is coloured so.
    expected = NOISE_SD / math.sqrt(reduced.rotations)
    assert 0.8 * expected < left.std() < 1.08 * expected


def test_the_noise_is_told_as_it_is(reduced):
    speed = reduced.channels["motor_speed_rpm"]
    current = reduced.channels["motor_current_a"]
    # 36,000 samples: sd to 0.8 %, φ to 0.004; four times that.
    assert speed.noise_sd == pytest.approx(NOISE_SD, rel=0.035)
    assert speed.noise_coefficients[0] == pytest.approx(PHI, abs=0.025)
    assert current.noise_sd == pytest.approx(1e-3 * speed.noise_sd, rel=1e-3)


def test_the_gear_ratio_tells_the_rotation_where_no_fit_does(tmp_path):
    time_s = np.arange(round(3 * ROTATION_S * SAMPLING_HZ)) / SAMPLING_HZ
    job = job_of(tmp_path, wave(time_s), gear_ratio=f"{2000.0 / 60.0 * ROTATION_S:.9g}")
    found = mean_rotation(job, 0, UNKNOWN)
    assert found is not None
    assert found.rotation_s == pytest.approx(ROTATION_S, rel=1e-4)


def test_a_channel_that_stands_still_is_left_out(tmp_path):
    job = job_of(tmp_path, noisy(np.random.default_rng(9)), current_a_per_rpm=0.0)
    found = mean_rotation(job, 0, replace(UNKNOWN, optimum={"rotation_period_s": ROTATION_S}))
    assert found is not None
    assert list(found.channels) == ["motor_speed_rpm"]
    assert encoded_rotation(found, "d1") is not None


@pytest.mark.parametrize(
    ("duration_s", "rotation_s"),
    [
        pytest.param(3.0 * ROTATION_S, None, id="nobody knows how long one takes"),
        pytest.param(1.4 * ROTATION_S, ROTATION_S, id="too few"),
        pytest.param(0.66, 0.3, id="too few samples to tell their noise"),
    ],
)
def test_without_rotations_to_compare_there_is_none(tmp_path, duration_s, rotation_s):
    time_s = np.arange(round(duration_s * SAMPLING_HZ)) / SAMPLING_HZ
    job = job_of(tmp_path, wave(time_s))
    known = None if rotation_s is None else {"rotation_period_s": rotation_s}
    assert mean_rotation(job, 0, replace(UNKNOWN, optimum=known)) is None


def test_it_comes_as_it_went_but_for_single_precision(reduced):
    message = encoded_rotation(reduced, "d1")
    assert message is not None
    assert len(message) < 25_000
    kind, given, device = decoded(message)
    assert kind == ROTATION_MESSAGE
    found = decoded_rotation(given, device)
    assert found.model_copy(update={"channels": {}}) == reduced.model_copy(
        update={"channels": {}, "device": "d1"}
    )
    for name, own in reduced.channels.items():
        assert found.channels[name].mean == pytest.approx(own.mean, rel=1e-6)
        assert found.channels[name].noise_sd == own.noise_sd
        assert np.array_equal(found.channels[name].noise_coefficients, own.noise_coefficients)


def test_one_that_is_too_large_is_not_sent(reduced):
    speed = reduced.channels["motor_speed_rpm"]
    long = speed.model_copy(update={"mean": np.ones(200_000)})
    assert (
        encoded_rotation(reduced.model_copy(update={"channels": {"motor_speed_rpm": long}}), "d1")
        is None
    )


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"joint": "../J1"}, "joint: "),
        ({"joint": 3}, "joint: "),
        ({"date": "spring"}, "date: "),
        ({"sha256": "../" * 21 + "x"}, "sha256: "),
        ({"rotations": 1}, "rotations: "),
        ({"rotations": 2.0}, "rotations: "),
        ({"rotation_s": 0.0}, "rotation_s: .*than 0"),
        ({"rotation_s": "3"}, "rotation_s: .*number"),
        ({"channels": {}}, "channels: "),
        ({"channels": {"load_position_rad": {}}}, "channels.load_position_rad"),
        ({"channels": {"motor_speed_rpm": {}}}, "mean: .*required"),
        ({"more": 1}, "more: Extra"),
        ({"mean": "no base64!"}, "mean: "),
        ({"mean": ""}, "mean: "),
        ({"mean": "AADAfwAAwH8="}, "no row of numbers"),  # two that are no number
        ({"mean": "AACAPwAAgD8="}, "equally long"),
        ({"noise_sd": -1.0}, "noise_sd: "),
        ({"noise_coefficients": [0.1] * 101}, "noise_coefficients: .*at most"),
        ({"noise_coefficients": [True]}, "noise_coefficients.0: "),
    ],
)
def test_anything_else_is_refused_with_a_reason(reduced, change, told):
    message = encoded_rotation(reduced, "d1")
    assert message is not None
    given = json.loads(message)[ROTATION_MESSAGE]
    speed = given["channels"]["motor_speed_rpm"]
    for key, value in change.items():
        (speed if key in speed else given)[key] = value
    with pytest.raises(ValueError, match=told):
        decoded_rotation(*decoded(encoded(ROTATION_MESSAGE, given, "d1"))[1:])


def test_it_is_stored_as_a_file_that_tells_its_noise(reduced, tmp_path):
    read_table = pytest.importorskip("pyarrow.parquet").read_table
    reduced = reduced.model_copy(update={"device": "d1"})
    store_rotation(reduced, tmp_path)
    store_rotation(reduced, tmp_path)
    (file,) = tmp_path.rglob("*.parquet")
    assert file == tmp_path / "rotations/d1/J1" / f"2026-03-01_{reduced.sha256[:12]}.parquet"
    found = read_table(file)
    assert found.column_names == ["time_s", "motor_speed_rpm", "motor_current_a"]
    step = np.diff(found["time_s"].to_numpy())
    assert step == pytest.approx(ROTATION_S / found.num_rows, rel=1e-9)
    told = {key.decode(): value.decode() for key, value in found.schema.metadata.items()}
    assert told["rotations"] == str(reduced.rotations)
    noise = json.loads(told["noise"])
    assert noise["motor_speed_rpm"]["sd"] == reduced.channels["motor_speed_rpm"].noise_sd
