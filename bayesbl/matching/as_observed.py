"""Simulate benches as a recording shows them: its channels, sampling rate and motion.

Recent simulations are cached, because fits of many candidates start at one point and would all
simulate the nominal bench around it.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesbl.bench.effects import repeat_each_rotation, turn_with_the_motor
from bayesbl.bench.kernel import CURRENT, POSITION, SPEED, Slot
from bayesbl.bench.parameters import rotation_period_s
from bayesbl.bench.simulation import ACCURACY, simulate_channels, simulate_motions
from bayesbl.matching.observed import Observed
from bayesbl.noise.channel_noise import ChannelNoise
from bayesbl.recording.types import FloatArray

ACCURACY_SHARE = 0.003
"""Largest error of a simulated speed, relative to the speed noise."""
FINEST = 0.01
"""Finest accuracy for tiny noise, relative to the usual accuracy."""

ENCODER_ROUNDS = 2
"""After two rounds an eccentric encoder of 20 mrad is off by 0.1 mrad; after one, by 8 mrad."""


def accuracy_rpm(noise: ChannelNoise, observation: Observed) -> float:
    """Required accuracy of simulations for a recording with this noise."""
    coarsest = ACCURACY * abs(observation.reference_speed_rpm)
    return float(np.clip(ACCURACY_SHARE * noise.sd[0], FINEST * coarsest, coarsest))


def simulated(
    observation: Observed,
    samples: int,
    accuracy_rpm: float,
    workers: int,
    failures: str,
    matrix: FloatArray,
) -> FloatArray:
    """Channels as observed, (m, SLOTS) to (m, c, samples)."""
    options: Any = {"accuracy_rpm": accuracy_rpm, "workers": workers, "failures": failures}
    if observation.motion is not None:
        signals = simulate_motions(
            matrix, observation.motion, samples, observation.sampling_hz, **options
        )
        return signals[:, observation.rows]
    if observation.motor_start_rad is not None:
        matrix = _with_encoder_start(matrix, observation.motor_start_rad, workers)
    grid = samples, observation.sampling_hz
    moments, order = _within_a_rotation(matrix, samples, observation.sampling_hz)
    speed_only = len(observation.signals) == 1
    signals = simulate_channels(matrix, *grid, moments_s=moments, speed_alone=speed_only, **options)
    if not speed_only:
        signals = signals[:, [SPEED, CURRENT]]
    return signals if order is None else np.take(signals, order, axis=2)


def _within_a_rotation(
    matrix: FloatArray, samples: int, sampling_hz: float
) -> tuple[FloatArray | None, NDArray[np.int64] | None]:
    """Sample times folded into the first rotation, ascending, and the index of each sample there.

    ``None`` if the benches (m, SLOTS) do not repeat, or not with one period, or if the samples end
    before.
    """
    turn_s, times = _common_rotation_s(matrix), np.arange(samples) / sampling_hz
    if turn_s is None or times[-1] <= turn_s:
        return None, None
    within = times % turn_s
    order = np.argsort(within, kind="stable")
    index = np.empty_like(order)
    index[order] = np.arange(samples)
    return within[order], index


def _common_rotation_s(matrix: FloatArray) -> float | None:
    """Common period of these benches (m, SLOTS); ``None`` if one does not repeat."""
    turns_s = rotation_period_s(matrix)
    repeat = np.all(turns_s == turns_s[0]) and repeat_each_rotation(matrix)
    return float(turns_s[0]) if repeat else None


def _with_encoder_start(matrix: FloatArray, motor_start_rad: float, workers: int) -> FloatArray:
    """The benches (m, SLOTS), each turned so that its encoder starts at this angle.

    The motor's start angle of a bench is that of a relaxed shaft. The encoder also shows twist, gap
    and its own error: half a radian of the motor, and another value on the other tooth flank.
    """
    if not turn_with_the_motor(matrix):
        return matrix
    matrix = matrix.copy()
    relaxed = matrix[:, Slot.gear_ratio] * matrix[:, Slot.start_angle_rad]
    begin = matrix[:, Slot.motor_start_angle_rad]
    begin[:] = motor_start_rad
    for _ in range(ENCODER_ROUNDS):
        shown = simulate_channels(matrix, 1, 1.0, workers=workers, failures="nan")[:, POSITION, 0]
        begin -= np.nan_to_num(begin + shown - relaxed - motor_start_rad)
    return matrix


def continued(stretch: FloatArray, samples: int) -> FloatArray:
    """Continue a repeating stretch to this many samples: (m, c, k) to (m, c, samples)."""
    if stretch.shape[2] == samples:
        return stretch
    # Indexing would put the samples first in memory, which makes whitening ten times slower.
    return np.asarray(np.take(stretch, np.arange(samples) % stretch.shape[2], axis=2))


def in_whole_ticks(matrix: FloatArray, observation: Observed) -> FloatArray:
    """Adjust sampled controllers to a whole number of ticks per rotation, so that rotations repeat.

    The relative change of the period is less than its share of two rotations, far below what
    recordings show. A period that is a whole number of samples stays: then each sample is at a
    tick.
    """
    period = matrix[:, Slot.sampled_control__period_s]
    samples = period * observation.sampling_hz
    adjustable = (period > 0.0) & (np.abs(samples - np.round(samples)) > 1e-6)
    if observation.motion is not None or not adjustable.any():
        return matrix
    matrix = matrix.copy()
    turn = rotation_period_s(matrix)[adjustable]
    matrix[adjustable, Slot.sampled_control__period_s] = turn / np.round(turn / period[adjustable])
    return matrix


def repeats(matrix: FloatArray, observation: Observed) -> bool:
    """Whether these benches repeat after whole samples, fewer than the recording has."""
    if observation.motion is not None or observation.lag >= observation.samples:
        return False
    turn_s = _common_rotation_s(matrix)
    return turn_s is not None and abs(turn_s * observation.sampling_hz - observation.lag) <= 1e-6


MOST_BYTES = 32_000_000


class RecentSimulations:
    """Cache of signals by parameters, which drops the oldest. Thread-safe."""

    def __init__(self) -> None:
        self._bytes = 0
        self._lock = Lock()
        self._kept: OrderedDict[tuple[Hashable, bytes], FloatArray] = OrderedDict()

    def signals(
        self,
        matrix: FloatArray,
        settings: Hashable,
        simulate: Callable[[FloatArray], FloatArray],
    ) -> FloatArray:
        """Signals of each parameter vector, (m, SLOTS) to (m, c, k).

        Parameters
        ----------
        settings
            Everything else that the signals depend on.
        simulate
            Makes the signals of the rows that are not cached.
        """
        keys = [(settings, row.tobytes()) for row in matrix]
        with self._lock:
            cached = {key: self._kept[key] for key in keys if key in self._kept}
        # Points often differ only in unknowns of other recordings: simulate duplicates once.
        missing = {key: row for key, row in zip(keys, matrix, strict=True) if key not in cached}
        if missing:
            # Simulating may use this cache too, and drop entries; ``known`` keeps them.
            cached |= zip(missing, simulate(np.stack([*missing.values()])), strict=True)
        with self._lock:
            for key, signals in cached.items():
                if key not in self._kept:
                    self._kept[key] = signals.copy()
                    self._bytes += signals.nbytes
                self._kept.move_to_end(key)
            while self._bytes > MOST_BYTES and len(self._kept) > 1:
                self._bytes -= self._kept.popitem(last=False)[1].nbytes
        return np.stack([cached[key] for key in keys])
