"""Posterior predictive check: whether simulation and recording agree within noise.

What repeats from rotation to rotation after the fit is not noise. The whitened residuals are
averaged over the rotations. In bands of load orders, the power of this mean is compared with the
power that does not repeat.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.loop_noise import degrees_of_freedom, loop_noise, rounded_rotations
from bayesbl.matching.observed import Observed, whole_rotations
from bayesbl.probabilities import FALSE_ALARM, chi2_isf, chi2_sf, f_sf
from bayesbl.recording.types import ComplexArray, FloatArray

BANDS = (0, 8, 32, 128, 512)
"""Highest load order of each band. Slow misfit stands out of a few orders, fast misfit out of many.

0 is the mean alone, which is in no other band: motor friction and offsets appear there.
"""


CHANCE_EDGES = np.geomspace(1.0, 1e-8, 400)
CHANCES = 0.5 * (CHANCE_EDGES[1:] + CHANCE_EDGES[:-1])
CHANCE_WEIGHTS = CHANCE_EDGES[:-1] - CHANCE_EDGES[1:]
"""Probabilities at which an average over a distribution is evaluated, dense in the decisive
tail."""


@dataclass(frozen=True, slots=True)
class RepeatingPower:
    """Repeating power in one channel of one recording, in one band of load orders.

    Attributes
    ----------
    ratio
        Repeating power over that of noise alone; about 1 if the bench explains the recording.
    probability
        Probability of at least this ratio from noise alone.
    """

    recording: str
    channel: str
    highest_order: int
    ratio: float
    probability: float


def disagreements(fit: SimulatedFit) -> list[RepeatingPower]:
    """Repeating power of each recording, channel and band."""
    model = fit.model
    parts = model.by_recording(fit.residual)
    by_recording = [
        [
            RepeatingPower(observation.name, channel, *entry)
            for channel, row in zip(
                observation.channels, part[:, observation.first_compared :], strict=True
            )
            for entry in _by_band(row, observation, scatters=not noise.repeats)
        ]
        for observation, noise, part in zip(model.recordings, model.noise, parts, strict=True)
    ]
    count = sum(map(len, by_recording))
    for recording, entries in enumerate(by_recording):
        # Entries that no false-alarm rate makes significant need no closer look.
        if any(entry.probability * count < 1.0 for entry in entries):
            by_recording[recording] = _against_special_noise(fit, recording, entries)
    return [entry for entries in by_recording for entry in entries]


def _against_special_noise(
    fit: SimulatedFit, recording: int, entries: list[RepeatingPower]
) -> list[RepeatingPower]:
    """The same entries, compared with noise in the loop or with rounding in each band.

    The power of such noise is at the impacts, and where the loop does not suppress it. So a band
    has few effective degrees of freedom, and chance exceeds a ratio more often. Rounding that may
    be the same in all rotations is compared with its own simulation. Whether the loop feeds it back
    is unknown, so what either case explains is no disagreement.
    """
    observation, noise = fit.model.recordings[recording], fit.model.noise[recording]
    rows = fit.model.by_recording(fit.residual)[recording][:, observation.first_compared :]
    if not observation.repeats:
        return entries
    turns = np.stack([whole_rotations(row, observation.lag) for row in rows], axis=1)
    rotations = len(turns)
    if rotations < 2:
        return entries

    def in_band(entry: RepeatingPower, rows: FloatArray) -> FloatArray:
        channel = observation.channels.index(entry.channel)
        channel_rows = rows.reshape(len(rows), len(observation.channels), -1)[:, channel]
        return _band(_spectrum(channel_rows), entry.highest_order)

    if not noise.repeats:
        loop = loop_noise(fit, recording)
        if loop is None:
            return entries
        chances = [loop.chance(e.ratio, partial(in_band, e), rotations) for e in entries]
        return [replace(e, probability=p) for e, p in zip(entries, chances, strict=True)]
    rounded = rounded_rotations(fit, recording)
    if not rounded:
        return entries
    closer = []
    for entry in entries:
        cases = [
            _against_rounding(in_band(entry, turns), in_band(entry, rounding))
            for rounding in rounded
        ]
        ratio, chance = max(cases, key=lambda case: case[1])
        closer.append(replace(entry, ratio=ratio, probability=chance))
    return closer


def _against_rounding(band: FloatArray, rounded: FloatArray) -> tuple[float, float]:
    """(ratio, probability) of the repeating power, against the rest and rounding that may repeat.

    ``band``: of the rotations, (r, d); ``rounded``: of rotations of rounding alone, (R, d).
    """
    rotations, degrees = band.shape
    repeats, scatter = _powers(band)
    # Equally likely values of the non-repeating variance, given the scatter of few rotations.
    variances = scatter / chi2_isf(1.0 - CHANCES, degrees * (rotations - 1))
    steady = rotations * float(np.mean(np.sum(rounded**2, axis=1)))
    expected = degrees * variances + steady
    squares = degrees * variances**2 + 2.0 * variances * steady
    squares += steady**2 / degrees_of_freedom(rounded)
    free = expected**2 / squares
    tails = chi2_sf(repeats * free / expected, free)
    ratio = repeats / (scatter / (rotations - 1) + steady)
    return ratio, float(np.sum(CHANCE_WEIGHTS * tails))


def _powers(band: FloatArray) -> tuple[float, float]:
    """Power of the mean of rotations (r, d), and of the scatter about it."""
    mean = band.mean(axis=0)
    return len(band) * float(np.sum(mean**2)), float(np.sum((band - mean) ** 2))


def _by_band(
    row: FloatArray, observation: Observed, *, scatters: bool
) -> Iterator[tuple[int, float, float]]:
    """Yield (highest order, ratio, probability) for each band.

    The repeating power, or slow power if nothing repeats, or less than two cycles are compared: a
    motion of two cycles is compared without its start. ``scatters``: compare it with the power of
    noise in the same row, instead of with 1.
    """
    powers = _slow(row, observation.lag)
    if observation.repeats:
        turns = whole_rotations(row, observation.lag)
        powers = _slow(row, row.size // 4) if scatters and len(turns) < 2 else _repeating(turns)
    for highest, power, degrees, noise_power, noise_degrees in powers:
        ratio, probability = power / degrees, float(chi2_sf(power, degrees))
        if scatters:
            ratio /= noise_power / noise_degrees
            probability = f_sf(ratio, degrees, noise_degrees)
        yield highest, ratio, probability


def standing_out(entries: Sequence[RepeatingPower]) -> list[RepeatingPower]:
    """Significant entries, at a family-wise false-alarm rate (Bonferroni)."""
    # An undefined probability counts as significant.
    return [entry for entry in entries if not entry.probability * len(entries) > FALSE_ALARM]


def agrees(entries: Sequence[RepeatingPower]) -> bool:
    """Whether noise explains all entries."""
    return not standing_out(entries)


def is_explained(fit: SimulatedFit) -> bool:
    """Whether noise explains everything that repeats."""
    return agrees(disagreements(fit))


def _spectrum(turns: FloatArray) -> ComplexArray:
    """Spectrum of rotations (r, lag) by order: whitened noise has the power 2, and 1 at order 0."""
    return np.asarray(np.fft.rfft(turns, axis=1) / np.sqrt(turns.shape[1] / 2.0))


def _band(spectrum: ComplexArray, highest: int) -> FloatArray:
    """Values of a band, (r, degrees of freedom): standard normal for whitened noise."""
    if highest == 0:
        return np.asarray(spectrum[:, :1].real / np.sqrt(2.0))
    band = spectrum[:, 1 : 1 + min(highest, spectrum.shape[1] - 2)]
    return np.concatenate([band.real, band.imag], axis=1)


def _repeating(turns: FloatArray) -> Iterator[tuple[int, float, int, float, int]]:
    """Power of the mean of rotations (r, lag), and of the scatter about it, each with its degrees
    of freedom, by band: (highest order, power, degrees, noise power, noise degrees)."""
    spectrum = _spectrum(turns)
    for highest in BANDS:
        band = _band(spectrum, highest)
        degrees = band.shape[1]
        repeats, scatter = _powers(band)
        yield highest, repeats, degrees, scatter, degrees * (len(turns) - 1)


def _slow(row: FloatArray, quarter: int) -> Iterator[tuple[int, float, int, float, int]]:
    """The same for a motion that does not repeat: its slow power, and that of the fastest half.

    The bands are in cycles per quarter of the recording; whitened noise has the same power in all.
    """
    spectrum = np.abs(np.fft.rfft(row)) ** 2 / row.size
    fast = spectrum[spectrum.size // 2 : -1]
    for highest in BANDS:
        end = 1 + highest * row.size // quarter
        if end > spectrum.size // 2:
            continue
        band = spectrum[:1] if highest == 0 else spectrum[1:end]
        degrees = 1 if highest == 0 else 2 * band.size
        power = degrees * float(band.mean())
        yield highest, power, degrees, 2.0 * float(fast.sum()), 2 * fast.size
