"""Motions: what the speed loop is asked to follow, generated or as it was recorded.

A motion is a row of pieces one after the other. On a piece that begins at t₀ the references of the
motor are polynomials of s = t − t₀,

    ω_ref = w₀ + w₁ s + w₂ s² + w₃ s³        θ_ref = a₀ + a₁ s + a₂ s² + a₃ s³ + a₄ s⁴

and the integrator ends a step wherever a piece ends, so that corners of the reference cost nothing
in accuracy. θ_ref counts from where the motor stands at the start. Where the output is held there
is no speed loop, and the motor's torque stands in place of ω_ref.
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
"""Of a sine: a cubic through value and slope at its ends is then off by 2e-7 of the amplitude."""

SHORTEST_PIECE_S = 1e-9
"""Corners that are nearer are one."""

EARLIER_S = 1e-7
"""Of a held reference's steps before the samples that show them."""

STRAIGHT_SHARE = 1e-6
"""Recorded references that are this close to a straight line, as a share of the largest speed, are
one piece: 0.002 rpm of 2000 rpm."""


@dataclass(frozen=True, eq=False)
class Motion:
    """References over time.

    Attributes
    ----------
    pieces
        Shape (k, PIECE_COLUMNS): start in s, w₀ … w₃ in rad/s and less by s each, a₀ … a₄ in rad.
        Of a held output w₀ … w₃ in N m and less by s each.
    duration_s
        To its end.
    start_angle_rad
        Load angle that it begins at; ``None`` if it may begin anywhere.
    output_held
        Whether the output cannot turn.
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
        """θ_ref less its first value, rad of the motor, shape as ``time_s``."""
        row, s = self._at(time_s)
        turned = row[:, 6] + s * (row[:, 7] + s * (row[:, 8] + s * row[:, 9]))
        return np.asarray(row[:, 5] + s * turned, dtype=float)

    def at_pace(self, pace: float) -> Motion:
        """The same way in ``1/pace`` of the time; all of it to the same end."""
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
    """Pieces through speeds (rad/s) at some times, straight, or cubic where slopes are given.

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
    turned = np.einsum("kj,kj->k", integral[:-1], h[:, None] ** np.arange(1, 5))
    pieces[1:, 5] = np.cumsum(turned)
    if position is not None:
        # The recorded angle goes its own way: straight from sample to sample of the pieces, with
        # the curvature that the speed has.
        missed = np.diff(position) - turned
        pieces[:, 5] = position - position[0]
        pieces[:-1, 6] += missed / h
    return pieces


def strokes(
    gear_ratio: float,
    range_rad: tuple[float, float],
    speed_rpm: float,
    acceleration_rpm_per_s: float,
    dwell_s: float,
    duration_s: float,
    jerk_rpm_per_s2: float | None = None,
) -> Motion:
    """From one end of a range of the load to the other and back, as :func:`cycle`."""
    return cycle(
        gear_ratio,
        range_rad,
        speed_rpm,
        acceleration_rpm_per_s,
        dwell_s,
        duration_s,
        jerk_rpm_per_s2,
    )


def cycle(
    gear_ratio: float,
    points_rad: Sequence[float],
    speed_rpm: float,
    acceleration_rpm_per_s: float,
    dwell_s: float,
    duration_s: float,
    jerk_rpm_per_s2: float | None = None,
) -> Motion:
    """From point to point of the load and back to the first, over and over, from rest.

    Trapezoids in speed, or S-curves where the jerk is limited. A way too short to reach the speed,
    or the acceleration, is crossed without.
    """
    time, speed, slope = [0.0], [0.0], [0.0]
    now, at = dwell_s, 0
    fastest, steepest = abs(speed_rpm) / RPM, abs(acceleration_rpm_per_s) / RPM
    jerk = math.inf if jerk_rpm_per_s2 is None else abs(jerk_rpm_per_s2) / RPM
    while now < duration_s:
        here, there = points_rad[at % len(points_rad)], points_rad[(at + 1) % len(points_rad)]
        way, direction = gear_ratio * abs(there - here), math.copysign(1.0, there - here)
        top = min(fastest, _fastest_over(way, steepest, jerk))
        ramp = _ramp(top, steepest, jerk)
        whole = way / top + ramp[-1][0]
        braking = [(whole - t, v, -a) for t, v, a in reversed(ramp)]
        for when, what, bend in (*ramp, *braking):
            if now + when > time[-1] + SHORTEST_PIECE_S:
                time.append(now + when)
                speed.append(direction * what)
                slope.append(direction * bend)
        now, at = now + whole + dwell_s, at + 1
    bends = None if jerk_rpm_per_s2 is None else np.array(slope)
    return Motion(through(np.array(time), np.array(speed), bends), duration_s, float(points_rad[0]))


def _fastest_over(way: float, acceleration: float, jerk: float) -> float:
    """Largest speed on a way that starts and ends at rest."""
    rounded = acceleration**2 / jerk
    top = 0.5 * (math.sqrt(rounded**2 + 4.0 * acceleration * way) - rounded)
    return top if top >= rounded else (0.25 * jerk * way**2) ** (1.0 / 3.0)


def _ramp(top: float, acceleration: float, jerk: float) -> list[tuple[float, float, float]]:
    """Time, speed and acceleration at the corners of a start from rest."""
    steepest = min(acceleration, math.sqrt(top * jerk))
    bending = steepest / jerk
    while_bending = 0.5 * steepest * bending
    whole = top / steepest + bending
    return [
        (0.0, 0.0, 0.0),
        (bending, while_bending, steepest),
        (whole - bending, top - while_bending, steepest),
        (whole, top, 0.0),
    ]


def sine(
    gear_ratio: float, range_rad: tuple[float, float], period_s: float, duration_s: float
) -> Motion:
    """To and fro between two load angles, the angle a cosine from the lower end."""
    middle_amplitude = 0.5 * gear_ratio * (range_rad[1] - range_rad[0])
    rate = 2.0 * math.pi / period_s
    time = np.arange(0.0, duration_s + period_s, period_s / PIECES_PER_PERIOD)
    speed = middle_amplitude * rate * np.sin(rate * time)
    slope = middle_amplitude * rate**2 * np.cos(rate * time)
    return Motion(through(time, speed, slope), duration_s, float(range_rad[0]))


def torque_ramps(
    torque_nm: Sequence[float], cycles: int, period_s: float, start_angle_rad: float = 0.0
) -> Motion:
    """The motor's torque ramped to and fro with the output held, in triangles from zero.

    Parameters
    ----------
    torque_nm
        Amplitudes, one after the other.
    cycles, period_s
        To and fro at each amplitude, and the time of each.
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

    With the position alone the speed is its derivative; with the speed alone the position is its
    integral. Straight stretches become one piece, and the corners between them are put where the
    stretches meet, between two samples.

    Raises
    ------
    BenchError
        If there is neither.
    """
    time = time_s - time_s[0]
    if speed_rpm is not None:
        at, speed = time, speed_rpm / RPM
    elif position_rad is not None:
        # Between two samples the mean speed is known exactly; at the first and the last it goes on
        # in a straight line.
        mean = np.diff(position_rad) / np.diff(time)
        at = np.r_[time[0], 0.5 * (time[1:] + time[:-1]), time[-1]]
        ends = 0.5 * (mean[[0, -1]] - mean[[1, -2]])
        speed = np.r_[mean[0] + ends[0], mean, mean[-1] + ends[1]]
        position_rad = None
    else:
        raise BenchError("A motion needs a reference speed or position.")
    tolerance = STRAIGHT_SHARE * max(float(np.max(np.abs(speed))), 1e-9)
    knots, values = _corners_restored(at, speed, _straight(at, speed, tolerance))
    position = None if position_rad is None else np.interp(knots, time, position_rad)
    return Motion(through(knots, values, position=position), float(time[-1]))


def held_motion(motion: Motion, samples: int, sampling_hz: float) -> Motion:
    """The same motion as a digital drive has it: the reference of each sample held to the next."""
    time = np.arange(samples) / sampling_hz
    pieces = np.zeros((samples, PIECE_COLUMNS))
    # A sample sees the reference that came with it.
    pieces[:, 0] = time - EARLIER_S
    pieces[:, 1] = motion.speed_rpm(time) / RPM
    pieces[:, 6] = pieces[:, 1]
    pieces[:, 5] = np.r_[0.0, np.cumsum(pieces[:-1, 1]) / sampling_hz]
    return Motion(pieces, motion.duration_s, motion.start_angle_rad)


def _straight(time: FloatArray, values: FloatArray, tolerance: float) -> list[int]:
    """Samples whose chords pass all samples within a tolerance, by the cone each can still hold."""
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
    """Knots at those samples; two neighbours between straight pieces become their corner."""
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
            right = float(speed[i + 2] - speed[i + 1]) / h
            rise = float(speed[i + 1] - speed[i]) - right * h
            at = rise / (slope_before - right) if slope_before != right else -1.0
            if 0.0 <= at <= h:
                knots[-1] += at
                values[-1] += slope_before * at
                n += 1
        n += 1
    return np.array(knots), np.array(values)
