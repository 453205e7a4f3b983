"""A torque of no known law: the simulator follows it, and bench files carry it."""

from __future__ import annotations

import math
from dataclasses import replace

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
EACH = pytest.mark.parametrize("torque", list(TORQUES.values()), ids=list(TORQUES))


def with_torque(torque: LearnedTerm) -> Bench:
    return replace(BENCH, gap_form="dead_zone", learned_torque=torque)


@pytest.mark.long
@EACH
def test_the_simulator_agrees_with_scipy(torque: LearnedTerm) -> None:
    bench = with_torque(torque)
    p = {name: item.value for name, item in bench.parameters.items()}
    n, speed_ref = p["gear_ratio"], -2000.0 / RPM
    run = bench.vector(gap_rad=GAP_RAD, start_angle_rad=0.4, reference_speed_rpm=-2000.0)
    state = start_state(run[0])
    assert state[DAHL] == 0.0

    def slopes(t: float, y: np.ndarray) -> list[float]:
        angle, speed, twist, slip, integral = y
        error = speed_ref - speed
        drive = p["speed_gain_nm_s_per_rad"] * error + p["integral_gain_nm_per_rad"] * integral
        shaft = 0.0
        if abs(twist) > GAP_RAD:
            shaft = p["shaft_stiffness_nm_per_rad"] * (twist - math.copysign(GAP_RAD, twist))
            shaft += p["shaft_damping_nm_s_per_rad"] * slip
        load_angle = angle / n - twist
        load = p["gravity_torque_nm"] * math.sin(load_angle)
        x = {
            "motor_angle": angle - n * 0.4,
            "load_angle": load_angle,
            "motor_speed": speed,
            "time": t,
        }[torque.variable]
        learned = float(torque.over(np.array(x)))
        if torque.reverses:
            learned *= math.tanh(speed / (5e-4 * abs(speed_ref)))
        at_motor = torque.side == "motor"
        acceleration = (drive - shaft / n - learned * at_motor) / p["motor_inertia_kg_m2"]
        load += learned * (not at_motor)
        twisting = acceleration / n - (shaft - load) / p["load_inertia_kg_m2"]
        return [speed, acceleration, slip, twisting, error]

    time = np.arange(250) / 500.0
    begin = state[[MOTOR_ANGLE, MOTOR_SPEED, TWIST, TWIST_SPEED, INTEGRAL]]
    exact = solve_ivp(
        slopes, (0.0, time[-1]), begin, "DOP853", time, rtol=1e-9, atol=1e-11, max_step=5e-4
    )
    made = simulate_channels(run, time.size, 500.0)[0]
    assert np.max(np.abs(made[1] - RPM * exact.y[1])) < 0.01
    without = simulate_channels(
        replace(bench, learned_torque=None).vector(
            gap_rad=GAP_RAD, start_angle_rad=0.4, reference_speed_rpm=-2000.0
        ),
        time.size,
        500.0,
    )[0]
    assert np.max(np.abs(made[2] - without[2])) > 0.02


@EACH
def test_what_repeats_every_rotation_is_what_is_said_to(torque: LearnedTerm) -> None:
    run = with_torque(torque).vector(gap_rad=GAP_RAD, start_angle_rad=0.4)
    speed = simulate_channels(run, 3600, 500.0)[0, 1]
    repeats = bool(np.max(np.abs(speed[1800:] - speed[:1800])) < 0.01)
    assert (
        repeat_each_rotation(run) is repeats is (torque.variable in ("load_angle", "motor_speed"))
    )
    assert turn_with_the_motor(run) is (torque.variable == "motor_angle")


@EACH
def test_a_bench_file_gives_back_the_same_bench(torque: LearnedTerm) -> None:
    bench = with_torque(replace(torque, sd=tuple(0.1 for _ in torque.names)))
    assert parse_bench(dump_bench(bench), "bench.toml") == bench
    assert bench.fingerprint() != replace(bench, learned_torque=None).fingerprint()


def test_a_torque_without_sense_is_refused_in_words(tmp_path) -> None:
    with pytest.raises(BenchError, match="as many sines as cosines"):
        LearnedTerm("load", "load_angle", TURN, 0.0, (1.0,), ())
    with pytest.raises(BenchError, match="acts at the motor"):
        LearnedTerm("load", "motor_angle", TURN, 0.0, (1.0,), (1.0,))
    file = tmp_path / "bench.toml"
    text = dump_bench(with_torque(TORQUES["reversing"])).replace("    -0.02,\n", "")
    file.write_text(text)
    with pytest.raises(ConfigError, match="as many sines as cosines"):
        load_bench(file)
