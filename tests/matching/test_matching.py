"""Recordings beside their simulation: shortcuts that must change nothing."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from bayesbl.bench.bench import Bench, BenchEffect, EffectParameterValue
from bayesbl.bench.kernel import CURRENT, SPEED
from bayesbl.bench.motion import cycle
from bayesbl.bench.simulation import Measurement, simulate_channels
from bayesbl.config.bench import reference_bench
from bayesbl.errors import BenchError, RecordingError
from bayesbl.matching.as_observed import RecentSimulations, in_whole_ticks, simulated
from bayesbl.matching.least_squares import fit_simulated
from bayesbl.matching.observed import observed, whole_rotations
from bayesbl.matching.signals import SimulatedSignals, Unknown, gap_unknown, start_angle_unknown
from bayesbl.noise.channel_noise import estimate_channel_noise
from bayesbl.noise.process import NoiseModel
from bayesbl.recording.checks import ready_for_fit
from bayesbl.recording.types import MOTOR_CURRENT, MOTOR_SPEED
from bayesbl.units import RPM_PER_RAD_PER_S

NOISE = Measurement(
    encoder_counts=None, speed_noise=NoiseModel(1.5, (0.6,)), current_noise=NoiseModel(0.05)
)
DRIFT = BenchEffect("friction_drift", {"rate_nm_per_s": EffectParameterValue(1e-3)})
POINTS = np.array([[math.log(8e-4), 1.0], [math.log(9e-4), 2.0], [math.log(8e-4), 1.0]])


def model(bench: Bench, sampling_hz: float = 500.0) -> SimulatedSignals:
    recording = replace(bench, measurement=NOISE).simulate(
        8e-4,
        rotations=2.4,
        sampling_hz=sampling_hz,
        start_angle_rad=1.0,
        name="one",
        seed=np.random.default_rng(1),
    )
    seen = observed(recording, bench)
    noise = estimate_channel_noise(seen.signals, seen.lag)
    unknowns = [gap_unknown(1e-4, 1e-2), start_angle_unknown("one")]
    return SimulatedSignals(bench, [seen], unknowns, [noise])


@pytest.mark.parametrize("effects", [(), (DRIFT,)], ids=["repeats", "drifts"])
def test_whitened_residuals_are_those_of_the_whole_recording(effects) -> None:
    asked = model(reference_bench().with_effects(*effects))
    seen, noise = asked.recordings[0], asked.noise[0]
    assert noise.order > 0
    stretch = asked.stretch(POINTS, 0).shape[2]
    assert stretch == (seen.samples if effects else seen.lag)
    whole = noise.whiten(seen.signals - asked.signals(POINTS, 0))
    assert asked.whitened(POINTS) == pytest.approx(whole.reshape(len(POINTS), -1), abs=1e-9)


@pytest.mark.parametrize("sampling_hz", [250.0, 1000.0])
def test_a_speed_that_is_derived_of_the_position_is_simulated_as_one(sampling_hz: float) -> None:
    bench = replace(reference_bench(), measurement=Measurement(encoder_counts=None))
    clean = bench.simulate(8e-4, rotations=2.4, sampling_hz=sampling_hz, start_angle_rad=1.0)
    speed = clean.motor_speed_rpm[1:]
    channels = {n: row for n, row in clean.channels.items() if n != MOTOR_SPEED}
    seen = observed(ready_for_fit(replace(clean, channels=channels)), bench)
    noise = estimate_channel_noise(seen.signals, seen.lag)
    unknowns = [gap_unknown(1e-4, 1e-2), start_angle_unknown(seen.name)]
    asked = SimulatedSignals(bench, [seen], unknowns, [noise])
    # Its first sample is the second of the position.
    turned = bench.value("reference_speed_rpm") / RPM_PER_RAD_PER_S / sampling_hz
    start = 1.0 + turned / bench.value("gear_ratio")
    simulated = asked.signals(np.array([[math.log(8e-4), start]]), 0)[0]
    apart = np.abs(simulated[0] - seen.signals[0]).max()
    assert apart < 0.05
    # A momentary speed it is not.
    assert np.abs(speed - seen.signals[0]).max() > 20.0 * apart


@pytest.mark.parametrize(("samples", "rotations"), [(300, 3), (298, 3), (297, 2), (203, 2)])
def test_what_whitening_takes_of_a_rotation_leaves_it_one(samples: int, rotations: int) -> None:
    assert whole_rotations(np.ones(samples), 100).shape == (rotations, 100)


def test_recordings_of_one_name_are_refused() -> None:
    """The start angle of one would be given to both."""
    asked = model(reference_bench())
    with pytest.raises(ValueError, match="two are alike"):
        replace(asked, recordings=2 * asked.recordings, noise=2 * asked.noise)


@pytest.mark.parametrize("speed_rpm", [2000.0, -2000.0])
@pytest.mark.parametrize("position_gain_per_s", [0.0, 5.0, 20.0])
@pytest.mark.parametrize("start_angle_rad", [0.3, 2.0])
def test_a_current_of_the_other_sign_is_refused_in_either_direction(
    speed_rpm: float, position_gain_per_s: float, start_angle_rad: float
) -> None:
    """A position loop, or a part of a rotation, turns the slope of the slow part alone."""
    bench = replace(reference_bench(), measurement=NOISE)
    bench = bench.with_parameters(position_gain_per_s=position_gain_per_s)
    recording = bench.simulate(
        8e-4,
        rotations=2.4,
        seed=np.random.default_rng(1),
        reference_speed_rpm=speed_rpm,
        start_angle_rad=start_angle_rad,
    )
    observed(recording, bench)
    turned = {MOTOR_CURRENT: -recording.channels[MOTOR_CURRENT]}
    with pytest.raises(RecordingError, match="rises with the speed"):
        observed(replace(recording, channels={**recording.channels, **turned}), bench)


@pytest.mark.parametrize("position_gain_per_s", [0.0, 5.0])
@pytest.mark.parametrize("fed_forward_a_s_per_rpm", [0.0, 2e-3])
def test_in_a_motion_too_whatever_the_drive_feeds_forward(
    position_gain_per_s: float, fed_forward_a_s_per_rpm: float
) -> None:
    """Current for the acceleration, several times what it takes, and the speed that it leads to."""
    bench = replace(reference_bench(), measurement=NOISE)
    bench = bench.with_parameters(position_gain_per_s=position_gain_per_s)
    motion = cycle(bench.value("gear_ratio"), (-0.5, 0.5), 1500.0, 6000.0, 0.15, 8.0)
    made = bench.simulate(8e-4, motion, seed=np.random.default_rng(1))
    acceleration = np.gradient(motion.speed_rpm(made.time_s), made.time_s)
    speed = made.motor_speed_rpm + 2e-3 * acceleration * (fed_forward_a_s_per_rpm > 0.0)
    for sign in (1.0, -1.0):
        current = sign * (made.channels[MOTOR_CURRENT] + fed_forward_a_s_per_rpm * acceleration)
        channels = {**made.channels, MOTOR_SPEED: speed, MOTOR_CURRENT: current}
        if sign > 0.0:
            observed(replace(made, channels=channels), bench)
        else:
            with pytest.raises(RecordingError, match="rises with the speed"):
                observed(replace(made, channels=channels), bench)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_noise_of_the_encoder_that_is_answered_a_tick_later_turns_no_sign(sign: float) -> None:
    """It rises and falls from tick to tick, and the current with the speed, later by one."""
    bench = reference_bench()
    recording = bench.simulate(8e-4, rotations=2.4)
    gain = bench.value("speed_gain_nm_s_per_rad") / bench.value("torque_constant_nm_per_a")
    steps = np.diff(np.random.default_rng(2).standard_normal(recording.samples + 2))
    current = recording.channels[MOTOR_CURRENT] - gain * steps[:-1]
    noisy = {
        MOTOR_SPEED: recording.motor_speed_rpm + RPM_PER_RAD_PER_S * steps[1:],
        MOTOR_CURRENT: sign * current,
    }
    seen = replace(recording, channels={**recording.channels, **noisy})
    slope = np.polyfit(seen.motor_speed_rpm, current, 1)[0]
    assert slope > 0.0  # over all frequencies the current rises with the speed
    if sign > 0.0:
        observed(seen, bench)
    else:
        with pytest.raises(RecordingError, match="rises with the speed"):
            observed(seen, bench)


def test_noise_of_the_encoder_that_hides_the_ringing_shows_no_sign() -> None:
    """Sampled more slowly than it is controlled, the current may rise with the noise."""
    bench = reference_bench()
    recording = bench.simulate(8e-4, rotations=5.0)
    gain = bench.value("speed_gain_nm_s_per_rad") / bench.value("torque_constant_nm_per_a")
    noise = 20.0 * np.random.default_rng(3).standard_normal(recording.samples)
    noisy = {
        MOTOR_SPEED: recording.motor_speed_rpm + RPM_PER_RAD_PER_S * noise,
        MOTOR_CURRENT: recording.channels[MOTOR_CURRENT] + 0.5 * gain * noise,
    }
    observed(replace(recording, channels={**recording.channels, **noisy}), bench)


def test_a_fit_says_why_its_bench_cannot_be_simulated() -> None:
    asked = model(reference_bench())
    weak = replace(asked, bench=reference_bench().with_parameters(current_limit_a=3.0))
    with pytest.raises(BenchError, match="cannot turn the load round"):
        fit_simulated(weak, POINTS[0])


def test_recordings_are_whitened_again_where_the_noise_is_another() -> None:
    asked = model(reference_bench())
    other = [replace(noise, root=2.0 * noise.root) for noise in asked.noise]
    white = asked.whitened(POINTS)
    assert asked.with_unknowns(asked.bench, []).whitened(POINTS) == pytest.approx(white)
    assert replace(asked, noise=other).whitened(POINTS) == pytest.approx(0.5 * white)


def test_a_steady_rotation_repeats_in_a_run_over_all_of_them() -> None:
    # A drift too small to matter makes the same bench run through the whole recording.
    tiny = BenchEffect("friction_drift", {"rate_nm_per_s": EffectParameterValue(1e-15)})
    once = model(reference_bench())
    whole = model(reference_bench().with_effects(tiny))
    accuracy_rpm = 0.003 * once.noise[0].sd[0]
    gap = np.abs(once.signals(POINTS, 0) - whole.signals(POINTS, 0))
    assert gap[:, 0].max() < 2.0 * accuracy_rpm


def test_a_phase_that_nothing_tells_keeps_the_prior_of_an_angle() -> None:
    names = ("torque_nm", "order", "phase_rad")
    values = {name: EffectParameterValue(v) for name, v in zip(names, (0.0, 6.0, 0.0), strict=True)}
    asked = model(reference_bench().with_effects(BenchEffect("motor_torque_ripple", values)))
    unknowns = (*asked.unknowns, Unknown("motor_torque_ripple__phase_rad"))
    free = SimulatedSignals(asked.bench, asked.recordings, unknowns, asked.noise)
    fit = fit_simulated(free, np.array([math.log(8e-4), 1.0, 0.0]))
    assert fit.sd("motor_torque_ripple__phase_rad") == pytest.approx(math.pi / math.sqrt(3.0))
    assert fit.sd("start_angle_rad", "one") < 0.01


@pytest.mark.filterwarnings("error")
def test_what_no_signal_depends_on_stays_where_it_is() -> None:
    """The torque constant, where the speed alone is compared: its tolerance decides."""
    asked = model(reference_bench())
    seen = asked.recordings[0]
    speed = replace(seen, signals=seen.signals[:1])
    alone = estimate_channel_noise(speed.signals, speed.lag)
    believed = reference_bench().value("torque_constant_nm_per_a")
    middle = math.log(believed)
    constant = Unknown("torque_constant_nm_per_a", centre=middle, sd=0.14, logarithmic=True)
    free = SimulatedSignals(asked.bench, [speed], (*asked.unknowns, constant), [alone])
    fit = fit_simulated(free, np.array([math.log(8.2e-4), 1.0, math.log(believed)]))
    assert fit.value(constant.name) == pytest.approx(believed, rel=1e-12)
    assert fit.sd(constant.name) == pytest.approx(constant.prior_sd, rel=1e-3)


def test_what_was_simulated_is_neither_made_nor_changed_again() -> None:
    asked: list[int] = []

    def simulate(matrix):
        asked.append(len(matrix))
        return matrix[:, None, :] ** 2

    recent = RecentSimulations()
    rows = np.arange(12.0).reshape(4, 3)
    first = recent.signals(rows[:3], "a", simulate)
    first[:] = np.nan  # what a caller does to its array is its own affair
    again = recent.signals(rows[[3, 1, 0]], "a", simulate)
    assert np.array_equal(again, rows[[3, 1, 0], None, :] ** 2)
    recent.signals(rows[:1], "b", simulate)
    assert asked == [3, 1, 1]


def test_the_oldest_simulations_are_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[float] = []

    def simulate(matrix):
        asked.extend(matrix[:, 0])
        return matrix[:, None, :]

    monkeypatch.setattr("bayesbl.matching.as_observed.MOST_BYTES", 2 * 8 * 5)
    recent = RecentSimulations()
    for value in (1.0, 2.0, 1.0, 3.0, 1.0, 2.0):
        recent.signals(np.full((1, 5), value), None, simulate)
    assert asked == [1.0, 2.0, 3.0, 2.0]
    # More at once than are kept, known ones among them.
    many = np.repeat(np.array([[2.0], [4.0], [5.0], [1.0], [6.0]]), 5, axis=1)
    assert np.array_equal(recent.signals(many, None, simulate)[:, 0], many)


@pytest.mark.parametrize("reference_rpm", [1987.3, -1987.3])
@pytest.mark.parametrize("period_s", [0.0, 2.5e-4])
def test_a_rotation_holds_all_samples_of_a_steady_run(
    period_s: float, reference_rpm: float
) -> None:
    """No whole number of samples fits into a rotation; the long run is the independent answer."""
    bench = reference_bench()
    if period_s > 0.0:
        values = {"period_s": EffectParameterValue(period_s)}
        bench = bench.with_effects(BenchEffect("sampled_control", values))
    recording = bench.simulate(8e-4, rotations=3.3, name="one", reference_speed_rpm=reference_rpm)
    seen = observed(recording, bench, reference_rpm)
    matrix = bench.vector(
        gap_rad=8e-4, start_angle_rad=1.0, reference_speed_rpm=seen.reference_speed_rpm
    )
    matrix = in_whole_ticks(matrix, seen)
    folded = simulated(seen, seen.samples, 1e-3, 1, "raise", matrix)
    long = simulate_channels(matrix, seen.samples, seen.sampling_hz, accuracy_rpm=1e-3)
    assert folded[:, 0] == pytest.approx(long[:, SPEED], abs=1e-3)
    assert folded[:, 1] == pytest.approx(long[:, CURRENT], abs=1e-4)
