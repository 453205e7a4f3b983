"""Detect a changed filter of the recorded speed from the colour of the noise.

A recorder that smooths the speed lowers the ringing, and with it the apparent gap. It also lowers
the noise, more so at higher frequencies. The part that does not repeat from rotation to rotation
therefore shows the filter, best well above the ringing frequency. The ratio of two such spectra is
fitted by the ratio of two first-order filters,

    ln S₂/S₁ = c ± ln(1 + u (f/f_r)²),    Δ ln A = ± ½ ln(1 + u),

with ringing frequency f_r, level c and strength u. Among common filters, the first-order one lowers
the ringing most for a given loss at higher frequencies, so this errs on the safe side. Noise from
another source may look like a filter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import polygamma

from bayesbl.recording.repetition import folded
from bayesbl.recording.types import FloatArray
from bayesbl.ringing.estimator import PointEstimate
from bayesbl.ringing.symbols import FREQUENCY, ROTATION

LOWEST_OVER_RINGING = 2.0
"""Lowest frequency used: below it, differences between impacts dominate."""

HIGHEST_OVER_SAMPLING = 0.4
"""Highest frequency used: above it, interpolation between samples leaves little power."""

LEAST_SCATTER = 1e-6
"""Share of the mean speed: less scatter is no noise, but the error of the fitted rotation."""

BANDS = 24
STRENGTHS = np.geomspace(1e-4, 30.0, 200)
"""Steps of 3 % in a filter's corner; the strongest filters cannot be distinguished."""


@dataclass(frozen=True, slots=True)
class NoiseSpectrum:
    """Spectrum of the part of a recorded speed that does not repeat.

    ``frequency_hz``, ``log_power``: shape (k,); power in an arbitrary unit, mean over ``degrees`` +
    1 rotations. ``degrees``: degrees of freedom (independent rotations) of each value.
    ``highest_hz``: highest usable frequency.
    """

    frequency_hz: FloatArray
    log_power: FloatArray
    degrees: int
    ringing_hz: float
    highest_hz: float


@dataclass(frozen=True, slots=True)
class FilterChange:
    """Change of ln A between two recordings by a changed filter.

    ``low``, ``high``: range in which χ² exceeds its minimum by at most the square of the requested
    deviations. ``deviations``: distance of the best value from no change, in standard deviations,
    with the sign of ``log_amplitude``.
    """

    log_amplitude: float
    low: float
    high: float
    deviations: float


def noise_spectrum(point: PointEstimate) -> NoiseSpectrum | None:
    """Noise spectrum of a fit's recording; ``None`` if the recording shows no usable noise.

    That is so if samples were repaired, if all rotations are rounded alike, or if there are fewer
    than two whole rotations.
    """
    recording, symbols = point.recording, point.optimum.symbols
    rotation_s, period_s = symbols[ROTATION], recording.sampling_period_s
    rotations = folded(recording.motor_speed_rpm, rotation_s / period_s)
    scatter = rotations - rotations.mean(axis=0)
    degrees, count = len(rotations) - 1, rotations.shape[1]
    smallest_scatter = LEAST_SCATTER * abs(float(rotations.mean()))
    if point.mended or point.noise.rounding_repeats or not scatter.std() > smallest_scatter:
        return None
    spectrum = np.fft.rfft(scatter, axis=1)[:, 1:]
    power = np.sum(np.abs(spectrum) ** 2, axis=0) / (degrees * count)
    # Linear interpolation at a fraction a between two samples keeps
    # 1 − 2a(1 − a)(1 − cos ωT) of the power.
    share = np.arange(rotations.size) * (rotation_s / period_s / count) % 1.0
    angle = 2.0 * math.pi * np.arange(1, power.size + 1) / count
    power /= 1.0 - 2.0 * np.mean(share * (1.0 - share)) * (1.0 - np.cos(angle))
    return NoiseSpectrum(
        np.arange(1, power.size + 1) / rotation_s,
        np.log(power),
        degrees,
        symbols[FREQUENCY] / (2.0 * math.pi),
        HIGHEST_OVER_SAMPLING / period_s,
    )


def filter_change(
    first: NoiseSpectrum, other: NoiseSpectrum, deviations: float
) -> FilterChange | None:
    """Fit the filter that would explain the changed noise; ``None`` with too few bands.

    ``deviations``: half width of the returned range, in standard deviations.
    """
    lowest = LOWEST_OVER_RINGING * max(first.ringing_hz, other.ringing_hz)
    highest = min(first.highest_hz, other.highest_hz)
    if highest <= lowest:
        return None
    edges = np.geomspace(lowest, highest, BANDS + 1)
    (before, before_variance), (after, after_variance) = (
        _in_bands(spectrum, edges) for spectrum in (first, other)
    )
    usable = np.isfinite(before) & np.isfinite(after)
    if np.count_nonzero(usable) < 3:
        return None
    ratio = (after - before)[usable]
    weight = 1.0 / (before_variance + after_variance)[usable]
    relative_frequency = np.sqrt(edges[1:] * edges[:-1])[usable] / first.ringing_hz
    strengths = np.concatenate([-STRENGTHS[::-1], [0.0], STRENGTHS])
    shapes = np.sign(strengths)[:, None] * np.log1p(
        np.abs(strengths)[:, None] * relative_frequency**2
    )
    residual = ratio - shapes
    residual -= (residual @ weight / weight.sum())[:, None]
    chi2 = residual**2 @ weight
    best = int(np.argmin(chi2))
    # If the filter family does not fit, scale the uncertainty by the misfit.
    chi2 /= max(1.0, chi2[best] / (relative_frequency.size - 2))
    shifts = 0.5 * np.sign(strengths) * np.log1p(np.abs(strengths))
    within = shifts[chi2 <= chi2[best] + deviations**2]
    return FilterChange(
        float(shifts[best]),
        float(within.min()),
        float(within.max()),
        float(np.sign(shifts[best]) * math.sqrt(chi2[STRENGTHS.size] - chi2[best])),
    )


def _in_bands(spectrum: NoiseSpectrum, edges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean of ln power in each band and its variance; NaN where a band is empty."""
    band = np.digitize(spectrum.frequency_hz, edges) - 1
    inside = (band >= 0) & (band < edges.size - 1)
    count = np.bincount(band[inside], minlength=edges.size - 1)
    total = np.bincount(band[inside], spectrum.log_power[inside], minlength=edges.size - 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return total / count, float(polygamma(1, spectrum.degrees)) / count
