"""Run many simulations in parallel, from flat parameter vectors to arrays.

Also model the measurement: encoder counts, noise, and the source of the speed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from bayesbl.bench import kernel
from bayesbl.bench.kernel import STATES, Slot
from bayesbl.bench.motion import Motion
from bayesbl.bench.parameters import check_parameters
from bayesbl.bench.steady import noise_through_loop, settling_time_s
from bayesbl.errors import BenchError, SimulationError
from bayesbl.noise.process import NO_NOISE, NoiseModel
from bayesbl.processes import in_threads
from bayesbl.recording.types import MOTOR_CURRENT, MOTOR_POSITION, MOTOR_SPEED, FloatArray
from bayesbl.units import RPM_PER_RAD_PER_S

SpeedSource = Literal["sensor", "encoder"]


@dataclass(frozen=True, slots=True)
class Measurement:
    """How the bench is measured.

    Attributes
    ----------
    encoder_counts
        Counts per motor revolution; ``None`` for an ideal encoder.
    speed_source
        ``sensor``: the speed that the controller sees, with noise. ``encoder``: backward difference
        of the recorded position over one sample (the first sample repeats the second), without
        noise of its own.
    speed_noise, current_noise
        In rpm and A.
    noise_through_controller
        Whether the speed noise is inside the loop: the controller responds to it, on the linear
        bench in contact, and the recorded speed includes the motor's response.
    """

    encoder_counts: int | None = None
    speed_source: SpeedSource = "sensor"
    speed_noise: NoiseModel = NO_NOISE
    current_noise: NoiseModel = NO_NOISE
    noise_through_controller: bool = False

    def seen_by(self, matrix: FloatArray, sampling_hz: float) -> FloatArray:
        """Benches, shape (m, SLOTS), with the averaging of the speed by its source at this rate.

        A difference of encoder positions is an average over a sampling period. If a bench states an
        averaging time, that includes it.
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
        """Recorded channels from the true signals, each (n,).

        ``loop`` has the parameters of the speed loop; ``None`` if there is none. Without ``rng``
        there is no noise.
        """
        if rng is not None:
            noise = self.speed_noise.draw(speed.size, rng)
            current = current + self.current_noise.draw(speed.size, rng)
            if self.noise_through_controller and loop is not None:
                motion, response = noise_through_loop(loop, noise, 1.0 / sampling_hz)
                noise = noise + motion
                current = current + response
            speed = speed + noise
        if self.encoder_counts is not None:
            count = 2.0 * math.pi / self.encoder_counts
            position = np.rint(position / count) * count
        if self.speed_source == "encoder":
            difference = np.diff(position) * sampling_hz * RPM_PER_RAD_PER_S
            speed = np.concatenate((difference[:1], difference))
        return {MOTOR_POSITION: position, MOTOR_SPEED: speed, MOTOR_CURRENT: current}


PERFECT = Measurement()


ACCURACY = 5e-6
"""Default for the largest error of a simulated speed, as a share of the fastest reference speed:
0.01 rpm of 2000."""
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
) -> FloatArray:
    """Noise-free signals in steady rotation.

    Parameters
    ----------
    parameter_matrix
        Shape (m, SLOTS), one simulation per row (see ``kernel.Slot``).
    samples, sampling_hz
        Number n and rate of the samples; the first is where the load passes the start angle.
    moments_s
        Times of the samples from there on, ascending, (n,); ``None`` for even spacing at the rate.
    accuracy_rpm
        Largest error of the speed, rpm; ``None`` for ``ACCURACY`` of the reference speed.
    workers
        Threads; the numbers do not depend on it.
    failures
        ``"raise"``, or ``"nan"`` to fill failed rows with nan, for samplers.

    Returns
    -------
    Array of shape (m, 3, n): position in rad (continuous over turns, without offset to zero or
    quantisation), speed in rpm as the controller sees it, current in A. With ``speed_alone`` shape
    (m, 1, n).

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
    no_state = np.empty(0)

    def run(row: int) -> Any:
        if math.isnan(settling[row]):
            return kernel.DIVERGED, 0
        start = matrix[row], settling[row], 1.0 / sampling_hz
        return kernel.simulate(*start, moments, accuracy[row], out[row], no_state)

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
    """Like :func:`simulate_channels`, but the speed loop follows a motion: shape (m, 3, n).

    The first sample is at the motion's start, with the load at ``start_angle_rad`` and all torques
    balanced, on the flank that the load's torque presses on, or on ``start_flank`` if that is 1 or
    −1. A held output starts at rest on the lower flank. With ``states``, all states as from
    :func:`simulate_states`, shape (m, 19, n).
    """
    out = np.zeros((parameter_matrix.shape[0], STATES if states else 3, samples))
    fastest = 0.0 if motion.output_held else motion.fastest_rpm
    accuracy = _accuracy_rpm(accuracy_rpm, np.full(len(parameter_matrix), fastest))
    matrix = _sound(parameter_matrix, out, sampling_hz, accuracy)
    if motion.output_held:
        matrix = matrix.copy()
        matrix[:, Slot.load_inertia_kg_m2] = math.inf
    moments = _even_s(out, sampling_hz)

    def run(row: int) -> Any:
        start = matrix[row], motion.pieces, 1.0 / sampling_hz
        return kernel.simulate_motion(*start, moments, accuracy[row], start_flank, out[row])

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
    """All states from an initial one: free motion, transients, tests of laws. Shape (19, n), SI.

    States as in ``kernel``. Those of effects, structure and a sampled controller are zero while
    these are off. A sampled controller has just had a tick. The torques that wait behind it follow
    in the initial state. The ramp of the position loop starts at the initial motor angle. Dry
    friction changes its sign over the given width at the motor, by default over the usual one.
    Parameters are not checked, so gains may be zero here.
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


def _even_s(out: FloatArray, sampling_hz: float) -> FloatArray:
    """Times of evenly spaced samples, (…, n) to (n,)."""
    return np.asarray(np.arange(out.shape[-1]) * (1.0 / sampling_hz), dtype=np.float64)


def _accuracy_rpm(given_rpm: float | None, reference_rpm: FloatArray) -> FloatArray:
    """Accuracy of each simulation, rpm, by default from its reference speed."""
    if given_rpm is not None:
        return np.full_like(reference_rpm, given_rpm)
    share = ACCURACY * np.abs(reference_rpm)
    return np.where(share > 0.0, share, UNDRIVEN_ACCURACY_RPM)


def _sound(
    matrix: FloatArray, out: FloatArray, sampling_hz: float, accuracy_rpm: FloatArray
) -> FloatArray:
    """Check the parameter vectors and convert them for the kernel."""
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
    run: Callable[[int], Any], matrix: FloatArray, out: FloatArray, workers: int, failures: str
) -> None:
    """Run every row, which returns first its status; raise for failed rows, or fill with nan."""
    status = np.empty(matrix.shape[0], dtype=np.int64)

    def run_all(rows: NDArray[np.int64]) -> None:
        for row in rows:
            status[row] = run(row)[0]

    # Small pieces, so that slow rows leave no core idle. Rows are independent, so the numbers do
    # not depend on the split.
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
