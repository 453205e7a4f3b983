"""Remove lines of the motor and a drift of the speed before A is fitted.

A torque ripple, a transmission error or an eccentric encoder causes a sustained wave at a whole
order of the motor's angle. If it is near the ringing frequency, pulses at every few motor turns
explain it better than any pulses explain the impacts. Ringing lasts only a short time after each
impact, so the median over motor turns is the line alone. Removing it takes only one of hundreds of
load orders from the ringing. Behind a gear of low ratio the motor turns only a few times between
impacts, and ringing may fill most turns. But ringing has a different phase in each turn, and a line
the same phase in all.

A drift is found from differences between rotations, so that no repeating signal is mistaken for
one. Its effect on the times of the impacts (early and late ones) is treated in
:mod:`bayesbl.noise.impact_scatter`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from bayesbl.noise.outside_lines import ROUNDS, UNSTEADY_SHARE, medians, subtract_line
from bayesbl.noise.rotation_noise import bridged, estimate_noise
from bayesbl.probabilities import LINE_FALSE_ALARM, chi2_isf, normal_isf
from bayesbl.recording.types import MOTOR_CURRENT, MOTOR_SPEED, ComplexArray, FloatArray, Recording
from bayesbl.ringing.optimum import Optimum
from bayesbl.ringing.symbols import MEAN, ROTATION
from bayesbl.units import RPM_PER_RAD_PER_S

HIGHEST_ORDER = 12
FEWEST_SAMPLES = 2.5
"""Fewest samples in a period of a line."""

FEWEST_TURNS = 20
SMALLEST_LINE = 0.02
"""Smallest line, as a share of half the range of the speed, which is about the ringing amplitude. A
smaller line changes the ringing by no more than that share, and even a bench without noise has some
of every order."""


@dataclass(frozen=True, slots=True)
class MotorLine:
    """Amplitude of a line in the speed at a whole order of the motor, with its standard error."""

    order: int
    size_rpm: float
    standard_error_rpm: float


def without_motor_lines(recording: Recording) -> tuple[Recording, tuple[MotorLine, ...]]:
    """Remove every significant line of the motor; return the recording and the lines."""
    speed = recording.motor_speed_rpm
    angle = np.cumsum(speed * np.gradient(recording.time_s)) / RPM_PER_RAD_PER_S
    turns = np.maximum.accumulate(np.abs(angle - angle[0])) // (2.0 * math.pi)
    begins = np.searchsorted(turns, np.arange(turns[-1] + 1.0))
    if begins.size - 1 < FEWEST_TURNS:
        return recording, ()
    samples_per_turn = (begins[-1] - begins[0]) / (begins.size - 1)
    highest = min(HIGHEST_ORDER, int(samples_per_turn / FEWEST_SAMPLES))
    bound = normal_isf(0.5 * LINE_FALSE_ALARM / max(2 * highest, 1))
    smallest = SMALLEST_LINE * 0.5 * float(np.ptp(speed))
    # The controller responds to the line: the control law holds only if both channels are cleaned.
    cleaned = {n: row for n, row in recording.channels.items() if n in (MOTOR_SPEED, MOTOR_CURRENT)}
    sizes: dict[int, complex] = {}
    errors: dict[int, float] = {}
    waves = {order: np.exp(1j * order * angle) for order in range(1, highest + 1)}
    for order, wave in waves.items():
        by_turn = partial(_by_turn, wave=wave, begins=begins)
        (line,), (error,), (unsteady,) = medians(by_turn(cleaned[MOTOR_SPEED]))
        if abs(line) > max(smallest, bound * error) and unsteady < UNSTEADY_SHARE:
            errors[order] = float(error)
            sizes[order] = subtract_line(cleaned, wave, by_turn)
    if not sizes:
        return recording, ()
    for order in ROUNDS * tuple(sizes):
        by_turn = partial(_by_turn, wave=waves[order], begins=begins)
        sizes[order] += subtract_line(cleaned, waves[order], by_turn)
    lines = tuple(MotorLine(order, abs(size), errors[order]) for order, size in sizes.items())
    return replace(recording, channels={**recording.channels, **cleaned}), lines


def in_words(lines: Sequence[MotorLine]) -> str:
    """A note on the removed lines."""
    listed = " and ".join(f"{line.size_rpm:.2g} rpm at motor order {line.order}" for line in lines)
    return (
        f"A line of {listed} was taken out of the speed: a ripple of the torque, an error of "
        "transmission or encoder, not the impacts."
    )


def _by_turn(values: FloatArray, wave: ComplexArray, begins: NDArray[np.intp]) -> ComplexArray:
    """Amplitude c of Re(c · wave) in each turn, about the turn's mean, shape (turns, 1)."""
    all_turns = slice(int(begins[0]), int(begins[-1]))
    starts, counts = begins[:-1] - begins[0], np.diff(begins)
    mean = np.repeat(np.add.reduceat(values[all_turns], starts) / counts, counts)
    demodulated = (values[all_turns] - mean) * wave[all_turns].conj()
    return np.asarray(2.0 * np.add.reduceat(demodulated, starts)[:, None] / counts[:, None])


SMALLEST_SHARE = 1e-5
"""A drift below this share of the speed moves no impact by more than 0.1 ms a minute."""

DEGREE = 2


def without_drift(
    recording: Recording, optimum: Optimum, residual_rpm: FloatArray
) -> tuple[Recording, str] | None:
    """Remove a drift of the speed, a parabola in time; return the recording and a note.

    Its coefficients are sums over differences between rotations, in which the misfit cancels.
    """
    period_s, n = recording.sampling_period_s, recording.samples
    x = np.linspace(-1.0, 1.0, n)
    powers = np.stack([x**k for k in range(1, DEGREE + 1)], axis=1)
    lag = max(1, round(optimum.symbols[ROTATION] / period_s))
    weights = np.linalg.pinv(powers[lag:] - powers[:-lag]).T
    # Rewritten as sums over the residual itself, whose covariance is known.
    on_residual = np.pad(weights, ((lag, 0), (0, 0))) - np.pad(weights, ((0, lag), (0, 0)))
    residual_rpm = bridged(residual_rpm)
    coefficients = residual_rpm @ on_residual
    drift = powers @ coefficients
    steady = estimate_noise(residual_rpm - drift, optimum.symbols[ROTATION], period_s)
    spread = on_residual.T @ steady.covariance_times(on_residual)
    size = float(coefficients @ np.linalg.solve(spread, coefficients))
    smallest = SMALLEST_SHARE * abs(optimum.symbols[MEAN])
    if size < chi2_isf(LINE_FALSE_ALARM, DEGREE) or np.ptp(drift) < smallest:
        return None
    level = recording.motor_speed_rpm - drift + drift.mean()
    note = f"The speed drifts by {np.ptp(drift):.2g} rpm over the recording; this was removed."
    return replace(recording, channels={**recording.channels, MOTOR_SPEED: level}), note
