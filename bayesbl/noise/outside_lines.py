"""What shakes a joint from outside: lines in time, locked to no angle, near the ringing.

Another machine that shakes the base or the load makes a wave that goes on all the time, while the
ringing is there for a short time behind each impact. So the median over short stretches of the
speed, turned back by the wave, is the line alone. It adds to the ringing, and it makes the load
meet each flank sooner or later, harder or less hard: by about as much as it moves the speed, and
that does not average out as noise does.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from bayesbl.probabilities import normal_isf
from bayesbl.recording.types import MOTOR_SPEED, ComplexArray, FloatArray

BAND_HZ = (6.0, 40.0)
"""Where joints ring; slower waves are the load's own, faster ones do not beat with the ringing."""

STRETCH_S = 0.25
"""One and a half periods of the slowest; the ringing fills few such stretches."""

SOUGHT_S = 120.0
"""In which a line is sought: one that goes on all the time is in any part, and the work grows with
the square of its length. A longer recording then sharpens its frequency."""

FEWEST_STRETCHES = 20
FALSE_ALARM = 1e-5
"""Of a recording, over all frequencies."""

UNSTEADY_SHARE = 0.75
"""Of a line's size, by which the quartiles over the stretches may be off it along its phase. Of
ringing that filled the motor's turns, 37 cases at gear ratios 6 to 10, the lower one was off by
0.97 or more; of lines of 1 rpm in noise of 1.5 rpm at 1 kHz by 0.58 at most."""

SMALLEST_SHARE = 0.01
"""Of half the range of the speed, about the ringing's amplitude: less moves it by no more."""

MOST_LINES = 3
"""More are a comb: ringing that has not ended when the next impact comes repeats with the load."""

FEWEST_IN_ROTATION = 3
"""Stretches in a load rotation, so that some have no ringing."""

ROUNDS = 3
FINER = 8


@dataclass(frozen=True, slots=True)
class OutsideLine:
    """A line in the speed at a frequency in time, and its amplitude."""

    frequency_hz: float
    size_rpm: float


def without_outside_lines(
    channels: dict[str, FloatArray], period_s: float, rotation_s: float = math.inf
) -> tuple[dict[str, FloatArray], tuple[OutsideLine, ...]]:
    """Channels (n,) by name without the lines that stand out of the speed, and these lines.

    ``rotation_s``: of the load, where it is known.
    """
    if rotation_s < FEWEST_IN_ROTATION * STRETCH_S:
        return channels, ()
    cleaned = dict(channels)
    lines: list[OutsideLine] = []
    least = SMALLEST_SHARE * 0.5 * float(np.ptp(channels[MOTOR_SPEED]))
    while (line := clearest_line(cleaned[MOTOR_SPEED], period_s, least)) is not None:
        if len(lines) == MOST_LINES:
            return channels, ()
        lines.append(line)
        for name, row in cleaned.items():
            cleaned[name] = row - _wave(row, period_s, line.frequency_hz)
    return cleaned, tuple(lines)


def clearest_line(speed_rpm: FloatArray, period_s: float, least_rpm: float) -> OutsideLine | None:
    """The largest line of at least this amplitude that goes on all the time, if there is one."""
    many = max(1, math.floor(1.0 / (4.0 * BAND_HZ[1] * period_s)))
    rows = speed_rpm[: speed_rpm.size // many * many].reshape(-1, many).mean(axis=1)
    step = many * period_s
    part = rows[: round(SOUGHT_S / step)]
    duration = part.size * step
    if duration < FEWEST_STRETCHES * STRETCH_S:
        return None
    highest = min(BAND_HZ[1], 0.4 / step)
    spacing = 0.25 / duration
    grid = np.arange(BAND_HZ[0], highest, spacing)
    each = _by_stretch(part, step, grid)
    line, error, unsteady = medians(each)
    bound = normal_isf(0.5 * FALSE_ALARM / (duration * highest))
    size = np.abs(line)
    size[(size < np.maximum(least_rpm, bound * error)) | (unsteady > UNSTEADY_SHARE)] = 0.0
    if not size.any():
        return None
    frequency = float(grid[np.argmax(size)])
    # The stretches without ringing, all together, tell the frequency: of twice as many each time.
    while True:
        at = _by_stretch(part, step, np.array([frequency]))
        off = np.abs(at - medians(at)[0])[:, 0]
        quiet = off < 2.0 * np.median(off)
        fine = frequency + spacing * np.linspace(-2.0, 2.0, 4 * FINER + 1)
        together = np.abs(_by_stretch(part, step, fine)[quiet].sum(axis=0))
        frequency = float(fine[np.argmax(together)])
        if part.size == rows.size:
            break
        part, spacing = rows[: 2 * part.size], 0.5 * spacing
    wave = _wave(speed_rpm, period_s, frequency)
    return OutsideLine(frequency, math.sqrt(2.0) * float(wave.std()))


def in_words(lines: Iterable[OutsideLine]) -> str:
    """What was taken out, as a note."""
    listed = " and ".join(
        f"{line.size_rpm:.2g} rpm at {line.frequency_hz:.4g} Hz" for line in lines
    )
    return (
        f"A line of {listed} goes on all the time and belongs to no angle: something shakes the "
        "joint from outside. It was taken out of the speed, and the interval allows for as much in "
        "the amplitude."
    )


def _wave(speed_rpm: FloatArray, period_s: float, frequency_hz: float) -> FloatArray:
    """The line at a frequency, (n,): what rounds of medians leave nothing of."""
    turning = np.exp(2.0j * np.pi * frequency_hz * period_s * np.arange(speed_rpm.size))
    remainder = speed_rpm.copy()
    for _ in range(ROUNDS):
        line = medians(_by_stretch(remainder, period_s, np.array([frequency_hz])))[0][0]
        remainder -= (line * turning).real
    return np.asarray(speed_rpm - remainder)


def _by_stretch(rows: FloatArray, step_s: float, frequency_hz: FloatArray) -> ComplexArray:
    """Complex amplitude of each line in each stretch, (stretches, f), straight lines left out."""
    length = max(4, round(STRETCH_S / step_s))
    stretches = rows[: rows.size // length * length].reshape(-1, length)
    at = np.arange(length) - 0.5 * (length - 1)
    straight = np.stack([np.ones(length), at / np.linalg.norm(at) * math.sqrt(length)])
    omega = 2.0 * np.pi * frequency_hz * step_s
    waves = np.exp(1j * np.outer(at, omega))
    own = waves - straight.T @ (straight @ waves) / length
    each = stretches @ own.conj() * (2.0 / np.sum(np.abs(own) ** 2, axis=0))
    middle = 0.5 * (length - 1) + length * np.arange(len(stretches))
    return np.asarray(each * np.exp(-1j * np.outer(middle, omega)))


def medians(each: ComplexArray) -> tuple[ComplexArray, FloatArray, FloatArray]:
    """Of lines in stretches, (stretches, f): size and phase, standard error, unsteadiness, (f,)."""
    parts = np.stack([each.real, each.imag])
    centre = np.median(parts, axis=1)
    spread = 1.4826 * np.median(np.abs(parts - centre[:, None]), axis=1)
    # A median is less sharp than a mean by the square root of π/2.
    error = math.sqrt(0.5 * math.pi / len(each)) * np.linalg.norm(spread, axis=0)
    line = centre[0] + 1j * centre[1]
    along = np.real(each * line.conj()) / np.maximum(np.abs(line) ** 2, 1e-300)
    low, high = np.quantile(along, [0.25, 0.75], axis=0)
    return line, np.asarray(error), np.maximum(1.0 - low, high - 1.0)
