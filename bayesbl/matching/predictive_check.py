"""Do simulation and recording agree within noise? The posterior predictive check of a direct fit.

What repeats from rotation to rotation after the fit is not noise. The whitened residuals are
averaged over the rotations and their power compared, in bands of load orders, with the power that
does not repeat.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.loop_noise import ComplexArray, LoopNoise, loop_noise
from bayesbl.matching.observed import ROUNDING, Observed, begin_of
from bayesbl.probabilities import chi2_sf, f_sf
from bayesbl.recording.types import FloatArray

BANDS = (0, 8, 32, 128, 512)
"""Highest load order of each band; slow misfit stands out of few orders, fast out of many.

0 is the mean alone, which is in no other band: motor friction and offsets show there."""


@dataclass(frozen=True, slots=True)
class RepeatingPower:
    """What repeats in one channel of one recording, in one band of load orders.

    Attributes
    ----------
    ratio
        Power that repeats over the power that noise alone would leave there; about 1 if the bench
        explains the recording.
    probability
        Of a ratio as large from noise alone.
    """

    recording: str
    channel: str
    highest_order: int
    ratio: float
    probability: float


def disagreements(fit: SimulatedFit) -> list[RepeatingPower]:
    """One entry for each recording, channel and band."""
    found = []
    parts = fit.model.by_recording(fit.residual)
    for seen, noise, part in zip(fit.model.recordings, fit.model.noise, parts, strict=True):
        for channel, row in zip(seen.channels, part, strict=True):
            entries = _by_band(row[begin_of(seen) :], seen, scatters=not noise.repeats)
            found += [RepeatingPower(seen.name, channel, *entry) for entry in entries]
    # What no rate of false alarms takes for more than noise needs no closer look.
    unlikely = {entry.recording for entry in found if entry.probability * len(found) < 1.0}
    for place, (seen, part) in enumerate(zip(fit.model.recordings, parts, strict=True)):
        rotations = _rotations_compared(part[0, begin_of(seen) :], seen)
        loop = loop_noise(fit, place) if seen.name in unlikely and rotations > 1 else None
        if loop is not None:
            found = [
                _with_noise_in_loop(entry, seen, loop, rotations)
                if entry.recording == seen.name
                else entry
                for entry in found
            ]
    return found


def _with_noise_in_loop(
    entry: RepeatingPower, seen: Observed, loop: LoopNoise, rotations: int
) -> RepeatingPower:
    """The same entry by the degrees of freedom of noise that goes round in the loop.

    Its power is at the impacts, and at the orders that the loop does not hold down: so few values
    stand for a band that what is left of them repeats by chance more often.
    """
    channel = seen.channels.index(entry.channel)

    def in_band(turns: FloatArray) -> FloatArray:
        own = turns.reshape(len(turns), len(seen.channels), -1)[:, channel]
        return _band(_spectrum(own), entry.highest_order)

    return replace(entry, probability=loop.chance(entry.ratio, in_band, rotations))


def _rotations_compared(row: FloatArray, seen: Observed) -> int:
    """Whole rotations, or cycles; 0 where nothing repeats."""
    if seen.motion is not None and seen.cycle is None:
        return 0
    return len(whole_rotations(row, seen.lag))


def _by_band(row: FloatArray, seen: Observed, *, scatters: bool) -> list[tuple[int, float, float]]:
    """Of what repeats; of what is slow where nothing does, or one cycle would have to scatter.

    Without its begin a motion of two cycles has less than two that are compared.
    """
    if seen.motion is not None and seen.cycle is None:
        return _slow(row, seen.lag, scatters=scatters)
    if scatters and len(whole_rotations(row, seen.lag)) < 2:
        return _slow(row, row.size // 4, scatters=scatters)
    return _repeating(row, seen.lag, scatters=scatters)


def agrees(found: list[RepeatingPower], false_alarm: float = 0.01) -> bool:
    """Whether no entry stands out, at a family-wise false-alarm rate (Bonferroni)."""
    return all(entry.probability * len(found) > false_alarm for entry in found)


def whole_rotations(row: FloatArray, lag: int) -> FloatArray:
    """Whitened residuals (n,) by rotation, (r, lag).

    Two that lack no more than their rounding are two: what they lack is taken for zero.
    """
    rotations = max(row.size // lag, min(2, math.floor(row.size / lag + ROUNDING)))
    padded = np.pad(row, (0, max(rotations * lag - row.size, 0)))
    return np.asarray(padded[: rotations * lag].reshape(rotations, lag))


def _spectrum(turns: FloatArray) -> ComplexArray:
    """Of rotations (r, lag) by order; whitened noise has a power of two, of one in the mean."""
    return np.asarray(np.fft.rfft(turns, axis=1) / np.sqrt(turns.shape[1] / 2.0))


def _band(spectrum: ComplexArray, highest: int) -> FloatArray:
    """Values of a band, (r, degrees of freedom): of whitened noise standard normal."""
    if highest == 0:
        return np.asarray(spectrum[:, :1].real / np.sqrt(2.0))
    band = spectrum[:, 1 : 1 + min(highest, spectrum.shape[1] - 2)]
    return np.concatenate([band.real, band.imag], axis=1)


def _repeating(row: FloatArray, lag: int, *, scatters: bool) -> list[tuple[int, float, float]]:
    """(highest order, ratio, probability) for each band.

    ``scatters``: what noise leaves is measured by its scatter between rotations, not taken for 1.
    """
    turns = whole_rotations(row, lag)
    rotations = len(turns)
    spectrum = _spectrum(turns)
    entries = []
    for highest in BANDS:
        band = _band(spectrum, highest)
        degrees = band.shape[1]
        mean = band.mean(axis=0)
        repeats = rotations * float(np.sum(mean**2))
        scatter = float(np.sum((band - mean) ** 2))
        if scatters:
            ratio = (repeats / degrees) / (scatter / (degrees * (rotations - 1)))
            probability = f_sf(ratio, degrees, degrees * (rotations - 1))
        else:
            ratio, probability = repeats / degrees, float(chi2_sf(repeats, degrees))
        entries.append((highest, ratio, probability))
    return entries


def _slow(row: FloatArray, quarter: int, *, scatters: bool) -> list[tuple[int, float, float]]:
    """The same of a motion that does not repeat: its slow power over that of the fastest half.

    The bands are in cycles per quarter of the recording; whitened noise has the same power in all.
    """
    spectrum = np.abs(np.fft.rfft(row)) ** 2 / row.size
    fast = spectrum[spectrum.size // 2 : -1]
    entries = []
    for highest in BANDS:
        last = 1 + highest * row.size // quarter
        if last > spectrum.size // 2:
            continue
        band = spectrum[:1] if highest == 0 else spectrum[1:last]
        degrees = 1 if highest == 0 else 2 * band.size
        if scatters:
            ratio = float(band.mean() / fast.mean())
            probability = f_sf(ratio, degrees, 2 * fast.size)
        else:
            ratio = float(band.mean())
            probability = float(chi2_sf(degrees * ratio, degrees))
        entries.append((highest, ratio, probability))
    return entries
