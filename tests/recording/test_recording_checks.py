"""What a fit asks of a recording: nothing good is turned away, each fault by its own reason."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from places import BEFORE, RECORDINGS

from bayesbl.errors import RecordingError
from bayesbl.recording import checks
from bayesbl.recording.readers import read_recording
from bayesbl.recording.repairs import deviation_from_grid, even
from bayesbl.recording.types import FloatArray, Recording


@pytest.fixture(scope="module")
def example() -> Recording:
    return read_recording(BEFORE)


def with_speed(recording: Recording, speed: FloatArray) -> Recording:
    return replace(recording, channels={**recording.channels, "motor_speed_rpm": speed})


def part(recording: Recording, keep: slice | FloatArray) -> Recording:
    channels = {name: values[keep] for name, values in recording.channels.items()}
    return replace(recording, time_s=recording.time_s[keep], channels=channels)


@pytest.mark.parametrize("name", ["wear_before", "wear_after"])
def test_the_example_recordings_pass_every_check(name: str) -> None:
    checks.ready_for_fit(read_recording(RECORDINGS / f"{name}.csv"), gear_ratio=120.0)


def test_the_examples_hold_five_rotations_by_position_and_by_speed(example: Recording) -> None:
    speed_only = replace(example, channels={"motor_speed_rpm": example.motor_speed_rpm})
    assert checks.rotations_of(example, 120.0) == pytest.approx(5.0, abs=0.01)
    assert checks.rotations_of(speed_only, 120.0) == pytest.approx(5.0, abs=0.01)


@pytest.mark.parametrize("seconds", [7.03, 7.2, 18.0])
def test_two_rotations_are_enough_even_if_a_little_lacks(
    example: Recording, seconds: float
) -> None:
    shorter = part(example, slice(0, int(seconds * 1000)))
    checks.require_rotations(shorter, checks.rotations_of(shorter, 120.0))


def test_less_than_two_rotations_are_refused_with_the_seconds_needed(example: Recording) -> None:
    shorter = part(example, slice(0, 5000))
    with pytest.raises(RecordingError, match=r"1\.39 rotations in 5 s.*at least 2 .*7\.2 s"):
        checks.ready_for_fit(shorter, gear_ratio=120.0)


@pytest.mark.parametrize(
    ("period", "resolution"),
    [(1e-3, 1e-6), (1e-3, 1e-5), (1e-3, 1e-4), (1e-3, 1e-3), (1.25e-3, 1e-3), (1 / 4096, 1e-4)],
)
def test_rounded_time_stamps_count_as_even(period: float, resolution: float) -> None:
    time = np.round(np.arange(20000) * period / resolution) * resolution
    recording = Recording("rounded", time, {"motor_speed_rpm": np.sin(time)})
    checks.require_no_holes(recording)


@pytest.mark.parametrize("lost", [1, 5000, 17990])
def test_a_hole_anywhere_is_noticed(example: Recording, lost: int) -> None:
    kept = np.delete(np.arange(example.samples), np.arange(lost, lost + 3))
    with pytest.raises(RecordingError, match="Samples are missing") as caught:
        checks.require_no_holes(part(example, kept))
    assert f"0.004 s, follows {example.time_s[lost - 1]:.6g} s" in str(caught.value.found)


def test_a_clock_that_keeps_no_pace_gives_the_same_motion_on_an_even_grid() -> None:
    """A logger's loop at some 250 Hz, many samples off any even grid; ringing of 11 Hz."""
    time = np.cumsum(4e-3 * np.random.default_rng(1).uniform(0.6, 1.6, 5000))

    def speed(time_s: np.ndarray) -> np.ndarray:
        return 2000.0 + 30.0 * np.sin(2.0 * np.pi * 11.0 * time_s)

    lost = np.zeros(time.size, dtype=bool)
    lost[2500] = True
    loop = Recording("loop", time, {"motor_speed_rpm": speed(time)}, excluded=lost)
    deviation, _ = deviation_from_grid(time, np.arange(time.size, dtype=float))
    assert np.abs(deviation).max() > 3.0
    checks.require_no_holes(loop)
    grid = even(loop, 0.1)
    np.testing.assert_allclose(np.diff(grid.time_s), grid.sampling_period_s, rtol=1e-9)
    inner = slice(5, -5)
    error = grid.motor_speed_rpm[inner] - speed(grid.time_s[inner])
    assert np.abs(error).max() < 0.005 * 30.0
    assert grid.excluded is not None
    assert abs(np.mean(grid.time_s[grid.excluded]) - time[2500]) < 4e-3


def test_a_missing_channel_is_named_with_its_likely_column(example: Recording) -> None:
    assert example.source is not None
    bare = replace(
        example,
        channels={"motor_current_a": example.channels["motor_current_a"]},
        source=replace(example.source, unused_columns=("motor_speed",)),
    )
    with pytest.raises(RecordingError, match='Did you mean "motor_speed"'):
        checks.ready_for_fit(bare)


@pytest.mark.parametrize("speed", [0.0, 2000.0])
def test_a_constant_speed_is_refused(example: Recording, speed: float) -> None:
    with pytest.raises(RecordingError, match="motor speed never changes"):
        checks.ready_for_fit(with_speed(example, np.full(example.samples, speed)))


@pytest.mark.parametrize("limit", [2012.0, 2020.0, 2028.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_speed_cut_off_at_a_limit_is_refused(
    example: Recording, limit: float, sign: float
) -> None:
    cut = sign * np.minimum(example.motor_speed_rpm, limit)
    side = "largest" if sign > 0 else "smallest"
    with pytest.raises(RecordingError, match=f"cut off.*exactly at the {side} value"):
        checks.require_unclipped(with_speed(example, cut), "motor_speed_rpm")


def ringing(time: FloatArray) -> FloatArray:
    phase = time % 1.8
    return np.asarray(2000.0 + 40.0 * np.exp(-15.0 * phase) * np.sin(62.8 * phase))


NOT_CLIPPED: dict[str, Callable[[FloatArray], FloatArray]] = {
    "pure sine": lambda time: 2000.0 + 10.0 * np.sin(7.0 * time),
    "coarse sine": lambda time: np.round(2000.0 + 10.0 * np.sin(7.0 * time)),
    "very coarse sine": lambda time: np.round(3.4 * np.sin(7.0 * time)),
    "fine sine of a whole number of samples": lambda time: np.sin(2 * np.pi * time),
    "ringing": ringing,
    "coarse ringing": lambda time: np.round(ringing(time)),
    "coarse ringing in half rpm": lambda time: np.round(2 * ringing(time)) / 2,
    "held for ten samples": lambda time: np.repeat(ringing(time)[::10], 10)[: time.size],
    "two levels": lambda time: np.where(np.sin(3 * time) > 0, 1.0, 2.0),
    "ramp": lambda time: np.round(100 * time),
}


@pytest.mark.parametrize("kind", NOT_CLIPPED)
def test_no_signal_that_merely_has_levels_is_called_cut_off(kind: str) -> None:
    time = np.arange(18000) * 1e-3
    checks.require_unclipped(Recording(kind, time, {"x": NOT_CLIPPED[kind](time)}), "x")


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
@pytest.mark.parametrize("smoothing", [1, 5, 20])
def test_speed_from_an_encoder_of_any_resolution_is_not_called_cut_off(
    example: Recording, bits: int, smoothing: int
) -> None:
    count = 2.0 * np.pi / 2**bits
    steps = np.diff(np.round(example.channels["motor_position_rad"] / count))
    speed = np.convolve(steps, np.ones(smoothing) / smoothing, "valid") * count * 9549.3
    recording = Recording("encoder", example.time_s[: speed.size], {"motor_speed_rpm": speed})
    checks.require_unclipped(recording, "motor_speed_rpm")


def test_a_slow_sampling_rate_is_refused_and_a_hundred_hertz_is_not(example: Recording) -> None:
    checks.require_sampling_rate(part(example, slice(None, None, 10)))
    with pytest.raises(RecordingError, match=r"too low.*Found: 40 Hz.*at least 50 Hz"):
        checks.require_sampling_rate(part(example, slice(None, None, 25)))


@pytest.mark.parametrize(
    ("factor", "unit"), [(np.pi / 30.0, "rad/s"), (6.0, "deg/s"), (1.0 / 60.0, "rev/s")]
)
def test_a_speed_in_another_unit_is_recognised_by_the_position(
    example: Recording, factor: float, unit: str
) -> None:
    with pytest.raises(RecordingError, match=f"motor_speed_rpm looks like {unit}, not rpm"):
        checks.ready_for_fit(with_speed(example, example.motor_speed_rpm * factor))


def test_a_position_in_degrees_is_recognised_by_the_speed(example: Recording) -> None:
    degrees = np.degrees(example.channels["motor_position_rad"])
    channels = {**example.channels, "motor_position_rad": degrees}
    with pytest.raises(RecordingError, match="motor_position_rad looks like deg, not rad"):
        checks.ready_for_fit(replace(example, channels=channels))


def test_a_position_alone_gives_the_speed(example: Recording) -> None:
    alone = {"motor_position_rad": example.channels["motor_position_rad"]}
    derived = checks.ready_for_fit(replace(example, channels=alone))
    turned = np.ptp(example.channels["motor_position_rad"])
    lasted = example.time_s[-1] - example.time_s[0]
    assert derived.samples == example.samples - 1
    assert derived.motor_speed_rpm.mean() == pytest.approx(60 / (2 * np.pi) * turned / lasted)
    assert any("that of the position" in note for note in derived.notes)


def test_positions_that_the_recorder_made_up_give_no_speed(example: Recording) -> None:
    time, angle = example.time_s, example.channels["motor_position_rad"]
    drawn = np.interp(time, time[::4], angle[::4])[: 4 * ((time.size - 1) // 4)]
    made_up = replace(
        example, time_s=time[: drawn.size], channels={"motor_position_rad": drawn}, excluded=None
    )
    derived = checks.with_speed(made_up)
    measured = 60 / (2 * np.pi) * np.diff(angle[::4]) / np.diff(time[::4])
    np.testing.assert_allclose(derived.motor_speed_rpm, measured[: derived.samples], rtol=1e-9)


def test_position_and_speed_may_count_in_opposite_directions(example: Recording) -> None:
    checks.require_plausible_speed_unit(with_speed(example, -example.motor_speed_rpm))


@pytest.mark.parametrize("changes_s", [(10.0,), (10.0, 20.5), (6.25, 12.0, 21.0)])
def test_every_speed_of_a_recording_is_named_with_its_time_range(
    changes_s: tuple[float, ...],
) -> None:
    time_s = np.arange(30_000) / 1000.0
    speeds = np.array([1000.0, 1500.0, -1500.0, 800.0])
    noise = np.random.default_rng(1).normal(0.0, 1.5, time_s.size)
    speed = speeds[np.searchsorted(changes_s, time_s, side="right")] + noise
    recording = Recording("steps", time_s, {"motor_speed_rpm": speed})
    with pytest.raises(RecordingError) as caught:
        checks.require_one_speed(recording)
    found = re.findall(r"(\S+) rpm from (\S+) to (\S+) s", str(caught.value.found))
    told = np.array(found, dtype=float)
    edges_s = np.array([0.0, *changes_s, 30.0])
    expected = np.column_stack([speeds[: len(told)], edges_s[:-1], edges_s[1:]])
    np.testing.assert_allclose(told, expected, atol=0.3)


@pytest.mark.parametrize("samples", [3600, 8280, 18000])
def test_the_wave_of_the_load_angle_is_no_drift(example: Recording, samples: int) -> None:
    checks.require_no_drift(part(example, slice(0, samples)))


def test_a_part_at_another_speed_is_named_with_its_time_range(example: Recording) -> None:
    time_s = example.time_s
    slow = np.interp(time_s, [0.0, 2.0, 5.0], [0.2, 0.2, 1.0])
    with pytest.raises(RecordingError, match=r"from 0 to 4\.25 s.* rpm for most"):
        checks.require_one_speed(with_speed(example, slow * example.motor_speed_rpm))


@pytest.mark.parametrize("channel", ["motor_position_rad", "motor_current_a"])
def test_what_is_no_speed_is_asked_for_its_column(example: Recording, channel: str) -> None:
    exchanged = replace(example, channels={"motor_speed_rpm": example.channels[channel]})
    with pytest.raises(RecordingError, match="is this another column"):
        checks.require_one_speed(exchanged)


def test_a_current_a_thousand_times_the_drives_is_refused(example: Recording) -> None:
    checks.require_plausible_current(example, 20.0)
    current = 1e3 * example.channels["motor_current_a"]
    wrong = replace(example, channels={**example.channels, "motor_current_a": current})
    with pytest.raises(RecordingError, match="far beyond the limit"):
        checks.require_plausible_current(wrong, 20.0)
