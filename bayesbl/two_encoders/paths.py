"""Paths of both encoders, and where the load rests between the flanks.

The motor is scaled to the load: x = θ_m/N. With play the load follows at θ_l = x − s, where the
lag s stays within ±δ. A load with much friction stays where it is while the play is crossed, so
that s is the play operator of x (Krasnosel'skiĭ and Pokrovskiĭ 1989); one with less coasts on and
reaches the other flank by itself, or falls there by its weight. :func:`load_lag` follows all: a
load that friction and weight alone move until a flank takes it along.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from bayesbl.compiled import compiled
from bayesbl.recording.types import FloatArray

MOST_SAMPLES = 60_000
"""Samples that the load's lag is followed over; longer recordings are averaged to fewer."""

MOST_BINS = 700
"""Means that the model is fitted to."""

LONGEST_SKEW_S = 0.25
"""Within which the stamps of both channels may differ."""

SMOOTH_S, COUNTS = 0.01, 100.0
"""Over which the motor's speed is averaged at most, and counts passed at its usual speed that are
enough: a load leaves its flank where the motor begins to slow down.
"""

FINE_S = 2e-3
"""Steps that the load is followed in: between two samples it may cross the whole play."""

ALIKE = 0.02
"""Share of the load's variance that the motor's position leaves, up to which play is small."""

STILL = 0.02
"""Of the motor's root mean square speed: below it stands still."""

REVERSAL = 0.02
"""Of the motor's travel: a turning back by less is none."""

HOLE = 5.0
"""Sampling periods without a sample, from which nothing is known in between."""


@dataclass(frozen=True, slots=True)
class Paths:
    """Both encoders at the load's stamps, shapes (n,), in s and rad.

    Attributes
    ----------
    slope
        θ_l over θ_m, 1/N, with its sign, that the motor is scaled by.
    motor_rad
        At the load, ``skew_s`` before the load's stamps; about its middle, as the load.
    torque_nm
        At the output, with the sign that friction has; ``None`` without one.
    skew_s
        By which the load's stamps were taken to be late.
    fine_time_s, fine_motor_rad, fine_speed, every
        The motor's path in steps of about ``FINE_S``; one of ``every`` is a sample.
    bins
        First sample of every bin of the fit, and the end of the last.
    load_step_rad, motor_step_rad
        The smallest change of either encoder, at the load.
    between_rad
        By which two interpolants of the motor between its samples differ.
    """

    slope: float
    time_s: FloatArray
    motor_rad: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    load_rad: FloatArray
    torque_nm: FloatArray | None
    skew_s: float
    fine_time_s: FloatArray
    fine_motor_rad: FloatArray
    fine_speed: FloatArray
    every: int
    bins: NDArray[np.int64]
    load_step_rad: float
    motor_step_rad: float
    between_rad: FloatArray

    def binned(self, values: FloatArray) -> FloatArray:
        """Means over the bins, shape (bins,)."""
        return np.asarray(np.add.reduceat(values, self.bins[:-1]) / np.diff(self.bins))

    def reading_variance(self) -> FloatArray:
        """Of the bins, rad², by the counts of both encoders and by motion between samples.

        The error of a count is a curve of the position: it averages over the samples of a bin as
        far as that passes many counts, and not at all where it stands still.
        """
        steps = np.array([[self.load_step_rad], [self.motor_step_rad]])
        paths = np.stack([self.load_rad, self.motor_rad])
        counts = (paths[:, self.bins[1:] - 1] - paths[:, self.bins[:-1]]) / steps
        means = np.minimum(1.0 + counts**2, np.diff(self.bins))
        of_counts = (steps**2 / 12.0 / means).sum(axis=0)
        return np.asarray(of_counts + self.binned(self.between_rad) ** 2)

    @property
    def scatter_rad(self) -> float:
        """Standard deviation of a sample, by what samples differ from their neighbours."""
        bends = np.diff(self.motor_rad - self.load_rad, 2)
        return float(np.median(np.abs(bends)) / (0.6745 * np.sqrt(6.0)))

    def scatter_variance(self) -> float:
        """Of a bin in the middle, rad². What a model leaves beyond that is no noise."""
        return self.scatter_rad**2 / float(np.median(np.diff(self.bins)))

    @property
    def period_s(self) -> float:
        """Between samples, in the middle."""
        return float(np.median(np.diff(self.time_s)))

    @property
    def reversals(self) -> int:
        """Times that the motor turned back."""
        least = REVERSAL * float(np.ptp(self.motor_rad))
        return max(len(turning_points(self.motor_rad, least)) - 2, 0)

    @property
    def typical_acceleration(self) -> float:
        """Root mean square of the motor's, at the load."""
        return float(np.sqrt(np.mean(self.acceleration**2)))


@dataclass(frozen=True, slots=True)
class Channels:
    """What was recorded, shapes (n,): positions that count turns, and the motor's torque."""

    time_s: FloatArray
    motor_rad: FloatArray
    load_rad: FloatArray
    torque_nm: FloatArray | None = None

    def slope(self) -> float:
        """The load over the motor: least squares; where a large play bends that, while both move.

        The latter is the median of the changes over a hundredth of the recording.
        """
        if _disagreement(self.motor_rad, self.load_rad) < ALIKE:
            return _slope(self.motor_rad, self.load_rad)
        step = max(1, self.time_s.size // 100)
        motor = self.motor_rad[step:] - self.motor_rad[:-step]
        load = self.load_rad[step:] - self.load_rad[:-step]
        fast = np.ones(motor.size, dtype=bool)
        for change in (np.abs(motor), np.abs(load)):
            fast &= change > 0.5 * np.quantile(change, 0.95)
        if not fast.any():
            return _slope(self.motor_rad, self.load_rad)
        return float(np.median(load[fast] / motor[fast]))


def _slope(motor: FloatArray, load: FloatArray) -> float:
    centred = motor - motor.mean()
    square = float(centred @ centred)
    return float(centred @ (load - load.mean())) / square if square else 0.0


def _disagreement(motor: FloatArray, load: FloatArray) -> float:
    """Share of the load's variance that the motor's position does not explain."""
    residual = load - load.mean() - _slope(motor, load) * (motor - motor.mean())
    variance = float(load.var())
    return float(residual.var()) / variance if variance else 1.0


def turning_points(path: FloatArray, least: float) -> list[int]:
    """Samples where a path turns back by ``least`` or more, between its ends."""
    points, high, low, direction = [0], 0, 0, 0
    for k, value in enumerate(path.tolist()):
        if value > path[high]:
            high = k
        if value < path[low]:
            low = k
        if direction >= 0 and value < path[high] - least:
            if direction or high:
                points.append(high)
            direction, low = -1, k
        elif direction <= 0 and value > path[low] + least:
            if direction or low:
                points.append(low)
            direction, high = 1, k
    return [*points, path.size - 1]


def scaled_paths(
    channels: Channels, slope: float, skew_s: float = 0.0, edge_s: float = 0.0
) -> Paths:
    """The motor scaled by ``slope``, at the time that the load's samples were really taken.

    A torque is taken with the sign that friction has: against the motion. With ``edge_s`` at both
    ends left out, the samples and bins are the same for all skews up to that.
    """
    stamps, motor, load, torque = _thinned(channels)
    path = CubicSpline(stamps, slope * motor)
    time = stamps - skew_s
    first, last = stamps[0] + edge_s, stamps[-1] - edge_s
    inside = (time >= stamps[0]) & (time <= stamps[-1]) & (stamps >= first) & (stamps <= last)
    time, load = time[inside], load[inside]
    every = max(1, round(float(np.median(np.diff(time))) / FINE_S))
    parts = np.arange(every) / every
    fine = np.append((time[:-1, None] + np.diff(time)[:, None] * parts).ravel(), time[-1])
    step = abs(slope) * _least_step(channels.motor_rad)
    raw = path(fine, 1)
    over_s = min(COUNTS * step / max(float(np.std(raw)), 1e-300), SMOOTH_S)
    fine_speed = moving_mean(raw, fine, over_s)
    x, speed = path(time), fine_speed[::every]
    acceleration = np.gradient(moving_mean(raw, fine, 3.0 * SMOOTH_S), fine)[::every]
    if torque is not None:
        torque = np.interp(time, stamps, torque) / slope
        turning = np.tanh(speed / (0.1 * float(np.sqrt(np.mean(speed**2))) + 1e-300))
        straight = torque - np.polyval(np.polyfit(x, torque, 1), x)
        if float(straight @ turning) < 0.0:
            torque = -torque
    return Paths(
        slope,
        time,
        x - x.mean(),
        speed,
        acceleration,
        load - load.mean(),
        torque,
        skew_s,
        fine,
        path(fine) - x.mean(),
        fine_speed,
        every,
        _bins(time, path(time + skew_s, 1)),
        _least_step(channels.load_rad),
        step,
        np.abs(x - np.interp(time, stamps, slope * motor)),
    )


def _least_step(angle: FloatArray) -> float:
    steps = np.abs(np.diff(angle))
    return float(np.min(steps, where=steps > 1e-9, initial=1.0))


def _thinned(channels: Channels) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray | None]:
    """Means over neighbours, where there are too many samples."""
    group = -(-channels.time_s.size // MOST_SAMPLES)
    even = channels.time_s.size // group * group

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(values[:even].reshape(-1, group).mean(axis=1))

    torque = None if channels.torque_nm is None else mean(channels.torque_nm)
    return mean(channels.time_s), mean(channels.motor_rad), mean(channels.load_rad), torque


def moving_mean(values: FloatArray, stamps: FloatArray, over_s: float) -> FloatArray:
    """A moving mean over about this time, three samples at least."""
    half = max(1, int(0.5 * over_s / float(np.median(np.diff(stamps)))))
    window = np.ones(2 * half + 1) / (2 * half + 1)
    return np.asarray(np.convolve(np.pad(values, half, "edge"), window, "valid"))


def _bins(time: FloatArray, speed: FloatArray) -> NDArray[np.int64]:
    """Starts of the bins: where the motor moves as even in time as in speed, which is where a load
    changes its flank; one for each time it stands still.

    A load that stands still is seen once, however long it stands. None reaches over a hole.
    """
    steps = np.diff(time)
    still = np.abs(speed) < STILL * float(np.sqrt(np.mean(speed**2)))
    moving = int(np.count_nonzero(~still))
    length = max(1, -(-moving // MOST_BINS))
    turns = np.abs(np.gradient(speed))
    turns = np.convolve(turns, np.ones(4 * length + 1), "same") * ~still
    way = ~still * 1.0 + turns * moving / max(float(turns.sum()), 1e-300)
    bins = np.floor(np.cumsum(way) / (2.0 * length)).astype(int)
    changes = (np.diff(still.astype(int)) != 0) | (steps > HOLE * np.median(steps))
    changes |= np.diff(bins) > 0
    return np.array([0, *(np.flatnonzero(changes) + 1), time.size])


@compiled()
def load_lag(
    motor: FloatArray,
    speed: FloatArray,
    time_s: FloatArray,
    half_play: float,
    drag: float,
    start: float,
    weight: complex = 0j,
) -> FloatArray:  # pragma: no cover (compiled)
    """The lag s of the load behind the motor, shape (n,), within ±``half_play``, rad.

    Parameters
    ----------
    drag
        Deceleration of a free load by its friction, rad/s²; infinite for one that stays.
    start
        s at the first sample.
    weight
        Deceleration of a free load by its weight, rad/s²: by cos (real) and sin of its angle.
    """
    lag = np.full(motor.size, start)
    # As if a flank takes the load along: at one, rounding alone decides whether it does.
    load, moving = motor[0] - start, speed[0]
    for k in range(1, motor.size):
        period, before = time_s[k] - time_s[k - 1], moving
        if weight != 0.0:
            moving -= period * (weight.real * np.cos(load) + weight.imag * np.sin(load))
        slowed = drag * period
        if abs(moving) <= slowed:
            load += 0.5 * before * abs(before) / drag if before != 0.0 else 0.0
            moving = 0.0
        else:
            moving -= slowed if moving > 0.0 else -slowed
            # By the mean of both speeds, as the motor's path has it: else a flank holds a load
            # until the motor slows down twice as fast as the load.
            load += 0.5 * (before + moving) * period
        if motor[k] - load >= half_play:
            load = motor[k] - half_play
            moving = speed[k]
        elif motor[k] - load <= -half_play:
            load = motor[k] + half_play
            moving = speed[k]
        lag[k] = motor[k] - load
    return lag
