"""The linear bench in contact: decay of transients, and response of the loop to sensor noise."""

from __future__ import annotations

import math

import numpy as np
from scipy import linalg

from bayesbl.bench import kernel
from bayesbl.bench.kernel import RPM, Slot, waiting_torques
from bayesbl.bench.parameters import label, rotation_period_s
from bayesbl.errors import BenchError
from bayesbl.recording.types import ComplexArray, FloatArray

# The run-in starts from balanced torques and ends at a tenth of the requested accuracy. The error
# at the start is that of the impacts, or of the gravity that leaks through a soft loop. For loops
# so slow that this takes longer than twenty rotations, it is cut there.
_START_ERROR = 0.01  # of the reference speed
_SHARE_OF_ACCURACY = 0.1
_MOST_ROTATIONS = 20.0
# Lags of zero become this short: faster than anything else in the bench.
_SHORTEST_LAG_S = 1e-6
_ABSENT = -1e6
# Smallest factor per period, as good as zero.
_GONE = 1e-30

_LOOP = (
    Slot.speed_gain_nm_s_per_rad,
    Slot.integral_gain_nm_per_rad,
    Slot.shaft_damping_nm_s_per_rad,
    Slot.sampled_control__period_s,
    Slot.sampled_control__delay_periods,
)

_LINEAR = (
    Slot.gear_ratio,
    Slot.motor_inertia_kg_m2,
    Slot.load_inertia_kg_m2,
    Slot.shaft_stiffness_nm_per_rad,
    Slot.shaft_damping_nm_s_per_rad,
    Slot.speed_gain_nm_s_per_rad,
    Slot.integral_gain_nm_per_rad,
    Slot.position_gain_per_s,
    Slot.torque_constant_nm_per_a,
    Slot.rigid,
    *(slot for slot in Slot if slot.name.startswith(("belt__", "arm__", "base__"))),
)
"""Parameters of a bench whose equations are linear on a flank: no friction, no gravity."""

_PARTS = {
    Slot.integral_gain_nm_per_rad: [kernel.INTEGRAL],
    Slot.position_gain_per_s: [kernel.MOTOR_ANGLE],
    Slot.belt__compliance_rad_per_nm: [kernel.BELT_TWIST, kernel.BELT_SPEED],
    Slot.arm__compliance_rad_per_nm: [kernel.ARM_TWIST, kernel.ARM_SPEED],
    Slot.base__compliance_rad_per_nm: [kernel.BASE_ANGLE, kernel.BASE_SPEED],
}
"""Parts that a bench lacks if the parameter is zero, and their states."""

_SPRINGS = [*_PARTS][2:]
_NOT_LINEAR = [Slot.encoder_eccentricity__angle_rad, Slot.encoder_error__orders]


def contact_matrices(matrix: FloatArray) -> FloatArray:
    """System matrices of the linear bench on one tooth flank.

    States are those of the kernel, with belt, arm and base only if any bench has one. States that a
    bench does not have decay at once and are decoupled.

    Parameters
    ----------
    matrix
        Parameter vectors, shape (m, SLOTS).

    Returns
    -------
    Array of shape (m, 8, 8) or (m, 15, 15), 1/s and SI.
    """
    linear = np.zeros_like(matrix)
    linear[:, _LINEAR] = matrix[:, _LINEAR]
    linear[:, Slot.hard_dead_zone] = 1.0
    linear[:, Slot.current_limit_a] = math.inf
    for lag in (Slot.current_loop_lag__time_s, Slot.speed_sensor_lag__time_s):
        linear[:, lag] = np.maximum(matrix[:, lag], _SHORTEST_LAG_S)
    rigid = matrix[:, Slot.rigid] != 0.0
    linear[np.ix_(rigid, _SPRINGS)] = 0.0
    size = kernel.HELD_TORQUE if np.any(linear[:, _SPRINGS] != 0.0) else kernel.BRISTLE
    a = np.empty((matrix.shape[0], size, size))
    for row, system in zip(linear, a, strict=True):
        kernel.contact_matrix(row, system)
    lacks = dict.fromkeys((kernel.DAHL, kernel.BRISTLE), np.ones_like(rigid))
    lacks |= dict.fromkeys((kernel.TWIST, kernel.TWIST_SPEED), rigid)
    lacks |= {state: linear[:, slot] == 0.0 for slot, states in _PARTS.items() for state in states}
    for state, absent in lacks.items():
        if state < size:
            a[absent, state, :] = 0.0
            a[absent, :, state] = 0.0
            a[absent, state, state] = _ABSENT
    return a


def sampled_period(parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """One period of the linear bench in contact under a sampled controller.

    For one parameter vector, shape (SLOTS,). The states are those of the kernel after a tick, with
    the motor's angle since that tick.

    Returns
    -------
    Transition matrix over a period, shape (19 + w, 19 + w); and the response to an error of the
    speed that the controller sees at its end, shape (19 + w,), SI.
    """
    period = parameters[Slot.sampled_control__period_s]
    delay = parameters[Slot.sampled_control__delay_periods]
    free = parameters.copy()
    free[Slot.position_gain_per_s] = 1.0  # keeps the angle among the states
    waiting = waiting_torques(parameters)
    states = kernel.STATES + waiting
    delay_fraction = delay - waiting
    plant = np.zeros((kernel.STATES, kernel.STATES))
    moving = contact_matrices(free[None, :])[0]
    plant[: len(moving), : len(moving)] = moving
    absent = np.arange(len(moving), kernel.HELD_TORQUE)
    plant[absent, absent] = _ABSENT
    plant[kernel.DRIVE_TORQUE] = 0.0
    plant[:, kernel.INTEGRAL] = plant[kernel.INTEGRAL, :] = 0.0
    torque_lag = max(parameters[Slot.current_loop_lag__time_s], _SHORTEST_LAG_S)
    torques = [kernel.DRIVE_TORQUE, kernel.HELD_TORQUE]
    plant[kernel.DRIVE_TORQUE, torques] = -1.0 / torque_lag, 1.0 / torque_lag
    apply = np.eye(states)
    apply[kernel.HELD_TORQUE] = apply[states - 1 if waiting else kernel.NEXT_TORQUE]
    before, after = np.eye(states), np.eye(states)
    moves = np.s_[: kernel.STATES, : kernel.STATES]
    before[moves] = linalg.expm(plant * delay_fraction * period)
    after[moves] = linalg.expm(plant * (1.0 - delay_fraction) * period)

    # The controller alone, after each unit state and after rest, with a reference of 1 rad/s.
    controller = parameters.copy()
    controller[_NOT_LINEAR] = 0.0
    controller[Slot.current_limit_a], controller[Slot.reference_speed_rpm] = math.inf, RPM
    ticked = np.eye(states + 1, states)
    kernel.tick_each(ticked, controller)
    # A motor that has turned freely is in no other state, so its angle begins at each tick.
    since = np.eye(states)
    since[kernel.MOTOR_ANGLE, kernel.TICK_ANGLE] = -1.0
    update, noise = since @ (ticked[:-1] - ticked[-1]).T @ np.linalg.inv(since), -ticked[-1]
    for gain, state in (
        (Slot.position_gain_per_s, kernel.TICK_ANGLE),
        (Slot.integral_gain_nm_per_rad, kernel.INTEGRAL),
    ):
        if parameters[gain] <= 0.0:
            update[state] = noise[state] = 0.0
    if delay <= 0.0:
        for states_after in (update, noise):
            states_after[kernel.HELD_TORQUE] = states_after[kernel.NEXT_TORQUE]
    return update @ after @ apply @ before, noise


def contact_rates(matrix: FloatArray) -> ComplexArray:
    """Rates (eigenvalues) of the linear bench's modes on one tooth flank, in time, 1/s.

    Shape (m, 19), plus the waiting torques of a sampled controller. Modes that a bench does not
    have decay at once.
    """
    waiting = max((waiting_torques(row) for row in matrix), default=0)
    rates = np.full((matrix.shape[0], kernel.STATES + waiting), complex(_ABSENT))
    systems = contact_matrices(matrix)
    rates[:, : systems.shape[1]] = np.linalg.eigvals(systems)
    for row in np.flatnonzero(matrix[:, Slot.sampled_control__period_s] > 0.0):
        # eigvals returns real values if all are real; some may be negative.
        factors = np.linalg.eigvals(sampled_period(matrix[row])[0]).astype(complex)
        factors = np.where(np.abs(factors) < _GONE, _GONE, factors)
        rates[row, : factors.size] = np.log(factors) / matrix[row, Slot.sampled_control__period_s]
    return rates


def settling_time_s(
    matrix: FloatArray, accuracy_rpm: float | FloatArray, failures: str = "raise"
) -> FloatArray:
    """Run-in until a bench is in steady rotation to a tenth of the accuracy, shape (m,), s.

    If the ringing hardly decays between two flank changes, a bench may rattle without ever
    repeating (one in a thousand of random benches did). No run-in changes that.

    Raises
    ------
    BenchError
        If the speed loop is unstable on a tooth flank and ``failures`` is ``"raise"``; with
        ``"nan"`` the run-in of such a bench is nan.
    """
    slowest = -np.max(contact_rates(matrix).real, axis=1)
    if failures == "nan":
        slowest = np.where(slowest > 0.0, slowest, np.nan)
    if np.any(slowest <= 0.0):
        row = matrix[int(np.argmin(slowest))]
        causes = _LOOP[: 5 if row[Slot.sampled_control__period_s] > 0.0 else 3]
        raise BenchError(
            "The speed loop is unstable even without a gap, so there is no steady rotation.",
            where=", ".join(label(slot) for slot in causes),
            found=", ".join(f"{row[slot]:g}" for slot in causes),
            expected="gains, damping and delays with which transients die out",
        )
    period = rotation_period_s(matrix)
    torque = matrix[:, Slot.gravity_torque_nm] / matrix[:, Slot.gear_ratio]
    resistance = np.maximum(
        matrix[:, Slot.speed_gain_nm_s_per_rad],
        matrix[:, Slot.integral_gain_nm_per_rad] * period / (2.0 * math.pi),
    )
    start_error = np.maximum(
        _START_ERROR * np.abs(matrix[:, Slot.reference_speed_rpm]), RPM * torque / resistance
    )
    e_folds = np.log(np.maximum(start_error / (_SHARE_OF_ACCURACY * accuracy_rpm), math.e))
    settling = e_folds / slowest
    # Ringing that lasts until the next flank change is excited by it and decays more slowly.
    settling *= np.where(settling > 0.25 * period, 3.0, 1.0)
    settling = np.minimum(settling, _MOST_ROTATIONS * period)
    # The hysteresis element forgets with travel, not with time: an e-fold for each θ_p of twist. A
    # rotation winds the shaft from flank to flank and back.
    gap = matrix[:, Slot.gap_rad] + matrix[:, Slot.backlash__gap_rad]
    wound = matrix[:, Slot.gravity_torque_nm] / matrix[:, Slot.shaft_stiffness_nm_per_rad]
    travel = np.maximum(4.0 * (gap + wound), 1e-9)
    rotations = e_folds * matrix[:, Slot.shaft_hysteresis__angle_rad] / travel
    memory = np.where(
        matrix[:, Slot.shaft_hysteresis__torque_nm] != 0.0,
        np.clip(rotations, 1.0, _MOST_ROTATIONS) * period,
        0.0,
    )
    result: FloatArray = settling + memory
    return result


def noise_through_loop(
    parameters: FloatArray, noise_rpm: FloatArray, sampling_s: float
) -> tuple[FloatArray, FloatArray]:
    """Response of the closed speed loop, on a tooth flank, to noise of its speed sensor.

    Parameters
    ----------
    parameters
        One parameter vector, shape (SLOTS,).
    noise_rpm
        Noise added to the speed that the controller sees, shape (n,), rpm, held between samples.
    sampling_s
        Time between samples, s.

    Returns
    -------
    Motion of the motor in rpm and change of the current in A that the noise causes, each (n,).
    """
    if parameters[Slot.sampled_control__period_s] > 0.0:
        return _noise_through_ticks(parameters, noise_rpm, sampling_s)
    a = contact_matrices(parameters[None, :])[0]
    size = len(a)
    gain = parameters[Slot.speed_gain_nm_s_per_rad]
    lag = max(parameters[Slot.current_loop_lag__time_s], _SHORTEST_LAG_S)
    b = np.zeros(size)
    b[kernel.DRIVE_TORQUE] = -gain / lag
    b[kernel.INTEGRAL] = -1.0 if parameters[Slot.integral_gain_nm_per_rad] > 0.0 else 0.0
    held = np.zeros((size + 1, size + 1))
    held[:size, :size] = a
    held[:size, size] = b
    transition = linalg.expm(held * sampling_s)
    state = np.zeros(size)
    states = np.empty((noise_rpm.size, size))
    for index, value in enumerate(noise_rpm / RPM):
        states[index] = state
        state = transition[:size, :size] @ state + transition[:size, size] * value
    torque = states[:, kernel.DRIVE_TORQUE].copy()
    if parameters[Slot.current_loop_lag__time_s] == 0.0:
        # Without lag, the controller's proportional part responds within the sample.
        torque += -gain * (noise_rpm / RPM - np.concatenate(([0.0], noise_rpm[:-1] / RPM)))
    return states[:, kernel.SENSED_SPEED] * RPM, torque / parameters[Slot.torque_constant_nm_per_a]


def _noise_through_ticks(
    parameters: FloatArray, noise_rpm: FloatArray, sampling_s: float
) -> tuple[FloatArray, FloatArray]:
    """Like :func:`noise_through_loop`, for a sampled controller as it logs itself."""
    period = parameters[Slot.sampled_control__period_s]
    delay = parameters[Slot.sampled_control__delay_periods]
    transition, by_noise = sampled_period(parameters)
    samples = np.arange(noise_rpm.size) * sampling_s
    last = np.floor(samples / period + 1e-6).astype(int)
    source = np.floor(np.arange(last[-1] + 1) * period / sampling_s + 1e-6).astype(int)
    state = np.zeros(by_noise.size)
    torque = np.zeros(by_noise.size)
    waiting = waiting_torques(parameters)
    if parameters[Slot.current_loop_lag__time_s] > 0.0:
        torque[kernel.DRIVE_TORQUE] = 1.0
    else:
        # The logged torque is the mean until the next tick (kernel.logged_torque).
        torque[kernel.HELD_TORQUE] = delay - waiting
        torque[-1 if waiting else kernel.NEXT_TORQUE] = 1.0 - torque[kernel.HELD_TORQUE]
    logged = np.empty((source.size, 2))
    for k, value in enumerate(noise_rpm[source] / RPM):
        state = transition @ state + by_noise * value
        logged[k] = state[kernel.TICK_SPEED], torque @ state
    motion, response = logged[last].T
    return motion * RPM, response / parameters[Slot.torque_constant_nm_per_a]


def ringing_hz(matrix: FloatArray) -> float:
    """Frequency of the slowest oscillation of the linear bench in contact, Hz; inf if it has none.

    Uses the first of the parameter vectors, shape (m, SLOTS).
    """
    rates = contact_rates(matrix[:1])[0].imag
    return float(np.min(rates[rates > 0.0], initial=math.inf)) / (2.0 * math.pi)
