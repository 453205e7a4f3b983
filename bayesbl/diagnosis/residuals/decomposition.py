"""The residual of one channel, split into what repeats, lines, drift and noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm

from bayesbl.diagnosis.residuals.line_search import (
    FoundLine,
    Scales,
    motor_orders_in_comb,
    orthonormal,
    strongest_line,
    without_repeating,
)
from bayesbl.diagnosis.residuals.skew import Skew, time_skew
from bayesbl.diagnosis.residuals.spectrum import NoiseFloor, comb, noise_floor, repeating_part
from bayesbl.recording.types import ComplexArray, FloatArray

BANDS = (8, 32, 128, 512)
"""Highest load order of each band that is tested as a whole: slow or fast, weak but everywhere."""
MAP_POINTS = 720
MOST_LINES = 40
OUTLIER_SD = 6.0


@dataclass(frozen=True, slots=True)
class WholeRotations:
    """The part of a recording that is looked at: whole load rotations, to the nearest sample.

    ``rotations`` of the load in ``samples``; ``gear_ratio`` motor turns in each;
    ``start_angle_rad`` the load angle at the first sample.
    """

    rotations: int
    samples: int
    sampling_hz: float
    reference_speed_rpm: float
    gear_ratio: float
    start_angle_rad: float

    @property
    def seconds(self) -> float:
        """Length of the record."""
        return self.samples / self.sampling_hz

    @property
    def rotation_hz(self) -> float:
        """Rotations of the load per second."""
        return self.rotations / self.seconds

    @property
    def motor_hz(self) -> float:
        """Turns of the motor per second."""
        return self.rotation_hz * self.gear_ratio

    @property
    def frequency_hz(self) -> FloatArray:
        """Of every bin, shape (n // 2 + 1,)."""
        return np.asarray(np.arange(self.samples // 2 + 1) / self.seconds)


@dataclass(frozen=True, slots=True)
class Wave:
    """A line with its amplitude and phase, those of a cosine at the first sample."""

    found: FoundLine
    amplitude: float
    phase_rad: float


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
    motor_waves
        What repeats with the motor angle and, the gear ratio being whole, with the load's too.
    free_waves
        What is periodic and no whole load order.
    noise, floor
        The rest, shape (n,), and its spectrum.
    outliers
        Samples of the whitened noise beyond six of its standard deviations.
    skew
        Fixed time by which the recording lags the simulation.
    """

    offset: float
    offset_error: float
    repeating: ComplexArray
    drift_per_s: float
    drift_error_per_s: float
    motor_waves: tuple[Wave, ...]
    free_waves: tuple[Wave, ...]
    noise: FloatArray
    floor: NoiseFloor
    outliers: int
    skew: Skew

    def ratio(self) -> FloatArray:
        """Periodogram over floor at every bin: whole load orders and, between them, the noise."""
        n = self.noise.size
        everything = self.repeating + np.fft.rfft(self.noise)
        return np.asarray(np.abs(everything) ** 2 / n / self.floor.at_bins(n))


def decompose(
    recorded: FloatArray,
    simulated: FloatArray,
    whole: WholeRotations,
    scale: Scales,
    false_discovery_rate: float,
) -> Decomposition:
    """Motor orders, then drift and lines in what does not repeat, then the average over rotations.

    Lines are removed from the strongest down, for strong ones leak into their neighbours: the
    j-th counts if noise makes one of the m bins as strong with probability j·rate/m at most.

    Parameters
    ----------
    recorded, simulated
        Shape (n,).
    """
    difference = recorded - simulated
    n, rotations = difference.size, whole.rotations
    at_comb = comb(n, rotations)
    floor = noise_floor(difference - repeating_part(difference, rotations), at_comb)
    in_comb = motor_orders_in_comb(
        difference, floor, rotations, whole.gear_ratio, scale, false_discovery_rate
    )
    values, motor_waves = _taken_off(difference, in_comb, scale)

    rest = values - repeating_part(values, rotations)
    ramp = (scale.time - scale.time.mean())[:, None]
    columns = [ramp]
    basis = orthonormal(without_repeating(ramp, rotations), [])
    noise = _less(rest, basis)
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
        added = orthonormal(without_repeating(columns[-1], rotations), basis)
        noise = _less(noise, added)
        basis += added
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
        motor_waves=motor_waves,
        free_waves=_waves(lines, coefficients[1:]),
        noise=noise,
        floor=floor,
        outliers=_outliers(floor.whiten(noise)),
        skew=time_skew(recorded, simulated, whole.sampling_hz, floor),
    )


def _less(values: FloatArray, basis: list[FloatArray]) -> FloatArray:
    for direction in basis:
        values = values - (direction @ values) * direction
    return values


def _taken_off(
    values: FloatArray, lines: list[FoundLine], scale: Scales
) -> tuple[FloatArray, tuple[Wave, ...]]:
    if not lines:
        return values, ()
    design = np.concatenate([line.waves(scale) for line in lines], axis=1)
    coefficients = np.asarray(np.linalg.lstsq(design, values - values.mean())[0], dtype=float)
    return values - design @ coefficients, _waves(lines, coefficients)


def _waves(lines: list[FoundLine], coefficients: FloatArray) -> tuple[Wave, ...]:
    """Amplitude and phase from the coefficients of cosine and sine of each line in turn."""
    return tuple(
        Wave(line, math.hypot(cosine, sine), math.atan2(-sine, cosine))
        for line, (cosine, sine) in zip(lines, coefficients.reshape(-1, 2), strict=True)
    )


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
