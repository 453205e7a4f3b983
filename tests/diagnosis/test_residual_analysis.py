"""Laws of residual analysis: what is planted is found where it is, and noise is nothing."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.signal import lfilter

from bayesbl.diagnosis.groups import plain
from bayesbl.errors import RecordingError
from bayesbl.matching.observed import Observed
from bayesbl.model_search.residuals import Unexplained, analyse_residuals
from bayesbl.presentation.diagnosis import unexplained_phrase

HZ = 500.0
GEAR = 40.0
ROTATIONS = 5
SD = np.array([1.5, 0.05])  # rpm, A
SWING = 30.0  # rpm, by which gravity swings the motor's speed
CHANNELS = ("motor_speed_rpm", "motor_current_a")


def ar_noise(rng, size, phi=0.6):
    white = rng.standard_normal((2, size))
    white[:, 1:] *= math.sqrt(1.0 - phi * phi)
    return SD[:, None] * lfilter([1.0], [1.0, -phi], white)


def recording(seed=None, speed=2000.0, swing=SWING, planted=None, name="made", start=0.4):
    """(Observed, prediction): a swinging speed, a current with two pulses, noise if seeded.

    ``planted(time, motor angle, load angle)`` is what the recording holds beyond its prediction,
    shape (2, n).
    """
    period = 60.0 * GEAR / abs(speed)
    time = np.arange(round(ROTATIONS * period * HZ) + 1) / HZ
    turning = 2.0 * math.pi / period
    load = start + math.copysign(turning, speed) * time
    simulated = np.stack(
        (
            speed + swing * np.sin(load),
            3.0 * np.sin(load) + np.exp(20.0 * (np.cos(load - 1.0) - 1.0)),
        )
    )
    faster = swing / RPM * (math.cos(start) - np.cos(load)) / math.copysign(turning, speed)
    motor = speed / RPM * time + faster
    signals = simulated.copy()
    if planted is not None:
        signals += planted(time, motor, load)
    if seed is not None:
        signals += ar_noise(np.random.default_rng(seed), time.size)
    return Observed(name, signals, HZ, speed, period), simulated


RPM = 60.0 / (2.0 * math.pi)


def in_channel(index, values):
    both = np.zeros((2, values.size))
    both[index] = values
    return both


def analysed(*pairs, **options):
    seen, made = zip(*pairs, strict=True)
    return analyse_residuals(seen, made, **options)


def entries(found, channel=0):
    return [entry for entry in found.remaining if entry.channel == CHANNELS[channel]]


def only(found, channel=0) -> Unexplained:
    (entry,) = entries(found, channel)
    return entry


@pytest.mark.long
def test_noise_alone_shows_a_line_no_more_often_than_stated():
    # At a rate of 0.1 over both channels, 120 recordings of noise: 12 expected at most. More than
    # 24 would happen by chance once in a thousand times.
    alarms = 0
    for seed in range(120):
        found = analysed(recording(seed), false_lines=0.1)
        alarms += any("time" in e.dependence or "motor" in e.dependence for e in found.remaining)
    assert alarms <= 24


def test_noise_alone_is_called_nothing():
    found = analysed(*(recording(seed, speed) for seed, speed in ((1, 2e3), (2, -2e3), (3, 1.2e3))))
    assert not found.remaining


@pytest.mark.parametrize("channel", [0, 1])
@pytest.mark.parametrize(
    ("dependence", "order", "wave"),
    [
        ("motor angle", 3.0, lambda t, m, a: np.cos(3.0 * m + 0.7)),
        ("motor angle", 0.73, lambda t, m, a: np.cos(0.73 * m + 0.7)),
        ("time", 23.7, lambda t, m, a: np.cos(2.0 * np.pi * 23.7 * t + 0.7)),
        ("load angle", 7.0, lambda t, m, a: np.cos(7.0 * (a - 0.4) + 0.7)),
    ],
    ids=["whole motor order", "belt", "time", "load"],
)
def test_a_wave_is_found_in_its_channel_with_its_angle_and_amplitude(
    channel, dependence, order, wave
):
    size = 1.5 * SD[channel]
    found = analysed(
        recording(11, planted=lambda t, m, a: in_channel(channel, size * wave(t, m, a)))
    )
    line = only(found, channel)
    assert line.dependence == dependence
    where = line.frequency_hz if dependence == "time" else line.lowest_order
    assert where == pytest.approx(order, abs=0.02)
    # Standard error of an amplitude where the noise is loudest: sqrt(2·4 sd²/n) = 0.05 sd.
    assert line.amplitude == pytest.approx(size, abs=0.2 * SD[channel])
    assert not entries(found, 1 - channel)


def test_an_evenly_turning_motor_cannot_tell_time_from_angle_but_two_speeds_can():
    def in_time(t, m, a):
        return in_channel(0, 1.5 * np.cos(2.0 * np.pi * 7.3 * t))

    def in_angle(t, m, a):
        return in_channel(0, 1.5 * np.cos(0.73 * m))

    for planted, dependence in ((in_time, "time"), (in_angle, "motor angle")):
        one = recording(5, swing=0.0, planted=planted)
        two = recording(6, speed=1200.0, swing=0.0, planted=planted, name="slow")
        assert only(analysed(one)).dependence == "angle or time"
        both = only(analysed(one, two))
        assert both.dependence == dependence
        assert both.recordings == ("made", "slow")


def test_a_frequency_that_is_a_load_order_by_chance_is_unmasked_by_the_other_speed():
    def in_time(t, m, a):  # load order 12 at 2000 rpm, 20 at 1200 rpm
        return in_channel(0, 1.5 * np.cos(2.0 * np.pi * 10.0 * t))

    one = recording(5, planted=in_time)
    two = recording(6, speed=1200.0, planted=in_time, name="slow")
    assert only(analysed(one)).dependence == "load angle"
    found = analysed(one, two)
    assert [entry.dependence for entry in found.remaining] == ["time"]
    assert found.remaining[0].recordings == ("made", "slow")


def test_mean_squares_are_those_of_what_was_planted():
    def much(t, m, a):
        wave = 2.0 * np.cos(3.0 * m) + 3.0 * np.cos(5.0 * a) + np.sin(2.0 * np.pi * 7.3 * t)
        return in_channel(0, wave + 0.3 * t + 1.0)

    seen, made = recording(3, planted=much)
    found = analysed((seen, made))
    load = next(e for e in found.remaining if e.dependence == "load angle")
    assert load.amplitude == pytest.approx(3.0, rel=0.025)
    drift = 0.3**2 * (seen.samples / HZ) ** 2 / 12.0
    assert found.power == pytest.approx((4.5 + 2.0 + 0.5 + drift) / SD[0] ** 2, rel=0.1)


def test_scaling_a_channel_scales_what_is_found_and_not_how_surely():
    seen, made = recording(7, planted=lambda t, m, a: in_channel(1, 0.03 * np.cos(4.0 * a)))
    factor = np.array([[10.0], [1000.0]])
    scaled = dataclasses.replace(seen, signals=factor * seen.signals - (factor - 1.0) * made)
    small, large = analysed((seen, made)), analysed((scaled, made))
    assert large.power == pytest.approx(small.power, rel=1e-6)
    assert only(large, 1).amplitude == pytest.approx(1000.0 * only(small, 1).amplitude, rel=1e-6)
    assert only(large, 1).lowest_order == only(small, 1).lowest_order


def test_drift_is_measured_within_its_error_and_is_no_line():
    drift = 0.02
    found = analysed(recording(31, planted=lambda t, m, a: in_channel(1, drift * t)))
    kinds = {entry.dependence: entry.amplitude for entry in entries(found, 1)}
    assert kinds.keys() == {"offset", "drift"}
    assert kinds["drift"] == pytest.approx(drift, rel=0.2)


def test_a_loud_line_does_not_hide_a_weak_one():
    def both(t, m, a):
        return in_channel(0, 40.0 * np.cos(0.73 * m) + 1.5 * np.cos(2.0 * np.pi * 13.1 * t))

    loud, weak = entries(analysed(recording(8, planted=both)))
    assert loud.amplitude == pytest.approx(40.0, rel=0.01)
    assert weak.frequency_hz == pytest.approx(13.1, abs=0.02)


def test_too_short_recordings_are_refused():
    seen, made = recording(1)
    short = dataclasses.replace(seen, signals=seen.signals[:, :1000])
    with pytest.raises(RecordingError, match="at least two"):
        analyse_residuals([short], [made[:, :1000]])


@pytest.fixture(scope="module")
def three():
    """Motor order 3 in the speed and a load-angle pulse in the current of three recordings."""

    def planted(t, m, a):
        pulse = 0.4 * np.exp(60.0 * (np.cos(a - 2.0) - 1.0))
        return np.stack((2.0 * np.cos(3.0 * m), pulse))

    runs = [("forward", 2000.0), ("reverse", -2000.0), ("slow", 1200.0)]
    return analysed(
        *(recording(50 + i, v, planted=planted, name=n) for i, (n, v) in enumerate(runs))
    )


def test_what_is_left_is_described_once_for_all_recordings(three):
    entries = three.remaining
    kinds = {(entry.channel, entry.dependence) for entry in entries}
    assert ("motor_speed_rpm", "motor angle") in kinds
    assert ("motor_current_a", "load angle") in kinds
    motor = next(entry for entry in entries if entry.dependence == "motor angle")
    assert motor.recordings == ("forward", "reverse", "slow")
    assert motor.lowest_order == pytest.approx(3.0, abs=1e-3)
    assert unexplained_phrase(plain(motor)).startswith("motor speed: 2.")
    assert unexplained_phrase(plain(motor)).endswith("at order 3 of the motor")
