"""The residual of one channel, split into what repeats, lines, drift and noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm

from bayesbl.diagnosis.residuals.lines import (
    FoundLine,
    Line,
    Scales,
    motor_orders_in_comb,
    strongest_line,
)
from bayesbl.diagnosis.residuals.spectrum import (
    NoiseFloor,
    WholeRotations,
    comb,
    noise_floor,
    repeating_part,
    without_repeating,
)
from bayesbl.recording.types import ComplexArray, FloatArray

BANDS = (8, 32, 128, 512)
"""Highest load order of each band that is tested as a whole: slow or fast, weak but everywhere."""
MAP_POINTS = 720
MOST_LINES = 40
OUTLIER_SD = 6.0


@dataclass(frozen=True, slots=True)
class Decomposition:
    """The residual of one channel of one recording, split into its parts.

    Attributes
    ----------
    offset, offset_error
        Mean of recording − simulation and its standard error, the channel's unit.
    repeating
        Transform of what repeats with the load angle, the offset included: real FFT over the whole
        rotations, zero but at whole load orders, shape (n // 2 + 1,). Lines and drift are removed,
        so that what they leak into the average over rotations is not counted twice.
    drift_per_s, drift_error_per_s
        Slope over the recording.
    lines
        What repeats with the motor angle and, the gear ratio being whole, with the load's too, and
        what is periodic and no whole load order.
    noise, floor
        The rest, shape (n,), and its spectrum.
    outliers
        Samples of the whitened noise beyond six of its standard deviations.
    """

    offset: float
    offset_error: float
    repeating: ComplexArray
    drift_per_s: float
    drift_error_per_s: float
    lines: tuple[Line, ...]
    noise: FloatArray
    floor: NoiseFloor
    outliers: int

    def ratio(self) -> FloatArray:
        """Periodogram over floor at every bin: whole load orders and, between them, the noise."""
        n = self.noise.size
        everything = self.repeating + np.fft.rfft(self.noise)
        return np.asarray(np.abs(everything) ** 2 / n / self.floor.at_bins(n))


def decompose(
    difference: FloatArray,
    whole: WholeRotations,
    scale: Scales,
    false_discovery_rate: float,
) -> Decomposition:
    """Motor orders, then drift and lines in what does not repeat, then the average over rotations.

    Lines are removed from the strongest down, for strong ones leak into their neighbours: the
    j-th counts if noise makes one of the m bins as strong with probability j·rate/m at most.

    Parameters
    ----------
    difference
        Recording − simulation, shape (n,).
    """
    n, rotations = difference.size, whole.rotations
    at_comb = comb(n, rotations)
    floor = noise_floor(difference - repeating_part(difference, rotations), at_comb)
    in_comb = motor_orders_in_comb(difference, floor, whole, scale, false_discovery_rate)
    values, of_motor = difference, np.zeros(0)
    if in_comb:
        waves = np.hstack([line.waves(scale) for line in in_comb])
        of_motor = np.asarray(np.linalg.lstsq(waves, values - values.mean())[0], dtype=float)
        values = values - waves @ of_motor

    rest = values - repeating_part(values, rotations)
    ramp = (scale.time - scale.time.mean())[:, None]
    columns = [ramp]
    basis = _orthonormal(without_repeating(ramp, rotations), np.zeros((n, 0)))
    noise = rest - basis @ (basis.T @ rest)
    lines: list[FoundLine] = []
    lines_at = at_comb.copy()
    tests = 2 * int(np.count_nonzero(~at_comb[rotations:]))  # on both scales
    while True:
        floor = noise_floor(noise, lines_at)
        line = strongest_line(noise, floor, rotations, scale)
        allowed = false_discovery_rate * (len(lines) + 1) / tests
        if line is None or line.probability > allowed or len(lines) == MOST_LINES:
            break
        lines.append(line)
        columns.append(line.waves(scale))
        added = _orthonormal(without_repeating(columns[-1], rotations), basis)
        noise = noise - added @ (added.T @ noise)
        basis = np.hstack([basis, added])
        lines_at[max(0, round(line.cycles) - 1) : round(line.cycles) + 2] = True

    design = np.concatenate(columns, axis=1)
    reduced = without_repeating(design, rotations)
    coefficients = np.asarray(np.linalg.lstsq(reduced, rest)[0], dtype=float)
    repeating = np.fft.rfft(values - design @ coefficients)
    repeating[~at_comb] = 0.0
    slope_error = math.sqrt(floor.at_zero) / float(np.linalg.norm(reduced[:, 0]))
    return Decomposition(
        offset=float(repeating[0].real) / n,
        offset_error=math.sqrt(floor.at_zero / n),
        repeating=repeating,
        drift_per_s=float(coefficients[0]) * whole.sampling_hz,
        drift_error_per_s=slope_error * whole.sampling_hz,
        lines=tuple(
            line.line(whole, *pair)
            for line, pair in zip(
                (*in_comb, *lines),
                np.concatenate([of_motor, coefficients[1:]]).reshape(-1, 2).tolist(),
                strict=True,
            )
        ),
        noise=noise,
        floor=floor,
        outliers=_outliers(floor.whiten(noise)),
    )


def _orthonormal(columns: FloatArray, basis: FloatArray) -> FloatArray:
    """Columns freed of one another and of an orthonormal basis, each of length one, (n, k)."""
    for _ in range(2):
        columns = columns - basis @ (basis.T @ columns)
    return np.linalg.qr(columns)[0]


def _outliers(white: FloatArray) -> int:
    spread = float(np.median(np.abs(white))) / float(norm.ppf(0.75))
    return int(np.count_nonzero(np.abs(white) > OUTLIER_SD * spread))


def order_probabilities(parts: Decomposition, rotations: int) -> FloatArray:
    """Chance of as much from noise alone at the load orders 0 (the offset), 1, 2, …"""
    probability = np.exp(-parts.ratio()[::rotations])
    probability[0] = 2.0 * norm.sf(abs(parts.offset) / parts.offset_error)
    if parts.noise.size % (2 * rotations) == 0:
        probability[-1] = 1.0  # at half the sampling rate a bin has one degree of freedom only
    return np.asarray(probability)


def band_probability(parts: Decomposition, rotations: int) -> tuple[float, int]:
    """(probability that noise alone repeats as much in any band, that band's highest order).

    Bonferroni over the bands. The constant is left out.
    """
    ratio = parts.ratio()[rotations::rotations]
    found = []
    for highest in BANDS:
        band = ratio[: min(highest, ratio.size - 1)]
        found.append((float(chi2.sf(2.0 * band.sum(), 2 * band.size)), highest))
    probability, highest = min(found)
    return min(1.0, len(BANDS) * probability), highest


def against_load_angle(harmonics: ComplexArray, whole: WholeRotations) -> FloatArray:
    """Harmonics 0, 1, 2, … of the rotation, counted from the first sample, as a function of angle.

    Shape (720,), at load angles 2π j/720; orders of 360 and more are left out.
    """
    kept = harmonics[: MAP_POINTS // 2]
    if whole.reference_speed_rpm < 0.0:
        kept = np.conj(kept)
    padded = np.zeros(MAP_POINTS // 2 + 1, dtype=complex)
    padded[: kept.size] = kept * np.exp(-1j * np.arange(kept.size) * whole.start_angle_rad)
    return np.asarray(MAP_POINTS * np.fft.irfft(padded, MAP_POINTS))


def mean_over_rotations(values: FloatArray, whole: WholeRotations) -> FloatArray:
    """Average of a signal at equal load angle, shape (720,)."""
    harmonics = np.fft.rfft(values)[:: whole.rotations] / values.size
    return against_load_angle(harmonics, whole)


def map_error(parts: Decomposition, whole: WholeRotations) -> float:
    """Standard error of such an average."""
    share = parts.floor.at_bins(whole.samples)[:: whole.rotations] / whole.samples
    return math.sqrt(float(share[0] + 2.0 * share[1 : MAP_POINTS // 2].sum()))
