"""Recordings of the disturbance model itself, with known truth, for studies and tests.

They hold no misfit that repeats every rotation, because the model is exact in them: they show what
the search, the noise model and the sampling do, never what the waveform fails to capture.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from bayesbl.noise.process import NoiseModel
from bayesbl.recording.types import MOTOR_SPEED, Recording
from bayesbl.ringing.model import model_speed
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
