"""Recordings of the disturbance model itself, whose truth is known."""

from __future__ import annotations

import numpy as np
from made_recordings import synthetic_recording
from scipy.optimize import brentq

from bayesbl.noise.process import NoiseModel
from bayesbl.recording.types import MOTOR_SPEED, FloatArray, Recording
from bayesbl.ringing.objective import Objective
from bayesbl.ringing.optimum import exchanged
from bayesbl.ringing.search import refine
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
    DisturbanceModel,
)
from bayesbl.ringing.waveform import model_speed

TRUTH = {
    AMPLITUDE: 20.0,
    START: 1.3,
    DECAY: 12.0,
    FREQUENCY: 62.0,
    MEAN: 2000.0,
    WINDOW_START: 0.0,
    WINDOW_END: 0.204,
    SEPARATION: 1.7,
    ROTATION: 3.6,
}
STRONG = TRUTH | {AMPLITUDE: 30.0}
QUICK = TRUTH | {START: 0.3, DECAY: 19.0, FREQUENCY: 70.0, SEPARATION: 0.7, ROTATION: 1.4}
"""Rotations of 1.4 s: few samples hold several."""
NOISE = NoiseModel(1.5)


def clean(seed: int = 1) -> Recording:
    return synthetic_recording(STRONG, NOISE, np.random.default_rng(seed), baseline_rpm=(5.0, -3.0))


def ambiguous() -> Recording:
    """Two trains of pulses on one another, mixed so that either alone explains them as well.

    The second has its pulses exchanged, half a ringing later, and decays faster: with it goes
    another amplitude.
    """
    measured, model = clean(), DisturbanceModel()
    first = np.array([STRONG[name] for name in model.searched])
    other = STRONG | dict(zip(model.searched, exchanged(model, first)[1], strict=True))
    other[DECAY] = 18.0
    second = np.array([other[name] for name in model.searched])
    pulses = [model_speed(measured.time_s, symbols, [5.0, -3.0]) for symbols in (STRONG, other)]
    noise = NoiseModel(4.0).draw(measured.time_s.size, np.random.default_rng(2))

    def mixed(share: float) -> FloatArray:
        return np.asarray((1.0 - share) * pulses[0] + share * pulses[1] + noise)

    def excess(share: float) -> float:
        objective = Objective(model, measured.time_s, mixed(share))
        ends = np.array([refine(objective, point) for point in (first, second)])
        sse = objective.sum_of_squares(ends)
        return float(sse[0] - sse[1])

    share = float(brentq(excess, 0.3, 0.9, xtol=1e-5))
    return Recording("ambiguous", measured.time_s, {MOTOR_SPEED: mixed(share)})
