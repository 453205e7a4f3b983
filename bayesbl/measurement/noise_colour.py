"""A filter that changed between two recordings of the speed, by the colour of their noise.

A recorder that smooths the speed lowers the ringing, and with it what is taken for the gap. It also
lowers the noise, the more the higher the frequency: what does not repeat from rotation to rotation
tells the filter, well above the ringing, where it acts most. The ratio of two such spectra is
fitted by that of two first-order filters,

    ln S₂/S₁ = c ± ln(1 + u (f/f_r)²),    Δ ln A = ± ½ ln(1 + u),

f_r the ringing's frequency, c the level, u the strength. Among common filters the first-order one
lowers the ringing most for a given loss at higher frequencies, so this errs on the safe side. Noise
from another source may look like a filter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import polygamma

from bayesbl.measurement.joint_features import folded_signal
from bayesbl.recording.types import FloatArray
from bayesbl.ringing.estimator import PointEstimate
from bayesbl.ringing.symbols import FREQUENCY, ROTATION

LOWEST_OVER_RINGING = 2.0
"""Below this frequency, what differs between impacts stands out."""

HIGHEST_OVER_SAMPLING = 0.4
"""Beyond, little is left of what lies between two samples."""

LEAST_SCATTER = 1e-6
"""Of the mean speed: less is no noise, but what the fitted rotation is off by."""

BANDS = 24
STRENGTHS = np.geomspace(1e-4, 30.0, 200)
"""Steps of 3 % in a filter's corner; the strongest ones are not told apart."""


@dataclass(frozen=True, slots=True)
class NoiseSpectrum:
    """What does not repeat of a recorded speed.

    Attributes
    ----------
    frequency_hz, log_power
        Shape (k,); the power in an arbitrary unit, mean over ``degrees`` + 1 rotations.
    degrees
        Independent rotations behind each value.
    highest_hz
        Up to which the recording tells it.
    """

    frequency_hz: FloatArray
    log_power: FloatArray
    degrees: int
    ringing_hz: float
    highest_hz: float


@dataclass(frozen=True, slots=True)
class FilterChange:
    """How far a changed filter would have moved ln A from a first recording to another.

    Attributes
    ----------
    low, high
        Where χ² is higher than at the best by the square of the deviations asked for.
    deviations
        Of the best from no change, in standard deviations, with the sign of ``log_amplitude``.
    """

    log_amplitude: float
    low: float
    high: float
    deviations: float


def noise_spectrum(point: PointEstimate) -> NoiseSpectrum | None:
    """Of the recording that a fit was made of; ``None`` where it has no noise of its own to show.

    That is where samples were mended, where its rounding is alike in all rotations, and where less
    than two whole rotations were recorded.
    """
    recording, symbols = point.recording, point.optimum.symbols
    rotation_s, period_s = symbols[ROTATION], recording.sampling_period_s
    folded = folded_signal(recording.motor_speed_rpm, rotation_s / period_s)
    scatter = folded - folded.mean(axis=0)
    degrees, count = len(folded) - 1, folded.shape[1]
    least = LEAST_SCATTER * abs(float(folded.mean()))
    if point.mended or point.noise.rounding_repeats or not scatter.std() > least:
        return None
    spectrum = np.fft.rfft(scatter, axis=1)[:, 1:]
    power = np.sum(np.abs(spectrum) ** 2, axis=0) / (degrees * count)
    # A value read between two samples, a share a of the way, is the mean of both: it keeps
    # 1 − 2a(1 − a)(1 − cos ωT) of the power.
    share = np.arange(folded.size) * (rotation_s / period_s / count) % 1.0
    turn = 2.0 * math.pi * np.arange(1, power.size + 1) / count
    power /= 1.0 - 2.0 * np.mean(share * (1.0 - share)) * (1.0 - np.cos(turn))
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
    """The filter that would explain how the noise's colour changed; ``None`` where too few bands.

    Parameters
    ----------
    deviations
        How many standard deviations the range of the answer spans on either side.
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
    place = np.sqrt(edges[1:] * edges[:-1])[usable] / first.ringing_hz
    strengths = np.concatenate([-STRENGTHS[::-1], [0.0], STRENGTHS])
    shapes = np.sign(strengths)[:, None] * np.log1p(np.abs(strengths)[:, None] * place**2)
    residual = ratio - shapes
    residual -= (residual @ weight / weight.sum())[:, None]
    chi2 = residual**2 @ weight
    best = int(np.argmin(chi2))
    # Another shape than the family's is no more certain than it fits.
    chi2 /= max(1.0, chi2[best] / (place.size - 2))
    shifts = 0.5 * np.sign(strengths) * np.log1p(np.abs(strengths))
    within = shifts[chi2 <= chi2[best] + deviations**2]
    return FilterChange(
        float(shifts[best]),
        float(within.min()),
        float(within.max()),
        float(np.sign(shifts[best]) * math.sqrt(chi2[STRENGTHS.size] - chi2[best])),
    )


def _in_bands(spectrum: NoiseSpectrum, edges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean of ln power in each band and its variance; NaN where a band holds nothing."""
    band = np.digitize(spectrum.frequency_hz, edges) - 1
    inside = (band >= 0) & (band < edges.size - 1)
    count = np.bincount(band[inside], minlength=edges.size - 1)
    total = np.bincount(band[inside], spectrum.log_power[inside], minlength=edges.size - 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return total / count, float(polygamma(1, spectrum.degrees)) / count
