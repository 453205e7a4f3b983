"""What a task may ask of a recording, each as a small function that refuses with the reason.

A recording that passes :mod:`bayesbl.recording.readers` is sound as a file; whether it holds what
a fit needs is asked here. Every function raises :class:`RecordingError` and changes nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bayesbl.errors import RecordingError
from bayesbl.recording.channels import CHANNELS, MOTOR_POSITION, MOTOR_SPEED, did_you_mean
from bayesbl.recording.types import FloatArray, Recording
from bayesbl.units import RPM_PER_RAD_PER_S, accepted_units, conversion_factor

MINIMUM_SAMPLING_HZ = 100.0
"""The ringing is near 10 Hz and lasts 0.2 s: below this a pulse is too few samples."""

MINIMUM_ROTATIONS = 1.95
"""Noise is told from misfit by what two rotations do not share; a little of the second may lack."""

GRID_TOLERANCE = 0.45
"""Largest distance of a time stamp from the even grid, in sampling periods."""

CONSTANT_RANGE = 1e-6
"""A signal that varies by less than this part of its size is constant."""


def check_for_fit(recording: Recording, gear_ratio: float | None = None) -> None:
    """Everything that a fit of the speed's disturbance pattern asks of a recording.

    Rotations are counted only if the gear ratio is known; otherwise the fit, which finds the
    rotation period itself, asks :func:`require_rotations` with what it found.
    """
    require_channels(recording, [MOTOR_SPEED])
    require_sampling_rate(recording)
    require_uniform_sampling(recording)
    require_varying(recording, MOTOR_SPEED)
    require_plausible_speed_unit(recording)
    require_unclipped(recording, MOTOR_SPEED)
    if gear_ratio is not None:
        require_rotations(recording, rotations_of(recording, gear_ratio))


def require_channels(recording: Recording, channels: Sequence[str]) -> None:
    """The recording holds these channels."""
    for channel in channels:
        if channel not in recording.channels:
            unused = recording.source.unused_columns if recording.source else ()
            present = [*recording.channels, *unused]
            raise _error(
                recording,
                f"There is no column for {CHANNELS.get(channel, channel)}."
                + did_you_mean(channel, present),
                where="header",
                found="time_s, " + ", ".join(present),
                expected=f'a column "{channel}", or another name for it under [columns]',
            )


def require_sampling_rate(recording: Recording, minimum_hz: float = MINIMUM_SAMPLING_HZ) -> None:
    """The mean sampling rate is at least ``minimum_hz``."""
    rate = 1.0 / recording.sampling_period_s
    # Rounded time stamps put 100 Hz a hair below itself.
    if not rate >= minimum_hz * (1.0 - 1e-3):
        raise _error(
            recording,
            "The sampling rate is too low to see the impacts.",
            where="time_s",
            found=f"{rate:.4g} Hz",
            expected=f"at least {minimum_hz:.4g} Hz; is time in seconds?",
        )


def grid_deviation(recording: Recording) -> FloatArray:
    """Distance of each time stamp from the best even grid, shape (n,), in sampling periods.

    The grid is the least-squares line of time over sample number. Stamps rounded to a resolution r
    lie within r/2 of it, however long the recording; one lost sample puts some stamp at least half
    a period off, wherever it was lost.
    """
    time = recording.time_s - recording.time_s[0]
    number = np.arange(time.size) - 0.5 * (time.size - 1)
    slope = float(number @ time) / float(number @ number)
    deviation: FloatArray = (time - time.mean()) / slope - number
    return deviation


def require_uniform_sampling(recording: Recording, tolerance: float = GRID_TOLERANCE) -> None:
    """Every time stamp is nearest to its own point of an even grid.

    The tolerance, 0.45 of a sampling period, lets time stamps pass that were rounded to up to
    0.9 of a period (0.1 ms, or 1 ms at 800 Hz), and no recording that lost a sample.
    """
    deviation = grid_deviation(recording)
    worst = int(np.argmax(np.abs(deviation)))
    if abs(deviation[worst]) <= tolerance:
        return
    steps = np.diff(recording.time_s)
    longest = int(np.argmax(steps))
    period = recording.sampling_period_s
    raise _error(
        recording,
        "The samples are not evenly spaced in time.",
        where=f"time_s near {recording.time_s[worst]:.6g} s",
        found=f"a time stamp {abs(deviation[worst]) * period:.3g} s off the even grid of "
        f"{period:.6g} s; the longest step, {steps[longest]:.3g} s, follows "
        f"{recording.time_s[longest]:.6g} s",
        expected=f"at most {tolerance * period:.3g} s off, and no lost sample",
    )


def rotations_of(recording: Recording, gear_ratio: float) -> float:
    """Load rotations in the recording, from the motor's position or else from its mean speed."""
    position = recording.channels.get(MOTOR_POSITION)
    if position is not None:
        covered = abs(float(position[-1] - position[0])) / (2.0 * math.pi)
        turns = covered * recording.samples / (recording.samples - 1)
    else:
        turns = abs(float(recording.motor_speed_rpm.mean())) / 60.0 * recording.duration_s
    return turns / gear_ratio


def require_rotations(
    recording: Recording, rotations: float, minimum: float = MINIMUM_ROTATIONS
) -> None:
    """The recording spans two rotations of the load; 1.95 pass."""
    if rotations >= minimum:
        return
    needed = (
        f" (at this speed {2.0 * recording.duration_s / rotations:.1f} s)" if rotations > 0 else ""
    )
    raise _error(
        recording,
        "The recording holds too few rotations of the load.",
        found=f"{rotations:.2f} rotations in {recording.duration_s:.4g} s",
        expected=f"at least 2{needed}, and the right gear ratio if one is given",
    )


def require_varying(recording: Recording, channel: str) -> None:
    """The signal is not constant: it varies by more than a millionth of its size."""
    values = recording.channels[channel]
    low, high = float(values.min()), float(values.max())
    if high - low <= CONSTANT_RANGE * max(abs(low), abs(high)):
        raise _error(
            recording,
            f"The {CHANNELS.get(channel, channel)} is constant.",
            where=channel,
            found=f"{values.mean():.6g} in all {values.size} samples",
            expected="a signal in which the load's impacts can be seen",
        )


def require_unclipped(recording: Recording, channel: str) -> None:
    """The signal does not run into a limit of its sensor or of its number format.

    A limited signal piles up on its very largest or smallest value. Three things must come
    together, at either end, to be called that:

    - at least 5 samples in a row sit exactly on the extreme value;
    - that value occurs more than 5 times as often as any of the 10 distinct values next to it;
    - there are at least 10 such values, so that the signal is not merely coarse.

    The second cannot hold for an encoder's quantised speed: its levels thin out towards the
    extremes, and even the flat top of a sine holds its highest level only 2.4 times as long as
    the next. A signal held for some samples repeats all its values alike.
    """
    values = recording.channels[channel]
    for side, signal in (("largest", values), ("smallest", -values)):
        count = _samples_at_limit(signal)
        if count:
            extreme = values.max() if side == "largest" else values.min()
            first = int(np.flatnonzero(values == extreme)[0])
            raise _error(
                recording,
                f"The {CHANNELS.get(channel, channel)} is cut off, or stands still.",
                where=f"{channel} at {recording.time_s[first]:.6g} s",
                found=f"{count} samples exactly at the {side} value, {extreme:.6g}",
                expected="a signal that does not reach the limit of its sensor",
            )


def _samples_at_limit(values: FloatArray) -> int:
    """Samples piled up on the maximum if it is a limit, else 0."""
    levels, counts = np.unique(values, return_counts=True)
    if levels.size < 11 or counts[-1] <= 5 * counts[-11:-1].max():
        return 0
    return int(counts[-1]) if _longest_run(values == levels[-1]) >= 5 else 0


def _longest_run(flags: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False]))))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def require_plausible_speed_unit(recording: Recording, tolerance: float = 0.02) -> None:
    """Mean speed agrees with the slope of the motor's position, where both are there.

    Directions may differ in sign. A mean speed below 1 rpm is too slow to compare. If another
    unit of either column makes them agree within ``tolerance``, the message says so.
    """
    position = recording.channels.get(MOTOR_POSITION)
    if position is None or MOTOR_SPEED not in recording.channels:
        return
    span = float(recording.time_s[-1] - recording.time_s[0])
    from_position = abs(float(position[-1] - position[0])) / span * RPM_PER_RAD_PER_S
    speed = abs(float(recording.motor_speed_rpm.mean()))
    if min(from_position, speed) < 1.0 or abs(speed / from_position - 1.0) <= 0.05:
        return
    raise _error(
        recording,
        "Motor speed and motor position do not belong together."
        + _other_unit(speed / from_position, tolerance),
        where=f"{MOTOR_SPEED}, {MOTOR_POSITION}",
        found=f"a mean speed of {speed:.6g} rpm, but a position that moves at "
        f"{from_position:.6g} rpm",
        expected="the same within 5 %; state the units under [columns]",
    )


def _other_unit(ratio: float, tolerance: float) -> str:
    """The unit that would explain a ratio of speed to position's slope, as a sentence."""
    for channel, sign in ((MOTOR_SPEED, 1), (MOTOR_POSITION, -1)):
        own, *others = accepted_units(channel)
        for unit in others:
            if abs(ratio * conversion_factor(channel, unit) ** sign - 1.0) <= tolerance:
                return f" The column for {channel} looks like {unit}, not {own}."
    return ""


def _error(
    recording: Recording,
    problem: str,
    *,
    where: str | None = None,
    found: str | None = None,
    expected: str | None = None,
) -> RecordingError:
    file = recording.source.file if recording.source else recording.name
    return RecordingError(problem, file=file, where=where, found=found, expected=expected)
