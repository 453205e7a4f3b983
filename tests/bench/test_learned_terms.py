"""Learned terms, a torque and an error of the encoder: simulator and bench files agree on them."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_recordings import start_state
from scipy.integrate import solve_ivp

from bayesbl.bench.bench import Bench
from bayesbl.bench.effects import repeat_each_rotation, turn_with_the_motor
from bayesbl.bench.kernel import DAHL, INTEGRAL, MOTOR_ANGLE, MOTOR_SPEED, RPM, TWIST, TWIST_SPEED
from bayesbl.bench.learned import LearnedTerm
from bayesbl.bench.simulation import simulate_channels
from bayesbl.config.bench import dump_bench, load_bench, parse_bench, reference_bench
from bayesbl.errors import BenchError, ConfigError

BENCH = reference_bench()
TURN = 2.0 * math.pi
GAP_RAD = 8e-4

TORQUES = {
    "over the load angle": LearnedTerm(
        "load", "load_angle", TURN, 2.0, (5.0, 0.0, 3.0), (-4.0, 6.0, 1.0)
    ),
    "reversing": LearnedTerm("motor", "load_angle", TURN, 0.1, (0.05,), (-0.02,), reverses=True),
    "over the motor angle": LearnedTerm(
        "motor", "motor_angle", TURN * 1.37, 0.0, (0.05, 0.02), (0.01, -0.03)
    ),
    "over the speed": LearnedTerm("motor", "motor_speed", 900.0, 0.0, (0.05,), (0.1,)),
    "over time": LearnedTerm("motor", "time", 0.137, 0.0, (0.05, 0.0), (0.0, 0.02)),
}
ERROR = LearnedTerm(
    "encoder", "motor_angle", TURN, 0.0, (3e-4, -1e-4, 0.0, 5e-5), (1e-4, 2e-4, 0.0, -2e-5)
)
EACH = pytest.mark.parametrize("torque", list(TORQUES.values()), ids=list(TORQUES))


def having(term: LearnedTerm) -> Bench:
    return replace(BENCH, gap_form="dead_zone", **{term.block: term})


@pytest.mark.parametrize(
    "term",
    [ERROR, *(pytest.param(torque, marks=pytest.mark.long) for torque in TORQUES.values())],
    ids=["error of the encoder", *TORQUES],
)
def test_the_simulator_agrees_with_scipy(term: LearnedTerm) -> None:
    bench = having(term)
    p = {name: item.value for name, item in bench.parameters.items()}
    n, speed_ref = p["gear_ratio"], -2000.0 / RPM
    settings = {"gap_rad": GAP_RAD, "start_angle_rad": 0.4, "reference_speed_rpm": -2000.0}
    run = bench.vector(**settings)
    state = start_state(run[0])
    assert state[DAHL] == 0.0

    def shown(angle: float, speed: float) -> tuple[float, float]:
        """Angle and speed that the encoder shows."""
        if not term.is_of_encoder:
            return angle, speed
        ahead = 1e-6
        error, before, after = term.over(angle - n * 0.4 + np.array([0.0, -ahead, ahead]))
        return angle + error, speed * (1.0 + (after - before) / (2.0 * ahead))

    def drive(y: np.ndarray) -> tuple[float, float]:
        error = speed_ref - shown(y[0], y[1])[1]
        torque = p["speed_gain_nm_s_per_rad"] * error + p["integral_gain_nm_per_rad"] * y[4]
        return torque, error

    def learned(t: float, angle: float, speed: float, load_angle: float) -> float:
        if term.is_of_encoder:
            return 0.0
        x = {
            "motor_angle": angle - n * 0.4,
            "load_angle": load_angle,
            "motor_speed": speed,
            "time": t,
        }[term.variable]
        sign = math.tanh(speed / (5e-4 * abs(speed_ref))) if term.reverses else 1.0
        return sign * float(term.over(np.array(x)))

    def slopes(t: float, y: np.ndarray) -> list[float]:
        angle, speed, twist, slip, _ = y
        torque, error = drive(y)
        shaft = 0.0
        if abs(twist) > GAP_RAD:
            shaft = p["shaft_stiffness_nm_per_rad"] * (twist - math.copysign(GAP_RAD, twist))
            shaft += p["shaft_damping_nm_s_per_rad"] * slip
        load_angle = angle / n - twist
        extra, at_motor = learned(t, angle, speed, load_angle), term.side == "motor"
        load = p["gravity_torque_nm"] * math.sin(load_angle) + extra * (not at_motor)
        acceleration = (torque - shaft / n - extra * at_motor) / p["motor_inertia_kg_m2"]
        twisting = acceleration / n - (shaft - load) / p["load_inertia_kg_m2"]
        return [speed, acceleration, slip, twisting, error]

    time = np.arange(250) / 500.0
    begin = state[[MOTOR_ANGLE, MOTOR_SPEED, TWIST, TWIST_SPEED, INTEGRAL]]
    exact = solve_ivp(
        slopes, (0.0, time[-1]), begin, "DOP853", time, rtol=1e-9, atol=1e-11, max_step=5e-4
    )
    position, speed, current = simulate_channels(run, time.size, 500.0)[0]
    angles, speeds = np.transpose([shown(*y[:2]) for y in exact.y.T])
    torques = [drive(y)[0] for y in exact.y.T]
    assert np.max(np.abs(position - angles)) < 1e-5
    assert np.max(np.abs(speed - RPM * speeds)) < 0.01
    assert np.max(np.abs(current * p["torque_constant_nm_per_a"] - torques)) < 1e-3
    plain = replace(bench, **{term.block: None}).vector(**settings)
    without = simulate_channels(plain, time.size, 500.0)[0]
    assert np.max(np.abs(current - without[2])) > 0.02


@EACH
def test_what_repeats_every_rotation_is_what_is_said_to(torque: LearnedTerm) -> None:
    run = having(torque).vector(gap_rad=GAP_RAD, start_angle_rad=0.4)
    speed = simulate_channels(run, 3600, 500.0)[0, 1]
    repeats = bool(np.max(np.abs(speed[1800:] - speed[:1800])) < 0.01)
    assert (
        repeat_each_rotation(run) is repeats is (torque.variable in ("load_angle", "motor_speed"))
    )
    assert turn_with_the_motor(run) is (torque.variable == "motor_angle")


@pytest.mark.parametrize("term", [ERROR, *TORQUES.values()], ids=["error", *TORQUES])
def test_a_bench_file_gives_back_the_same_bench(term: LearnedTerm) -> None:
    bench = having(replace(term, sd=tuple(1e-6 for _ in term.names)))
    assert parse_bench(dump_bench(bench), "bench.toml") == bench
    assert bench.fingerprint() != replace(bench, **{term.block: None}).fingerprint()


def test_a_torque_without_sense_is_refused_in_words(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="as many sines as cosines"):
        LearnedTerm("load", "load_angle", TURN, 0.0, (1.0,), ())
    with pytest.raises(BenchError, match="acts at the motor"):
        LearnedTerm("load", "motor_angle", TURN, 0.0, (1.0,), (1.0,))
    file = tmp_path / "bench.toml"
    text = dump_bench(having(TORQUES["reversing"])).replace("    -0.02,\n", "")
    file.write_text(text)
    with pytest.raises(ConfigError, match="as many sines as cosines"):
        load_bench(file)


@pytest.mark.parametrize("speed_rpm", [1200.0, -2000.0])
def test_each_order_is_its_slope_times_the_speed_through_the_closed_loop(speed_rpm: float) -> None:
    # Without gap and gravity the bench is linear: S = 1/(1 + P C).
    bench = replace(BENCH.with_parameters(gravity_torque_nm=0.0), encoder_error=ERROR)
    p = {name: item.value for name, item in bench.parameters.items()}
    turns, rate = 40, 1000.0
    samples = round(turns * rate * 60.0 / abs(speed_rpm))
    run = bench.vector(gap_rad=0.0, reference_speed_rpm=speed_rpm)
    _, speed, current = simulate_channels(run, samples, rate, accuracy_rpm=1e-4)[0]
    seen_speed, seen_current = (
        2.0 / samples * np.abs(np.fft.rfft(row)[turns * np.arange(1, 5)])
        for row in (speed, current)
    )
    s = 2j * math.pi * abs(speed_rpm) / 60.0 * np.arange(1, 5)
    shaft = p["shaft_stiffness_nm_per_rad"] / s + p["shaft_damping_nm_s_per_rad"]
    load = p["load_inertia_kg_m2"] * s
    carried = load * shaft / (load + shaft) / p["gear_ratio"] ** 2
    plant = 1.0 / (p["motor_inertia_kg_m2"] * s + carried)
    gains = p["speed_gain_nm_s_per_rad"] + p["integral_gain_nm_per_rad"] / s
    size = abs(speed_rpm) * np.arange(1, 5) * np.hypot(ERROR.cosine, ERROR.sine)
    assert ERROR.slopes * abs(speed_rpm) == pytest.approx(size)
    answered = size / np.abs(1.0 + plant * gains)
    driven = answered / RPM * np.abs(gains) / p["torque_constant_nm_per_a"]
    assert seen_speed == pytest.approx(answered, rel=2e-3, abs=2e-3)
    assert seen_current == pytest.approx(driven, rel=2e-3, abs=2e-4)


def test_it_repeats_with_the_load_where_the_gear_ratio_is_whole() -> None:
    run = having(ERROR).vector(gap_rad=GAP_RAD, start_angle_rad=0.4)
    assert repeat_each_rotation(run)
    assert turn_with_the_motor(run)
    odd = having(ERROR).with_parameters(gear_ratio=120.3).vector(gap_rad=GAP_RAD)
    assert not repeat_each_rotation(odd)


def test_an_error_without_sense_is_refused_in_words(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="as many sines as cosines"):
        LearnedTerm("encoder", "motor_angle", TURN, 0.0, (1e-4,), ())
    with pytest.raises(BenchError, match="standard deviation for each coefficient"):
        replace(ERROR, sd=(1e-6,))
    with pytest.raises(BenchError, match="run backwards"):
        LearnedTerm("encoder", "motor_angle", TURN, 0.0, (0.0, 0.6), (0.0, 0.0))
    file = tmp_path / "bench.toml"
    file.write_text(dump_bench(having(ERROR)).replace("    -2e-05,\n", ""))
    with pytest.raises(ConfigError, match="as many sines as cosines"):
        load_bench(file)
    file.write_text(dump_bench(having(ERROR)).replace('"two_mass"', '"rigid"'))
    with pytest.raises(ConfigError, match="Only a bench of two masses"):
        load_bench(file)
