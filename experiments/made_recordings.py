"""Recordings that studies and tests make: of the disturbance model itself, or spoiled.

Those of the disturbance model have a known truth, and no misfit that repeats every rotation,
because the model is exact in them: they show what the search, the noise model and the sampling do,
never what the waveform fails to capture. Spoiled ones are so as real ones are: samples were lost,
or the speed drifts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.bench.kernel import DONE, STATES, Slot, simulate, waiting_torques
from bayesbl.bench.simulation import ACCURACY
from bayesbl.bench.steady import settling_time_s
from bayesbl.noise.process import NoiseModel
from bayesbl.recording.repairs import bridge
from bayesbl.recording.types import MOTOR_SPEED, FloatArray, Recording
from bayesbl.ringing.symbols import (
    AMPLITUDE,
    DECAY,
    FREQUENCY,
    MEAN,
    ROTATION,
    SEPARATION,
    START,
    WINDOW_END,
    WINDOW_START,
)
from bayesbl.ringing.table_2 import REPETITIONS
from bayesbl.ringing.waveform import model_speed

FINER = 10
"""How many times finer a steady recording is sampled that a drifting one is read from."""


def draw_symbols(generator: np.random.Generator, amplitude_rpm: float) -> dict[str, float]:
    """All nine symbols at random, but for A, the mean speed and the window: T_w 2.5 to 4.5 s."""
    rotation = generator.uniform(2.5, 4.5)
    return {
        AMPLITUDE: amplitude_rpm,
        START: generator.uniform(0.0, rotation),
        DECAY: generator.uniform(6.0, 25.0),
        FREQUENCY: 2.0 * math.pi * math.exp(generator.uniform(math.log(5.0), math.log(25.0))),
        MEAN: 2000.0,
        WINDOW_START: 0.0,
        WINDOW_END: 0.204,
        SEPARATION: rotation * generator.uniform(0.25, 0.75),
        ROTATION: rotation,
    }


def synthetic_recording(
    symbols: Mapping[str, float],
    noise: NoiseModel,
    generator: np.random.Generator,
    *,
    rotations: float = 5.0,
    baseline_rpm: Sequence[float] = (),
    sampling_hz: float = 1000.0,
) -> Recording:
    """The motor speed of the model with noise of the given kind, evenly sampled from t = 0."""
    time_s = np.arange(round(rotations * symbols[ROTATION] * sampling_hz)) / sampling_hz
    speed = model_speed(time_s, symbols, baseline_rpm) + noise.draw(time_s.size, generator)
    return Recording("synthetic", time_s, {MOTOR_SPEED: speed})


def speed_as_printed(time_s: FloatArray, symbols: Mapping[str, float]) -> FloatArray:
    """h(t) of eq. 6, shape (n,), rpm: hard edges, four repetitions, nothing before or after.

    sin ω(t) is read as sin(ω (t − t1)). Where t2 is not later than t1 there is no pulse.
    """
    train = np.zeros_like(time_s)
    for repetition in range(1, REPETITIONS + 1):
        first = symbols[START] + repetition * symbols[ROTATION]
        for sign, moved in ((1.0, first), (-1.0, first - symbols[SEPARATION])):
            since = time_s - moved
            u = since - symbols[WINDOW_START]
            decaying = np.exp(-symbols[DECAY] * np.maximum(u, 0.0))
            ringing = decaying * np.sin(symbols[FREQUENCY] * u)
            inside = (u >= 0.0) & (since <= symbols[WINDOW_END])
            train += sign * np.where(inside, ringing, 0.0)
    return np.asarray(symbols[MEAN] + symbols[AMPLITUDE] * train)


def with_samples_lost(
    recording: Recording, share: float, generator: np.random.Generator
) -> Recording:
    """A recording as it is read in after each sample was lost with probability ``share``.

    Raises
    ------
    RecordingError
        If more is lost than a reader bridges.
    """
    names = list(recording.channels)
    values = np.column_stack([recording.channels[name] for name in names])
    values[generator.uniform(size=recording.samples) < share] = np.nan
    bridged = bridge(recording.time_s, values, lambda row, _: f"sample {row}")
    return replace(
        recording,
        time_s=bridged.time_s,
        channels=dict(zip(names, bridged.values.T, strict=True)),
        excluded=bridged.excluded,
        notes=(*recording.notes, *bridged.notes),
    )


def drifting(
    bench: Bench,
    gap_rad: float,
    drift_share: float,
    generator: np.random.Generator,
    *,
    rotations: float,
    sampling_hz: float,
    start_angle_rad: float,
) -> Recording:
    """Motor speed whose mean grows by ``drift_share`` of itself from begin to end.

    The drift is slow against the ringing, so everything happens as at constant speed, when the
    load reaches the angle at which it happens.
    """
    steady = bench.simulate(
        gap_rad,
        rotations=rotations + 0.1,
        sampling_hz=FINER * sampling_hz,
        start_angle_rad=start_angle_rad,
    )
    samples = bench.samples(rotations, sampling_hz)
    time_s = np.arange(samples) / sampling_hz
    drift = drift_share * (time_s / time_s[-1] - 0.5)
    ahead_s = np.concatenate(([0.0], np.cumsum(drift[1:] + drift[:-1]))) * (0.5 / sampling_hz)
    reached_s = time_s + ahead_s
    speed = np.interp(reached_s - reached_s.min(), steady.time_s, steady.motor_speed_rpm)
    speed += drift * bench.value("reference_speed_rpm")
    speed += bench.measurement.speed_noise.draw(samples, generator)
    return Recording("drifting", time_s, {MOTOR_SPEED: speed})


def start_state(parameters: FloatArray, accuracy_rpm: float | None = None) -> FloatArray:
    """State of a bench at the first sample of a steady rotation, SI, (18,).

    The torques of a sampled controller that do not act yet come behind it.
    """
    accuracy = accuracy_rpm or ACCURACY * abs(parameters[Slot.reference_speed_rpm])
    settling_s = settling_time_s(parameters[None], accuracy)[0]
    state = np.empty(STATES + waiting_torques(parameters))
    sample = np.zeros(1), accuracy, np.empty((1, 1)), state
    assert simulate(parameters, settling_s, 1.0, *sample)[0] == DONE
    return state
