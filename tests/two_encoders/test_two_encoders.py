"""Laws of play from two encoders: a load that is dragged through the play, and real joints."""

from __future__ import annotations

import numpy as np
import pytest
from places import ROOT

import bayesbl
from bayesbl.measurement.two_encoder_route import upper_bound_rad
from bayesbl.recording.types import MOTOR_TORQUE
from bayesbl.two_encoders.paths import Channels, load_lag, scaled_paths
from bayesbl.two_encoders.transmission import (
    FRICTION_SPREAD,
    LOGITS,
    Noise,
    Scaling,
    _model,
    drawn_parts,
    fit_transmission,
    has_one_speed,
    of_friction,
)

DATA = ROOT.parent / "shared" / "data"
PLAY, RATIO, SKEW_S = 6e-3, 50.0, 2e-3

needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the measured recordings are not here")


def dragged(path, half):
    load, at = [], path[0]
    for x in path:
        at = min(max(at, x - half), x + half)
        load.append(at)
    return np.array(load)


def recorded(
    play=PLAY, ratio=RATIO, skew_s=SKEW_S, eccentric=2e-3, seed=0, offset=0.0, oval=0.0, wound=0.0
):
    """Uneven stamps of a sine and its harmonic, the load's encoder of 2^16 counts.

    ``oval`` of its ring, and what viscous friction winds up at the usual speed, rad.
    """
    generator = np.random.default_rng(seed)
    time = np.arange(0.0, 16.0, 5e-4)
    path = 0.7 * np.sin(2.0 * np.pi * time / 2.0) + 0.3 * np.sin(2.0 * np.pi * time / 3.1)
    speed = np.gradient(path, time)
    load = dragged(path, 0.5 * play) - wound * speed / np.std(speed)
    stamps = np.sort(generator.uniform(0.1, 15.9, 1600))
    at = np.interp(stamps - skew_s, time, load)
    step = 2.0 * np.pi / 2**16
    curve = eccentric * np.sin(at + 1.0) + oval * np.sin(2.0 * at + 0.3)
    read = step * np.round((at + curve) / step)
    motor = ratio * np.interp(stamps, time, path)
    return Channels(stamps, motor + offset, read - offset)


def fitted(channels, ratio=RATIO):
    return fit_transmission(channels, np.random.SeedSequence(1), np.random.SeedSequence(2), ratio)


def bounds(values, level=0.95):
    return np.quantile(values, (0.5 - 0.5 * level, 0.5 + 0.5 * level))


@pytest.fixture(scope="module")
def answer():
    return fitted(recorded())


def test_a_load_that_stays_lags_as_the_play_operator():
    path = np.cumsum(np.random.default_rng(1).standard_normal(500)) * 1e-3
    time = 1e-3 * np.arange(500)
    found = load_lag(path, np.gradient(path, time), time, 4e-3, np.inf, 0.0)
    np.testing.assert_allclose(found, path - dragged(path, 4e-3), atol=1e-15)


def test_a_load_without_friction_keeps_its_speed_until_a_flank_takes_it():
    time = 1e-3 * np.arange(1000)
    path = np.where(time < 0.5, time, 0.5)
    speed = np.where(time < 0.5, 1.0, 0.0)
    found = load_lag(path, speed, time, 0.05, 0.0, 0.05)
    assert found[499] == pytest.approx(0.05)
    assert found[-1] == pytest.approx(-0.05)
    # 0.1 rad of play at 1 rad/s takes 0.1 s.
    assert found[550] == pytest.approx(0.0, abs=2e-3)


def test_a_load_that_coasts_starts_with_the_speed_of_the_motor():
    time = 1e-3 * np.arange(1000)
    found = load_lag(-time, np.full(1000, -1.0), time, 0.05, 0.0, 0.02)
    np.testing.assert_allclose(found, 0.02, atol=1e-9)


def test_a_count_does_not_average_where_the_encoder_stands():
    step = 2.0 * np.pi / 4096
    time = 1e-3 * np.arange(8000)
    motor = np.clip(np.abs(time - 4.0) - 2.0, 0.0, None) ** 2
    load = step * np.round(motor / step)
    paths = scaled_paths(Channels(time, motor, load), 1.0)
    variance = paths.reading_variance()
    rest = np.argmin(np.abs(paths.binned(paths.time_s) - 4.0))
    assert variance[rest] == pytest.approx(step**2 / 12.0, rel=0.01)
    assert np.median(variance) < 0.2 * step**2 / 12.0


def test_at_the_corners_of_a_fast_motion_a_skew_of_some_samples_is_no_falling_load():
    generator = np.random.default_rng(8)
    time = np.arange(0.0, 14.0, 5e-4)
    strokes = np.clip(np.arcsin(np.sin(2.0 * np.pi * time / 3.0)), -1.0, 1.0)
    window = np.hanning(81)
    path = 6.0 * np.convolve(np.pad(strokes, 40, "edge"), window / window.sum(), "valid")
    stamps = np.arange(0.05, 13.9, 1.0 / 95.0)
    stamps += 3e-3 * generator.uniform(-1.0, 1.0, stamps.size)
    load = np.interp(stamps - 4e-3, time, dragged(path, 0.5 * PLAY))
    load += 2e-5 * generator.standard_normal(load.size)
    found = fitted(Channels(stamps, RATIO * np.interp(stamps, time, path), load))
    for name, truth in (("play_rad", PLAY), ("channel_skew_s", 4e-3), ("gear_ratio", RATIO)):
        low, high = bounds(found.draws[name], 0.99)
        assert low <= truth <= high, name
    assert np.median(found.draws["play_rad"]) == pytest.approx(PLAY, rel=0.05)


def test_play_skew_and_ratio_are_what_the_joint_has(answer):
    for name, truth in (
        ("play_rad", PLAY),
        ("lost_motion_rad", PLAY),
        ("gear_ratio", RATIO),
        ("channel_skew_s", SKEW_S),
    ):
        low, high = bounds(answer.draws[name], 0.99)
        assert low <= truth <= high, name
    assert answer.probability_of_play > 0.95
    # Without a torque a part of it may be wind-up, so the play is less well known than this.
    assert np.ptp(bounds(answer.draws["lost_motion_rad"])) < 0.2 * PLAY


def test_of_a_play_that_grows_on_the_way_the_interval_has_both():
    plain = recorded(eccentric=0.0)
    half = np.where(plain.time_s < 8.0, 0.5, 1.0) * PLAY
    path = plain.motor_rad / RATIO
    load, at = [], path[0]
    for x, gap in zip(path, half, strict=True):
        at = min(max(at, x - gap), x + gap)
        load.append(at)
    found = fitted(Channels(plain.time_s, plain.motor_rad, np.array(load)))
    low, high = bounds(found.draws["play_rad"], 0.9)
    assert low < PLAY
    assert high > 2.0 * PLAY
    assert found.half_lag_rad == pytest.approx((0.5 * PLAY, PLAY), rel=0.1)


def test_a_reading_that_wanders_over_many_strokes_hides_no_play():
    play = 5e-4
    time = np.linspace(0.0, 40.0, 40_000)
    path = 1.3 * np.sin(2.0 * np.pi * time / 3.0) + 0.7 * np.sin(2.0 * np.pi * time / 7.1)
    load, path, time = dragged(path, 0.5 * play)[::20], path[::20], time[::20]
    read = load + 1e-3 * np.sin(load + 1.0) + 3e-5 * np.random.default_rng(3).normal(size=time.size)
    warmth = 4e-3 * (1.0 - np.exp(-time / 20.0))
    steady, warm = (fitted(Channels(time, RATIO * path, r), None) for r in (read, read + warmth))
    for found in (steady, warm):
        assert play < 2.0 * upper_bound_rad(found) < 1.4 * play
    spread, wider = (np.std(found.draws["lost_motion_rad"]) for found in (steady, warm))
    assert wider < 2.0 * spread


def test_sign_offset_and_an_unknown_ratio_change_nothing(answer):
    other = fitted(recorded(ratio=-RATIO, offset=11.0), None)
    for name in ("play_rad", "lost_motion_rad"):
        low, high = bounds(answer.draws[name], 0.99)
        assert low <= np.median(other.draws[name]) <= high
    assert np.median(other.draws["gear_ratio"]) == pytest.approx(-RATIO, rel=0.02)


def test_eccentric_and_skewed_encoders_are_no_play():
    found = fitted(recorded(play=0.0, skew_s=-5e-3, eccentric=8e-3), 1.004 * RATIO)
    assert found.probability_of_play < 0.95
    assert np.quantile(found.draws["delta_rad"], 0.95) < 2e-4
    low, high = bounds(found.draws["channel_skew_s"], 0.99)
    assert low <= -5e-3 <= high


@pytest.mark.parametrize("oval", [1e-3, -1e-3])
def test_an_oval_ring_over_a_part_of_a_turn_is_not_another_gear_ratio(oval):
    low, high = bounds(fitted(recorded(oval=oval)).draws["gear_ratio"], 0.99)
    assert low <= RATIO <= high


@pytest.mark.parametrize("wound", [3e-5, -3e-5])
def test_twist_by_viscous_friction_is_not_taken_for_a_skew_that_is_known(wound):
    low, high = bounds(fitted(recorded(wound=wound)).draws["channel_skew_s"], 0.99)
    assert low <= SKEW_S <= high


def test_the_published_backlash_of_two_actuators_is_not_confirmed():
    table = DATA / "planetary_compact"
    if not table.is_dir():
        pytest.skip("the measured recordings are not here")
    for name, ratio, published in (("sspg", 7.2, 0.59), ("cpg", 14.0, 2.6)):
        (file,) = table.glob(f"{name}_backlash*.csv.gz")
        columns = np.genfromtxt(file, delimiter=",", names=True)
        _, once = np.unique(columns["time_s"], return_index=True)
        time, motor, load = (
            columns[c][once] for c in ("time_s", "odrive_pos_rad", "output_pos_rad")
        )
        found = fitted(Channels(time, motor, load), ratio)
        # The branches are 0.06 and 0.08 degrees apart: play is at most that.
        assert np.quantile(found.draws["play_rad"], 0.95) < np.deg2rad(0.08)
        assert np.quantile(found.draws["lost_motion_rad"], 0.95) < 0.2 * np.deg2rad(published)


@needs_data
def test_a_skew_of_3_ms_of_a_large_robot_is_no_play():
    columns = np.genfromtxt(DATA / "kuka_kr300_axis1_B.csv", delimiter=",", names=True)
    channels = Channels(
        columns["time_s"],
        columns["motor_position_rad"],
        columns["load_position_rad"],
        columns[MOTOR_TORQUE],
    )
    found = fitted(channels, 256.857)
    assert np.median(found.draws["channel_skew_s"]) == pytest.approx(3.0e-3, abs=0.2e-3)
    assert np.quantile(found.draws["delta_rad"], 0.95) < 5e-5


def weighed(motor, half, step, seed, eccentric=3e-3, phase=0.0):
    """A load that its weight moves between the flanks, its reading eccentric and noisy."""
    load, at, speed = [], motor[0] - half, 0.0
    for x, taken in zip(motor, np.gradient(motor, step), strict=True):
        pull = -40.0 * np.sin(at + 0.1)
        rubs = 6.0 * step
        speed += pull * step
        speed = 0.0 if abs(speed) <= rubs else speed - np.sign(speed) * rubs
        at += speed * step
        if abs(at - x) >= half:
            at, speed = x + np.sign(at - x) * half, taken
        load.append(at)
    read = np.array(load) + eccentric * np.sin(np.array(load) + phase)
    return read + 2e-5 * np.random.default_rng(seed).standard_normal(read.size)


def test_a_load_that_its_weight_moves_shows_its_play():
    step, half = 5e-4, 2.5e-3
    time = np.arange(0.0, 24.0, step)
    motor = 0.4 * np.sin(np.pi * time) + 0.6 * np.sin(0.43 * np.pi * time)
    read = weighed(motor, half, step, 3)
    found = fitted(Channels(time[::8], RATIO * motor[::8], read[::8]))
    low, high = bounds(found.draws["delta_rad"], 0.99)
    assert low <= half <= high
    assert np.median(found.draws["delta_rad"]) == pytest.approx(half, rel=0.05)
    assert found.probability_of_play > 0.95
    # Wind-up can move like this too: only a torque tells whether weight holds a load.
    assert np.isnan(found.gravity_holds)


def test_a_small_play_of_a_load_with_weight_shows_behind_a_large_eccentricity():
    step, half = 5e-4, 1e-3
    time = np.arange(0.0, 24.0, step)
    motor = 0.4 * np.sin(np.pi * time) + 0.6 * np.sin(0.43 * np.pi * time)
    read = weighed(motor, half, step, 3, eccentric=15e-3, phase=0.7)
    found = fitted(Channels(time[::8], RATIO * motor[::8], read[::8]), None)
    delta = found.draws["delta_rad"]
    assert np.quantile(delta, 0.99) >= half
    assert np.median(delta) == pytest.approx(half, rel=0.05)


def test_a_load_over_its_balance_hides_no_play_in_ratio_and_transmission_error():
    """Its flank is one of the angle, the same both ways but for the friction."""
    step, half = 5e-4, 0.035
    time = np.arange(0.0, 20.0, step)
    motor = 1.6 * np.sin(2.0 * np.pi * 0.55 * time)
    late = round(3e-3 / step)
    read = weighed(motor, half, step, 5)[:-late]
    found = fitted(Channels(time[late::20], RATIO * motor[late::20], read[::20]), None)
    low, high = bounds(found.draws["delta_rad"], 0.99)
    assert low <= half <= high < 1.3 * half
    assert np.median(found.draws["gear_ratio"]) == pytest.approx(RATIO, rel=0.01)
    assert found.probability_of_play > 0.95


def test_a_heavy_load_with_less_play_is_not_told_from_a_light_one_with_more():
    """Over a pendulum's balance, on encoders of 12 bits: other weights count too."""
    step, half, count = 5e-4, 0.03, 2.0 * np.pi / 2**12
    time = np.arange(0.0, 36.0, step)
    motor = np.sin(0.8 * np.pi * time + 0.4)
    paths = motor[::20], weighed(motor, half, step, 5, eccentric=8e-3)[::20]
    noises = (
        np.random.default_rng(seed).normal(scale=0.3, size=time[::20].size) for seed in (0, 1)
    )
    read = [
        count * np.round(path / count + noise) for path, noise in zip(paths, noises, strict=True)
    ]
    low, high = bounds(fitted(Channels(time[::20], *read), 1.0).draws["delta_rad"], 0.9)
    assert low <= half <= high < 1.3 * half


@pytest.mark.parametrize("most", [2.0, 0.6], ids=["turns", "rests"])
@pytest.mark.parametrize(("wound", "is_play"), [(1.0, False), (0.5, True), (0.1, True)])
def test_the_torque_on_the_way_tells_wind_up_from_play(wound, is_play, most):
    """At rest the motor needs no friction of its own, and the joint stays wound up."""
    generator = np.random.default_rng(4)
    half, friction = 1e-3, 20.0
    time = np.arange(0.0, 20.0, 2e-3)
    path = 0.7 * np.sin(np.pi * time) + 0.3 * np.sin(2.0 * np.pi * time / 3.1)
    path = np.clip(path, -most, most)
    load = dragged(path, half)
    lag = (path - load) / half
    # Of its whole way a part ``wound`` hands the load's friction over, half of it at each end.
    handed = np.sign(lag) * np.clip(1.0 - (1.0 - np.abs(lag)) / wound, 0.0, 1.0)
    if wound == 1.0:
        handed = lag
    torque = friction * handed + 0.5 * friction * np.sign(np.gradient(path))
    torque += 0.05 * friction * generator.standard_normal(time.size)
    read = load + 2e-6 * generator.standard_normal(time.size)
    found = fitted(Channels(time, RATIO * path, read, torque / RATIO))
    assert (found.probability_of_play > 0.95) == is_play
    low, high = bounds(found.draws["lost_motion_rad"], 0.99)
    assert low <= 2.0 * half <= high
    low, high = bounds(found.draws["play_rad"], 0.99)
    assert low <= 2.0 * (1.0 - wound) * half <= high


@pytest.mark.parametrize("half", [2e-3, 2e-2])
def test_a_torque_that_bends_the_joint_shows_its_stiffness_and_narrows_its_play(half):
    """A brake at the output that pulls to and fro, too weakly to change the flank."""
    generator = np.random.default_rng(9)
    friction, stiffness = 8.0, 3e4
    time = np.arange(0.0, 30.0, 2e-3)
    path = 0.7 * np.sin(np.pi * time) + 0.3 * np.sin(2.0 * np.pi * time / 3.1)
    pulled = 4.0 * np.sin(2.0 * np.pi * time / 7.3)
    load, at = [], path[0]
    for x, brake in zip(path, pulled, strict=True):
        behind, ahead = (half + (friction + sign * brake) / stiffness for sign in (1.0, -1.0))
        at = min(max(at, x - behind), x + ahead)
        load.append(at)
    wound = path - load
    torque = stiffness * (wound - np.clip(wound, -half, half)) + 5.0 * np.sign(np.gradient(path))
    torque += 0.4 * generator.standard_normal(time.size)
    read = load + 5e-6 * generator.standard_normal(time.size)
    found = fitted(Channels(time, RATIO * path, read, torque / RATIO))
    low, high = bounds(found.draws["compliance_rad_per_nm"], 0.95)
    assert low <= 1.0 / stiffness <= high < 1.3 * low
    low, high = bounds(found.draws["play_rad"], 0.95)
    assert low <= 2.0 * half <= high < 1.2 * low


def test_a_torque_that_the_motor_alone_needs_tells_no_stiffness():
    generator = np.random.default_rng(10)
    time = np.arange(0.0, 30.0, 2e-3)
    path = 0.7 * np.sin(np.pi * time) + 0.3 * np.sin(2.0 * np.pi * time / 3.1)
    read = dragged(path, 2e-3) + 5e-6 * generator.standard_normal(time.size)
    torque = 13.0 * np.sign(np.gradient(path)) + 4.0 * np.sin(2.0 * np.pi * time / 7.3)
    found = fitted(Channels(time, RATIO * path, read, torque / RATIO))
    assert "compliance_rad_per_nm" not in found.draws
    low, high = bounds(found.draws["play_rad"], 0.99)
    assert low <= 4e-3 <= high


def test_misfit_of_which_no_stroke_repeats_another_leaves_wide_play_certain():
    """An elastic load whose flank wanders from stroke to stroke, thirty strokes long."""
    generator = np.random.default_rng(11)
    time = np.arange(0.0, 60.0, 5e-3)
    path = 0.5 * np.sin(2.0 * np.pi * time / 4.0) + 0.2 * np.sin(2.0 * np.pi * time / 2.7)
    knots = np.arange(0.0, 62.0, 2.0)
    wanders = np.interp(time, knots, 4e-4 * generator.standard_normal(knots.size))
    load = dragged(path, 2e-3) + wanders
    found = fitted(Channels(time, RATIO * path, load + 2e-5 * generator.standard_normal(time.size)))
    low, high = bounds(found.draws["lost_motion_rad"], 0.95)
    assert low <= 4e-3 <= high < 1.2 * low


def test_a_load_that_drags_the_motor_shows_the_same_play():
    generator = np.random.default_rng(5)
    time = np.arange(0.0, 20.0, 5e-3)
    path = 0.7 * np.sin(np.pi * time) + 0.3 * np.sin(2.0 * np.pi * time / 3.1)
    read = path + 2e-6 * generator.standard_normal(time.size)
    found = fitted(Channels(time, RATIO * dragged(path, 0.5 * PLAY), read))
    low, high = bounds(found.draws["play_rad"], 0.99)
    assert low <= PLAY <= high
    assert found.probability_of_play > 0.95


@pytest.mark.parametrize(
    ("weight", "held"), [((0.0, 0.0), 0.0), ((0.0, 9.0), 0.0), ((3.0, 0.0), 1.0)]
)
def test_only_weight_on_one_side_holds_a_load_on_a_flank(weight, held):
    """Inertia does not, nor weight or a spring that pulls to both sides."""
    time = np.arange(0.0, 20.0, 5e-3)
    waves = [np.sin(np.pi * rate * time) / rate for rate in (1.0, 2.7)]
    path = 0.2 * np.sum(waves, axis=0)
    torque = np.gradient(np.gradient(path, time), time) + np.sign(np.gradient(path))
    torque += weight[0] + weight[1] * np.sin(path)
    friction, share, _ = of_friction(scaled_paths(Channels(time, path, path, torque), 1.0))
    assert friction == pytest.approx(1.0, rel=0.1)
    assert share == pytest.approx(held, abs=0.1)


@pytest.mark.parametrize("restitution", [0.0, 0.5, 0.9])
def test_of_a_load_without_friction_that_bounces_the_play_is_not_told_wrong(restitution):
    generator = np.random.default_rng(int(10.0 * restitution))
    step, half = 5e-4, 0.5
    time = np.arange(0.0, 16.0, step)
    motor = 2.0 * np.sin(np.pi * time)
    load, at, speed = [], motor[0] - half, 0.0
    for x, taken in zip(motor, np.gradient(motor, step), strict=True):
        at += speed * step
        if abs(at - x) >= half:
            side = np.sign(at - x)
            at = x + side * half
            if side * (speed - taken) > 0.0:
                speed = taken - restitution * (speed - taken)
        load.append(at)
    read = np.array(load)[::8] + 1e-4 * generator.standard_normal(time[::8].size)
    found = fitted(Channels(time[::8], RATIO * motor[::8], read))
    low, high = bounds(found.draws["delta_rad"], 0.99)
    if found.probability_of_play < 0.95:
        # Then the bound is what is reported.
        high = upper_bound_rad(found)
    assert low <= half <= high


def at_one_speed(half, skew_s, period_s=4e-3):
    generator = np.random.default_rng(0)
    time = np.arange(0.0, 80.0, 4e-3)
    ends = 0.9 * 2.0 / np.pi * np.arcsin(np.sin(2.0 * np.pi * time / 4.5))
    window = np.ones(25) / 25.0
    path = np.convolve(np.pad(ends, 25, "edge"), window, "same")[25:-25]
    load = np.interp(time - skew_s, time, dragged(path, half))
    step = 2.0 * np.pi / 2**17
    read = step * np.round((load + 2e-5 * generator.standard_normal(time.size)) / step)
    every = round(period_s / 4e-3)
    return fitted(Channels(time[::every], RATIO * path[::every], read[::every]))


@pytest.mark.parametrize(("half", "skew_s"), [(5e-3, 0.0), (0.0, 0.01)])
def test_at_one_speed_a_skew_is_not_told_from_play_but_play_is(half, skew_s):
    found = at_one_speed(half, skew_s)
    assert found.skew_or_play == (skew_s > 0.0)
    if not found.skew_or_play:
        low, high = bounds(found.draws["delta_rad"], 0.9)
        assert low <= half <= high < 1.2 * half


@pytest.mark.parametrize("skew_s", [-0.02, 0.03, 0.06])
def test_at_one_speed_channels_of_a_network_are_not_told_as_play(skew_s):
    half = 8e-3
    found = at_one_speed(half, skew_s, period_s=2e-2)
    low = bounds(found.draws["delta_rad"], 0.99)[0]
    sure = found.probability_of_play >= 0.95
    assert found.skew_or_play or (low if sure else 0.0) <= half <= upper_bound_rad(found)


def test_a_standstill_is_seen_once_however_long_it_lasts():
    time = 1e-2 * np.arange(2000)
    motor = np.interp(time, [0.0, 2.0, 12.0, 14.0, 20.0], [0.0, 1.0, 1.0, 0.0, 1.0])
    paths = scaled_paths(Channels(time, motor, motor), 1.0)
    inside = (time[paths.bins[:-1]] > 2.5) & (time[paths.bins[:-1]] < 11.5)
    assert inside.sum() == 0


def test_a_load_that_coasts_leaves_its_flank_when_the_motor_slows_down_faster():
    # At once, by whatever little: half the difference of both decelerations times the time squared.
    time = 2e-3 * np.arange(400)
    slows, drag, half = 10.0, 8.0, 0.05
    since = np.maximum(time - 0.2, 0.0)
    speed = 3.0 - slows * since
    path = 3.0 * time - 0.5 * slows * since**2
    found = load_lag(path, speed, time, half, drag, half)
    left = since < 0.25
    expected = half - 0.5 * (slows - drag) * since**2
    np.testing.assert_allclose(found[left], expected[left], atol=1e-4)


def driven(path, step, half, stiffness, damping, friction):
    """A load of inertia one behind a dead zone with a spring and a damper, with dry friction."""
    load, at, speed = [], path[0], 0.0
    for x, taken in zip(path, np.gradient(path, step), strict=True):
        over = max(x - at - half, 0.0) + min(x - at + half, 0.0)
        push = stiffness * over + damping * (taken - speed) * (over != 0.0)
        speed += step * push
        rubs = friction * step
        speed = 0.0 if abs(speed) <= rubs else speed - np.sign(speed) * rubs
        at += step * speed
        load.append(at)
    return np.array(load)


@pytest.mark.parametrize("seed", range(4))
def test_at_one_speed_a_load_that_coasts_is_not_measured_too_surely(seed):
    """There a skew moves both directions as a play does: what tells them apart is the passage."""
    generator = np.random.default_rng(100 + seed)
    step, half = 1e-4, 2.8e-3
    time = np.arange(0.0, 30.0, step)
    corners = np.arcsin(np.sin(2.0 * np.pi * time / generator.uniform(4.0, 8.0)))
    window = np.ones(601) / 601.0
    path = 0.65 * np.convolve(np.pad(corners, 300, "edge"), window, "valid")
    load = driven(
        path, step, half, 8e4, generator.uniform(50.0, 300.0), generator.uniform(6.0, 40.0)
    )
    stamps = np.arange(0.1, 29.8, 5e-3)
    skew_s = generator.uniform(-3e-3, 3e-3)
    count = 2.0 * np.pi / 2**15
    read = count * np.round(np.interp(stamps - skew_s, time, load) / count)
    found = fitted(Channels(stamps, RATIO * np.interp(stamps, time, path), read))
    low, high = bounds(found.draws["delta_rad"], 0.95)
    assert low <= half <= high


@pytest.mark.parametrize("drag", [np.inf, 8.0])
def test_a_motor_that_a_fast_load_drags_and_that_coasts_shows_the_play(drag):
    time = np.arange(0.0, 40.0, 1e-3)
    load = 0.8 * np.sin(2.0 * np.pi * 0.4 * time) + 0.3 * np.sin(2.0 * np.pi * 0.7 * time)
    motor = load - load_lag(load, np.gradient(load, time), time, 0.02, drag, 0.02)
    step = 2.0 * np.pi / 2**14
    channels = Channels(time[::10], RATIO * motor[::10], step * np.round(load[::10] / step))
    low, high = bounds(fitted(channels).draws["play_rad"], 0.99)
    assert low <= 0.04 <= high


def test_passages_at_one_speed_do_not_tell_a_skew_from_a_load_that_coasts():
    generator = np.random.default_rng(3)
    step, half, speed = 2e-3, 0.0346, 0.17
    turns = generator.choice([-1.0, 1.0], 72).repeat(round(1.146 / step))
    smooth = np.convolve(turns, np.ones(25) / 25.0, "same")
    path = speed * step * np.cumsum(smooth)
    time = step * np.arange(path.size)
    load = path - load_lag(path, speed * smooth, time, half, 2.6, 0.0)
    count = 2.0 * np.pi / 1024
    channels = Channels(time[::5], RATIO * path[::5], count * np.floor(load[::5] / count))
    found = fitted(channels)
    low, high = bounds(found.draws["lost_motion_rad"], 0.99)
    assert low <= 2.0 * half <= high


def test_a_wide_gap_is_seen_even_if_it_was_taken_for_drift_before():
    time, half = 0.01 * np.arange(4000), 0.3
    hand = np.sin(2.0 * np.pi * 0.23 * time) + 0.4 * np.sin(2.0 * np.pi * 0.31 * time)
    load = hand + 1e-4 * np.random.default_rng(7).standard_normal(time.size)
    goes_home = np.sign(hand) * np.maximum(np.abs(hand) - half, 0.0)
    model = _model(Channels(time, goes_home, load), Scaling(1.0, 1.0, True))
    freely = next(k for k, course in enumerate(model.courses) if course.free)
    model.measure_lag(model.fitted(0, 0.0, Noise(1e-3, 0.2, 2.0, 1e-3))[1])
    noise, cell = model.fitted(freely, half, Noise(1e-3, 0.2, 2.0, 1e-3))
    assert cell.log_evidence > model.fitted(0, 0.0, noise)[1].log_evidence


def test_a_wide_lag_that_no_course_follows_is_not_told_as_none():
    generator = np.random.default_rng(5)
    time = 0.01 * np.arange(4000)
    path = 0.8 * np.sin(2.0 * np.pi * 0.2 * time) + 0.3 * np.sin(2.0 * np.pi * 0.33 * time)
    window = np.hanning(60)
    swings = np.convolve(generator.standard_normal(4059), window / np.linalg.norm(window), "valid")
    lag = np.clip(0.03 * swings, -0.05, 0.05)
    found = fitted(Channels(time, RATIO * path, path - lag))
    assert np.quantile(found.draws["lost_motion_rad"], 0.95) > upper_bound_rad(found)


@pytest.mark.parametrize("wound", [1e-3, 2e-3, 4e-3])
def test_without_a_torque_wind_up_is_no_play_that_is_known(wound):
    """A joint that its load's friction winds up by so much each way, and that rings as it must."""
    step, friction = 1e-4, 20.0
    time = np.arange(0.0, 24.0, step)
    path = 0.5 * np.sin(2.0 * np.pi * time / 3.0) + 0.3 * np.sin(2.0 * np.pi * time / 4.7)
    stiffness = friction / wound
    load = driven(path, step, 0.0, stiffness, 0.6 * np.sqrt(stiffness), friction)
    read = load[::40] + 5e-6 * np.random.default_rng(6).standard_normal(load[::40].size)
    found = fitted(Channels(time[::40], RATIO * path[::40], read))
    assert found.probability_of_play < 0.95
    low, high = bounds(found.draws["lost_motion_rad"], 0.99)
    assert low <= 2.0 * wound <= high


def test_recordings_of_a_joint_share_what_is_soft_but_not_the_friction():
    """Of one recording twice: as two of one joint, and as of two joints."""
    time = np.arange(0.0, 24.0, 2e-3)
    path = 0.5 * np.sin(2.0 * np.pi * time / 3.0) + 0.3 * np.sin(2.0 * np.pi * time / 4.7)
    read = path - load_lag(path, np.gradient(path, time), time, 5e-3, np.inf, 0.0)
    read += 2e-5 * np.random.default_rng(3).standard_normal(time.size)
    channels = Channels(time, RATIO * path, read)

    def parts(own, joint):
        seeds = np.random.SeedSequence(own), np.random.SeedSequence(joint)
        draws = fit_transmission(channels, *seeds, RATIO).draws
        return (draws["held_windup_rad"] / draws["lost_motion_rad"]).ravel()

    first, second, other = parts(1, 9), parts(2, 9), parts(3, 8)
    # A part of one is a joint without play.
    soft = [(part > 0.05) & (part < 1.0) for part in (first, second, other)]
    both = soft[0] & soft[1]
    # What is wound up in one is more often than not in the other, and of another joint by chance.
    assert both.mean() > 0.5 * soft[0].mean()
    by_chance = soft[0].mean() * soft[2].mean()
    assert (soft[0] & soft[2]).mean() < by_chance + 5.0 * np.sqrt(by_chance / soft[0].size)
    # Each recording alone says the same, whichever joint it is of.
    shares = [each.mean() for each in soft]
    error = np.sqrt(np.mean(shares) / soft[0].size)
    assert np.ptp(shares) < 5.0 * error


def test_parts_of_two_recordings_differ_by_their_friction():
    density = np.exp(-0.5 * ((LOGITS + 2.0) / 1.5) ** 2)
    joint, first, second = np.random.default_rng(7).standard_normal((3, 20_000))
    logits = [LOGITS[drawn_parts(density, joint, own)] for own in (first, second)]
    # Each alone is of the density; beside it the friction differs by FRICTION_SPREAD in each.
    known = 1.5**2 / (1.5**2 + FRICTION_SPREAD**2)
    assert np.std(logits[0]) == pytest.approx(1.5, rel=0.03)
    expected = FRICTION_SPREAD * np.sqrt(2.0 * known)
    assert np.std(logits[0] - logits[1]) == pytest.approx(expected, rel=0.03)


def test_only_a_motion_to_and_fro_at_a_constant_speed_has_one_speed():
    time = np.arange(0.0, 12.0, 1e-2)
    angle = 2.0 * np.pi * time / 3.0
    for path, is_one in ((np.arcsin(np.sin(angle)), True), (np.sin(angle), False)):
        assert has_one_speed(scaled_paths(Channels(time, path, path), 1.0)) is is_one


def test_a_load_that_turns_further_than_the_motor_is_a_question(tmp_path):
    channels = recorded()
    header = "time_s,motor_position_rad,load_position_rad"
    columns = [channels.time_s, channels.load_rad, channels.motor_rad]
    path = tmp_path / "exchanged.csv"
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="")
    told = bayesbl.fit(path, route="two_encoders").summary
    assert (told["outcome"], told["reason"]["code"]) == ("withheld", "positions_exchanged")
    stated = bayesbl.fit(path, route="two_encoders", gear_ratio=1.0 / RATIO).summary
    assert "positions_exchanged" not in str(stated)
