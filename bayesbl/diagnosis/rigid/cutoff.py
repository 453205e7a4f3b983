"""The cut-off of a comparison from the recordings: as far as they resolve the motion and cohere."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesbl.diagnosis.rigid.inverse import InverseView
from bayesbl.diagnosis.rigid.motion import END_PERIODS
from bayesbl.diagnosis.rigid.view import noise_of
from bayesbl.recording.types import FloatArray

LARGEST_SHARE = 0.01
"""Of noise in the power of the acceleration: so much too small an inertia comes out."""

BANDS_PER_OCTAVE = 3
FEWEST_LINES = 10
"""Of a spectrum in a band."""


def resolved_hz(positions: Sequence[FloatArray], period_s: float) -> float:
    """The frequency up to which noise of the position has no more than a share in the acceleration.

    Noise of the acceleration lowers the inertia by its share in the acceleration's power (errors in
    variables): Σ f⁴ σ² over the frequencies below, over Σ f⁴ |θ|².
    """
    frequencies, powers, noises = [], [], []
    for position in positions:
        trend = np.linspace(position[0], position[-1], position.size)
        taper = np.hanning(position.size)
        frequency = np.fft.rfftfreq(position.size, period_s)
        frequencies.append(frequency)
        powers.append(frequency**4 * np.abs(np.fft.rfft(taper * (position - trend))) ** 2)
        noises.append(frequency**4 * noise_of(position) ** 2 * float(taper @ taper))
    frequency = np.concatenate(frequencies)
    order = np.argsort(frequency, kind="stable")
    power, noise = (np.cumsum(np.concatenate(parts)[order]) for parts in (powers, noises))
    within = np.flatnonzero(noise <= LARGEST_SHARE * power)
    # Below four times what the filter carries from the ends nothing would be left to compare.
    lasting = period_s * max(position.size for position in positions)
    least = 4.0 * END_PERIODS / lasting
    return max(least, float(frequency[order][within[-1]]) if within.size else 0.0)


def coherent_hz(resolved: InverseView) -> float | None:
    """The end of the highest third of an octave that the prediction explains more than half of.

    With T the spectrum of the measurement and R that of what all that is linear, and the motor
    orders that stand out, leave of it: Σ|R|² < ½ Σ|T|². ``None`` if no band has that.

    Parameters
    ----------
    resolved
        The view behind the highest cut-off that resolves the motion.
    """
    view = resolved.coarse()
    predicted = view.fitted()
    frequencies, measured, left = [], [], []
    for i in view.used:
        piece = view.pieces[i]
        if piece.shown:
            rest = piece.measured - predicted[i]
            frequencies.append(np.fft.rfftfreq(rest.size, piece.period_s))
            measured.append(_power(piece.measured))
            left.append(_power(rest))
    frequency, total = np.concatenate(frequencies), np.concatenate(measured)
    rest = np.concatenate(left)
    top = view.windows[0].low_pass.cutoff_hz
    ratio = 2.0 ** (1.0 / BANDS_PER_OCTAVE)
    while np.count_nonzero(band := (frequency > top / ratio) & (frequency <= top)) >= FEWEST_LINES:
        if 2.0 * rest[band].sum() < total[band].sum():
            return top
        top /= ratio
    return None


def _power(values: FloatArray) -> FloatArray:
    tapered = np.hanning(values.size) * (values - values.mean())
    return np.asarray(np.abs(np.fft.rfft(tapered)) ** 2)
