"""Lines of outside vibration near the ringing: fixed in frequency, locked to no angle.

Another machine that shakes the base or the load causes a sustained wave, while the ringing lasts
only a short time after each impact. The median over short stretches of the demodulated speed is
therefore the line alone. The line adds to the ringing. It also makes the load meet each flank
earlier or later, and harder or softer, by about as much as it moves the speed. That does not
average out like noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

import numpy as np

from bayesbl.probabilities import LINE_FALSE_ALARM, normal_isf
from bayesbl.recording.types import MOTOR_SPEED, ComplexArray, FloatArray

BAND_HZ = (6.0, 40.0)
"""Where joints ring; slower waves are the load's own, faster ones do not beat with ringing."""

STRETCH_S = 0.25
"""One and a half periods of the slowest line; the ringing fills few such stretches."""

SOUGHT_S = 120.0
"""Length in which a line is sought: a sustained line is in any part, and the work grows with the
square of the length. A longer recording then refines the frequency."""

FEWEST_STRETCHES = 20
UNSTEADY_SHARE = 0.75
"""Largest departure of the quartiles over stretches from a line, along its phase, as a share of
its amplitude. For ringing that filled the motor's turns, 37 cases at gear ratios 6 to 10, the
lower quartile departed by 0.97 or more; for lines of 1 rpm in noise of 1.5 rpm at 1 kHz by at
most 0.58."""

SMALLEST_SHARE = 0.01
"""Smallest line, as a share of half the range of the speed (about the ringing amplitude, which a
smaller line moves by less)."""

MOST_LINES = 3
"""More lines are a comb: ringing that lasts until the next impact repeats with the load."""

FEWEST_IN_ROTATION = 3
"""Fewest stretches in a load rotation, so that some have no ringing."""

ROUNDS = 3
"""Each round leaves a few per cent of the line, as pieces hold no whole number of periods."""

FINER = 8


@dataclass(frozen=True, slots=True)
class OutsideLine:
    """A line in the speed at a fixed frequency, and its amplitude."""

    frequency_hz: float
    size_rpm: float


def without_outside_lines(
    channels: dict[str, FloatArray], period_s: float, rotation_s: float = math.inf
) -> tuple[dict[str, FloatArray], tuple[OutsideLine, ...]]:
    """Remove the significant lines from channels (n,) by name; return channels and lines.

    ``rotation_s``: rotation period of the load, if known.
    """
    if rotation_s < FEWEST_IN_ROTATION * STRETCH_S:
        return channels, ()
    cleaned = dict(channels)
    lines: list[OutsideLine] = []
    smallest = SMALLEST_SHARE * 0.5 * float(np.ptp(channels[MOTOR_SPEED]))
    while (hz := _clearest_frequency(cleaned[MOTOR_SPEED], period_s, smallest)) is not None:
        if len(lines) == MOST_LINES:
            return channels, ()
        wave = np.exp(2.0j * np.pi * hz * period_s * np.arange(cleaned[MOTOR_SPEED].size))
        by_stretch = partial(_by_stretch, step_s=period_s, frequency_hz=np.array([hz]))
        size = sum(subtract_line(cleaned, wave, by_stretch) for _ in range(ROUNDS))
        lines.append(OutsideLine(hz, abs(size)))
    return cleaned, tuple(lines)


def subtract_line(
    channels: dict[str, FloatArray], wave: ComplexArray, by_piece: Callable[..., ComplexArray]
) -> complex:
    """Subtract Re(c · wave) from each channel, (n,), in place; return c of the speed.

    ``by_piece``: complex amplitudes (pieces, 1) of a channel; c is their median.
    """
    lines = {name: complex(medians(by_piece(row))[0][0]) for name, row in channels.items()}
    for name, line in lines.items():
        channels[name] = channels[name] - (line * wave).real
    return lines[MOTOR_SPEED]


def _clearest_frequency(speed_rpm: FloatArray, period_s: float, least_rpm: float) -> float | None:
    """Frequency of the largest sustained line of at least this amplitude, if there is one, Hz."""
    decimation = max(1, math.floor(1.0 / (4.0 * BAND_HZ[1] * period_s)))
    rows = (
        speed_rpm[: speed_rpm.size // decimation * decimation].reshape(-1, decimation).mean(axis=1)
    )
    step = decimation * period_s
    part = rows[: round(SOUGHT_S / step)]
    duration = part.size * step
    if duration < FEWEST_STRETCHES * STRETCH_S:
        return None
    highest = min(BAND_HZ[1], 0.4 / step)
    spacing = 0.25 / duration
    grid = np.arange(BAND_HZ[0], highest, spacing)
    by_stretch = _by_stretch(part, step, grid)
    line, error, unsteady = medians(by_stretch)
    bound = normal_isf(0.5 * LINE_FALSE_ALARM / (duration * highest))
    size = np.abs(line)
    size[(size < np.maximum(least_rpm, bound * error)) | (unsteady > UNSTEADY_SHARE)] = 0.0
    if not size.any():
        return None
    frequency = float(grid[np.argmax(size)])
    # The stretches without ringing together give the frequency; double their number each time.
    while True:
        amplitudes = _by_stretch(part, step, np.array([frequency]))
        departure = np.abs(amplitudes - medians(amplitudes)[0])[:, 0]
        quiet = departure < 2.0 * np.median(departure)
        fine = frequency + spacing * np.linspace(-2.0, 2.0, 4 * FINER + 1)
        coherent_sum = np.abs(_by_stretch(part, step, fine)[quiet].sum(axis=0))
        frequency = float(fine[np.argmax(coherent_sum)])
        if part.size == rows.size:
            return frequency
        part, spacing = rows[: 2 * part.size], 0.5 * spacing


def in_words(lines: Iterable[OutsideLine]) -> str:
    """A note on the removed lines."""
    listed = " and ".join(
        f"{line.size_rpm:.2g} rpm at {line.frequency_hz:.4g} Hz" for line in lines
    )
    return (
        f"A line of {listed} goes on all the time and belongs to no angle: something shakes the "
        "joint from outside. It was taken out of the speed, and the interval allows for as much in "
        "the amplitude."
    )


def _by_stretch(rows: FloatArray, step_s: float, frequency_hz: FloatArray) -> ComplexArray:
    """Complex amplitude of each line in each stretch without its trend, (stretches, f)."""
    length = max(4, round(STRETCH_S / step_s))
    stretches = rows[: rows.size // length * length].reshape(-1, length)
    centred = np.arange(length) - 0.5 * (length - 1)
    trend = np.stack([np.ones(length), centred / np.linalg.norm(centred) * math.sqrt(length)])
    omega = 2.0 * np.pi * frequency_hz * step_s
    waves = np.exp(1j * np.outer(centred, omega))
    detrended = waves - trend.T @ (trend @ waves) / length
    amplitudes = stretches @ detrended.conj() * (2.0 / np.sum(np.abs(detrended) ** 2, axis=0))
    middle = 0.5 * (length - 1) + length * np.arange(len(stretches))
    return np.asarray(amplitudes * np.exp(-1j * np.outer(middle, omega)))


def medians(by_stretch: ComplexArray) -> tuple[ComplexArray, FloatArray, FloatArray]:
    """Amplitude, standard error, unsteadiness of lines, (f,), from stretches, (stretches, f)."""
    parts = np.stack([by_stretch.real, by_stretch.imag])
    centre = np.median(parts, axis=1)
    sd = 1.4826 * np.median(np.abs(parts - centre[:, None]), axis=1)
    # The standard error of a median is √(π/2) times that of a mean.
    error = math.sqrt(0.5 * math.pi / len(by_stretch)) * np.linalg.norm(sd, axis=0)
    line = centre[0] + 1j * centre[1]
    projection = np.real(by_stretch * line.conj()) / np.maximum(np.abs(line) ** 2, 1e-300)
    low, high = np.quantile(projection, [0.25, 0.75], axis=0)
    return line, np.asarray(error), np.maximum(1.0 - low, high - 1.0)
