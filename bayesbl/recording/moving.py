"""Recordings of a joint that follows a reference over time instead of turning at one speed."""

from __future__ import annotations

import math

import numpy as np

from bayesbl.errors import RecordingError
from bayesbl.recording.channels import MOTOR_SPEED, REFERENCE_POSITION, REFERENCE_SPEED
from bayesbl.recording.types import FloatArray, Recording

VARIES = 0.05
"""Range of a reference speed over its largest value, from which on it is a motion. Below it the
speed is one, and what it varies by is at most what a fit of one speed refuses."""

PARTS = 8
"""Of a recording, whose mean speeds are compared."""

AT_REST = 1e-3
"""Share of its largest value below which a reference speed is a rest."""

DIFFERENT = 0.25
"""Squared difference over power at which a reference no longer is what it was a little earlier: a
cycle is longer than that."""

ALIKE = 0.03
"""RMS difference of a reference from itself one cycle later, over its RMS: less than a shift by one
sample in a hundred of a stroke."""

AGREEMENT = 0.1
"""Largest relative difference of the speed from its reference, by least squares over the motion. A
speed loop follows within a few per cent; the nearest wrong units differ by a factor of 2π."""


def moves(recording: Recording) -> bool:
    """Whether the recording holds a reference that varies over time."""
    speed = recording.channels.get(REFERENCE_SPEED)
    if speed is not None:
        largest = float(np.max(np.abs(speed)))
        return largest > 0.0 and float(np.ptp(speed)) > VARIES * largest
    position = recording.channels.get(REFERENCE_POSITION)
    if position is None:
        return False
    steps = np.abs(np.diff(position))
    straight = np.linspace(position[0], position[-1], position.size)
    return float(np.max(np.abs(position - straight))) > VARIES * float(steps.sum() + 1e-300)


def is_one_speed(speed_rpm: FloatArray, period_s: float) -> bool:
    """Whether a motor turns at one speed: no part of the recording is slower or faster.

    Parts of a turn or more, if there are so many: torque that repeats averages out over them.
    ``speed_rpm``: shape (n,).
    """
    turns = float(np.mean(np.abs(speed_rpm))) / 60.0 * speed_rpm.size * period_s
    parts = np.array_split(speed_rpm, max(2, min(PARTS, int(turns))))
    means = np.array([part.mean() for part in parts])
    return bool(np.ptp(means) <= VARIES * abs(float(means.mean())))


def require_same_motion(recording: Recording, asked_rpm: FloatArray) -> None:
    """The speed is that of its reference, in size and direction.

    Parameters
    ----------
    asked_rpm
        Reference speed, shape (n,).

    Raises
    ------
    RecordingError
        If not: another unit, the load's side of the gear, or another motion.
    """
    speed = recording.motor_speed_rpm
    ratio = float(speed @ asked_rpm) / float(asked_rpm @ asked_rpm)
    left = float(np.sqrt(np.mean((speed - ratio * asked_rpm) ** 2)))
    share = left / max(float(np.sqrt(np.mean(speed**2))), 1e-300)
    if abs(ratio - 1.0) <= AGREEMENT:
        return
    raise RecordingError(
        "Motor speed and reference do not agree.",
        file=recording.place,
        where=f"{MOTOR_SPEED}, "
        + (REFERENCE_SPEED if REFERENCE_SPEED in recording.channels else REFERENCE_POSITION),
        found=f"a speed of {ratio:.4g} times the reference, and {share:.2g} of it that does not "
        "follow the reference at all",
        expected="the same within 10 %: both of the motor, not of the load, with the same sign, "
        "and their units stated under [columns]",
    )


def first_move(asked: FloatArray) -> int:
    """Samples that a reference, shape (n,), rests for at its begin; 0 where it begins in motion."""
    return int(np.argmax(np.abs(asked) > AT_REST * float(np.max(np.abs(asked)))))


def cycle_of(asked: FloatArray) -> int | None:
    """Samples after which a reference, shape (n,), repeats; ``None`` where less than two cycles do.

    What comes before the first motion is left out.
    """
    part = asked[first_move(asked) :]
    n = part.size
    if n < 4:
        return None
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(part, size)
    product = np.fft.irfft(np.abs(spectrum) ** 2, size)[:n]
    power = np.cumsum(np.r_[0.0, part**2])
    lag = np.arange(n)
    # Σ (w(t + L) − w(t))² over what has a counterpart, and the power of both.
    both = (power[n] - power[lag]) + power[n - lag]
    apart = (both - 2.0 * product) / np.maximum(both, 1e-300)
    apart[both <= 1e-6 * power[n]] = math.inf
    other = np.flatnonzero(apart > DIFFERENT)
    if not other.size:
        return None
    shortest = int(other[0])
    alike = np.flatnonzero(apart[shortest : n // 2 + 1] < 0.5 * ALIKE**2) + shortest
    if not alike.size:
        return None
    # The first run of lags that are alike, where it is best.
    run = alike[: int(np.argmax(np.r_[np.diff(alike) > 1, True])) + 1]
    return int(run[np.argmin(apart[run])])
