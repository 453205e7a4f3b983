"""Where recording and simulation disagree: per channel, with which angle or time, how surely.

Averaging over load rotations splits the residual of a simulation into what repeats and what does
not. Lines are sought in the periodogram |X_k|²/n over time and over the motor's angle: the motor
does not turn evenly, so what repeats with its angle has side bands in time, and the reverse. Over
its floor the periodogram of noise is standard exponential. With a whole gear ratio all that turns
with the motor repeats with the load too, so a line at a whole load order is one by itself only if
it stands out of the load orders beside it. What a line repeats with is what explains it best in all
recordings together: they turn at several speeds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from scipy.ndimage import median_filter
from scipy.optimize import minimize_scalar
from scipy.stats import chi2, norm

from bayesbl.errors import RecordingError
from bayesbl.matching.observed import Observed
from bayesbl.matching.predictive_check import BANDS
from bayesbl.noise.rotation_noise import bic, levinson, log_variances
from bayesbl.recording.types import MOTOR_SPEED, BoolArray, FloatArray
from bayesbl.units import unit_of

FALSE_LINES = 0.01
"""Probability of any line where there is none, over all channels of all recordings."""

SURE = 1e-3
"""The same of what is no line: repeating bands, offset, drift."""

FEWEST_ROTATIONS = 2
HIGHEST_AUTOREGRESSION = 30
MEDIAN_BINS = 201
CLIP = 8.0
"""Ordinates above this many floors are lines for all we know: they count as this many."""
FLOOR_ROUNDS = 3

CLEARLY = 10.0
"""Difference of log likelihoods beyond which a line is sharp on one scale and not on the other."""
NEIGHBOURS = 4
STANDS_OUT = 4.0
"""Times the power of the load orders beside it: then a whole load order is a line by itself."""

MAIN_SHARE = 0.8
MOST_LINES = 6
"""Of a channel: what is beyond them is weaker, mostly side bands."""

What = Literal["load angle", "motor angle", "time", "angle or time", "offset", "drift"]
Scale = Literal["time", "motor angle", "load angle"]
TIME: Literal["time"] = "time"
MOTOR: Literal["motor angle"] = "motor angle"
LOAD: Literal["load angle"] = "load angle"
BETWEEN_ORDERS: tuple[Scale, ...] = (TIME, MOTOR)
"""Scales on which a line is drawn that need not be a whole load order."""


@dataclass(frozen=True, slots=True)
class WholeRotations:
    """The part of a recording that is looked at: whole load rotations, to the nearest sample.

    ``rotations`` of the load in ``samples``; ``gear_ratio`` motor turns in each.
    """

    rotations: int
    samples: int
    sampling_hz: float
    gear_ratio: float

    @property
    def seconds(self) -> float:
        """Length of the record."""
        return self.samples / self.sampling_hz

    @property
    def turns(self) -> float:
        """Of the motor."""
        return self.rotations * self.gear_ratio

    @property
    def motor_hz(self) -> float:
        """Turns of the motor per second."""
        return self.turns / self.seconds

    def cycles(self, scale: Scale, frequency_hz: float, other: WholeRotations) -> float:
        """In the record, of a line of another: of its frequency, or of its order."""
        if scale == TIME:
            return frequency_hz * self.seconds
        return frequency_hz / other.motor_hz * self.turns


@dataclass(frozen=True, slots=True)
class Line:
    """A significant line of one recording.

    ``load_order``, ``motor_order``: cycles per turn of the load and of the motor; ``amplitude``: in
    the channel's unit; ``dependence``: what it repeats with, ``angle or time`` where the recordings
    cannot tell.
    """

    frequency_hz: float
    load_order: float
    motor_order: float
    amplitude: float
    dependence: What


@dataclass(frozen=True, slots=True)
class ChannelResiduals:
    """The residual of one channel of one recording, in the unit that the channel's name ends in.

    Attributes
    ----------
    offset, offset_error
        Mean of recording − simulation, and its standard error.
    repeating_rms
        RMS of what repeats with the load angle, without the offset, lines of the motor angle and
        what noise alone would leave; up to the load order ``repeating_band``.
    repeating_probability
        That noise alone repeats as much (bands of load orders, Bonferroni).
    main_orders
        Load orders between which 80 % of the significant power lies; ``None`` if none is
        significant.
    lines
        Strongest first.
    other
        Mean square of lines and drift.
    noise_sd
        Of the noise.
    drift_per_s, drift_error_per_s
        Slope over the recording and its standard error.
    """

    recording: str
    channel: str
    offset: float
    offset_error: float
    repeating_rms: float
    repeating_band: int
    repeating_probability: float
    main_orders: tuple[int, int] | None
    lines: tuple[Line, ...]
    other: float
    noise_sd: float
    drift_per_s: float
    drift_error_per_s: float

    @property
    def unexplained(self) -> float:
        """Power of all but noise and offset, which any friction takes away, over the noise's."""
        return (self.repeating_rms**2 + self.other) / self.noise_sd**2


@dataclass(frozen=True, slots=True)
class Unexplained:
    """One thing that the simulation does not explain, over all recordings that show it.

    Attributes
    ----------
    dependence
        What it repeats with, or ``offset``, ``drift`` (over a recording).
    amplitude
        Largest over the recordings, in ``unit``: of the line; for the load angle that of a sine
        of the same RMS; the offset; the drift per second.
    lowest_order, highest_order
        Of the load for the load angle, else of the motor; ``nan`` where it has none.
    frequency_hz
        Of a line periodic in time, or of one that may be; else ``nan``.
    recordings
        Names of those that show it.
    chi_squared
        Of a line whose test has one.
    """

    channel: str
    dependence: What
    amplitude: float
    unit: str
    lowest_order: float
    highest_order: float
    frequency_hz: float
    recordings: tuple[str, ...]
    chi_squared: float | None = None


@dataclass(frozen=True, slots=True)
class ResidualAnalysis:
    """The residuals of all recordings, channel by channel; what of them no noise explains."""

    channels: tuple[ChannelResiduals, ...]
    remaining: tuple[Unexplained, ...]

    def closes(self, before: ResidualAnalysis) -> float:
        """Share of what another one leaves, in power over the noise, repeating or not."""
        first, last = (
            sum(channel.unexplained for channel in analysis.channels) for analysis in (before, self)
        )
        return 1.0 - last / first if first > 0.0 else 0.0


@dataclass(frozen=True, slots=True)
class NoiseFloor:
    """Autoregressive spectrum of one channel's noise.

    ``coefficients``: φ_1 … φ_p of n_t = Σ φ_k n_{t−k} + ε_t; ``innovation_variance``: of ε.
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


def noise_floor(values: FloatArray, lines_at: BoolArray) -> NoiseFloor:
    """Floor of noise among lines.

    The periodogram, clipped where lines stand out and filled in where ``lines_at``, (n // 2 + 1,),
    says that they may, gives the autocovariance; Levinson's recursion the autoregression; BIC its
    order. The first round is from a running median.
    """
    n = values.size
    bins = np.arange(n // 2 + 1)
    periodogram = np.abs(np.fft.rfft(values)) ** 2 / n
    used = periodogram[~lines_at]
    median = median_filter(used, min(MEDIAN_BINS, used.size), mode="reflect") / math.log(2.0)
    spectrum = np.interp(bins, bins[~lines_at], median)
    for _ in range(FLOOR_ROUNDS):
        quiet = np.where(lines_at, spectrum, np.minimum(periodogram, CLIP * spectrum))
        fits = levinson(np.fft.irfft(quiet, n), min(HIGHEST_AUTOREGRESSION, n // 4))
        variance, coefficients = fits[int(np.argmin(bic(log_variances(fits), n)))]
        floor = NoiseFloor(coefficients, variance)
        spectrum = floor.at_bins(n)
    return floor


@dataclass(slots=True)
class _Split:
    """One channel of one recording, (n,), while lines are taken out of it.

    ``positions``: time and the motor's angle, both in samples; ``waves``: of the lines so far, with
    the slope of a drift, (n, k); ``noise``: what neither they nor a rotation's mean hold.
    """

    whole: WholeRotations
    values: FloatArray
    positions: Mapping[Scale, FloatArray]
    waves: FloatArray
    lines: list[Line] = field(default_factory=list)
    of_comb: list[int] = field(default_factory=list)
    coefficients: FloatArray = field(init=False)
    noise: FloatArray = field(init=False)
    floor: NoiseFloor = field(init=False)
    slope_error: float = field(init=False)

    def __post_init__(self) -> None:
        self.fit()

    def fit(self) -> None:
        """Waves in what does not repeat; those of whole load orders in all."""
        rotations, comb = self.whole.rotations, self.of_comb
        apart = [k for k in range(self.waves.shape[1]) if k not in comb]
        reduced = _without_comb(self.waves[:, apart], rotations)
        self.coefficients = np.zeros(self.waves.shape[1])
        for _ in range(2 if comb else 1):
            rest = self.values - self.waves[:, comb] @ self.coefficients[comb]
            rest = _without_comb(rest[:, None], rotations)[:, 0]
            self.coefficients[apart] = np.linalg.lstsq(reduced, rest)[0]
            beside = self.values - self.waves[:, apart] @ self.coefficients[apart]
            own = self.waves[:, comb]
            self.coefficients[comb] = np.linalg.lstsq(own, beside - beside.mean())[0]
        self.noise = rest - reduced @ self.coefficients[apart]
        lines_at = np.arange(self.noise.size // 2 + 1) % rotations == 0
        for line in self.lines:
            near = round(line.load_order * rotations)
            lines_at[max(0, near - 1) : near + 2] = True
        self.floor = noise_floor(self.noise, lines_at)
        norm_of_slope = float(np.linalg.norm(reduced[:, 0]))
        self.slope_error = math.sqrt(self.floor.at_zero) / norm_of_slope

    @property
    def without_lines(self) -> FloatArray:
        """What repeats with the load and noise, (n,)."""
        return np.asarray(self.values - self.waves @ self.coefficients)

    def scores(self, scale: Scale) -> FloatArray:
        """Periodogram over what is there without a line, of every bin of a scale."""
        n, rotations, values = self.noise.size, self.whole.rotations, self.without_lines
        time, position = self.positions["time"], self.positions[scale]
        if position is not time:
            values = CubicSpline(time, values)(np.interp(time, position, time))
        power = np.abs(np.fft.rfft(values)) ** 2 / n / self.floor.at_bins(n)
        comb = power[::rotations].copy()
        beside = np.ones(2 * NEIGHBOURS + 1, dtype=bool)
        beside[NEIGHBOURS] = False
        comb[0] = 0.0
        around = np.lib.stride_tricks.sliding_window_view(np.pad(comb, NEIGHBOURS), beside.size)[
            :, beside
        ].max(axis=1)
        power[::rotations] = np.where(comb > STANDS_OUT * around, comb, 0.0)
        power[:rotations] = 0.0  # below a cycle in a rotation is drift
        power[-1] = 0.0
        for line in self.lines:
            if line.dependence == LOAD:
                power[round(line.load_order) * rotations] = 0.0
        return power

    def gain(self, scale: Scale, cycles: float) -> tuple[float, float]:
        """Log likelihood that a line gains near so many cycles in the record, and where.

        What does not repeat lacks the share of a line that averaging over rotations took.
        """
        n, rotations = self.noise.size, self.whole.rotations
        position, floor = self.positions[scale], self.floor.at_bins(n)
        if not rotations <= cycles < floor.size - 1:
            return 0.0, cycles
        variance = n * float(floor[round(cycles)])
        order = cycles / rotations
        if abs(order - round(order)) * rotations < 0.5:
            whole, values = float(round(order) * rotations), self.without_lines
            return _power(values - values.mean(), position, whole) / variance, whole

        def off_comb(cycles: float) -> float:
            below = rotations * math.sin(math.pi * cycles / rotations)
            kept = 1.0 - (math.sin(math.pi * cycles) / below) ** 2 if abs(below) > 1e-9 else 0.0
            return -_power(self.noise, position, cycles) / max(kept, 1e-3) / variance

        ends = (cycles - 0.9, cycles + 0.9)
        best = minimize_scalar(off_comb, bounds=ends, method="bounded", options={"xatol": 1e-3})
        return -float(best.fun), float(best.x)

    def add(self, scale: Scale, cycles: float, dependence: What) -> None:
        """A line with its amplitude and phase; what repeats with the load stays where it is."""
        n, whole = self.noise.size, self.whole
        angle = 2.0 * np.pi * cycles / n * self.positions[scale]
        pair = np.stack((np.cos(angle), np.sin(angle)), axis=1)
        per_rotation = cycles / whole.rotations
        order = per_rotation / whole.gear_ratio
        line = Line(cycles / whole.seconds, per_rotation, order, 0.0, dependence)
        self.lines.append(line)
        begin = self.waves.shape[1]
        if dependence == LOAD:
            size = 2.0 / n * float(np.hypot(*(self.without_lines @ pair)))
            self.lines[-1] = replace(line, amplitude=size)
            return
        self.waves = np.hstack([self.waves, pair])
        if per_rotation == round(per_rotation):
            self.of_comb += [begin, begin + 1]
        self.fit()
        moved = [k for k, known in enumerate(self.lines) if known.dependence != LOAD]
        sizes = np.hypot(*self.coefficients[1:].reshape(-1, 2).T).tolist()
        for k, size in zip(moved, sizes, strict=True):
            self.lines[k] = replace(self.lines[k], amplitude=size)


def _power(values: FloatArray, position: FloatArray, cycles: float) -> float:
    return float(abs(values @ np.exp(-2j * np.pi * cycles / values.size * position)) ** 2)


def _without_comb(columns: FloatArray, rotations: int) -> FloatArray:
    """Columns less what repeats of each in every rotation, (n, k)."""
    transform = np.fft.rfft(columns, axis=0)
    transform[::rotations] = 0.0
    return np.asarray(np.fft.irfft(transform, len(columns), axis=0))


def analyse_residuals(
    recordings: Sequence[Observed],
    simulated: Sequence[FloatArray],
    *,
    false_lines: float = FALSE_LINES,
) -> ResidualAnalysis:
    """Split the residual of every channel and seek lines in it.

    Parameters
    ----------
    recordings
        Recordings in steady rotation.
    simulated
        Prediction for each, shape (c, n) as its ``signals``.
    false_lines
        Probability of any line where there is none.

    Raises
    ------
    RecordingError
        If a recording holds less than two load rotations.
    """
    count = sum(len(seen.signals) for seen in recordings)
    wholes = list(map(_whole, recordings))
    names = [seen.name for seen in recordings]
    every: list[ChannelResiduals] = []
    remaining: list[Unexplained] = []
    for channel in dict.fromkeys(name for seen in recordings for name in seen.channels):
        splits = {
            i: _split(seen, made, whole, seen.channels.index(channel))
            for i, (seen, made, whole) in enumerate(zip(recordings, simulated, wholes, strict=True))
            if channel in seen.channels
        }
        lines = [
            (dependence, [(i, len(splits[i].lines) - 1) for i in shown])
            for dependence, shown in _remove_lines(splits, false_lines / count)
        ]
        own = [_channel(names[i], channel, s, false_lines / count) for i, s in splits.items()]
        turning = [line for line in lines if line[0] != LOAD]
        remaining += _repeating(own, count)
        remaining += _lines(channel, names, splits, turning)
        remaining += _numbers(own, count)
        every += own
    return ResidualAnalysis(tuple(every), tuple(remaining))


def _whole(seen: Observed) -> WholeRotations:
    rotation = seen.rotation_period_s * seen.sampling_hz
    rotations = int(seen.samples / rotation + 1e-6)
    if rotations < FEWEST_ROTATIONS:
        raise RecordingError(
            "The recording is too short to tell noise from what repeats every load rotation.",
            file=seen.name,
            found=f"{seen.samples / rotation:.3g} load rotations",
            expected="at least two",
        )
    return WholeRotations(
        rotations=rotations,
        samples=min(round(rotations * rotation), seen.samples),
        sampling_hz=seen.sampling_hz,
        gear_ratio=seen.rotation_period_s * abs(seen.reference_speed_rpm) / 60.0,
    )


def _split(seen: Observed, simulated: FloatArray, whole: WholeRotations, row: int) -> _Split:
    """Of one channel, over time and over the motor angle that the simulated speed makes, which has
    no noise."""
    n = whole.samples
    hertz = np.full(n, whole.motor_hz)
    if MOTOR_SPEED in seen.channels:
        hertz = np.abs(simulated[seen.channels.index(MOTOR_SPEED), :n]) / 60.0
    turned = cumulative_trapezoid(hertz, dx=1.0 / whole.motor_hz, initial=0.0)
    time = np.arange(n, dtype=float)
    ramp = (time - time.mean())[:, None]
    difference = (seen.signals - simulated)[row, :n]
    return _Split(whole, difference, {TIME: time, MOTOR: turned, LOAD: time}, ramp)


def _remove_lines(splits: Mapping[int, _Split], rate: float) -> Iterator[tuple[What, list[int]]]:
    """Lines of one channel, from the strongest down, out of every recording that shows them.

    Yields what each repeats with and the recordings, in which it is the last line then.
    """
    for _ in range(MOST_LINES):
        tops: list[tuple[float, int, Scale, int]] = []
        for i, split in splits.items():
            for scale in BETWEEN_ORDERS:
                score = split.scores(scale)
                k = int(np.argmax(score))
                tops.append((float(score[k]) - math.log(2.0 * score.size), i, scale, k))
        most, first, scale, k = max(tops)
        if most < -math.log(rate):
            return
        own = splits[first]
        hertz: dict[Scale, float] = {LOAD: k / own.whole.seconds}
        hertz |= {s: own.gain(s, k)[1] / own.whole.seconds for s in BETWEEN_ORDERS}
        gains = {
            s: {i: one.gain(s, one.whole.cycles(s, f, own.whole)) for i, one in splits.items()}
            for s, f in hertz.items()
            if s != LOAD or k % own.whole.rotations == 0
        }
        totals = {s: sum(gain for gain, _ in each.values()) for s, each in gains.items()}
        near = [s for s in totals if totals[s] >= max(totals.values()) - CLEARLY]
        half = 2.0 * hertz[MOTOR] / own.whole.motor_hz
        whole = round(half) > 0 and abs(half - round(half)) * own.whole.turns < 1.0
        by_order = MOTOR in near and whole
        drawn = MOTOR if by_order else LOAD if LOAD in near else near[0]
        dependence: What = drawn if by_order or drawn == LOAD or len(near) == 1 else "angle or time"
        shown = []
        for i, (gain, cycles) in gains[drawn].items():
            if i == first or gain > -math.log(rate):
                splits[i].add(drawn, cycles, dependence)
                shown.append(i)
        yield dependence, shown


def _channel(recording: str, name: str, split: _Split, rate: float) -> ChannelResiduals:
    n, whole, rest = split.values.size, split.whole, split.without_lines
    transform = np.fft.rfft(rest)[:: whole.rotations]
    floor = split.floor.at_bins(n)
    at_orders = floor[:: whole.rotations]
    ratio = np.abs(transform) ** 2 / n / at_orders
    if n % (2 * whole.rotations) == 0:
        ratio[-1] = 0.0  # at half the sampling rate a bin has one degree of freedom only
    bands = []
    for highest in BANDS[1:]:
        band = ratio[1 : highest + 1]
        bands.append((float(chi2.sf(2.0 * band.sum(), 2 * band.size)), highest))
    probability, highest = min(bands)
    power = 2.0 * np.abs(transform / n) ** 2
    significant = ratio > math.log(ratio.size / rate)
    highest = max(highest, int(np.flatnonzero(significant).max(initial=0)))
    excess = float((power - 2.0 * at_orders / n)[1 : highest + 1].sum())
    difference = split.values
    return ChannelResiduals(
        recording=recording,
        channel=name,
        offset=float(rest.mean()),
        offset_error=math.sqrt(split.floor.at_zero / n),
        repeating_rms=math.sqrt(max(excess, 0.0)),
        repeating_band=highest,
        repeating_probability=min(1.0, len(bands) * probability),
        main_orders=_main_orders(np.where(significant, power, 0.0)[1:]),
        lines=tuple(sorted(split.lines, key=lambda line: -line.amplitude)),
        other=float(np.mean((difference - rest) ** 2)),
        noise_sd=math.sqrt(float(np.mean(floor[:-1]))),
        drift_per_s=float(split.coefficients[0]) * whole.sampling_hz,
        drift_error_per_s=split.slope_error * whole.sampling_hz,
    )


def _main_orders(power: FloatArray) -> tuple[int, int] | None:
    """Orders, from 1 on, that cut off a tenth of the power below and above them."""
    if not power.any():
        return None
    below = np.cumsum(power) / power.sum()
    aside = 0.5 * (1.0 - MAIN_SHARE)
    return int(np.argmax(below >= aside)) + 1, int(np.argmax(below >= 1.0 - aside)) + 1


def _lines(
    name: str,
    recordings: Sequence[str],
    splits: Mapping[int, _Split],
    groups: Sequence[tuple[What, Sequence[tuple[int, int]]]],
) -> Iterator[Unexplained]:
    """Lines of the motor angle and of time, each in all recordings that show it."""
    for dependence, places in groups:
        lines = [splits[i].lines[k] for i, k in places]
        largest = max(lines, key=lambda line: line.amplitude)
        order = math.nan if dependence == TIME else largest.motor_order
        hertz = math.nan if dependence == MOTOR else largest.frequency_hz
        shown = tuple(recordings[i] for i, _ in places)
        size = largest.amplitude
        yield Unexplained(name, dependence, size, unit_of(name), order, order, hertz, shown)


def _repeating(seen: Sequence[ChannelResiduals], tests: int) -> Iterator[Unexplained]:
    """What repeats with the load: a line of a load order, or a whole band."""
    channel = seen[0].channel
    repeats = [
        c for c in seen if c.main_orders is not None or c.repeating_probability * tests <= SURE
    ]
    if repeats:
        orders = [c.main_orders or (1, c.repeating_band) for c in repeats]
        low, high = min(first for first, _ in orders), max(last for _, last in orders)
        size = math.sqrt(2.0) * max(c.repeating_rms for c in repeats)
        shown = tuple(c.recording for c in repeats)
        unit = unit_of(channel)
        yield Unexplained(channel, LOAD, size, unit, float(low), float(high), math.nan, shown)


def _numbers(seen: Sequence[ChannelResiduals], tests: int) -> Iterator[Unexplained]:
    """What a channel has one of: the largest of those sure."""
    channel, nan = seen[0].channel, math.nan
    unit = unit_of(channel)

    def sure(value: float, error: float) -> bool:
        return 2.0 * float(norm.sf(abs(value) / error)) * tests <= SURE

    offsets = {c.recording: c.offset for c in seen if sure(c.offset, c.offset_error)}
    drifts = {c.recording: c.drift_per_s for c in seen if sure(c.drift_per_s, c.drift_error_per_s)}
    numbers: list[tuple[What, str, Mapping[str, float]]] = [
        ("offset", unit, offsets),
        ("drift", f"{unit}/s", drifts),
    ]
    for what, own_unit, values in numbers:
        if values:
            largest = max(values.values(), key=abs)
            yield Unexplained(channel, what, largest, own_unit, nan, nan, nan, tuple(values))
