"""Laws that the virtual bench obeys, and what it refuses."""

from __future__ import annotations

import math
import pickle
from typing import Any

import numpy as np
import pytest
from scipy.integrate import cumulative_simpson

from bayesbl.bench.bench import Bench, BenchParameter
from bayesbl.bench.kernel import RPM, STATES, Slot
from bayesbl.bench.parameters import BENCH_PARAMETERS, ParameterInfo, check_parameters
from bayesbl.bench.simulation import simulate_channels, simulate_states
from bayesbl.config.bench import reference_bench
from bayesbl.errors import BenchError

BENCH = reference_bench()


def energy(states: np.ndarray, p: np.ndarray, potential: np.ndarray) -> np.ndarray:
    """Kinetic, gravity and shaft energy, J."""
    ratio = p[Slot.gear_ratio]
    load_angle = states[0] / ratio - states[2]
    load_speed = states[1] / ratio - states[3]
    kinetic = 0.5 * p[Slot.motor_inertia_kg_m2] * states[1] ** 2
    kinetic = kinetic + 0.5 * p[Slot.load_inertia_kg_m2] * load_speed**2
    return kinetic - p[Slot.gravity_torque_nm] * np.cos(load_angle) + potential


@pytest.mark.parametrize("hard_dead_zone", [0.0, 1.0])
def test_energy_is_kept_without_control_and_damping(hard_dead_zone: float) -> None:
    gap, cubic = 2e-3, 2e9
    p = BENCH.vector(
        gap_rad=gap,
        hard_dead_zone=hard_dead_zone,
        stiffness_sharpness_per_rad=1e5,
        stiffness_hardening__stiffness_nm_per_rad3=cubic,
    )[0]
    for slot in (
        Slot.shaft_damping_nm_s_per_rad,
        Slot.speed_gain_nm_s_per_rad,
        Slot.integral_gain_nm_per_rad,
    ):
        p[slot] = 0.0
    start = np.zeros(STATES)
    start[1] = 60.0
    start[2] = 6e-3
    states = simulate_states(p, start, 4000, 500.0, accuracy_rpm=1e-3)
    twist = states[2]
    assert twist.min() < -gap
    assert twist.max() > gap

    stiffness = p[Slot.shaft_stiffness_nm_per_rad]
    compression = np.maximum(0.0, np.abs(twist) - gap)
    potential = 0.5 * stiffness * compression**2
    if not hard_dead_zone:
        x = np.linspace(0.0, 1.1 * np.abs(twist).max(), 400_001)
        sharp = 1e5
        k = (
            stiffness
            / math.pi
            * (math.pi + np.arctan(sharp * (x - gap)) - np.arctan(sharp * (x + gap)))
        )
        torque = (x - gap) * k
        potential = np.interp(np.abs(twist), x, cumulative_simpson(torque, x=x, initial=0.0))
    total = energy(states, p, potential + 0.25 * cubic * compression**4)
    swing = np.ptp(0.5 * p[Slot.motor_inertia_kg_m2] * states[1] ** 2)
    assert np.ptp(total) < 1e-4 * swing


def test_damping_only_takes_energy() -> None:
    p = BENCH.vector(gap_rad=1e-3, hard_dead_zone=1.0, gravity_torque_nm=0.0)[0]
    p[Slot.speed_gain_nm_s_per_rad] = p[Slot.integral_gain_nm_per_rad] = 0.0
    start = np.zeros(STATES)
    start[3] = 1.0
    states = simulate_states(p, start, 1000, 500.0)
    compression = np.maximum(0.0, np.abs(states[2]) - 1e-3)
    total = energy(states, p, 0.5 * p[Slot.shaft_stiffness_nm_per_rad] * compression**2)
    assert np.all(np.diff(total) < 1e-6 * total[0])
    assert total[-1] < total[0]


@pytest.mark.parametrize("load_frequency_hz", [0.2, 1.0, 5.0, 12.0, 20.0])
def test_no_gap_gives_the_linear_frequency_response(load_frequency_hz: float) -> None:
    omega = 2.0 * math.pi * load_frequency_hz
    bench = BENCH.with_parameters(gravity_torque_nm=5.0, reference_speed_rpm=omega * 120.0 * RPM)
    rotations, per_rotation = 3, 200
    p = bench.vector(gap_rad=0.0)
    samples = rotations * per_rotation
    rate = per_rotation * load_frequency_hz
    speed = simulate_channels(p, samples, rate, accuracy_rpm=1e-5, speed_alone=True)[0, 0]
    wave = np.exp(-1j * 2.0 * math.pi * np.arange(samples) / per_rotation)
    measured = 2.0 * np.mean((speed - speed.mean()) * wave) / RPM

    def value(name: str) -> float:
        return bench.value(name)

    # Laplace transform of the two masses, PI and shaft, by hand; input: torque on the load.
    s = 1j * omega
    n = value("gear_ratio")
    shaft = value("shaft_stiffness_nm_per_rad") / s + value("shaft_damping_nm_s_per_rad")
    loop = value("speed_gain_nm_s_per_rad") + value("integral_gain_nm_per_rad") / s
    system = np.array(
        [
            [value("motor_inertia_kg_m2") * s + loop + shaft / n**2, -shaft / n],
            [-shaft / n, value("load_inertia_kg_m2") * s + shaft],
        ]
    )
    # −m g l sin(ω t): a sine is Re(−j e^{jωt})
    expected = np.linalg.solve(system, [0.0, 1j * value("gravity_torque_nm")])[0]
    assert abs(measured) == pytest.approx(abs(expected), rel=1e-3)
    assert measured == pytest.approx(expected, rel=3e-3)


def test_arctan_tends_to_the_hard_dead_zone_as_it_sharpens() -> None:
    settings = {"rotations": 1.0, "sampling_hz": 500.0, "accuracy_rpm": 1e-4}
    hard = BENCH.simulate_many(1e-3, hard_dead_zone=1.0, **settings)[0]
    sharpness = np.array([1e5, 1e6, 1e7, 1e8])
    soft = BENCH.simulate_many(1e-3, stiffness_sharpness_per_rad=sharpness, **settings)
    distance = np.max(np.abs(soft - hard), axis=1)
    assert np.all(distance[1:] < 0.2 * distance[:-1])
    assert distance[-1] < 0.01


@pytest.mark.parametrize("gap_form", [0.0, 1.0])
def test_reversing_the_direction_mirrors_the_signals(gap_form: float) -> None:
    p = BENCH.vector(
        gap_rad=[1e-3, 1e-3],
        reference_speed_rpm=[2000.0, -2000.0],
        start_angle_rad=[0.7, -0.7],
        hard_dead_zone=gap_form,
    )
    forward, reverse = simulate_channels(p, 1800, 500.0)
    assert np.allclose(forward, -reverse, rtol=0.0, atol=1e-4)


def test_signals_repeat_after_one_load_rotation() -> None:
    period = 2.0 * math.pi * 120.0 / (2000.0 / RPM)
    assert BENCH.rotation_period_s() == pytest.approx(period)
    assert BENCH.rotation_period_s(-1000.0) == pytest.approx(2.0 * period)
    samples = 3 * 1800 + 1
    position, speed, current = simulate_channels(
        BENCH.vector(gap_rad=1e-3, start_angle_rad=2.0), samples, 1800 / period
    )[0]
    assert np.max(np.abs(speed[1800:] - speed[:-1800])) < 0.01
    assert np.max(np.abs(current[1800:] - current[:-1800])) < 1e-3
    turned = position[1800:] - position[:-1800]
    assert np.max(np.abs(turned - 2.0 * math.pi * 120.0)) < 1e-4


def test_load_stands_at_the_start_angle_at_the_first_sample() -> None:
    for angle in (-2.0, 0.0, 0.5, 4.0):
        p = BENCH.vector(gap_rad=1e-3, start_angle_rad=angle)
        # The motor leads by at most the gap and the wind-up, 3.5 mrad at the largest torque.
        motor = simulate_channels(p, 1, 500.0)[0, 0, 0]
        assert abs(motor / 120.0 - angle) < 1e-3 + 4e-3


def test_no_gravity_gives_no_pulses() -> None:
    speed = BENCH.simulate_many(1e-3, rotations=1.0, gravity_torque_nm=0.0)
    assert np.max(np.abs(speed - 2000.0)) < 0.01


def test_position_loop_keeps_the_mean_speed() -> None:
    bench = BENCH.with_parameters(position_gain_per_s=4.0)
    position = simulate_channels(bench.vector(gap_rad=8e-4), 3601, 1000.0)[0, 0]
    assert position[-1] - position[0] == pytest.approx(2.0 * math.pi * 120.0, rel=1e-6)


def test_current_stays_within_its_limit_and_the_integral_does_not_wind_up() -> None:
    # From standstill the demand is far beyond the limit for a tenth of a second.
    torque, inertia = 0.5 * 10.0, 1.21e-3 + 20.0 / 120.0**2
    p = BENCH.vector(
        gap_rad=0.0,
        gravity_torque_nm=0.0,
        current_limit_a=[10.0, 1e4],
        shaft_stiffness_nm_per_rad=1e7,
        shaft_damping_nm_s_per_rad=2e3,
    )
    limited, free = (simulate_states(row, np.zeros(STATES), 500, 500.0) for row in p)
    mean_acceleration = (limited[1, 40] - limited[1, 10]) / (30 / 500.0)
    assert mean_acceleration == pytest.approx(torque / inertia, rel=0.02)
    # Wound up, the speed would overshoot by far more than without a limit.
    assert limited[1].max() < free[1].max()
    assert limited[1, -1] * RPM == pytest.approx(2000.0, abs=1.0)


def test_rigid_drive_is_the_stiff_limit_of_two_masses() -> None:
    stiff = BENCH.with_parameters(shaft_stiffness_nm_per_rad=1e8, shaft_damping_nm_s_per_rad=5e4)
    rigid = Bench(BENCH.parameters, drive="rigid")
    settings = {"rotations": 1.0, "sampling_hz": 250.0, "channels": "all"}
    two, one = stiff.simulate_many(0.0, **settings)[0], rigid.simulate_many(0.0, **settings)[0]
    assert np.max(np.abs(two[1] - one[1])) < 0.05
    assert np.max(np.abs(two[2] - one[2])) < 0.02


def test_any_number_of_workers_gives_the_same_numbers() -> None:
    gaps = np.geomspace(1e-4, 4e-3, 13)
    one = BENCH.simulate_many(gaps, rotations=0.5, workers=1)
    for workers in (2, 5):
        assert np.array_equal(one, BENCH.simulate_many(gaps, rotations=0.5, workers=workers))
    alone = [BENCH.simulate_many(gap, rotations=0.5)[0] for gap in gaps]
    assert np.array_equal(one, np.array(alone))


def test_draws_fill_the_tolerances_uniformly() -> None:
    parameters = dict(BENCH.parameters)
    parameters["load_inertia_kg_m2"] = BenchParameter(20.0, 1.0)
    bench = Bench(parameters)
    rng = np.random.default_rng(1)
    drawn = np.array([bench.draw(rng).value("load_inertia_kg_m2") for _ in range(400)])
    assert drawn.min() > 19.0
    assert drawn.max() < 21.0
    # mean and variance of a uniform: four standard errors
    assert abs(drawn.mean() - 20.0) < 4 / math.sqrt(3 * 400)
    assert abs(drawn.var() * 3 - 1.0) < 4 * math.sqrt(0.8 / 400)
    assert bench.draw(rng).value("gear_ratio") == 120.0


def test_fingerprint_knows_what_decides_the_signals() -> None:
    assert reference_bench().fingerprint() == BENCH.fingerprint()
    assert BENCH.with_parameters(gear_ratio=121.0).fingerprint() != BENCH.fingerprint()
    assert Bench(BENCH.parameters, gap_form="dead_zone").fingerprint() != BENCH.fingerprint()
    assert Bench(BENCH.parameters).fingerprint() == BENCH.fingerprint()
    again = pickle.loads(pickle.dumps(BENCH))
    assert again == BENCH
    assert again.fingerprint() == BENCH.fingerprint()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"gap_rad": 1e-5, "stiffness_sharpness_per_rad": 4e5},
            "arctan stiffness has no dead zone",
        ),
        ({"gap_rad": -1e-3}, "gap_rad"),
        ({"shaft_stiffness_nm_per_rad": -1.0}, "shaft_stiffness_nm_per_rad"),
        ({"load_inertia_kg_m2": math.nan}, "load_inertia_kg_m2"),
        ({"reference_speed_rpm": 0.0}, "reference_speed_rpm"),
        ({"load_coulomb_friction__torque_nm": -1.0}, "load_coulomb_friction.torque_nm"),
        ({"shaft_hysteresis__torque_nm": 5.0}, "shaft_hysteresis.angle_rad"),
        ({"integral_gain_nm_per_rad": 1e3, "current_loop_lag__time_s": 0.01}, "unstable"),
        (
            {"sampled_control__period_s": 4e-3, "sampled_control__delay_periods": 1.0},
            "period_s, sampled_control.delay_periods: The speed loop is unstable",
        ),
        ({"sampled_control__delay_periods": 129.0}, "sampled_control.delay_periods"),
        (
            {"sampled_control__period_s": 1e-3, "sampled_control__delay_periods": 12.0},
            "delay_periods: The speed loop is unstable",
        ),
        ({"current_limit_a": 3.0}, "cannot turn the load round"),
        ({"stiffness_hardening__stiffness_nm_per_rad3": -3e10}, "diverged"),
    ],
)
def test_what_makes_no_sense_is_refused_with_its_name(
    settings: dict[str, float], message: str
) -> None:
    with pytest.raises(BenchError, match=message):
        simulate_channels(BENCH.vector(**{"gap_rad": 1e-3, **settings}), 500, 500.0)


@pytest.mark.parametrize(
    "settings",
    [
        {"current_limit_a": [30.0, 3.0]},
        {"current_loop_lag__time_s": 0.01, "integral_gain_nm_per_rad": [2.0, 1e3]},
    ],
    ids=["too weak", "unstable"],
)
def test_failed_rows_can_be_nan(settings: dict[str, Any]) -> None:
    p = BENCH.vector(gap_rad=1e-3, **settings)
    speed = simulate_channels(p, 100, 500.0, failures="nan", speed_alone=True)[:, 0]
    assert np.all(np.isfinite(speed[0]))
    assert np.all(np.isnan(speed[1]))


@pytest.mark.parametrize("info", BENCH_PARAMETERS, ids=lambda info: info.name)
@pytest.mark.parametrize("value", [1e-300, 1e300])
def test_a_size_whose_square_is_no_number_is_refused(info: ParameterInfo, value: float) -> None:
    with pytest.raises(BenchError, match=info.name):
        check_parameters(BENCH.vector(**{info.name: value}))
