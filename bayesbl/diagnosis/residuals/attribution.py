"""To which angle, or to time, a line belongs; how offsets depend on direction and speed."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayesbl.diagnosis.residuals.decomposition import Decomposition, Wave, WholeRotations
from bayesbl.diagnosis.residuals.line_search import NEIGHBOURS, STANDS_OUT
from bayesbl.recording.types import FloatArray

Dependence = Literal["load angle", "motor angle", "time", "angle or time"]

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


def load_lines(
    parts: Decomposition, whole: WholeRotations, probability: FloatArray, threshold: float
) -> list[Line]:
    """Significant whole load orders.

    ``probability``: of each order from 0 on, from noise alone.
    """
    harmonics = parts.repeating[:: whole.rotations] / whole.samples
    power = np.abs(harmonics) ** 2
    power[0] = 0.0
    lines = []
    for order in (int(found) for found in np.flatnonzero(probability <= threshold) if found):
        around = power[max(1, order - NEIGHBOURS) : order + NEIGHBOURS + 1].copy()
        around[min(order - 1, NEIGHBOURS)] = 0.0
        stands_out = bool(power[order] > STANDS_OUT * around.max())
        lines.append(
            Line(
                frequency_hz=float(order * whole.rotation_hz),
                load_order=float(order),
                motor_order=float(order / whole.gear_ratio),
                amplitude=2.0 * math.sqrt(power[order]),
                phase_rad=float(np.angle(harmonics[order])),
                probability=float(probability[order]),
                dependence="load angle",
                stands_out=stands_out,
            )
        )
    return lines


def wave_lines(parts: Decomposition, whole: WholeRotations) -> list[Line]:
    """Significant lines periodic in the motor angle or in time."""
    return [_wave_line(wave, whole) for wave in (*parts.motor_waves, *parts.free_waves)]


def _wave_line(wave: Wave, whole: WholeRotations) -> Line:
    found = wave.found
    motor_order = found.cycles / (whole.rotations * whole.gear_ratio)
    dependence: Dependence = "angle or time"
    if found.decided:
        dependence = found.along
    elif _whole_or_half(motor_order, whole):
        dependence = "motor angle"
    return Line(
        frequency_hz=found.cycles / whole.seconds,
        load_order=found.cycles / whole.rotations,
        motor_order=motor_order,
        amplitude=wave.amplitude,
        phase_rad=wave.phase_rad,
        probability=found.probability,
        dependence=dependence,
        stands_out=True,
    )


def _whole_or_half(motor_order: float, whole: WholeRotations) -> bool:
    apart = abs(motor_order - 0.5 * round(2.0 * motor_order)) * whole.motor_hz * whole.seconds
    return round(2.0 * motor_order) > 0 and apart < SAME_BINS


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


@dataclass(frozen=True, slots=True)
class OffsetDependence:
    """How the offset of a channel depends on direction and speed.

    offset = constant + with_direction · sign ω + per_1000_rpm · ω/(1000 rpm), the channel's unit.
    A part that these recordings cannot tell from another is nan and contained in the one before it.
    """

    channel: str
    constant: float
    constant_error: float
    with_direction: float
    with_direction_error: float
    per_1000_rpm: float
    per_1000_rpm_error: float


def offset_dependence(
    channel: str, speeds_rpm: FloatArray, offsets: FloatArray, errors: FloatArray
) -> OffsetDependence:
    """Weighted least squares over recordings, each of shape (r,)."""
    columns = [np.ones(speeds_rpm.size)]
    places = [0]
    for place, column in ((1, np.sign(speeds_rpm)), (2, speeds_rpm / 1000.0)):
        if np.linalg.matrix_rank(np.stack([*columns, column]), tol=0.05) > len(columns):
            columns.append(column)
            places.append(place)
    design = np.stack(columns, axis=1) / errors[:, None]
    covariance = np.linalg.inv(design.T @ design)
    solved = covariance @ design.T @ (offsets / errors)
    value, error = np.full(3, math.nan), np.full(3, math.nan)
    value[places] = solved
    error[places] = np.sqrt(np.diag(covariance))
    return OffsetDependence(
        channel,
        *(float(part) for pair in zip(value, error, strict=True) for part in pair),
    )
