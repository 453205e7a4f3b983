"""The residual of one channel, split into what repeats, lines, drift and noise.

Periodograms are |X_k|²/n with X the real FFT of n samples, so white noise of variance σ² has the
floor σ² at every bin, and of noise alone the periodogram over its floor is standard exponential.

The motor does not turn evenly. Gravity and the speed loop swing its angle about that of even
rotation by up to half a radian, so what repeats with the motor angle has side bands in time, and
what repeats in time has them in angle: a line belongs to where it is sharp. A scale here is what
a line counts its cycles along, in samples: time itself, or the motor angle over its mean rate.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import median_filter
from scipy.optimize import minimize_scalar
from scipy.stats import chi2, norm

from bayesbl.noise.rotation_noise import bic, innovations, levinson, log_variances
from bayesbl.recording.types import ComplexArray, FloatArray

HIGHEST_ORDER = 30
MEDIAN_BINS = 201
CLIP = 8.0
"""Ordinates above this many floors are lines for all we know: they count as this many."""
FLOOR_ROUNDS = 3


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
class NoiseFloor:
    """Autoregressive spectrum of one channel's noise.

    Attributes
    ----------
    coefficients
        φ_1 … φ_p of n_t = Σ φ_k n_{t−k} + ε_t, shape (p,); empty for white noise.
    innovation_variance
        Of ε, the channel's unit squared.
    """

    coefficients: FloatArray
    innovation_variance: float

    def at_bins(self, n: int) -> FloatArray:
        """Expected periodogram of n samples, shape (n // 2 + 1,)."""
        transfer = np.fft.rfft(np.concatenate(([1.0], -self.coefficients)), n)
        return np.asarray(self.innovation_variance / np.abs(transfer) ** 2)

    @property
    def at_zero(self) -> float:
        """Expected periodogram at frequency zero: n times the variance of a mean over n samples."""
        return float(self.innovation_variance / (1.0 - self.coefficients.sum()) ** 2)

    @property
    def sd(self) -> float:
        """Standard deviation of the noise."""
        return float(np.sqrt(np.mean(self.at_bins(4096)[:-1])))

    def whiten(self, values: FloatArray) -> FloatArray:
        """Innovations in units of their scatter, shape (n,) to (n − p,)."""
        return innovations(values, self.coefficients) / math.sqrt(self.innovation_variance)


def noise_floor(values: FloatArray, lines_at: NDArray[np.bool_]) -> NoiseFloor:
    """Floor of noise among lines.

    The periodogram, clipped where lines stand out and filled in where ``lines_at`` says that they
    may, gives the autocovariance; Levinson's recursion the autoregression; BIC its order. Two
    or three rounds, the first from a running median.

    Parameters
    ----------
    values
        Shape (n,).
    lines_at
        Bins that hold no noise or more than noise, shape (n // 2 + 1,), bool.
    """
    n = values.size
    frequency = np.arange(n // 2 + 1) / n
    periodogram = np.abs(np.fft.rfft(values)) ** 2 / n
    used = periodogram[~lines_at]
    width = min(MEDIAN_BINS, used.size)
    median = median_filter(used, width, mode="reflect") / math.log(2.0)
    spectrum = np.interp(frequency, frequency[~lines_at], median)
    for _ in range(FLOOR_ROUNDS):
        quiet = np.where(lines_at, spectrum, np.minimum(periodogram, CLIP * spectrum))
        fits = levinson(np.fft.irfft(quiet, n), min(HIGHEST_ORDER, n // 4))
        variance, coefficients = fits[int(np.argmin(bic(log_variances(fits), n)))]
        floor = NoiseFloor(coefficients, variance)
        spectrum = floor.at_bins(n)
    return floor


def comb(n: int, rotations: int) -> NDArray[np.bool_]:
    """Bins of whole load orders, the constant included, shape (n // 2 + 1,), bool."""
    return np.asarray(np.arange(n // 2 + 1) % rotations == 0)


def repeating_part(values: FloatArray, rotations: int) -> FloatArray:
    """What repeats in each of the rotations that ``values`` holds, constant included, (n,)."""
    transform = np.fft.rfft(values)
    return np.asarray(
        np.fft.irfft(np.where(comb(values.size, rotations), transform, 0.0), len(values))
    )


def without_repeating(columns: FloatArray, rotations: int) -> FloatArray:
    """Columns less what repeats of each, same shape (n, k)."""
    parts = [column - repeating_part(column, rotations) for column in columns.T]
    return np.stack(parts, axis=1)


def benjamini_hochberg(probabilities: FloatArray, false_discovery_rate: float) -> float:
    """Largest probability that still counts as a discovery; 0 if none does.

    Benjamini & Hochberg 1995, J. R. Stat. Soc. B 57, 289. If nothing is there, the chance of any
    discovery is the rate.
    """
    ordered = np.sort(probabilities)
    allowed = false_discovery_rate * np.arange(1, ordered.size + 1) / ordered.size
    passed = np.flatnonzero(ordered <= allowed)
    return float(ordered[passed[-1]]) if passed.size else 0.0


Along = Literal["time", "motor angle"]
Dependence = Literal["load angle", "motor angle", "time", "angle or time"]

CLEARLY = 10.0
"""Difference of log likelihoods beyond which a line is sharp on one scale and not on the other."""
NEIGHBOURS = 4
STANDS_OUT = 4.0
"""Times its neighbours' power among the load orders: then a line is one by itself."""

SAME_BINS = 0.5
"""Two lines are one if they are apart by this much of both records' resolution."""
OTHER_SPEED = 0.02


@dataclass(frozen=True, slots=True)
class Line:
    """A significant line in the spectrum of a residual.

    Attributes
    ----------
    load_order, motor_order
        Cycles per turn of the load and of the motor.
    amplitude, phase_rad
        Of a cosine at the first sample, the channel's unit.
    probability
        Of as much from noise alone.
    dependence
        What it repeats with. Load angle: a whole load order. Motor angle: sharper in the motor
        angle than in time, a whole or half motor order, or the same order at different speeds.
        Time: sharper in time, or the same frequency at different speeds. Angle or time: these
        recordings cannot tell.
    stands_out
        It is no part of a comb of load orders.
    """

    frequency_hz: float
    load_order: float
    motor_order: float
    amplitude: float
    phase_rad: float
    probability: float
    dependence: Dependence
    stands_out: bool


@dataclass(frozen=True, slots=True)
class Scales:
    """Time and motor angle, each in samples, shape (n,)."""

    time: FloatArray
    motor: FloatArray

    def on_motor_angle(self, values: FloatArray) -> FloatArray:
        """Values at even steps of the motor angle, shape (n,)."""
        even = np.interp(self.time, self.motor, self.time)
        return np.asarray(CubicSpline(self.time, values)(even))


def scales(motor_angle_rad: FloatArray, motor_hz: float, sampling_hz: float) -> Scales:
    """From the motor angle since the first sample, counted in the direction of rotation, (n,)."""
    per_sample = 2.0 * math.pi * motor_hz / sampling_hz
    return Scales(np.arange(motor_angle_rad.size, dtype=float), motor_angle_rad / per_sample)


@dataclass(frozen=True, slots=True)
class FoundLine:
    """A line before its amplitude is known.

    Attributes
    ----------
    cycles
        In the record.
    along
        The scale on which it is drawn.
    probability
        That noise alone makes a bin as strong.
    decided
        It is clearly sharper on this scale than on the other.
    """

    cycles: float
    along: Along
    probability: float
    decided: bool

    def waves(self, scale: Scales) -> FloatArray:
        """Cosine and sine, shape (n, 2)."""
        position = scale.time if self.along == "time" else scale.motor
        angle = 2.0 * np.pi * self.cycles / position.size * position
        return np.stack((np.cos(angle), np.sin(angle)), axis=1)

    def line(self, whole: WholeRotations, cosine: float, sine: float) -> Line:
        """With its amplitude and phase, from the coefficients of these."""
        motor_order = self.cycles / (whole.rotations * whole.gear_ratio)
        dependence: Dependence = "angle or time"
        if self.decided:
            dependence = self.along
        elif _whole_or_half(motor_order, whole):
            dependence = "motor angle"
        return Line(
            frequency_hz=self.cycles / whole.seconds,
            load_order=self.cycles / whole.rotations,
            motor_order=motor_order,
            amplitude=math.hypot(cosine, sine),
            phase_rad=math.atan2(-sine, cosine),
            probability=self.probability,
            dependence=dependence,
            stands_out=True,
        )


def _whole_or_half(motor_order: float, whole: WholeRotations) -> bool:
    apart = abs(motor_order - 0.5 * round(2.0 * motor_order)) * whole.motor_hz * whole.seconds
    return round(2.0 * motor_order) > 0 and apart < SAME_BINS


def strongest_line(
    rest: FloatArray, floor: NoiseFloor, rotations: int, scale: Scales
) -> FoundLine | None:
    """Strongest line that is no whole load order; ``None`` if there is no bin to look at.

    ``rest`` must hold nothing that repeats with the load. Below one cycle per rotation is drift.
    """
    n = rest.size
    at_bins = floor.at_bins(n)
    tops: list[tuple[float, int, Along]] = []
    candidates: tuple[tuple[Along, FloatArray], ...] = (
        ("time", rest),
        ("motor angle", scale.on_motor_angle(rest)),
    )
    for along, values in candidates:
        ratio = np.abs(np.fft.rfft(values)) ** 2 / n / at_bins
        ratio[comb(n, rotations)] = 0.0
        ratio[:rotations] = 0.0
        ratio[-1] = 0.0
        top = int(np.argmax(ratio))
        tops.append((float(ratio[top]), top, along))
    strongest, top, along = max(tops)
    if strongest <= 0.0:
        return None
    on_time = _refined(rest, scale.time, top, rotations, float(at_bins[top]))
    on_motor = _refined(rest, scale.motor, top, rotations, float(at_bins[top]))
    decided = abs(on_time[1] - on_motor[1]) > CLEARLY
    if decided:
        along = "time" if on_time[1] > on_motor[1] else "motor angle"
    cycles = (on_time if along == "time" else on_motor)[0]
    return FoundLine(cycles, along, math.exp(-strongest), decided)


def _refined(
    rest: FloatArray, position: FloatArray, top: int, rotations: int, floor: float
) -> tuple[float, float]:
    """Cycles in the record that explain most, and the log likelihood that they gain."""
    n = rest.size

    def gain(cycles: float) -> float:
        # What the rest can hold of a line lacks the share that averaging over rotations took.
        left = 1.0 - _mean_turn(cycles, rotations) ** 2
        amplitude = abs(np.dot(rest, np.exp(-2j * np.pi * cycles / n * position)))
        return -float(amplitude**2 / max(left, 1e-3)) / (n * floor)

    found = minimize_scalar(
        gain, bounds=(top - 0.9, top + 0.9), method="bounded", options={"xatol": 1e-3}
    )
    return float(found.x), -float(found.fun)


def _mean_turn(cycles: float, rotations: int) -> float:
    """Size of the mean over the rotations of exp(2πi · cycles · r / rotations)."""
    below = rotations * math.sin(math.pi * cycles / rotations)
    return 1.0 if abs(below) < 1e-9 else abs(math.sin(math.pi * cycles) / below)


def motor_orders_in_comb(
    values: FloatArray,
    floor: NoiseFloor,
    whole: WholeRotations,
    scale: Scales,
    rate: float,
) -> list[FoundLine]:
    """Whole and half motor orders that are whole load orders too and stand out of these.

    With a whole gear ratio everything periodic in the motor angle repeats with the load: only its
    standing alone tells, on the scale of the motor angle and no less sharp there than in time.
    ``rate`` is the false-alarm rate.
    """
    n, rotations, gear_ratio = values.size, whole.rotations, whole.gear_ratio
    in_time = np.abs(np.fft.rfft(values)[::rotations]) ** 2 / n
    power = np.abs(np.fft.rfft(scale.on_motor_angle(values - values.mean()))[::rotations]) ** 2 / n
    at_orders = floor.at_bins(n)[::rotations]
    orders = [
        round(0.5 * half * gear_ratio)
        for half in range(1, int(2.0 * (power.size - 1 - NEIGHBOURS) / gear_ratio) + 1)
        if abs(0.5 * half * gear_ratio - round(0.5 * half * gear_ratio)) * rotations < 0.25
    ]
    found = []
    for order in orders:
        probability = math.exp(-power[order] / at_orders[order])
        if in_time[order] - power[order] > CLEARLY * at_orders[order]:
            continue
        if probability * len(orders) <= rate and _stands_out(power, order):
            found.append(FoundLine(float(order * rotations), "motor angle", probability, True))
    return found


def load_lines(
    harmonics: ComplexArray, whole: WholeRotations, probability: FloatArray, threshold: float
) -> list[Line]:
    """Significant whole load orders.

    Of each order from 0 on: ``harmonics`` of the rotation, and ``probability`` from noise alone.
    """
    power = np.abs(harmonics) ** 2
    lines = []
    for order in (int(found) for found in np.flatnonzero(probability <= threshold) if found):
        lines.append(
            Line(
                frequency_hz=float(order * whole.rotation_hz),
                load_order=float(order),
                motor_order=float(order / whole.gear_ratio),
                amplitude=2.0 * math.sqrt(power[order]),
                phase_rad=float(np.angle(harmonics[order])),
                probability=float(probability[order]),
                dependence="load angle",
                stands_out=_stands_out(power, order),
            )
        )
    return lines


def _stands_out(power: FloatArray, order: int) -> bool:
    """Whether a load order, from 1 on, is one by itself among its neighbours."""
    around = power[max(1, order - NEIGHBOURS) : order + NEIGHBOURS + 1].copy()
    around[min(order - 1, NEIGHBOURS)] = 0.0
    return bool(power[order] > STANDS_OUT * around.max())


def over_speeds(
    line: Line,
    whole: WholeRotations,
    others: Sequence[tuple[WholeRotations, Sequence[Line]]],
) -> Line:
    """The line, attributed anew by what recordings of the same channel at other speeds show."""
    if not line.stands_out or line.dependence in ("motor angle", "time"):
        return line
    same_time = same_turn = False
    for other, lines in others:
        if abs(abs(other.reference_speed_rpm / whole.reference_speed_rpm) - 1.0) < OTHER_SPEED:
            continue
        seconds = SAME_BINS * (1.0 / whole.seconds + 1.0 / other.seconds)
        turns = SAME_BINS * (
            1.0 / (whole.seconds * whole.motor_hz) + 1.0 / (other.seconds * other.motor_hz)
        )
        for partner in lines:
            if partner.stands_out:
                same_time |= abs(partner.frequency_hz - line.frequency_hz) < seconds
                same_turn |= abs(partner.motor_order - line.motor_order) < turns
    if same_time == same_turn:
        return line
    if same_time:
        return dataclasses.replace(line, dependence="time")
    if line.dependence == "angle or time":
        return dataclasses.replace(line, dependence="motor angle")
    return line


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
