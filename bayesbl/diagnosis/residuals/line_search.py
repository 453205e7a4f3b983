"""Lines in a residual: periodic in time or with the motor's angle.

The motor does not turn evenly. Gravity and the speed loop swing its angle about that of even
rotation by up to half a radian, so what repeats with the motor angle has side bands in time, and
what repeats in time has them in angle: a line belongs to where it is sharp. A scale here is what
a line counts its cycles along, in samples: time itself, or the motor angle over its mean rate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from bayesbl.diagnosis.residuals.spectrum import NoiseFloor, comb, repeating_part
from bayesbl.recording.types import FloatArray

Along = Literal["time", "motor angle"]

CLEARLY = 10.0
"""Difference of log likelihoods beyond which a line is sharp on one scale and not on the other."""
NEIGHBOURS = 4
STANDS_OUT = 4.0
"""Times its neighbours' power among the load orders: then a line is one by itself."""


@dataclass(frozen=True, slots=True)
class Scales:
    """Time and motor angle, each in samples, shape (n,)."""

    time: FloatArray
    motor: FloatArray

    def on_motor_angle(self, values: FloatArray) -> FloatArray:
        """Values at even steps of the motor angle, shape (n,)."""
        even = np.interp(self.time, self.motor, self.time)
        return np.asarray(CubicSpline(self.time, values)(even))


def scales(motor_angle_rad: FloatArray, motor_hz: float, sampling_hz: float) -> Scales:
    """From the motor angle since the first sample, counted in the direction of rotation, (n,)."""
    per_sample = 2.0 * math.pi * motor_hz / sampling_hz
    return Scales(np.arange(motor_angle_rad.size, dtype=float), motor_angle_rad / per_sample)


@dataclass(frozen=True, slots=True)
class FoundLine:
    """A line before its amplitude is known.

    Attributes
    ----------
    cycles
        In the record.
    along
        The scale on which it is drawn.
    probability
        That noise alone makes a bin as strong.
    decided
        It is clearly sharper on this scale than on the other.
    """

    cycles: float
    along: Along
    probability: float
    decided: bool

    def waves(self, scale: Scales) -> FloatArray:
        """Cosine and sine, shape (n, 2)."""
        position = scale.time if self.along == "time" else scale.motor
        angle = 2.0 * np.pi * self.cycles / position.size * position
        return np.stack((np.cos(angle), np.sin(angle)), axis=1)


def strongest_line(
    rest: FloatArray, floor: NoiseFloor, rotations: int, scale: Scales
) -> FoundLine | None:
    """Strongest line that is no whole load order; ``None`` if there is no bin to look at.

    ``rest`` must hold nothing that repeats with the load. Below one cycle per rotation is drift.
    """
    n = rest.size
    at_bins = floor.at_bins(n)
    tops: list[tuple[float, int, Along]] = []
    candidates: tuple[tuple[Along, FloatArray], ...] = (
        ("time", rest),
        ("motor angle", scale.on_motor_angle(rest)),
    )
    for along, values in candidates:
        ratio = np.abs(np.fft.rfft(values)) ** 2 / n / at_bins
        ratio[comb(n, rotations)] = 0.0
        ratio[:rotations] = 0.0
        ratio[-1] = 0.0
        top = int(np.argmax(ratio))
        tops.append((float(ratio[top]), top, along))
    strongest, top, along = max(tops)
    if strongest <= 0.0:
        return None
    on_time = _refined(rest, scale.time, top, rotations, float(at_bins[top]))
    on_motor = _refined(rest, scale.motor, top, rotations, float(at_bins[top]))
    decided = abs(on_time[1] - on_motor[1]) > CLEARLY
    if decided:
        along = "time" if on_time[1] > on_motor[1] else "motor angle"
    cycles = (on_time if along == "time" else on_motor)[0]
    return FoundLine(cycles, along, math.exp(-strongest), decided)


def _refined(
    rest: FloatArray, position: FloatArray, top: int, rotations: int, floor: float
) -> tuple[float, float]:
    """Cycles in the record that explain most, and the log likelihood that they gain."""
    n = rest.size

    def gain(cycles: float) -> float:
        # What the rest can hold of a line lacks the share that averaging over rotations took.
        left = 1.0 - _mean_turn(cycles, rotations) ** 2
        amplitude = abs(np.dot(rest, np.exp(-2j * np.pi * cycles / n * position)))
        return -float(amplitude**2 / max(left, 1e-3)) / (n * floor)

    found = minimize_scalar(
        gain, bounds=(top - 0.9, top + 0.9), method="bounded", options={"xatol": 1e-3}
    )
    return float(found.x), -float(found.fun)


def _mean_turn(cycles: float, rotations: int) -> float:
    """Size of the mean over the rotations of exp(2πi · cycles · r / rotations)."""
    below = rotations * math.sin(math.pi * cycles / rotations)
    return 1.0 if abs(below) < 1e-9 else abs(math.sin(math.pi * cycles) / below)


def motor_orders_in_comb(
    values: FloatArray,
    floor: NoiseFloor,
    rotations: int,
    gear_ratio: float,
    scale: Scales,
    rate: float,
) -> list[FoundLine]:
    """Whole and half motor orders that are whole load orders too and stand out of these.

    With a whole gear ratio everything periodic in the motor angle repeats with the load: only its
    standing alone tells, on the scale of the motor angle and no less sharp there than in time.
    ``rate`` is the false-alarm rate.
    """
    n = values.size
    in_time = np.abs(np.fft.rfft(values)[::rotations]) ** 2 / n
    power = np.abs(np.fft.rfft(scale.on_motor_angle(values - values.mean()))[::rotations]) ** 2 / n
    at_orders = floor.at_bins(n)[::rotations]
    orders = [
        round(0.5 * half * gear_ratio)
        for half in range(1, int(2.0 * (power.size - 1 - NEIGHBOURS) / gear_ratio) + 1)
        if abs(0.5 * half * gear_ratio - round(0.5 * half * gear_ratio)) * rotations < 0.25
    ]
    found = []
    for order in orders:
        around = power[max(1, order - NEIGHBOURS) : order + NEIGHBOURS + 1].copy()
        around[min(order - 1, NEIGHBOURS)] = 0.0
        probability = math.exp(-power[order] / at_orders[order])
        if in_time[order] - power[order] > CLEARLY * at_orders[order]:
            continue
        if probability * len(orders) <= rate and power[order] > STANDS_OUT * around.max():
            found.append(FoundLine(float(order * rotations), "motor angle", probability, True))
    return found


def orthonormal(columns: FloatArray, before: Sequence[FloatArray]) -> list[FloatArray]:
    """Columns freed of one another and of those before, each of length one."""
    found = list(before)
    for column in columns.T:
        left = column
        for _ in range(2):
            for other in found:
                left = left - (other @ left) * other
        size = float(np.linalg.norm(left))
        if size > 1e-9 * float(np.linalg.norm(column)):
            found.append(left / size)
    return found[len(before) :]


def without_repeating(columns: FloatArray, rotations: int) -> FloatArray:
    """Columns less what repeats of each, same shape (n, k)."""
    parts = [column - repeating_part(column, rotations) for column in columns.T]
    return np.stack(parts, axis=1)
