"""One law for each effect of the catalogue."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from made_recordings import start_state

from bayesbl.bench import kernel
from bayesbl.bench.bench import BenchEffect, EffectParameterValue
from bayesbl.bench.effects import effect_named, repeat_each_rotation
from bayesbl.bench.kernel import CURRENT, POSITION, RPM, SPEED, STATES, Slot
from bayesbl.bench.motion import recorded_motion
from bayesbl.bench.simulation import simulate_channels, simulate_motions, simulate_states
from bayesbl.bench.steady import contact_rates, noise_through_loop
from bayesbl.config.bench import reference_bench
from bayesbl.errors import BenchError

BENCH = reference_bench()
GAP = 8e-4
PER_ROTATION = 3600
MOTOR_SPEED = 2000.0 / RPM
LOAD_SPEED = MOTOR_SPEED / 120.0
TORQUE_CONSTANT = 0.5


def channels(direction: float = 1.0, rotations: int = 1, **settings: float) -> np.ndarray:
    """Whole rotations at 1 kHz, without the sample that closes them."""
    p = BENCH.vector(
        **{"gap_rad": GAP, "start_angle_rad": 0.4, **settings},
        reference_speed_rpm=direction * 2000.0,
    )
    return simulate_channels(p, rotations * PER_ROTATION, 1000.0)[0]


def mean_torque(**settings: float) -> float:
    """Mean motor torque that the settings add, N m."""
    direction = settings.pop("direction", 1.0)
    added = channels(direction, **settings)[CURRENT] - channels(direction)[CURRENT]
    return float(TORQUE_CONSTANT * np.mean(added))


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize(
    ("settings", "forward", "reverse"),
    [
        ({"motor_coulomb_friction__torque_nm": 0.4}, 0.4, -0.4),
        (
            {"motor_viscous_friction__coefficient_nm_s_per_rad": 2e-3},
            2e-3 * MOTOR_SPEED,
            -2e-3 * MOTOR_SPEED,
        ),
        (
            {
                "motor_stribeck_friction__torque_nm": 0.6,
                "motor_stribeck_friction__speed_rad_per_s": 200.0,
            },
            0.6 * math.exp(-((MOTOR_SPEED / 200.0) ** 2)),
            -0.6 * math.exp(-((MOTOR_SPEED / 200.0) ** 2)),
        ),
        (
            {"motor_quadratic_drag__coefficient_nm_s2_per_rad2": 1e-5},
            1e-5 * MOTOR_SPEED**2,
            -1e-5 * MOTOR_SPEED**2,
        ),
        (
            {"friction_asymmetry__coefficient_nm_s_per_rad": 1e-3},
            1e-3 * MOTOR_SPEED,
            1e-3 * MOTOR_SPEED,
        ),
        ({"motor_torque_offset__torque_nm": 0.3}, 0.3, 0.3),
        ({"load_coulomb_friction__torque_nm": 15.0}, 15.0 / 120, -15.0 / 120),
        (
            {"load_viscous_friction__coefficient_nm_s_per_rad": 10.0},
            10.0 * LOAD_SPEED / 120,
            -10.0 * LOAD_SPEED / 120,
        ),
        ({"load_torque_offset__torque_nm": 20.0}, 20.0 / 120, 20.0 / 120),
        ({"friction_drift__torque_nm": 0.4}, 0.4, -0.4),
    ],
    ids=lambda value: next(iter(value)).split("__")[0] if isinstance(value, dict) else "",
)
def test_mean_current_carries_the_friction(
    settings: dict[str, float], forward: float, reverse: float, direction: float
) -> None:
    expected = forward if direction > 0 else reverse
    # Where friction depends on speed its mean differs a little from that at the mean speed.
    assert mean_torque(direction=direction, **settings) == pytest.approx(expected, rel=4e-3)


def test_constant_motor_friction_leaves_the_speed_alone() -> None:
    rubbing = channels(motor_coulomb_friction__torque_nm=0.4)
    assert np.max(np.abs(rubbing[SPEED] - channels()[SPEED])) < 0.01


def test_load_friction_moves_the_pulses_and_motor_friction_does_not() -> None:
    # Gravity balances load friction at another angle: sin θ = −T/(m g l) at the flips.
    slow = channels(load_coulomb_friction__torque_nm=60.0)[SPEED] - channels()[SPEED]
    assert np.max(np.abs(slow)) > 5.0


def test_gravity_phase_is_a_start_angle_in_disguise() -> None:
    sine, cosine = 400.0, 90.0
    size, shift = math.hypot(sine, cosine), math.atan2(cosine, sine)
    one = channels(gravity_torque_nm=sine, gravity_phase__torque_nm=cosine)
    other = channels(gravity_torque_nm=size, start_angle_rad=0.4 + shift)
    assert np.max(np.abs(one[SPEED] - other[SPEED])) < 0.01
    assert np.max(np.abs(one[CURRENT] - other[CURRENT])) < 1e-3


def test_gear_mesh_friction_takes_its_share_of_the_torque_passed_on() -> None:
    share = 0.1
    # Mean of |m g l sin θ| is 2/π of its peak; impacts add a few per cent.
    expected = share * 425.0 / 120.0 * 2.0 / math.pi
    assert mean_torque(gear_mesh_friction__coefficient=share) == pytest.approx(expected, rel=0.05)


def linear_response(
    frequency: float, motor_torque: complex, twist: complex, seen: complex
) -> complex:
    """Motor speed of the linear bench, rad/s, to torque on the motor, twist error, speed error."""
    s = 1j * frequency
    n, stiffness, damping = 120.0, 1.2e5, 231.0
    shaft = stiffness / s + damping
    loop = 0.185 + 8.0 / s
    system = np.array(
        [
            [1.21e-3 * s + loop + shaft / n**2, -shaft / n],
            [-shaft / n, 20.0 * s + shaft],
        ]
    )
    pushed = (stiffness + damping * s) * twist
    right = [motor_torque - pushed / n - loop * seen, pushed]
    return complex(np.linalg.solve(system, right)[0])


def line(signal: np.ndarray, order: float, motor_angle: np.ndarray) -> complex:
    """Amplitude of Re(line · e^{j n θ}) in a signal."""
    centred = signal - signal.mean()
    return complex(2.0 * np.mean(centred * np.exp(-1j * order * motor_angle)))


@pytest.mark.parametrize(
    ("effect", "order"),
    [
        ("ripple", 1.0),
        ("ripple", 3.0),
        ("transmission", 1.0),
        ("transmission", 3.0),
        ("eccentricity", 1.0),
    ],
)
def test_periodic_effects_drive_the_linear_bench_at_their_order(effect: str, order: float) -> None:
    phase, frequency = 0.7, order * MOTOR_SPEED
    turning = -1j * np.exp(1j * phase)  # sin(nθ + φ) = Re(−j e^{jφ} e^{jnθ})
    settings = {"gap_rad": 0.0, "gravity_torque_nm": 0.0}
    if effect == "ripple":
        size = 0.02
        settings |= {
            "motor_torque_ripple__torque_nm": size,
            "motor_torque_ripple__order": order,
            "motor_torque_ripple__phase_rad": phase,
        }
        expected = linear_response(frequency, -size * turning, 0.0, 0.0)
    elif effect == "transmission":
        size = 1e-6
        settings |= {
            "gear_transmission_error__angle_rad": size,
            "gear_transmission_error__order": order,
            "gear_transmission_error__phase_rad": phase,
        }
        expected = linear_response(frequency, 0.0, size * turning, 0.0)
    else:
        size = 1e-4
        settings |= {
            "encoder_eccentricity__angle_rad": size,
            "encoder_eccentricity__phase_rad": phase,
        }
        seen = size * MOTOR_SPEED * np.exp(1j * phase)
        # recorded: the motor's motion and the encoder's error together
        expected = linear_response(frequency, 0.0, 0.0, seen) + seen
    signals = simulate_channels(BENCH.vector(**settings), 3000, 1000.0, accuracy_rpm=1e-4)[0]
    measured = line(signals[SPEED] / RPM, order, MOTOR_SPEED * np.arange(3000) / 1000.0)
    # The motor angle starts at the start angle's, zero, plus what the effect itself moves it.
    assert measured == pytest.approx(expected, rel=5e-3)


def test_transmission_error_is_not_felt_inside_the_gap() -> None:
    p = BENCH.vector(
        gap_rad=4e-3,
        gravity_torque_nm=0.0,
        hard_dead_zone=1.0,
        gear_transmission_error__angle_rad=1e-4,
        gear_transmission_error__order=2.0,
    )[0]
    start = np.zeros(STATES)
    start[kernel.MOTOR_SPEED] = MOTOR_SPEED
    states = simulate_states(p, start, 500, 500.0)
    assert np.max(np.abs(states[kernel.MOTOR_SPEED] - MOTOR_SPEED)) < 1e-9


def test_encoder_eccentricity_shows_in_the_position() -> None:
    # Speed and position come from one encoder: the one is the other's derivative.
    p = BENCH.vector(gap_rad=GAP, encoder_eccentricity__angle_rad=0.005)
    position, speed, _ = simulate_channels(p, 40_000, 20_000.0)[0]
    difference = np.gradient(position, 5e-5) * RPM
    # a central difference of a sine at 209 rad/s is short by (ω Δt)²/6
    assert np.max(np.abs(difference - speed)[1:-1]) < 0.02
    assert np.ptp(speed) > 2.0 * 0.005 * 1900.0


def wound_up(torque: float, damping: float, **effect: float) -> np.ndarray:
    """Parameters of a shaft that stands between a torque at the load and one at the motor, N m."""
    p = BENCH.vector(gap_rad=0.0, **effect)[0]
    for slot in (Slot.speed_gain_nm_s_per_rad, Slot.integral_gain_nm_per_rad):
        p[slot] = 0.0
    p[Slot.gravity_torque_nm] = 0.0
    p[Slot.shaft_damping_nm_s_per_rad] = damping
    p[Slot.load_torque_offset__torque_nm] = torque
    p[Slot.motor_torque_offset__torque_nm] = -torque / 120.0
    return p


def twist_under(torque: float, **effect: float) -> float:
    """Twist, rad, at which that shaft comes to rest."""
    p = wound_up(torque, 3e3, **effect)
    return float(simulate_states(p, np.zeros(STATES), 1000, 500.0)[kernel.TWIST, -1])


def test_hardening_shaft_winds_up_less() -> None:
    torque, cubic = 425.0, 5e9
    twist = twist_under(torque, stiffness_hardening__stiffness_nm_per_rad3=cubic)
    assert 1.2e5 * twist + cubic * twist**3 == pytest.approx(torque, rel=1e-3)


@pytest.mark.parametrize("excess", [0.11, 0.5, -0.1])
def test_a_hertzian_contact_winds_up_by_a_power_of_its_load(excess: float) -> None:
    """K_s is its stiffness at a compression of 1 mrad, as that shaft has no gravity."""
    at = kernel.COMPRESSION_RAD
    for share in (1.0, 0.3):
        twist = twist_under(1.2e5 * at * share, contact_exponent__excess=excess)
        assert twist / at == pytest.approx(share ** (1.0 / (1.0 + excess)), rel=1e-3)


def test_soft_edges_bear_at_the_edge_and_nothing_far_from_it() -> None:
    """At its edge a logistic gap bears K_s s ln 2, s its scale; four standard deviations on, as
    if its edges were sharp."""
    variance = 1e-9
    scale = math.sqrt(3.0 * variance) / math.pi
    soft = {"backlash__gap_rad": GAP, "hard_dead_zone": 1.0}
    soft["contact_softness__variance_rad2"] = variance
    at_the_edge = twist_under(1.2e5 * scale * math.log(2.0), **soft)
    assert at_the_edge == pytest.approx(GAP, rel=1e-4)
    far = 4.0 * math.sqrt(variance)
    assert twist_under(1.2e5 * far, **soft) == pytest.approx(GAP + far, abs=2e-3 * far)


@pytest.mark.parametrize("torque", [425.0, -425.0])
def test_flanks_of_different_stiffness_wind_up_differently(torque: float) -> None:
    share = 0.2
    stiffness = 1.2e5 * (1.0 + math.copysign(share, torque))
    assert stiffness * twist_under(torque, flank_asymmetry__share=share) == pytest.approx(
        torque, rel=1e-3
    )


@pytest.mark.parametrize(
    "effect",
    [
        {"flank_asymmetry__share": 0.3},
        {"flank_asymmetry__share": -0.5},
        {"stiffness_hardening__stiffness_nm_per_rad3": 5e9},
        {"contact_exponent__excess": 0.4},
        {"contact_softness__variance_rad2": 1e-9},
    ],
)
def test_a_motion_begins_at_rest_on_flanks_of_any_law(effect: dict[str, float]) -> None:
    """The load hangs to one side, then to the other; a false start would ring by 4 rpm or more."""
    waiting = recorded_motion(np.arange(1000) / 1000.0, np.zeros(1000))
    for start_angle in (1.3, -1.3):
        p = BENCH.vector(gap_rad=GAP, start_angle_rad=start_angle, **effect)
        speed = simulate_motions(p, waiting, 300, 1000.0)[0, SPEED]
        assert np.abs(speed).max() < 0.05


def small_ringing(torque: float, damping: float, **effect: float) -> np.ndarray:
    """Twist, rad, of that shaft let go 1 % short of its rest."""
    start = np.zeros(STATES)
    start[kernel.TWIST] = 0.99 * torque / 1.2e5
    p = wound_up(torque, damping, **effect)
    return simulate_states(p, start, 200, 1000.0, accuracy_rpm=1e-4)[kernel.TWIST]


@pytest.mark.parametrize("torque", [425.0, -425.0])
def test_a_compressed_contact_damps_by_its_load(torque: float) -> None:
    """About a load T, λ K_s |e| is λ T: the shaft's own damping, larger by that."""
    factor = 0.5
    found = small_ringing(torque, 231.0, contact_damping__factor_s_per_rad=factor)
    same = small_ringing(torque, 231.0 + factor * abs(torque))
    without = small_ringing(torque, 231.0)
    # the compression differs by 1 % at most, and so does what it adds
    assert np.max(np.abs(found - same)) < 0.01 * np.max(np.abs(without - same))


def test_damping_in_the_gap_slows_a_crossing_and_leaves_the_contact_alone() -> None:
    """Free inertias lose their relative speed at the rate d (1/(N² J_m) + 1/J_l)."""
    damping = 50.0
    law = {"gap_damping__coefficient_nm_s_per_rad": damping}
    assert np.array_equal(small_ringing(425.0, 231.0, **law), small_ringing(425.0, 231.0))
    p = BENCH.vector(gap_rad=1.0, hard_dead_zone=1.0, **law)[0]
    gains = (Slot.speed_gain_nm_s_per_rad, Slot.integral_gain_nm_per_rad)
    p[[*gains, Slot.gravity_torque_nm]] = 0.0
    start = np.zeros(STATES)
    start[kernel.TWIST_SPEED] = 1e-2
    speed = simulate_states(p, start, 200, 1000.0, accuracy_rpm=1e-4)[kernel.TWIST_SPEED]
    inertia = p[Slot.motor_inertia_kg_m2] * p[Slot.gear_ratio] ** 2
    rate = damping * (1.0 / inertia + 1.0 / p[Slot.load_inertia_kg_m2])
    assert speed == pytest.approx(1e-2 * np.exp(-rate * np.arange(speed.size) / 1000.0), rel=1e-3)


def test_hysteresis_stays_bounded_and_takes_energy() -> None:
    p = BENCH.vector(
        gap_rad=0.0, shaft_hysteresis__torque_nm=40.0, shaft_hysteresis__angle_rad=1e-3
    )[0]
    for slot in (
        Slot.speed_gain_nm_s_per_rad,
        Slot.integral_gain_nm_per_rad,
        Slot.gravity_torque_nm,
        Slot.shaft_damping_nm_s_per_rad,
    ):
        p[slot] = 0.0
    start = np.zeros(STATES)
    start[kernel.TWIST] = 5e-3
    states = simulate_states(p, start, 2000, 500.0, accuracy_rpm=1e-3)
    assert np.max(np.abs(states[kernel.DAHL])) <= 1.0 + 1e-6
    assert np.ptp(states[kernel.TWIST, -200:]) < 0.3 * np.ptp(states[kernel.TWIST, :200])


def test_current_loop_lag_is_a_first_order_lag_of_the_demand() -> None:
    lag = 2e-3
    p = BENCH.vector(gap_rad=GAP, current_loop_lag__time_s=lag)
    states_speed, states_current = simulate_channels(p, 40_000, 20_000.0)[0, [SPEED, CURRENT]]
    error = (2000.0 - states_speed) / RPM
    demand_rate = 0.185 * np.gradient(error, 5e-5) + 8.0 * error
    torque = TORQUE_CONSTANT * states_current
    # T τ̈ + τ̇ = d(demand)/dt
    rate = np.gradient(torque, 5e-5)
    residual = lag * np.gradient(rate, 5e-5) + rate - demand_rate
    assert np.std(residual[5:-5]) < 0.02 * np.std(demand_rate)


def test_speed_sensor_lag_records_the_filtered_speed() -> None:
    lag = 2e-3
    p = BENCH.vector(gap_rad=GAP, speed_sensor_lag__time_s=lag)
    position, speed, _ = simulate_channels(p, 40_000, 20_000.0)[0]
    true = np.gradient(position, 5e-5) * RPM
    residual = lag * np.gradient(speed, 5e-5) + speed - true
    assert np.std(residual[5:-5]) < 0.02 * np.std(true)


PERIOD_S = 1e-3


def sampled(period_s: float = PERIOD_S, delay: float = 1.0) -> dict[str, float]:
    return {"sampled_control__period_s": period_s, "sampled_control__delay_periods": delay}


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_a_sampled_controller_is_a_difference_and_a_sum_held_for_a_period(delay: int) -> None:
    # At its ticks all is known: the recording begins with one.
    position, speed, current = simulate_channels(
        BENCH.vector(gap_rad=GAP, **sampled(delay=delay)), 4000, 1.0 / PERIOD_S
    )[0]
    assert np.diff(position) / PERIOD_S * RPM == pytest.approx(speed[1:], abs=1e-6)
    error = (2000.0 - speed) / RPM
    rise = 0.185 * np.diff(error) + 8.0 * PERIOD_S * error[1:]
    shown = TORQUE_CONSTANT * np.diff(current)
    assert shown[delay:] == pytest.approx(rise[: rise.size - delay], abs=1e-9)
    assert np.ptp(shown) > 0.01
    # A recorder four times as fast sees the same four times.
    often = simulate_channels(
        BENCH.vector(gap_rad=GAP, **sampled(delay=delay)), 4000, 4.0 / PERIOD_S
    )[0, [SPEED, CURRENT]]
    assert often == pytest.approx(np.repeat(often[:, ::4], 4, axis=1), abs=1e-9)
    assert often[:, ::4] == pytest.approx(np.array([speed, current])[:, :1000], abs=1e-6)


def test_a_delay_in_periods_is_a_dead_time() -> None:
    """A delay smooth in its size: half-way between two, the signals are; whatever the period."""
    halves = [channels(**sampled(delay=delay)) for delay in (2.5, 3.0, 3.5)]
    between = 0.5 * (halves[0] + halves[2])
    for row in (SPEED, CURRENT):
        bend = np.max(np.abs(halves[1][row] - between[row]))
        assert bend < 0.1 * np.max(np.abs(halves[2][row] - halves[0][row]))
    # The motor moves as a loop that is (1 + d) T late has it, 5 ms here, whatever the period.
    slow, fast, later = (
        np.diff(channels(**sampled(period, delay))[POSITION], n=2)
        for period, delay in ((1e-3, 4.0), (2.5e-4, 19.0), (1e-3, 5.0))
    )
    assert np.max(np.abs(fast - slow)) < 0.1 * np.max(np.abs(later - slow))


@pytest.mark.parametrize("lag_s", [0.0, 3e-4])
@pytest.mark.parametrize("delay", [0.25, 0.5, 1.0, 1.5])
def test_what_a_faster_recorder_sees_is_smooth_in_delay_and_skew(
    delay: float, lag_s: float
) -> None:
    """At 1 kHz of a torque that is held for 2 ms; it changes at a sample or between two."""

    def seen(delay: float, skew_s: float) -> np.ndarray:
        lag = {"current_loop_lag__time_s": lag_s, "channel_time_skew__current_s": skew_s}
        slow = {"speed_gain_nm_s_per_rad": 0.13, "integral_gain_nm_per_rad": 5.6}
        bench = BENCH.with_parameters(**slow)
        p = bench.vector(gap_rad=GAP, **sampled(2e-3, delay), **lag)
        return simulate_channels(p, 1000, 1e3)[0, CURRENT]

    for later, skew_s in ((1e-3, 0.0), (0.0, 2e-6)):
        moved = [seen(delay + k * later, k * skew_s) for k in (-1, 0, 1)]
        steps = np.diff(moved, axis=0)
        assert 0.0 < np.max(np.abs(steps)) < 1e-3


def test_what_the_controller_logs_is_smooth_in_the_delay_from_none_on() -> None:
    logged = [channels(**sampled(delay=delay))[CURRENT] for delay in (0.0, 1e-3, 2e-3)]
    first, second = np.max(np.abs(np.diff(logged, axis=0)), axis=1)
    assert second == pytest.approx(first, rel=0.1)


def test_a_short_period_is_a_continuous_controller() -> None:
    # What is late by T is off by what is proportional to T.
    far, near = (np.max(np.abs(channels(**sampled(T)) - channels()), axis=1) for T in (2e-4, 5e-5))
    assert far[SPEED] > 0.3
    assert near == pytest.approx(0.25 * far, rel=0.1)


def test_a_sampled_rotation_begins_with_a_tick_at_the_start_angle() -> None:
    # Neither the way to the start angle nor a turn is a whole number of these ticks.
    p = BENCH.vector(gap_rad=GAP, start_angle_rad=1.234, **sampled(0.7e-3))
    state = start_state(p[0])
    assert state[0] / 120.0 - state[kernel.TWIST] == pytest.approx(1.234, abs=1e-6)
    assert state[kernel.TICK_ANGLE] == state[0]
    assert not repeat_each_rotation(p)
    assert repeat_each_rotation(BENCH.vector(gap_rad=GAP, **sampled(0.75e-3)))


def test_the_linear_loop_knows_its_ticks() -> None:
    continuous = contact_rates(BENCH.vector())[0]
    for extra in ({}, {"position_gain_per_s": 5.0}, {"current_loop_lag__time_s": 1e-3}):
        slow = [
            np.sort_complex(rates[rates.real > -200.0])
            for rates in (
                contact_rates(BENCH.vector(**extra))[0],
                contact_rates(BENCH.vector(**extra, **sampled(3e-6)))[0],
            )
        ]
        assert slow[1] == pytest.approx(slow[0], rel=2e-3)
    # The loop's delay of two periods takes damping away.
    slower = contact_rates(BENCH.vector(**sampled()))[0]
    assert np.max(slower.real) > 0.9 * np.max(continuous.real)


def test_a_speed_of_the_instant_takes_half_a_period_from_the_loop() -> None:
    """What damps the ringing is how late the loop is: (1 + d − s/2) T."""
    instant, difference, later = (
        np.min(rates.real[(rates.imag != 0.0) & (rates.real > -200.0)])
        for rates in (
            contact_rates(
                BENCH.vector(**sampled(period, 0.0), sampled_control__instant_share=share)
            )[0]
            for period, share in ((1e-3, 1.0), (5e-4, 0.0), (1e-3, 0.0))
        )
    )
    assert abs(instant - difference) < 0.1 * abs(later - difference)


@pytest.mark.parametrize("delay", [1, 4])
def test_noise_through_a_sampled_controller_is_answered_as_late_as_its_torque_acts(
    delay: int,
) -> None:
    kick = np.zeros(200)
    kick[10] = 3.0
    loop = BENCH.vector(**sampled(delay=delay))[0]
    motion, answer = noise_through_loop(loop, kick, PERIOD_S)
    first = -(0.185 + 8.0 * PERIOD_S) * 3.0 / RPM / TORQUE_CONSTANT
    assert answer[: 10 + delay] == pytest.approx(0.0, abs=1e-12)
    assert answer[10 + delay] == pytest.approx(first, rel=1e-9)
    # Half of what that torque does in a period, at first against the motor's inertia alone.
    assert motion[11 + delay] == pytest.approx(
        first * TORQUE_CONSTANT / 1.21e-3 * 5e-4 * RPM, rel=0.05
    )


def test_friction_drift_grows_from_rotation_to_rotation() -> None:
    rate = 0.01
    drifting = channels(rotations=3, friction_drift__rate_nm_per_s=rate)[CURRENT]
    means = drifting.reshape(3, PER_ROTATION).mean(axis=1) * TORQUE_CONSTANT
    assert np.diff(means) == pytest.approx(rate * 3.6, rel=2e-3)


@pytest.mark.parametrize("channel", [POSITION, SPEED, CURRENT])
@pytest.mark.parametrize("shift", [4, -4])
def test_a_skewed_channel_lags_the_others(channel: int, shift: int) -> None:
    name = ("position", "speed", "current")[channel]
    skewed = channels(**{f"channel_time_skew__{name}_s": shift * 1e-3})
    true = channels()
    inside = slice(10, -10)
    moved = np.roll(true, shift, axis=1)
    for row in range(3):
        expected = moved[row] if row == channel else true[row]
        assert np.allclose(skewed[row][inside], expected[inside], atol=1e-3)


@pytest.mark.parametrize("others", [{}, {"sampled_control__period_s": 1e-3}])
def test_an_averaged_speed_is_the_change_of_the_encoder_over_that_time(others) -> None:
    averaged = channels(speed_averaging__time_s=4e-3, **others)
    true = channels(**others)
    change = (true[POSITION][4:] - true[POSITION][:-4]) / 4e-3 * 60.0 / (2.0 * np.pi)
    assert np.allclose(averaged[SPEED][4:], change, atol=2e-3)
    rest = [POSITION, CURRENT]
    assert np.allclose(averaged[rest], true[rest], atol=1e-4)


def test_an_average_over_no_time_is_the_speed_itself() -> None:
    assert np.allclose(channels(speed_averaging__time_s=1e-5)[SPEED], channels()[SPEED], atol=0.02)


def test_an_average_that_lags_too_is_the_same_one_later() -> None:
    averaged = channels(speed_averaging__time_s=3e-3)
    late = channels(speed_averaging__time_s=3e-3, channel_time_skew__speed_s=2e-3)
    assert np.allclose(late[SPEED][2:], averaged[SPEED][:-2], atol=2e-3)


def test_backlash_is_the_gap_itself() -> None:
    assert np.array_equal(channels(), channels(gap_rad=0.0, backlash__gap_rad=GAP))


def test_a_bench_carries_effects_by_name() -> None:
    effect = BenchEffect("load_coulomb_friction", {"torque_nm": EffectParameterValue(15.0, 0.4)})
    bench = BENCH.with_effects(effect)
    assert bench.value("load_coulomb_friction.torque_nm") == 15.0
    assert bench.fingerprint() != BENCH.fingerprint()
    assert np.array_equal(
        bench.simulate_many(GAP, rotations=0.5),
        BENCH.simulate_many(GAP, rotations=0.5, load_coulomb_friction__torque_nm=15.0),
    )
    with pytest.raises(BenchError, match="no such effect"):
        effect_named("friction")
    with pytest.raises(BenchError, match="no such parameter"):
        BENCH.with_effects(BenchEffect("backlash", {"size": EffectParameterValue(1.0)}))


@pytest.mark.parametrize("variance", [1e-12, 1e-11])
@pytest.mark.parametrize("gap", [3.4e-4, 5e-4, 8e-4])
def test_what_soft_edges_do_does_not_depend_on_the_accuracy(gap: float, variance: float) -> None:
    """An edge much narrower than a step of the integrator is not passed unseen."""
    bench = replace(BENCH, gap_form="dead_zone").vector
    late = {"gap_rad": gap, "current_loop_lag__time_s": 1e-3}
    matrix = np.vstack([bench(**late), bench(**late, contact_softness__variance_rad2=variance)])

    def change(accuracy_rpm: float) -> np.ndarray:
        sharp, soft = simulate_channels(matrix, 7200, 1000.0, accuracy_rpm=accuracy_rpm)[:, SPEED]
        return np.asarray(soft - sharp)

    fine = change(1e-6)
    assert np.linalg.norm(change(1e-3) - fine) < 0.15 * np.linalg.norm(fine)


@pytest.mark.parametrize("delay", [0.0, 0.5, 1.0, 1.4])
@pytest.mark.parametrize("hz", [1000.0, 4000.0])
def test_a_short_lag_behind_a_sampled_controller_is_next_to_none(delay: float, hz: float) -> None:
    """Of what is logged too: the current that flows until the next tick, or the next sample."""
    none = simulate_channels(BENCH.vector(gap_rad=GAP, **sampled(delay=delay)), 2000, hz)
    changes = []
    for lag in (2e-6, 2e-5):
        late = BENCH.vector(gap_rad=GAP, current_loop_lag__time_s=lag, **sampled(delay=delay))
        changes.append((simulate_channels(late, 2000, hz) - none)[0, CURRENT] / lag)
    assert np.linalg.norm(changes[0] - changes[1]) < 0.2 * np.linalg.norm(changes[1])


def test_a_current_behind_a_lag_decays_from_sample_to_sample() -> None:
    """Seen several times in a period, it goes towards what is held."""
    lag = 5e-4
    p = BENCH.vector(gap_rad=GAP, current_loop_lag__time_s=lag, **sampled(delay=0.0))
    current = simulate_channels(p, 4000, 4000.0)[0, CURRENT]
    steps = np.diff(current)
    phase = np.arange(steps.size) % 4
    ratios = steps[phase == 1][1:] / steps[phase == 0][1:]
    assert np.median(ratios) == pytest.approx(math.exp(-2.5e-4 / lag), rel=0.05)
