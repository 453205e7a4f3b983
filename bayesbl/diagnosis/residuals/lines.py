"""Lines in a residual: to which angle, or to time, each belongs.

The motor does not turn evenly. Gravity and the speed loop swing its angle about that of even
rotation by up to half a radian, so what repeats with the motor angle has side bands in time, and
what repeats in time has them in angle: a line belongs to where it is sharp. A scale here is what
a line counts its cycles along, in samples: time itself, or the motor angle over its mean rate.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from bayesbl.diagnosis.residuals.spectrum import NoiseFloor, WholeRotations, comb
from bayesbl.recording.types import ComplexArray, FloatArray

Along = Literal["time", "motor angle"]
Dependence = Literal["load angle", "motor angle", "time", "angle or time"]

CLEARLY = 10.0
"""Difference of log likelihoods beyond which a line is sharp on one scale and not on the other."""
NEIGHBOURS = 4
STANDS_OUT = 4.0
"""Times its neighbours' power among the load orders: then a line is one by itself."""

SAME_BINS = 0.5
"""Two lines are one if they are apart by this much of both records' resolution."""
OTHER_SPEED = 0.02


@dataclass(frozen=True, slots=True)
class Line:
    """A significant line in the spectrum of a residual.

    Attributes
    ----------
    load_order, motor_order
        Cycles per turn of the load and of the motor.
    amplitude, phase_rad
        Of a cosine at the first sample, the channel's unit.
    probability
        Of as much from noise alone.
    dependence
        What it repeats with. Load angle: a whole load order. Motor angle: sharper in the motor
        angle than in time, a whole or half motor order, or the same order at different speeds.
        Time: sharper in time, or the same frequency at different speeds. Angle or time: these
        recordings cannot tell.
    stands_out
        It is no part of a comb of load orders.
    """

    frequency_hz: float
    load_order: float
    motor_order: float
    amplitude: float
    phase_rad: float
    probability: float
    dependence: Dependence
    stands_out: bool


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

    def line(self, whole: WholeRotations, cosine: float, sine: float) -> Line:
        """With its amplitude and phase, from the coefficients of these."""
        motor_order = self.cycles / (whole.rotations * whole.gear_ratio)
        dependence: Dependence = "angle or time"
        if self.decided:
            dependence = self.along
        elif _whole_or_half(motor_order, whole):
            dependence = "motor angle"
        return Line(
            frequency_hz=self.cycles / whole.seconds,
            load_order=self.cycles / whole.rotations,
            motor_order=motor_order,
            amplitude=math.hypot(cosine, sine),
            phase_rad=math.atan2(-sine, cosine),
            probability=self.probability,
            dependence=dependence,
            stands_out=True,
        )


def _whole_or_half(motor_order: float, whole: WholeRotations) -> bool:
    apart = abs(motor_order - 0.5 * round(2.0 * motor_order)) * whole.motor_hz * whole.seconds
    return round(2.0 * motor_order) > 0 and apart < SAME_BINS


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
    whole: WholeRotations,
    scale: Scales,
    rate: float,
) -> list[FoundLine]:
    """Whole and half motor orders that are whole load orders too and stand out of these.

    With a whole gear ratio everything periodic in the motor angle repeats with the load: only its
    standing alone tells, on the scale of the motor angle and no less sharp there than in time.
    ``rate`` is the false-alarm rate.
    """
    n, rotations, gear_ratio = values.size, whole.rotations, whole.gear_ratio
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
        probability = math.exp(-power[order] / at_orders[order])
        if in_time[order] - power[order] > CLEARLY * at_orders[order]:
            continue
        if probability * len(orders) <= rate and _stands_out(power, order):
            found.append(FoundLine(float(order * rotations), "motor angle", probability, True))
    return found


def load_lines(
    harmonics: ComplexArray, whole: WholeRotations, probability: FloatArray, threshold: float
) -> list[Line]:
    """Significant whole load orders.

    Of each order from 0 on: ``harmonics`` of the rotation, and ``probability`` from noise alone.
    """
    power = np.abs(harmonics) ** 2
    lines = []
    for order in (int(found) for found in np.flatnonzero(probability <= threshold) if found):
        lines.append(
            Line(
                frequency_hz=float(order * whole.rotation_hz),
                load_order=float(order),
                motor_order=float(order / whole.gear_ratio),
                amplitude=2.0 * math.sqrt(power[order]),
                phase_rad=float(np.angle(harmonics[order])),
                probability=float(probability[order]),
                dependence="load angle",
                stands_out=_stands_out(power, order),
            )
        )
    return lines


def _stands_out(power: FloatArray, order: int) -> bool:
    """Whether a load order, from 1 on, is one by itself among its neighbours."""
    around = power[max(1, order - NEIGHBOURS) : order + NEIGHBOURS + 1].copy()
    around[min(order - 1, NEIGHBOURS)] = 0.0
    return bool(power[order] > STANDS_OUT * around.max())


def over_speeds(
    line: Line,
    whole: WholeRotations,
    others: Sequence[tuple[WholeRotations, Sequence[Line]]],
) -> Line:
    """The line, attributed anew by what recordings of the same channel at other speeds show."""
    if not line.stands_out or line.dependence in ("motor angle", "time"):
        return line
    same_time = same_turn = False
    for other, lines in others:
        if abs(abs(other.reference_speed_rpm / whole.reference_speed_rpm) - 1.0) < OTHER_SPEED:
            continue
        seconds = SAME_BINS * (1.0 / whole.seconds + 1.0 / other.seconds)
        turns = SAME_BINS * (
            1.0 / (whole.seconds * whole.motor_hz) + 1.0 / (other.seconds * other.motor_hz)
        )
        for partner in lines:
            if partner.stands_out:
                same_time |= abs(partner.frequency_hz - line.frequency_hz) < seconds
                same_turn |= abs(partner.motor_order - line.motor_order) < turns
    if same_time == same_turn:
        return line
    if same_time:
        return dataclasses.replace(line, dependence="time")
    if line.dependence == "angle or time":
        return dataclasses.replace(line, dependence="motor angle")
    return line
