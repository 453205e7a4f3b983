"""Checks that a recording holds what a task needs; each refuses with the reason.

:mod:`bayesbl.recording.readers` checks the file. These functions check for a joint at constant
speed, or one that follows a varying reference. All raise :class:`RecordingError`. Only
:func:`ready_for_fit` and :func:`with_speed` change a recording, and return the changed copy.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayesbl.errors import RecordingError
from bayesbl.recording.channels import (
    CHANNELS,
    MOTOR_CURRENT,
    MOTOR_POSITION,
    MOTOR_SPEED,
    REFERENCE_POSITION,
    REFERENCE_SPEED,
    TIME,
    did_you_mean,
    or_another_name,
)
from bayesbl.recording.repairs import HOLE, new_values, runs
from bayesbl.recording.types import FloatArray, Recording
from bayesbl.units import RPM_PER_RAD_PER_S, accepted_units, conversion_factor

MINIMUM_SAMPLING_HZ = 50.0  # a pulse rings near 10 Hz for 0.2 s and needs enough samples
MINIMUM_ROTATIONS = 1.95  # two separate noise from misfit; a little may be missing
BLOCK_S = 0.25
BLOCKS_COMPARED = 4
LARGEST_DEPARTURE = 0.2
SMALLEST_STEP = 0.02
STEP_OVER_SCATTER = 6.0
MOST_STRETCHES = 6  # this and those above: of :func:`require_one_speed`
LARGEST_CURRENT = 2.0  # times the bench's limit: peak and RMS differ by √2, wrong units by more
STANDSTILL_RPM = 1.0  # A slower motor would take minutes for one rotation even without a gear
LARGEST_DRIFT = 0.01
DRIFT_OVER_SCATTER = 3.0  # of :func:`require_no_drift`; the load angle's effect is below both
UNIT_AGREEMENT = 0.02  # relative difference below which another unit is the likely one

WHAT_A_MOTION_NEEDS = (
    "what the controller was asked for over time, as a column reference_speed_rpm or "
    "reference_position_rad of the motor, and a bench"
)

CONSTANT_RANGE = 1e-6  # A signal that varies by a smaller share of its size is constant


def ready_for_fit(recording: Recording, gear_ratio: float | None = None) -> Recording:
    """The recording with a speed, checked for a fit of the speed's disturbance pattern.

    A motion needs a reference, but neither one speed nor whole rotations. Rotations are counted
    here only if the gear ratio is known; otherwise the fit finds the rotation period and calls
    :func:`require_rotations`. Raises RecordingError if anything is missing.
    """
    recording = with_speed(recording)
    require_channels(recording, [MOTOR_SPEED])
    require_sampling_rate(recording)
    require_no_holes(recording)
    require_alive(recording, (MOTOR_SPEED,))
    if not moves(recording):
        require_alive(recording, (MOTOR_POSITION,))
        require_plausible_speed_unit(recording)
        require_unclipped(recording, MOTOR_SPEED)
        require_turning(recording)
        require_one_speed(recording)
        if gear_ratio is not None:
            require_rotations(recording, rotations_of(recording, gear_ratio))
    current = recording.channels.get(MOTOR_CURRENT)
    if current is None or not is_constant(current):
        return recording
    note = (
        f"The {CHANNELS[MOTOR_CURRENT]} ({MOTOR_CURRENT}) never changes "
        f"({_all_alike(recording, MOTOR_CURRENT)}): a dead sensor, or a value that was filled in. "
        "It is not used here, and the direct route refuses it."
    )
    return replace(recording, notes=(*recording.notes, note))


SPEED_AVERAGED_S = "speed_averaged_s"  # metadata: averaging time in s of a speed from positions


def with_speed(recording: Recording) -> Recording:
    """The recording with a motor speed, derived from the motor's position if there is no speed.

    ω_k = (θ_k − θ_{k−1})/Δt is the mean over the period before a sample, as in the law
    ``speed_averaging``. Positions that the recorder repeated or interpolated are dropped.
    """
    if MOTOR_SPEED in recording.channels or MOTOR_POSITION not in recording.channels:
        return recording
    steps = np.diff(recording.channels[MOTOR_POSITION])
    speed = RPM_PER_RAD_PER_S * steps / np.diff(recording.time_s)
    if made_up := new_values(speed):
        return with_speed(_only(recording, made_up[0]))
    lost = recording.excluded
    behind = _only(recording, slice(1, None))
    period_s = recording.sampling_period_s
    return replace(
        behind,
        channels={**behind.channels, MOTOR_SPEED: speed},
        excluded=None if lost is None else lost[1:] | lost[:-1],
        metadata={**recording.metadata, SPEED_AVERAGED_S: period_s},
        notes=(
            *recording.notes,
            f"The speed is that of the position, its mean over the {1e3 * period_s:.3g} ms before "
            "each sample.",
        ),
    )


def _only(recording: Recording, kept: slice) -> Recording:
    """The recording with some of its samples."""
    lost = recording.excluded
    return replace(
        recording,
        time_s=recording.time_s[kept],
        channels={name: np.ascontiguousarray(v[kept]) for name, v in recording.channels.items()},
        excluded=None if lost is None else lost[kept],
    )


def require_channels(recording: Recording, channels: Sequence[str]) -> None:
    """Require these channels."""
    for channel in channels:
        if channel not in recording.channels:
            unused = recording.source.unused_columns if recording.source else ()
            present = [*recording.channels, *unused]
            raise RecordingError(
                f"There is no column for {CHANNELS.get(channel, channel)}."
                + did_you_mean(channel, present),
                file=recording.place,
                where="header",
                found="time_s, " + ", ".join(present),
                expected=f'a column "{channel}", {or_another_name(recording.place)}',
            )


def require_sampling_rate(recording: Recording) -> None:
    """Require a mean sampling rate of at least :data:`MINIMUM_SAMPLING_HZ`."""
    rate = 1.0 / recording.sampling_period_s
    # Rounded time stamps put a rate a hair below itself.
    if not rate >= MINIMUM_SAMPLING_HZ * (1.0 - 1e-3):
        raise RecordingError(
            "The sampling rate is too low to see the impacts."
            + (
                f" The column for {TIME} looks like ms, not s."
                if 1e3 * rate >= MINIMUM_SAMPLING_HZ and recording.duration_s >= 1e3 * BLOCK_S
                else ""
            ),
            file=recording.place,
            where="time_s",
            found=f"{rate:.4g} Hz",
            expected=f"at least {MINIMUM_SAMPLING_HZ:g} Hz; is time in seconds?",
        )


def require_no_holes(recording: Recording) -> None:
    """Require that no step between samples is longer than :data:`HOLE` times the usual one.

    Shorter steps may be uneven: :func:`bayesbl.recording.repairs.even` handles them.
    """
    steps = np.diff(recording.time_s)
    longest, usual = int(np.argmax(steps)), float(np.median(steps))
    if steps[longest] <= HOLE * usual:
        return
    raise RecordingError(
        "Samples are missing.",
        file=recording.place,
        where=f"time_s near {recording.time_s[longest]:.6g} s",
        found=f"the longest step, {steps[longest]:.3g} s, follows {recording.time_s[longest]:.6g} "
        f"s; the usual one is {usual:.3g} s",
        expected=f"at most {HOLE * usual:.3g} s; use the part before or after",
    )


def rotations_of(recording: Recording, gear_ratio: float) -> float:
    """Load rotations in the recording, from the motor's position or else its mean speed."""
    position = recording.channels.get(MOTOR_POSITION)
    if position is not None:
        covered = abs(float(position[-1] - position[0])) / (2.0 * math.pi)
        turns = covered * recording.samples / (recording.samples - 1)
    else:
        turns = abs(float(recording.motor_speed_rpm.mean())) / 60.0 * recording.duration_s
    return turns / gear_ratio


def require_rotations(recording: Recording, rotations: float) -> None:
    """Require :data:`MINIMUM_ROTATIONS` rotations of the load."""
    if rotations >= MINIMUM_ROTATIONS:
        return
    needed = (
        f" (at this speed {2.0 * recording.duration_s / rotations:.1f} s)" if rotations > 0 else ""
    )
    raise RecordingError(
        "The recording holds too few rotations of the load.",
        file=recording.place,
        found=f"{rotations:.2f} rotations in {recording.duration_s:.4g} s",
        expected=f"at least 2{needed}; speed in rpm, and the right gear ratio if one is given",
    )


def require_alive(recording: Recording, channels: Sequence[str]) -> None:
    """Require that these channels vary, if the recording holds them."""
    for channel in channels:
        if channel in recording.channels and is_constant(recording.channels[channel]):
            raise RecordingError(
                f"The {CHANNELS.get(channel, channel)} never changes: a dead sensor, or a value "
                "that was filled in.",
                file=recording.place,
                where=f"[columns] {channel}",
                found=_all_alike(recording, channel),
                expected="a measured signal; remove its line from [columns] to do without it, or "
                "rename the column in the file if that is its name there",
            )


def is_constant(values: FloatArray) -> bool:
    """Whether a signal varies by no more than a millionth of its size."""
    low, high = float(values.min()), float(values.max())
    return high - low <= CONSTANT_RANGE * max(abs(low), abs(high))


def _all_alike(recording: Recording, channel: str) -> str:
    values = recording.channels[channel]
    return f"{values.mean():.6g} in all {values.size} samples"


def require_turning(recording: Recording) -> None:
    """Require that the motor turns: its mean speed is more than the sensor's noise."""
    means, _ = _block_means(recording)
    fastest = float(np.abs(means).max())
    if fastest >= STANDSTILL_RPM:
        return
    raise RecordingError(
        "The motor does not turn.",
        file=recording.place,
        where=MOTOR_SPEED,
        found=f"at most {fastest:.2g} rpm in means over {BLOCK_S:g} s",
        expected="a motor that turns at one speed; is the speed in rpm?",
    )


def require_one_speed(recording: Recording) -> None:
    """Require one speed from start to end.

    Means over a quarter of a second, which average the ringing out, must not differ from their
    median by more than a fifth. Between one second and the next they must not change by more than 2
    % and six times their scatter within those seconds. Slow waves of the load angle make no such
    step: on a slope, the ratio is at most √12.
    """
    means, edges_s = _block_means(recording)
    count = means.size
    if count < 4 * BLOCKS_COMPARED:
        return
    usual = float(np.median(means))
    departs = np.abs(means - usual) > LARGEST_DEPARTURE * abs(usual)
    windows = np.lib.stride_tricks.sliding_window_view(means, BLOCKS_COMPARED)
    before, after = windows[:-BLOCKS_COMPARED], windows[BLOCKS_COMPARED:]
    size = np.abs(after.mean(axis=1) - before.mean(axis=1))
    scatter = np.sqrt(0.5 * (before.var(axis=1) + after.var(axis=1)))
    steps = np.flatnonzero(
        (size > SMALLEST_STEP * abs(usual)) & (size > STEP_OVER_SCATTER * scatter)
    )
    if steps.size:
        # One change is seen from several places; each is reported where it is sharpest.
        changes = np.split(steps, np.flatnonzero(np.diff(steps) > BLOCKS_COMPARED) + 1)
        cuts = [int(change[np.argmax(size[change])]) + BLOCKS_COMPARED for change in changes]
        where = "near " + ", ".join(f"{edges_s[cut]:.4g}" for cut in cuts[:MOST_STRETCHES])
        stretches = _stretches(means, [0, *cuts, count], edges_s)
    elif departs.any():
        begin, end = (edge[0] for edge in runs(departs))
        where = f"from {edges_s[begin]:.4g} to {edges_s[end]:.4g}"
        there = np.median(means[begin:end])
        stretches = f"{there:.5g} rpm there, {usual:.5g} rpm for most of the recording"
    else:
        return
    raise RecordingError(
        "The speed changes: a fit needs one constant speed.",
        file=recording.place,
        where=f"{MOTOR_SPEED} {where} s",
        found=stretches,
        expected="one speed; split the file there into one recording per speed, each of two load "
        "rotations or more. Or is this another column, a position or a current, under [columns]? "
        f"If the joint cannot turn round: {WHAT_A_MOTION_NEEDS}",
    )


def require_no_drift(recording: Recording) -> None:
    """Require that the speed does not drift, for a fit that did not find the rotations.

    The drift is a parabola through means over a quarter of a second. In one rotation the load
    angle's wave resembles one, so a fit that finds its rotations does not call this.
    """
    means, edges_s = _block_means(recording)
    x = np.linspace(-1.0, 1.0, means.size)
    drift = np.polynomial.Polynomial.fit(x, means, min(2, means.size - 1))(x)
    size, usual = float(np.ptp(drift)), abs(float(np.median(means)))
    if size <= max(LARGEST_DRIFT * usual, DRIFT_OVER_SCATTER * float(np.std(means - drift))):
        return
    begin, end = sorted((int(np.argmin(drift)), int(np.argmax(drift))))
    # The last block is named by its end, which is the recording's.
    times = edges_s[begin], edges_s[end if end + 1 < means.size else -1]
    raise RecordingError(
        "The speed drifts too far to find the load's rotations in it.",
        file=recording.place,
        where=f"{MOTOR_SPEED} from {times[0]:.4g} to {times[1]:.4g} s",
        found=f"a drift from {drift[begin]:.5g} to {drift[end]:.5g} rpm "
        f"({100.0 * size / usual:.2g} %)",
        expected="one speed for two rotations of the load or more, e.g. a machine that has settled",
    )


def _block_means(recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Mean speeds over a quarter of a second, shape (b,), rpm, and the edges of these blocks, (b +
    1,), s.

    A shorter recording is one block; an incomplete last block is left out.
    """
    block = min(max(1, round(BLOCK_S / recording.sampling_period_s)), recording.samples)
    count = recording.samples // block
    means = recording.motor_speed_rpm[: count * block].reshape(count, block).mean(axis=1)
    return means, np.r_[recording.time_s[: count * block : block], recording.time_s[-1]]


def _stretches(means: FloatArray, cuts: Sequence[int], edges_s: FloatArray) -> str:
    """Speed and time range of each stretch between cuts (block numbers), in words."""
    parts = [
        f"{np.median(means[begin:end]):.5g} rpm from {edges_s[begin]:.4g} to {edges_s[end]:.4g} s"
        for begin, end in itertools.pairwise(cuts)
    ]
    more = len(parts) - MOST_STRETCHES
    return ", ".join(parts[:MOST_STRETCHES]) + (f" and {more} more" if more > 0 else "")


def require_plausible_speed_unit(recording: Recording) -> None:
    """Require that the mean speed agrees with the motor's position and the reference speed.

    Signs may differ, and a mean speed below 1 rpm is not compared. If another unit of a column
    would make them agree within 2 %, the message says so.
    """
    speed = abs(float(recording.motor_speed_rpm.mean()))
    position = recording.channels.get(MOTOR_POSITION)
    if position is not None:
        span = float(recording.time_s[-1] - recording.time_s[0])
        moved = abs(float(position[-1] - position[0])) / span * RPM_PER_RAD_PER_S
        _require_same_speed(recording, speed, moved, MOTOR_POSITION, "that moves at")
    reference = recording.channels.get(REFERENCE_SPEED)
    if reference is not None:
        asked = abs(float(reference.mean()))
        _require_same_speed(recording, speed, asked, REFERENCE_SPEED, "of")


def require_reference_speed(recording: Recording, speed_rpm: float) -> None:
    """Require that the mean speed agrees with the reference speed, of either sign, within 5 %."""
    require_channels(recording, [MOTOR_SPEED])
    speed = abs(float(recording.motor_speed_rpm.mean()))
    _require_same_speed(recording, speed, abs(speed_rpm), REFERENCE_SPEED, "of")


def require_plausible_current(recording: Recording, limit_a: float) -> None:
    """Require a current within reach of the drive; one sample in a hundred may be a stray."""
    size = float(np.quantile(np.abs(recording.channels[MOTOR_CURRENT]), 0.99))
    if size <= LARGEST_CURRENT * limit_a:
        return
    raise RecordingError(
        "The motor current is far beyond the limit of the bench's drive.",
        file=recording.place,
        where=MOTOR_CURRENT,
        found=f"{size:.4g} A, where current_limit_a = {limit_a:g}",
        expected="a current in A; state another unit under [columns], or correct the bench file",
    )


def speed_in_another_unit(recording: Recording, expected_rpm: float | None) -> str | None:
    """A question to the user if the mean speed would be as expected in another unit."""
    if expected_rpm is None:
        return None
    speed = abs(float(recording.motor_speed_rpm.mean()))
    ratio, bench = speed / abs(expected_rpm), f"the speed of the bench ({abs(expected_rpm):g} rpm)"
    if unit := _unit_of_ratio(ratio, MOTOR_SPEED):
        size = speed * conversion_factor(MOTOR_SPEED, unit)
        what = (
            f'if the column is in {unit}, it is {size:.4g} rpm, {bench}: then state unit = "{unit}"'
        )
    elif abs(ratio / conversion_factor(MOTOR_SPEED, "rad/s") - 1.0) <= UNIT_AGREEMENT:
        # Other units are whole multiples of rpm, as another speed of the same joint may be.
        what = f'if the column is in rpm, not rad/s, it is {bench}: then state unit = "rpm"'
    else:
        return None
    return f"Is the unit of the speed right? The mean is {speed:.4g} rpm; {what} under [columns]."


def _require_same_speed(
    recording: Recording, speed: float, other: float, channel: str, verb: str
) -> None:
    if min(other, speed) < 1.0 or abs(speed / other - 1.0) <= 0.05:
        return
    raise RecordingError(
        f"Motor speed and {CHANNELS[channel]} do not agree." + _other_unit(speed / other, channel),
        file=recording.place,
        where=f"{MOTOR_SPEED}, {channel}",
        found=f"a mean speed of {speed:.6g} rpm, but a {CHANNELS[channel]} {verb} {other:.6g} rpm",
        expected="the same within 5 %; state the units under [columns]",
    )


def _other_unit(ratio: float, channel: str) -> str:
    """The unit that would explain the ratio of speed to another channel, as a sentence."""
    suspects = [(MOTOR_SPEED, 1), (channel, -1)]
    if channel == MOTOR_POSITION:
        suspects.append((TIME, 1))
    for suspect, sign in suspects:
        if unit := _unit_of_ratio(ratio**sign, suspect):
            return f" The column for {suspect} looks like {unit}, not {accepted_units(suspect)[0]}."
    return ""


def _unit_of_ratio(ratio: float, channel: str) -> str | None:
    """The unit whose conversion factor is the inverse of a ratio."""
    for unit in accepted_units(channel)[1:]:
        factor = conversion_factor(channel, unit)
        if factor != 1.0 and abs(ratio * factor - 1.0) <= UNIT_AGREEMENT:
            return unit
    return None


def require_unclipped(recording: Recording, channel: str) -> None:
    """Require that the signal does not run into a limit of its sensor or number format.

    A clipped signal piles up on its largest or smallest value. It counts as clipped if, at either
    end,

    - at least 5 samples in a row have exactly the extreme value;
    - that value occurs more than 5 times as often as any of the 10 distinct values next to it;
    - there are at least 10 such values, so that the signal is not merely coarse.

    The second condition excludes quantised speeds of an encoder: their levels thin out towards the
    extremes, and even the flat top of a sine holds its highest level only 2.4 times as long as the
    next. A signal that is held for some samples repeats all of its values.
    """
    values = recording.channels[channel]
    for side, signal in (("largest", values), ("smallest", -values)):
        count = _samples_at_limit(signal)
        if count:
            extreme = values.max() if side == "largest" else values.min()
            first, *_, last = recording.time_s[values == extreme]
            raise RecordingError(
                f"The {CHANNELS.get(channel, channel)} is cut off, or does not change.",
                file=recording.place,
                where=f"{channel} from {first:.6g} to {last:.6g} s",
                found=f"{count} samples exactly at the {side} value, {extreme:.6g}",
                expected="a signal that does not reach the limit of its sensor; record again with "
                "a wider range, or cut the file to a part that stays inside it",
            )


def _samples_at_limit(values: FloatArray) -> int:
    """Number of samples at the maximum if that is a limit, else 0."""
    levels, counts = np.unique(values, return_counts=True)
    if levels.size < 11 or counts[-1] <= 5 * counts[-11:-1].max():
        return 0
    begins, ends = runs(values == levels[-1])
    return int(counts[-1]) if (ends - begins).max(initial=0) >= 5 else 0


VARIES = 0.05
"""A reference speed whose range is a larger share of its maximum is a motion. A smaller variation
passes for one speed; a fit of one speed refuses hardly less."""

PARTS = 8  # number of parts of a recording whose mean speeds are compared
AT_REST = 1e-3  # share of its maximum below which a reference speed is a rest

DIFFERENT = 0.25
"""A reference has changed at the lag at which its squared difference over its power exceeds this; a
cycle is longer than that lag."""

ALIKE = 0.03
"""RMS difference between a reference and itself one cycle later, over its RMS; a shift by one
sample in a hundred of a stroke gives more."""

AGREEMENT = 0.1
"""Largest relative difference between speed and reference, by least squares. A speed loop follows
within a few per cent; the nearest wrong units differ by a factor of 2π."""


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
    """Whether no part of a recording is slower or faster; ``speed_rpm`` has shape (n,).

    Parts last a turn or more if possible, so that torque that repeats averages out.
    """
    turns = float(np.mean(np.abs(speed_rpm))) / 60.0 * speed_rpm.size * period_s
    parts = np.array_split(speed_rpm, max(2, min(PARTS, int(turns))))
    means = np.array([part.mean() for part in parts])
    return bool(np.ptp(means) <= VARIES * abs(float(means.mean())))


def require_same_motion(recording: Recording, asked_rpm: FloatArray) -> None:
    """Require that the speed has the size and direction of its reference, ``asked_rpm``, shape
    (n,).

    Otherwise units are wrong, the reference belongs to the load's side of the gear, or to another
    motion.
    """
    speed = recording.motor_speed_rpm
    ratio = float(speed @ asked_rpm) / float(asked_rpm @ asked_rpm)
    difference = float(np.sqrt(np.mean((speed - ratio * asked_rpm) ** 2)))
    share = difference / max(float(np.sqrt(np.mean(speed**2))), 1e-300)
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
    """Number of samples for which a reference, shape (n,), rests at its start."""
    return int(np.argmax(np.abs(asked) > AT_REST * float(np.max(np.abs(asked)))))


def cycle_of(asked: FloatArray) -> int | None:
    """Number of samples after which a reference, shape (n,), repeats; ``None`` below two cycles.

    The rest before the first motion is left out.
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
