"""Many simulations at once over the cores, from flat parameter vectors to arrays.

And how the bench is seen: encoder counts, noise, and which sensor the speed is of.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesbl.bench import kernel
from bayesbl.bench.kernel import STATES, Slot
from bayesbl.bench.motion import Motion
from bayesbl.bench.parameters import check_parameters
from bayesbl.bench.steady import noise_through_loop, settling_time_s
from bayesbl.errors import BenchError, SimulationError
from bayesbl.noise.process import NO_NOISE, NoiseModel, quantised
from bayesbl.processes import in_threads
from bayesbl.recording.types import MOTOR_CURRENT, MOTOR_POSITION, MOTOR_SPEED, FloatArray
from bayesbl.units import RPM_PER_RAD_PER_S

SpeedSource = Literal["sensor", "encoder"]


@dataclass(frozen=True, slots=True)
class Measurement:
    """How the bench is seen.

    Attributes
    ----------
    encoder_counts
        Counts per motor revolution; ``None`` for an ideal encoder.
    speed_source
        ``sensor``: the speed the controller sees, with noise. ``encoder``: backward difference
        of the recorded position over one sample (the first sample repeats the second), no noise
        of its own.
    speed_noise, current_noise
        In rpm and A.
    noise_through_controller
        The speed noise is inside the loop: the controller answers it, on the linear bench in
        contact, and the recorded speed holds the motor's answer too.
    """

    encoder_counts: int | None = None
    speed_source: SpeedSource = "sensor"
    speed_noise: NoiseModel = NO_NOISE
    current_noise: NoiseModel = NO_NOISE
    noise_through_controller: bool = False

    def seen_by(self, matrix: FloatArray, sampling_hz: float) -> FloatArray:
        """Benches, shape (m, SLOTS), with the speed averaged as its source does at this rate.

        A difference of the encoder's positions is an average over a sampling period; where a bench
        states an average, that is all of it.
        """
        if self.speed_source != "encoder":
            return matrix
        matrix = matrix.copy()
        averaging = matrix[:, Slot.speed_averaging__time_s]
        averaging[averaging == 0.0] = 1.0 / sampling_hz
        return matrix

    def channels(
        self,
        position: FloatArray,
        speed: FloatArray,
        current: FloatArray,
        loop: FloatArray | None,
        sampling_hz: float,
        rng: np.random.Generator | None,
    ) -> dict[str, FloatArray]:
        """As recorded, from what happened, each (n,).

        ``loop`` has the parameters of the speed loop, ``None`` where there is none; without
        ``rng`` there is no noise.
        """
        if rng is not None:
            noise = self.speed_noise.draw(speed.size, rng)
            current = current + self.current_noise.draw(speed.size, rng)
            if self.noise_through_controller and loop is not None:
                motion, answer = noise_through_loop(loop, noise, 1.0 / sampling_hz)
                noise = noise + motion
                current = current + answer
            speed = speed + noise
        if self.encoder_counts is not None:
            position = quantised(position, self.encoder_counts)
        if self.speed_source == "encoder":
            difference = np.diff(position) * sampling_hz * RPM_PER_RAD_PER_S
            speed = np.concatenate((difference[:1], difference))
        return {MOTOR_POSITION: position, MOTOR_SPEED: speed, MOTOR_CURRENT: current}


PERFECT = Measurement()


ACCURACY = 5e-6
"""Largest error of a simulated speed where none is given, as a share of the fastest reference
speed: 0.01 rpm of 2000."""
UNDRIVEN_ACCURACY_RPM = 0.01

_REASONS = {
    kernel.DIVERGED: "the simulation diverged: the motor ran away or no step is short enough",
    kernel.TOO_MANY_STEPS: "the simulation needs steps far shorter than any oscillation of the "
    "bench: a time constant or a friction width is out of proportion",
    kernel.SATURATED: "the motor cannot turn the load round: the torque that gravity and friction "
    "ask for exceeds torque_constant_nm_per_a times current_limit_a, or the speed loop does not "
    "reach its reference",
}


def simulate_channels(
    parameter_matrix: FloatArray,
    samples: int,
    sampling_hz: float,
    *,
    moments_s: FloatArray | None = None,
    accuracy_rpm: float | None = None,
    workers: int = 1,
    failures: str = "raise",
    speed_alone: bool = False,
    ends: FloatArray | None = None,
) -> FloatArray:
    """Noise-free signals in steady rotation.

    Parameters
    ----------
    parameter_matrix
        Shape (m, SLOTS), one simulation a row (see ``kernel.Slot``).
    samples, sampling_hz
        Number n and rate of the samples; the first lies where the load passes the start angle.
    moments_s
        Times of the samples from there on, ascending, (n,); ``None`` for evenly at the rate.
    accuracy_rpm
        Largest error of the speed, rpm; ``None`` for ``ACCURACY`` of the reference speed.
    workers
        Threads; the numbers do not depend on it.
    failures
        ``"raise"``, or ``"nan"`` to fill failed rows with nan, as samplers want it.
    ends
        Filled with the states at the first sample, as :func:`start_states` gives them.

    Returns
    -------
    Array of shape (m, 3, n): position in rad (continuing from one turn to the next, not yet begun
    at zero, not quantised), speed in rpm as the controller sees it, current in A. With
    ``speed_alone`` shape (m, 1, n).

    Raises
    ------
    BenchError
        If a parameter makes no sense, or a simulation fails and ``failures`` is ``"raise"``.
    """
    out = np.empty((parameter_matrix.shape[0], 1 if speed_alone else 3, samples))
    moments = _even_s(out, sampling_hz) if moments_s is None else moments_s
    accuracy = _accuracy_rpm(accuracy_rpm, parameter_matrix[:, Slot.reference_speed_rpm])
    matrix = _sound(parameter_matrix, out, sampling_hz, accuracy)
    settling = settling_time_s(matrix, accuracy, failures)
    states = _room_for_states(matrix) if ends is None else ends

    def run(row: int) -> int:
        if math.isnan(settling[row]):
            return kernel.DIVERGED
        status: int = kernel.simulate(
            matrix[row],
            settling[row],
            1.0 / sampling_hz,
            moments,
            accuracy[row],
            out[row],
            states[row],
        )[0]
        return status

    _run_rows(run, matrix, out, workers, failures)
    return out


def simulate_motions(
    parameter_matrix: FloatArray,
    motion: Motion,
    samples: int,
    sampling_hz: float,
    *,
    accuracy_rpm: float | None = None,
    workers: int = 1,
    failures: str = "raise",
    states: bool = False,
    start_flank: float = 0.0,
) -> FloatArray:
    """As :func:`simulate_channels` where the speed loop follows a motion: shape (m, 3, n).

    The first sample lies at the motion's start, with the load at ``start_angle_rad``, all torques
    balanced on the flank that the load's torque presses on, or on ``start_flank`` if that is 1 or
    −1; where the output is held, at rest on the lower flank. With ``states`` all states as
    :func:`simulate_states` gives them, shape (m, 12, n).
    """
    out = np.zeros((parameter_matrix.shape[0], STATES if states else 3, samples))
    fastest = 0.0 if motion.output_held else motion.fastest_rpm
    accuracy = _accuracy_rpm(accuracy_rpm, np.full(len(parameter_matrix), fastest))
    matrix = _sound(parameter_matrix, out, sampling_hz, accuracy)
    if motion.output_held:
        matrix = matrix.copy()
        matrix[:, Slot.load_inertia_kg_m2] = math.inf
    moments = _even_s(out, sampling_hz)

    def run(row: int) -> int:
        status: int = kernel.simulate_motion(
            matrix[row],
            motion.pieces,
            1.0 / sampling_hz,
            moments,
            accuracy[row],
            start_flank,
            out[row],
        )[0]
        return status

    _run_rows(run, matrix, out, workers, failures)
    return out


def simulate_states(
    parameters: FloatArray,
    initial_state: FloatArray,
    samples: int,
    sampling_hz: float,
    *,
    accuracy_rpm: float | None = None,
    friction_width_rad_per_s: float | None = None,
) -> FloatArray:
    """All states from a given one on: free motion, transients, laws. Shape (12, n), SI.

    States as in ``kernel``: motor angle, motor speed, twist, twist speed, integral, drive torque,
    sensed speed, Dahl z (these three zero while no effect is on); of a sampled controller, which
    has just had a tick, torque held, torque computed last, angle and speed at the tick; torques
    that wait behind it follow in the initial state. The position loop's ramp starts at the initial
    motor angle. Dry friction changes its sign over the given width at the motor, by default over
    what holds elsewhere. No check of the parameters, so gains may be zero here.
    """
    c = kernel.constants(parameters, initial_state[0], 0.0)
    if friction_width_rad_per_s is not None:
        c = c._replace(
            friction_width=friction_width_rad_per_s,
            load_friction_width=friction_width_rad_per_s * c.per_ratio,
        )
    size = kernel.states_of(c)
    state = np.array(initial_state[:size], dtype=float)
    out = np.zeros((STATES, samples))
    stop = (samples - 1) / sampling_hz * (1.0 + 1e-12)
    status, time, _ = kernel.integrate(
        0.0,
        state,
        stop,
        math.copysign(math.inf, parameters[Slot.reference_speed_rpm]),
        0.0,
        1.0 / sampling_hz,
        _even_s(out, sampling_hz),
        out,
        parameters,
        c,
        float(_accuracy_rpm(accuracy_rpm, parameters[Slot.reference_speed_rpm])),
        np.empty((0, kernel.PIECE_COLUMNS)),
    )
    if status != kernel.DONE:
        raise SimulationError(f"At {time:.4g} s {_REASONS[status]}.")
    return out


def start_states(parameter_matrix: FloatArray, *, accuracy_rpm: float | None = None) -> FloatArray:
    """States at the first sample of a steady rotation, SI.

    Shape (m, 12), or as many more as torques of a sampled controller wait.
    """
    states = _room_for_states(parameter_matrix)
    simulate_channels(
        parameter_matrix, 1, 1.0, accuracy_rpm=accuracy_rpm, speed_alone=True, ends=states
    )
    return states


def _room_for_states(matrix: FloatArray) -> FloatArray:
    waiting = max(map(kernel.waiting_torques, matrix), default=0)
    return np.empty((matrix.shape[0], STATES + waiting))


def _even_s(out: FloatArray, sampling_hz: float) -> FloatArray:
    """Times of evenly spaced samples, (…, n) to (n,)."""
    return np.asarray(np.arange(out.shape[-1]) * (1.0 / sampling_hz), dtype=np.float64)


def _accuracy_rpm(asked_rpm: float | None, reference_rpm: FloatArray) -> FloatArray:
    """Of each simulation, as the reference speeds are given."""
    if asked_rpm is not None:
        return np.full_like(reference_rpm, asked_rpm)
    share = ACCURACY * np.abs(reference_rpm)
    return np.where(share > 0.0, share, UNDRIVEN_ACCURACY_RPM)


def _sound(
    matrix: FloatArray, out: FloatArray, sampling_hz: float, accuracy_rpm: FloatArray
) -> FloatArray:
    """The parameter vectors as the kernel takes them; raises where nothing can be simulated."""
    if not (np.all(accuracy_rpm > 0.0) and sampling_hz > 0.0 and out.shape[2] > 0):
        raise BenchError(
            "A simulation needs an accuracy, a sampling rate and a number of samples above zero.",
            found=f"{np.min(accuracy_rpm, initial=math.inf):g} rpm, {sampling_hz:g} Hz, "
            f"{out.shape[2]} samples",
        )
    matrix = np.ascontiguousarray(matrix, dtype=float)
    check_parameters(matrix)
    return matrix


def _run_rows(
    run: Callable[[int], int], matrix: FloatArray, out: FloatArray, workers: int, failures: str
) -> None:
    """Run every row, which returns its status; rows that fail are raised, or filled with nan."""
    status = np.empty(matrix.shape[0], dtype=np.int64)

    def run_all(rows: NDArray[np.int64]) -> None:
        for row in rows:
            status[row] = run(row)

    # Small pieces, so that slow rows do not leave a core idle; each row is on its own, so the
    # numbers do not depend on how they are dealt out.
    rows = np.arange(matrix.shape[0])
    in_threads(run_all, np.array_split(rows, max(1, min(rows.size, 8 * workers))), workers)
    failed = np.flatnonzero(status != kernel.DONE)
    if failed.size and failures == "nan":
        out[failed] = np.nan
    elif failed.size:
        raise _failure(matrix, int(failed[0]), int(status[failed[0]]))


def _failure(matrix: FloatArray, row: int, status: int) -> SimulationError:
    values = matrix[row]
    shown = {
        "gap": (Slot.gap_rad, "rad"),
        "reference speed": (Slot.reference_speed_rpm, "rpm"),
        "current limit": (Slot.current_limit_a, "A"),
    }
    listed_values = ", ".join(
        f"{name} {values[slot]:g} {unit}" for name, (slot, unit) in shown.items()
    )
    number = f"Simulation {row + 1} of {matrix.shape[0]}: " if matrix.shape[0] > 1 else ""
    return SimulationError(f"{number}{_REASONS[status]}.", found=listed_values)
