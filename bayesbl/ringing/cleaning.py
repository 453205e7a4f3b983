"""What is taken out of a recording before A is fitted: lines of the motor, a drift of the speed.

A ripple of the torque, a transmission error or an encoder off centre makes a wave at a whole order
of the motor's angle that goes on all the time. Near the ringing's frequency pulses at every few
turns of the motor explain it better than any explain the impacts. Ringing is there for a short
time behind each impact only, so the median over the turns is the line alone. What that takes from
the ringing is a single one of hundreds of load orders. Behind a gear of a low ratio the motor turns
only a few times between two impacts, and ringing may fill most of its turns: it has another phase
in each, where a line has the same in all.

A drift is found by comparing rotations, so that what repeats is never taken for one. What it does
to the impacts' times is left to :mod:`bayesbl.noise.impact_scatter`: they come early and late.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesbl.noise.outside_lines import UNSTEADY_SHARE, medians
from bayesbl.noise.rotation_noise import bridged, estimate_noise
from bayesbl.probabilities import chi2_isf, normal_isf
from bayesbl.recording.types import MOTOR_CURRENT, MOTOR_SPEED, ComplexArray, FloatArray, Recording
from bayesbl.ringing.optimum import Optimum
from bayesbl.ringing.symbols import MEAN, ROTATION
from bayesbl.units import RPM_PER_RAD_PER_S

FALSE_ALARM = 1e-5
"""Of a recording: over all orders of lines, and of a drift."""

HIGHEST_ORDER = 12
FEWEST_SAMPLES = 2.5
"""In a period of the line."""

FEWEST_TURNS = 20
SMALLEST_LINE = 0.02
"""As a share of half the range of the speed, about the ringing's amplitude: a smaller line moves
that by no more than such a share, and a bench without noise has some of every order."""

ROUNDS = 3
"""Each leaves a few per cent of the line, as no turn has a whole number of samples."""


@dataclass(frozen=True, slots=True)
class MotorLine:
    """Amplitude of a line in the speed, at a whole order of the motor, with its standard error."""

    order: int
    size_rpm: float
    standard_error_rpm: float


def without_motor_lines(recording: Recording) -> tuple[Recording, tuple[MotorLine, ...]]:
    """The recording without such lines, and each of them that stands out."""
    speed = recording.motor_speed_rpm
    angle = np.cumsum(speed * np.gradient(recording.time_s)) / RPM_PER_RAD_PER_S
    turns = np.maximum.accumulate(np.abs(angle - angle[0])) // (2.0 * math.pi)
    begins = np.searchsorted(turns, np.arange(turns[-1] + 1.0))
    if begins.size - 1 < FEWEST_TURNS:
        return recording, ()
    samples_per_turn = (begins[-1] - begins[0]) / (begins.size - 1)
    highest = min(HIGHEST_ORDER, int(samples_per_turn / FEWEST_SAMPLES))
    bound = normal_isf(0.5 * FALSE_ALARM / max(2 * highest, 1))
    least = SMALLEST_LINE * 0.5 * float(np.ptp(speed))
    # The controller answers the line: with one of the two left, its law would not hold.
    cleaned = {n: row for n, row in recording.channels.items() if n in (MOTOR_SPEED, MOTOR_CURRENT)}
    sizes: dict[int, complex] = {}
    errors: dict[int, float] = {}
    for order in range(1, highest + 1):
        each = _each_turn(cleaned[MOTOR_SPEED], np.exp(1j * order * angle), begins)
        line, error, unsteady = medians(each[:, None])
        if abs(line[0]) > max(least, bound * error[0]) and unsteady[0] < UNSTEADY_SHARE:
            errors[order] = float(error[0])
            sizes[order] = _take(cleaned, np.exp(1j * order * angle), begins)
    if not sizes:
        return recording, ()
    for _ in range(ROUNDS):
        for order in sizes:
            sizes[order] += _take(cleaned, np.exp(1j * order * angle), begins)
    lines = tuple(MotorLine(order, abs(size), errors[order]) for order, size in sizes.items())
    return replace(recording, channels={**recording.channels, **cleaned}), lines


def in_words(lines: Sequence[MotorLine]) -> str:
    """What was taken out, as a note."""
    listed = " and ".join(f"{line.size_rpm:.2g} rpm at motor order {line.order}" for line in lines)
    return (
        f"A line of {listed} was taken out of the speed: a ripple of the torque, an error of "
        "transmission or encoder, not the impacts."
    )


def _take(channels: dict[str, FloatArray], wave: ComplexArray, begins: NDArray[np.intp]) -> complex:
    """Subtract the line from each channel; returns what it was in the speed."""
    lines = {
        name: complex(medians(_each_turn(row, wave, begins)[:, None])[0][0])
        for name, row in channels.items()
    }
    for name, line in lines.items():
        channels[name] = channels[name] - (line * wave).real
    return lines[MOTOR_SPEED]


def _each_turn(values: FloatArray, wave: ComplexArray, begins: NDArray[np.intp]) -> ComplexArray:
    """Amplitude c of Re(c · wave) in each turn, about its mean, shape (turns,)."""
    whole = slice(int(begins[0]), int(begins[-1]))
    starts, counts = begins[:-1] - begins[0], np.diff(begins)
    mean = np.repeat(np.add.reduceat(values[whole], starts) / counts, counts)
    turned = (values[whole] - mean) * wave[whole].conj()
    return np.asarray(2.0 * np.add.reduceat(turned, starts) / counts)


SMALLEST_SHARE = 1e-5
"""A drift below this share of the speed moves no impact by more than 0.1 ms a minute."""

DEGREE = 2


def without_drift(
    recording: Recording, optimum: Optimum, residual_rpm: FloatArray
) -> tuple[Recording, str] | None:
    """The recording without a drift of its speed, a parabola in time, and a note.

    Its coefficients are sums over the differences between rotations, in which a misfit cancels.
    """
    period_s, n = recording.sampling_period_s, recording.samples
    x = np.linspace(-1.0, 1.0, n)
    powers = np.stack([x**k for k in range(1, DEGREE + 1)], axis=1)
    lag = max(1, round(optimum.symbols[ROTATION] / period_s))
    weights = np.linalg.pinv(powers[lag:] - powers[:-lag]).T
    # As sums over the residual itself, whose covariance is known.
    on_residual = np.pad(weights, ((lag, 0), (0, 0))) - np.pad(weights, ((0, lag), (0, 0)))
    residual_rpm = bridged(residual_rpm)
    coefficients = residual_rpm @ on_residual
    drift = powers @ coefficients
    steady = estimate_noise(residual_rpm - drift, optimum.symbols[ROTATION], period_s)
    spread = on_residual.T @ steady.covariance_times(on_residual)
    size = float(coefficients @ np.linalg.solve(spread, coefficients))
    least = SMALLEST_SHARE * abs(optimum.symbols[MEAN])
    if size < chi2_isf(FALSE_ALARM, DEGREE) or np.ptp(drift) < least:
        return None
    level = recording.motor_speed_rpm - drift + drift.mean()
    note = f"The speed drifts by {np.ptp(drift):.2g} rpm over the recording; this was removed."
    return replace(recording, channels={**recording.channels, MOTOR_SPEED: level}), note
