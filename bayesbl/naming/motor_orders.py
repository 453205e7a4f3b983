"""Motor orders that stand out of what a fit leaves: cycles per motor revolution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.probabilities import chi2_isf
from bayesbl.recording.types import FloatArray

LOWEST_ORDER = 0.45
PADDING = 4
SIDEBANDS = 2.5
"""Load orders to either side of a whole motor order that belong to it: load torque modulates it."""


@dataclass(frozen=True, slots=True)
class OrderPeak:
    """A line in the spectrum of whitened residuals over motor revolutions.

    Attributes
    ----------
    order
        Cycles per motor revolution.
    power
        Summed over recordings and channels, in units of the noise's mean power.
    """

    order: float
    power: float


def order_peaks(fit: SimulatedFit, count: int = 3, false_alarm: float = 1e-3) -> list[OrderPeak]:
    """The strongest motor orders above the noise, at a stated false-alarm rate for all together."""
    spectra = [_spectrum(fit, i) for i in range(len(fit.model.recordings))]
    highest = max(order[-1] for order, _, _ in spectra)
    step = min(order[1] - order[0] for order, _, _ in spectra)
    grid = np.arange(LOWEST_ORDER, highest, step)
    power, degrees = np.zeros(grid.size), np.zeros(grid.size)
    for order, values, channels in spectra:
        within = grid <= order[-1]
        power[within] += np.interp(grid[within], order, values)
        degrees[within] += 2.0 * channels

    # Under noise alone twice the summed power is χ² with two degrees per recording and channel.
    limit = 0.5 * chi2_isf(false_alarm / grid.size, np.maximum(degrees, 1.0))
    found: list[OrderPeak] = []
    excess = np.where(power > limit, power, 0.0)
    while len(found) < count and excess.max() > 0.0:
        k = int(np.argmax(excess))
        peak, nearest = float(grid[k]), round(float(grid[k]))
        if nearest and abs(peak - nearest) < SIDEBANDS / fit.model.bench.value("gear_ratio"):
            peak = float(nearest)
        found.append(OrderPeak(peak, float(power[k])))
        excess[np.abs(grid - grid[k]) < 0.05] = 0.0
    return found


def _spectrum(fit: SimulatedFit, recording: int) -> tuple[FloatArray, FloatArray, int]:
    """Orders, power summed over channels (mean 1 per channel for white noise), channels."""
    model = fit.model
    seen = model.recordings[recording]
    rows = model.by_recording(fit.residual)[recording]
    n = rows.shape[1]
    window = np.hanning(n)
    window /= np.sqrt(np.sum(window**2))
    spectrum = np.abs(np.fft.rfft(rows * window, PADDING * n, axis=1)) ** 2
    frequency = np.fft.rfftfreq(PADDING * n, 1.0 / seen.sampling_hz)
    order = frequency / (abs(seen.reference_speed_rpm) / 60.0)
    return np.asarray(order), np.asarray(spectrum.sum(axis=0)), len(seen.signals)
