"""Motions: references of the speed loop, generated or recorded.

A motion is a sequence of pieces. On a piece that begins at t₀, the references of the motor are
polynomials of s = t − t₀,

    ω_ref = w₀ + w₁ s + w₂ s² + w₃ s³        θ_ref = a₀ + a₁ s + a₂ s² + a₃ s³ + a₄ s⁴

The integrator ends a step where a piece ends, so corners of the reference cost no accuracy. θ_ref
counts from the motor's position at the start. With a held output there is no speed loop, and the
motor's torque takes the place of ω_ref.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesbl.bench.kernel import PIECE_COLUMNS, RPM
from bayesbl.errors import BenchError
from bayesbl.recording.types import FloatArray

PIECES_PER_PERIOD = 100
"""Pieces per period of a sine: the error of a cubic is then 2e-7 of the amplitude."""

SHORTEST_PIECE_S = 1e-9
"""Corners that are closer than this are one corner."""

EARLIER_S = 1e-7
"""Lead of a held reference's steps over the samples that show them."""

STRAIGHT_SHARE = 1e-6
"""Recorded references within this distance of a straight line, as a share of the largest speed,
become one piece: 0.002 rpm of 2000 rpm."""


@dataclass(frozen=True, eq=False)
class Motion:
    """References over time.

    Attributes
    ----------
    pieces
        Shape (k, PIECE_COLUMNS): start in s; w₀ … w₃ in rad/s, rad/s² …; a₀ … a₄ in rad, rad/s ….
        With a held output w₀ … w₃ are in N m, N m/s ….
    duration_s
        Duration.
    start_angle_rad
        Load angle at the start; ``None`` if it may begin anywhere.
    output_held
        Whether the output is blocked.
    """

    pieces: FloatArray
    duration_s: float
    start_angle_rad: float | None = None
    output_held: bool = False

    @property
    def fastest_rpm(self) -> float:
        """Largest reference speed at the start of a piece."""
        return float(np.max(np.abs(self.pieces[:, 1]))) * RPM

    def speed_rpm(self, time_s: FloatArray) -> FloatArray:
        """ω_ref, rpm, shape as ``time_s``."""
        row, s = self._at(time_s)
        return np.asarray(
            RPM * (row[:, 1] + s * (row[:, 2] + s * (row[:, 3] + s * row[:, 4]))), dtype=float
        )

    def position_rad(self, time_s: FloatArray) -> FloatArray:
        """θ_ref minus its first value, rad of the motor, shape as ``time_s``."""
        row, s = self._at(time_s)
        horner = row[:, 6] + s * (row[:, 7] + s * (row[:, 8] + s * row[:, 9]))
        return np.asarray(row[:, 5] + s * horner, dtype=float)

    def at_pace(self, pace: float) -> Motion:
        """The same path in ``1/pace`` of the time, to the same end."""
        power = np.arange(5.0)
        pieces = self.pieces.copy()
        pieces[:, 0] /= pace
        pieces[:, 1:5] *= pace ** (1.0 + power[:4])
        pieces[:, 5:] *= pace**power
        return replace(self, pieces=pieces, duration_s=self.duration_s / pace)

    def _at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        number = np.searchsorted(self.pieces[:, 0], time_s, side="right") - 1
        row = self.pieces[np.clip(number, 0, None)]
        return row, time_s - row[:, 0]


def through(
    time_s: FloatArray,
    speed: FloatArray,
    slope: FloatArray | None = None,
    position: FloatArray | None = None,
) -> FloatArray:
    """Pieces through speeds (rad/s) at given times: linear, or cubic if slopes are given.

    ``position``: θ_ref at those times; the integral of the speed if ``None``.
    """
    h = np.diff(time_s)
    rise = np.diff(speed) / h
    pieces = np.zeros((time_s.size, PIECE_COLUMNS))
    pieces[:, 0], pieces[:, 1] = time_s, speed
    if slope is None:
        pieces[:-1, 2] = rise
    else:
        pieces[:-1, 2] = slope[:-1]
        pieces[:-1, 3] = (3.0 * rise - 2.0 * slope[:-1] - slope[1:]) / h
        pieces[:-1, 4] = (slope[:-1] + slope[1:] - 2.0 * rise) / h**2
    integral = pieces[:, 1:5] / np.array([1.0, 2.0, 3.0, 4.0])
    pieces[:, 6:] = integral
    advance = np.einsum("kj,kj->k", integral[:-1], h[:, None] ** np.arange(1, 5))
    pieces[1:, 5] = np.cumsum(advance)
    if position is not None:
        # The recorded angle differs from the integral of the speed. Spread the difference linearly
        # over each piece, and keep the curvature of the speed.
        position_error = np.diff(position) - advance
        pieces[:, 5] = position - position[0]
        pieces[:-1, 6] += position_error / h
    return pieces


def cycle(
    gear_ratio: float,
    points_rad: Sequence[float],
    speed_rpm: float,
    acceleration_rpm_per_s: float,
    dwell_s: float,
    duration_s: float,
    jerk_rpm_per_s2: float | None = None,
) -> Motion:
    """Move from point to point of the load and back to the first, repeatedly, starting at rest.

    Speed profiles are trapezoids, or S-curves if the jerk is limited. On a path too short for the
    full speed or acceleration, the profile does not reach it.
    """
    time, speed, slope = [0.0], [0.0], [0.0]
    start_s, i = dwell_s, 0
    fastest, steepest = abs(speed_rpm) / RPM, abs(acceleration_rpm_per_s) / RPM
    jerk = math.inf if jerk_rpm_per_s2 is None else abs(jerk_rpm_per_s2) / RPM
    while start_s < duration_s:
        first, second = points_rad[i % len(points_rad)], points_rad[(i + 1) % len(points_rad)]
        path, direction = gear_ratio * abs(second - first), math.copysign(1.0, second - first)
        peak_speed = min(fastest, _fastest_over(path, steepest, jerk))
        ramp = _ramp(peak_speed, steepest, jerk)
        total_s = path / peak_speed + ramp[-1][0]
        braking = [(total_s - t, v, -a) for t, v, a in reversed(ramp)]
        for t_ramp, v_ramp, a_ramp in (*ramp, *braking):
            if start_s + t_ramp > time[-1] + SHORTEST_PIECE_S:
                time.append(start_s + t_ramp)
                speed.append(direction * v_ramp)
                slope.append(direction * a_ramp)
        start_s, i = start_s + total_s + dwell_s, i + 1
    bends = None if jerk_rpm_per_s2 is None else np.array(slope)
    return Motion(through(np.array(time), np.array(speed), bends), duration_s, float(points_rad[0]))


def _fastest_over(path: float, acceleration: float, jerk: float) -> float:
    """Largest speed on a path that starts and ends at rest."""
    rounded = acceleration**2 / jerk
    top = 0.5 * (math.sqrt(rounded**2 + 4.0 * acceleration * path) - rounded)
    return top if top >= rounded else (0.25 * jerk * path**2) ** (1.0 / 3.0)


def _ramp(top: float, acceleration: float, jerk: float) -> list[tuple[float, float, float]]:
    """Time, speed and acceleration at the corners of a start from rest."""
    steepest = min(acceleration, math.sqrt(top * jerk))
    jerk_s = steepest / jerk
    speed_after_jerk = 0.5 * steepest * jerk_s
    total_s = top / steepest + jerk_s
    return [
        (0.0, 0.0, 0.0),
        (jerk_s, speed_after_jerk, steepest),
        (total_s - jerk_s, top - speed_after_jerk, steepest),
        (total_s, top, 0.0),
    ]


def sine(
    gear_ratio: float, range_rad: tuple[float, float], period_s: float, duration_s: float
) -> Motion:
    """Oscillate between two load angles, the angle a cosine from the lower end."""
    middle_amplitude = 0.5 * gear_ratio * (range_rad[1] - range_rad[0])
    rate = 2.0 * math.pi / period_s
    time = np.arange(0.0, duration_s + period_s, period_s / PIECES_PER_PERIOD)
    speed = middle_amplitude * rate * np.sin(rate * time)
    slope = middle_amplitude * rate**2 * np.cos(rate * time)
    return Motion(through(time, speed, slope), duration_s, float(range_rad[0]))


def torque_ramps(
    torque_nm: Sequence[float], cycles: int, period_s: float, start_angle_rad: float = 0.0
) -> Motion:
    """Triangular ramps of the motor's torque from zero, both ways, with the output held.

    Parameters
    ----------
    torque_nm
        Amplitudes, in sequence.
    cycles, period_s
        Number of cycles at each amplitude, and their period.
    """
    quarters = np.tile([0.0, 1.0, 0.0, -1.0], cycles)
    torque = np.append(np.outer(np.asarray(torque_nm, dtype=np.float64), quarters).ravel(), 0.0)
    time = 0.25 * period_s * np.arange(torque.size, dtype=np.float64)
    pieces = through(time, torque)
    pieces[:, 5:] = 0.0
    return Motion(pieces, float(time[-1]), start_angle_rad, output_held=True)


def recorded_motion(
    time_s: FloatArray,
    speed_rpm: FloatArray | None = None,
    position_rad: FloatArray | None = None,
) -> Motion:
    """The motion of reference channels, shape (n,), at evenly spaced times.

    With the position alone, the speed is its derivative; with the speed alone, the position is its
    integral. Straight stretches become one piece. Their corners are placed where the stretches
    meet, between two samples.

    Raises
    ------
    BenchError
        If there is neither.
    """
    time = time_s - time_s[0]
    if speed_rpm is not None:
        speed_time, speed = time, speed_rpm / RPM
    elif position_rad is not None:
        # The mean speed between two samples is known exactly; it is extrapolated linearly to the
        # first and the last sample.
        mean = np.diff(position_rad) / np.diff(time)
        speed_time = np.r_[time[0], 0.5 * (time[1:] + time[:-1]), time[-1]]
        ends = 0.5 * (mean[[0, -1]] - mean[[1, -2]])
        speed = np.r_[mean[0] + ends[0], mean, mean[-1] + ends[1]]
        position_rad = None
    else:
        raise BenchError("A motion needs a reference speed or position.")
    tolerance = STRAIGHT_SHARE * max(float(np.max(np.abs(speed))), 1e-9)
    knots, values = _corners_restored(speed_time, speed, _straight(speed_time, speed, tolerance))
    position = None if position_rad is None else np.interp(knots, time, position_rad)
    return Motion(through(knots, values, position=position), float(time[-1]))


def held_motion(motion: Motion, samples: int, sampling_hz: float) -> Motion:
    """The motion of a digital drive, which holds the reference of each sample until the next."""
    time = np.arange(samples) / sampling_hz
    pieces = np.zeros((samples, PIECE_COLUMNS))
    # A sample sees the reference that came with it.
    pieces[:, 0] = time - EARLIER_S
    pieces[:, 1] = motion.speed_rpm(time) / RPM
    pieces[:, 6] = pieces[:, 1]
    pieces[:, 5] = np.r_[0.0, np.cumsum(pieces[:-1, 1]) / sampling_hz]
    return Motion(pieces, motion.duration_s, motion.start_angle_rad)


def _straight(time: FloatArray, values: FloatArray, tolerance: float) -> list[int]:
    """Samples whose chords pass all samples within a tolerance, found by a cone of slopes."""
    kept = [0]
    t, v = time.tolist(), values.tolist()
    low, high = -math.inf, math.inf
    for i in range(1, len(t)):
        start = kept[-1]
        span = t[i] - t[start]
        slope = (v[i] - v[start]) / span
        if not low <= slope <= high:
            kept.append(i - 1)
            span = t[i] - t[i - 1]
            slope = (v[i] - v[i - 1]) / span
            low, high = -math.inf, math.inf
        low = max(low, slope - tolerance / span)
        high = min(high, slope + tolerance / span)
    return [*kept, len(t) - 1]


def _corners_restored(
    time: FloatArray, speed: FloatArray, kept: list[int]
) -> tuple[FloatArray, FloatArray]:
    """Knots at these samples; two neighbours between straight pieces become their corner."""
    knots, values = [], []
    n = 0
    while n < len(kept):
        i = kept[n]
        knots.append(float(time[i]))
        values.append(float(speed[i]))
        between = 0 < n < len(kept) - 2 and kept[n + 1] == i + 1
        if between and i - kept[n - 1] >= 2 and kept[n + 2] - i >= 3:
            h = float(time[i + 1] - time[i])
            slope_before = float(speed[i] - speed[i - 1]) / h
            slope_after = float(speed[i + 2] - speed[i + 1]) / h
            rise = float(speed[i + 1] - speed[i]) - slope_after * h
            corner_s = rise / (slope_before - slope_after) if slope_before != slope_after else -1.0
            if 0.0 <= corner_s <= h:
                knots[-1] += corner_s
                values[-1] += slope_before * corner_s
                n += 1
        n += 1
    return np.array(knots), np.array(values)
