"""What a simulation in steady rotation leaves, and what it repeats with: load, motor or time.

Averaging over load rotations splits a residual into what repeats and what does not. Lines are
sought in the periodogram |X_k|²/n over time and over the motor's angle: the motor does not turn
evenly, so what repeats with its angle has side bands in time, and the reverse. Over its floor the
periodogram of noise is standard exponential. With a whole gear ratio all that turns with the motor
repeats with the load too, so a line at a whole load order is one by itself only if it stands out of
the load orders beside it. What a line repeats with is what explains it best in all recordings
together: they turn at several speeds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import median_filter
from scipy.optimize import minimize_scalar
from scipy.stats import chi2, norm

from bayesbl.errors import RecordingError
from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.observed import Observed
from bayesbl.matching.predictive_check import BANDS
from bayesbl.recording.types import MOTOR_SPEED, FloatArray
from bayesbl.units import unit_of

FALSE_LINES = 0.01
"""Probability of any line where there is none, over all channels of all recordings."""

SURE = 1e-3
"""The same of what is no line: repeating bands, offset, drift."""

FEWEST_ROTATIONS = 2
MEDIAN_BINS = 201
"""Of a periodogram, whose median lines do not move."""

CLEARLY = 10.0
"""Difference of log likelihoods beyond which a line is sharp on one scale and not on the other."""
NEIGHBOURS = 4
STANDS_OUT = 4.0
"""Times the power of the load orders beside it: then a whole load order is a line by itself."""

MAIN_SHARE = 0.8
"""Of the significant power, between the load orders that are told."""

MOST_LINES = 6
"""Of a channel: what is beyond them is weaker, mostly side bands."""

MOST_ORDERS = 3
"""Of the motor, that are tried as ripples at once. It limits time only: others are looked for in
what the best set leaves."""

SIDEBANDS = 2.5
"""Load orders to either side of a whole motor order that belong to it: load torque modulates it."""

What = Literal["load angle", "motor angle", "time", "angle or time", "offset", "drift"]
Scale = Literal["time", "motor angle", "load angle"]
TIME: Literal["time"] = "time"
MOTOR: Literal["motor angle"] = "motor angle"
LOAD: Literal["load angle"] = "load angle"
TURNING: tuple[What, ...] = (MOTOR, "angle or time")
BETWEEN_ORDERS: tuple[Scale, ...] = (TIME, MOTOR)
"""Scales on which a line is drawn that need not be a whole load order."""


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
    """What no noise explains; ``power`` of all but the mean, which any friction takes away, over
    that of the noise, summed over recordings and channels."""

    remaining: tuple[Unexplained, ...]
    power: float

    def closes(self, before: ResidualAnalysis) -> float:
        """Share of what another one leaves, repeating or not."""
        return 1.0 - self.power / before.power if before.power > 0.0 else 0.0


@dataclass(slots=True, eq=False)
class _Residual:
    """One channel of a recording over whole load rotations, (n,), while lines are taken out of it.

    Attributes
    ----------
    positions
        Time and the motor's angle, both in samples.
    lengths
        Of the record on each scale: seconds, or turns of the motor.
    cycles
        In the record, of the lines that are no load order's.
    waves
        The slope of a drift, then cosine and sine of each of these, (n, k).
    of_load
        Load orders that stand out of their neighbours and repeat with nothing else.
    rest, noise
        Without drift and lines, and without what repeats.
    floor
        Periodogram that the noise is expected to have, (n // 2 + 1,).
    """

    recording: str
    values: FloatArray
    rotations: int
    positions: Mapping[Scale, FloatArray]
    lengths: Mapping[Scale, float]
    waves: FloatArray
    cycles: list[float] = field(default_factory=list)
    of_load: list[int] = field(default_factory=list)
    coefficients: FloatArray = field(init=False)
    rest: FloatArray = field(init=False)
    noise: FloatArray = field(init=False)
    floor: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        self.fit()

    def fit(self) -> None:
        """Waves in what does not repeat; those of whole load orders in all."""
        n, rotations = self.values.size, self.rotations
        whole = np.repeat([False, *(c % rotations == 0.0 for c in self.cycles)], 2)[1:]
        apart = self._without_repeating(self.waves[:, ~whole])
        beside = self._without_repeating(self.values[:, None])[:, 0]
        self.coefficients = np.zeros(whole.size)
        self.coefficients[~whole] = np.linalg.lstsq(apart, beside)[0]
        self.noise = beside - apart @ self.coefficients[~whole]
        rest = self.values - self.waves @ self.coefficients
        own = self.waves[:, whole]
        self.coefficients[whole] = np.linalg.lstsq(own, rest - rest.mean())[0]
        self.rest = rest - own @ self.coefficients[whole]
        power = np.abs(np.fft.rfft(self.noise)) ** 2 / n
        between = np.flatnonzero(np.arange(power.size) % rotations)
        median = median_filter(power[between], min(MEDIAN_BINS, between.size)) / math.log(2.0)
        self.floor = np.interp(np.arange(power.size), between, median)

    def _without_repeating(self, columns: FloatArray) -> FloatArray:
        """Columns less what repeats of each in every rotation, (n, k)."""
        transform = np.fft.rfft(columns, axis=0)
        transform[:: self.rotations] = 0.0
        return np.asarray(np.fft.irfft(transform, len(columns), axis=0))

    def scores(self, scale: Scale) -> FloatArray:
        """Periodogram of what is there without a line, over its floor, of every bin of a scale."""
        values, time, position = self.rest, self.positions[TIME], self.positions[scale]
        if position is not time:
            values = CubicSpline(time, values)(np.interp(time, position, time))
        power = np.abs(np.fft.rfft(values)) ** 2 / values.size / self.floor
        comb = power[:: self.rotations].copy()
        comb[0] = 0.0
        beside = np.ones(2 * NEIGHBOURS + 1, dtype=bool)
        beside[NEIGHBOURS] = False
        around = np.lib.stride_tricks.sliding_window_view(np.pad(comb, NEIGHBOURS), beside.size)
        comb[comb <= STANDS_OUT * around[:, beside].max(axis=1)] = 0.0
        comb[self.of_load] = 0.0
        power[:: self.rotations] = comb
        power[: self.rotations] = 0.0  # below a cycle in a rotation is drift
        power[-1] = 0.0
        return power

    def gain(self, scale: Scale, cycles: float) -> tuple[float, float]:
        """Log likelihood that a line gains near so many cycles in the record, and where.

        What does not repeat lacks the share of a line that averaging over rotations took.
        """
        rotations, position = self.rotations, self.positions[scale]
        if not rotations <= cycles < self.floor.size - 1:
            return 0.0, cycles
        variance = self.values.size * float(self.floor[round(cycles)])
        order = cycles / rotations
        if abs(order - round(order)) * rotations < 0.5:
            whole = float(round(order) * rotations)
            return _power(self.rest - self.rest.mean(), position, whole) / variance, whole

        def off_comb(cycles: float) -> float:
            below = rotations * math.sin(math.pi * cycles / rotations)
            kept = 1.0 - (math.sin(math.pi * cycles) / below) ** 2 if abs(below) > 1e-9 else 0.0
            return -_power(self.noise, position, cycles) / max(kept, 1e-3) / variance

        ends = (cycles - 0.9, cycles + 0.9)
        best = minimize_scalar(off_comb, bounds=ends, method="bounded", options={"xatol": 1e-3})
        return -float(best.fun), float(best.x)

    def take_out(self, scale: Scale, cycles: float) -> None:
        """A line with its amplitude and phase; what repeats with the load stays where it is."""
        if scale == LOAD:
            self.of_load.append(round(cycles / self.rotations))
            return
        angle = 2.0 * np.pi * cycles / self.values.size * self.positions[scale]
        self.waves = np.column_stack([self.waves, np.cos(angle), np.sin(angle)])
        self.cycles.append(cycles)
        self.fit()

    @property
    def amplitudes(self) -> FloatArray:
        """Of the lines."""
        return np.asarray(np.hypot(*self.coefficients[1:].reshape(-1, 2).T))

    @property
    def offset(self) -> tuple[float, float]:
        """Mean, and its standard error."""
        return float(self.rest.mean()), math.sqrt(float(self.floor[0]) / self.values.size)

    @property
    def drift_per_s(self) -> tuple[float, float]:
        """Slope over the recording, and its standard error."""
        hertz = self.values.size / self.lengths[TIME]
        length = float(np.linalg.norm(self._without_repeating(self.waves[:, :1])))
        error = math.sqrt(float(self.floor[0])) / length
        return hertz * float(self.coefficients[0]), hertz * error

    def repeating(self, chance: float, tests: int) -> tuple[float, tuple[int, int] | None]:
        """Mean square of what repeats with the load, and the load orders between which it stands
        out; ``None`` where it does not.

        Without the mean, lines, and what noise alone would leave. ``chance``: of a single order
        that stands out; a whole band may (Bonferroni over ``tests`` and bands).
        """
        power = np.abs(np.fft.rfft(self.rest)[:: self.rotations]) ** 2 / self.rest.size
        floor = self.floor[:: self.rotations]
        ratio = power / floor
        if self.rest.size % (2 * self.rotations) == 0:
            ratio[-1] = 0.0  # at half the sampling rate a bin has one degree of freedom only
        bands = []
        for highest in BANDS[1:]:
            band = ratio[1 : highest + 1]
            bands.append((float(chi2.sf(2.0 * band.sum(), 2 * band.size)), highest))
        probability, highest = min(bands)
        significant = np.flatnonzero(ratio > math.log(ratio.size / chance))
        highest = max(highest, int(significant.max(initial=0)))
        excess = 2.0 / self.rest.size * float((power - floor)[1 : highest + 1].sum())
        orders = (1, highest) if len(bands) * probability * tests <= SURE else None
        if (significant := significant[significant > 0]).size:
            below = np.cumsum(power[significant]) / power[significant].sum()
            ends = 0.5 * (1.0 - MAIN_SHARE), 0.5 * (1.0 + MAIN_SHARE)
            low, high = (int(significant[np.argmax(below >= end)]) for end in ends)
            orders = low, high
        return max(excess, 0.0), orders

    def over_noise(self, repeating: float) -> float:
        """Power of what repeats, lines and drift, over the noise's."""
        other = float(np.mean((self.values - self.rest) ** 2))
        return (repeating + other) / float(np.mean(self.floor[:-1]))


def _power(values: FloatArray, position: FloatArray, cycles: float) -> float:
    return float(abs(values @ np.exp(-2j * np.pi * cycles / values.size * position)) ** 2)


def residuals_of(fit: SimulatedFit) -> ResidualAnalysis:
    """What a fit leaves of its steady rotations.

    Not of those whose lines of the motor are marginalised, nor of motions.
    """
    model = fit.model
    steady = [
        i for i, r in enumerate(model.recordings) if r.motion is None and r.motor_lines is None
    ]
    own = [fit.simulated(i) for i in steady]
    # Bridged samples hold nothing that repeats.
    observations = [
        replace(r, signals=made + r.residual_of(made))
        for r, made in zip((model.recordings[i] for i in steady), own, strict=True)
    ]
    return analyse_residuals(observations, own)


def motor_orders(fit: SimulatedFit) -> list[float]:
    """Whole orders of the motor that what a fit leaves repeats with, a few, the strongest first.

    None of recordings that hardly hold two rotations.
    """
    near = SIDEBANDS / fit.model.bench.value("gear_ratio")
    try:
        remaining = residuals_of(fit).remaining
    except RecordingError:
        return []
    powers: dict[float, float] = {}
    for entry in remaining:
        whole = float(round(entry.lowest_order)) if entry.dependence in TURNING else 0.0
        if whole and abs(entry.lowest_order - whole) < near:
            every = sum(e.amplitude**2 for e in remaining if e.channel == entry.channel)
            powers[whole] = powers.get(whole, 0.0) + entry.amplitude**2 / every
    return sorted(powers, key=lambda order: -powers[order])[:MOST_ORDERS]


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
    tests = max(1, sum(len(observation.signals) for observation in recordings))
    remaining, power = list[Unexplained](), 0.0
    for channel in dict.fromkeys(
        name for observation in recordings for name in observation.channels
    ):
        pairs = zip(recordings, simulated, strict=True)
        own = [
            _residual(observation, made, channel)
            for observation, made in pairs
            if channel in observation.channels
        ]
        lines = list(_lines(own, false_lines / tests))
        repeating = [one.repeating(false_lines / tests, tests) for one in own]
        power += sum(one.over_noise(size) for one, (size, _) in zip(own, repeating, strict=True))
        remaining += _with_load(channel, own, repeating)
        remaining += (_line(channel, own, *line) for line in lines)
        remaining += _numbers(channel, own, tests)
    return ResidualAnalysis(tuple(remaining), power)


def _residual(observation: Observed, simulated: FloatArray, channel: str) -> _Residual:
    """Of one channel, over time and over the motor angle that the simulated speed makes, which has
    no noise; whole load rotations, to the nearest sample."""
    rotation = observation.rotation_period_s * observation.sampling_hz
    rotations = int(observation.samples / rotation + 1e-6)
    if rotations < FEWEST_ROTATIONS:
        raise RecordingError(
            "The recording is too short to tell noise from what repeats every load rotation.",
            file=observation.name,
            found=f"{observation.samples / rotation:.3g} load rotations",
            expected="at least two",
        )
    n = min(round(rotations * rotation), observation.samples)
    row = observation.channels.index(channel)
    turns = rotations * observation.rotation_period_s * abs(observation.reference_speed_rpm) / 60.0
    time = np.arange(n, dtype=float)
    turned = time
    if MOTOR_SPEED in observation.channels:
        from scipy.integrate import cumulative_trapezoid

        turning = np.abs(simulated[observation.channels.index(MOTOR_SPEED), :n]) / 60.0
        turned = cumulative_trapezoid(turning, dx=n / observation.sampling_hz / turns, initial=0.0)
    lengths: dict[Scale, float] = {TIME: n / observation.sampling_hz, MOTOR: turns, LOAD: turns}
    positions: dict[Scale, FloatArray] = {TIME: time, MOTOR: turned, LOAD: time}
    values = (observation.signals - simulated)[row, :n]
    return _Residual(
        observation.name, values, rotations, positions, lengths, (time - time.mean())[:, None]
    )


def _lines(own: Sequence[_Residual], chance: float) -> Iterator[tuple[What, list[tuple[int, int]]]]:
    """Lines of one channel, from the strongest down, out of every recording that shows them.

    Yields what each repeats with, where that is not the load alone, and its places: of a recording,
    and of the line in it.
    """
    for _ in range(MOST_LINES):
        tops: list[tuple[float, int, Scale, int]] = []
        for i, one in enumerate(own):
            for scale in BETWEEN_ORDERS:
                score = one.scores(scale)
                k = int(np.argmax(score))
                tops.append((float(score[k]) - math.log(2.0 * score.size), i, scale, k))
        most, first, _, k = max(tops)
        if most < -math.log(chance):
            return
        # Where it is on each scale, per second or per turn of the motor.
        strongest = own[first]
        at = {s: strongest.gain(s, k)[1] / strongest.lengths[s] for s in BETWEEN_ORDERS}
        if k % strongest.rotations == 0:
            at[LOAD] = k / strongest.lengths[LOAD]
        gains = {s: [one.gain(s, x * one.lengths[s]) for one in own] for s, x in at.items()}
        totals = {s: sum(gain for gain, _ in each) for s, each in gains.items()}
        near = [s for s in totals if totals[s] >= max(totals.values()) - CLEARLY]
        half = 2.0 * at[MOTOR]
        whole = round(half) > 0 and abs(half - round(half)) * strongest.lengths[MOTOR] < 1.0
        by_order = MOTOR in near and whole
        drawn = MOTOR if by_order else LOAD if LOAD in near else near[0]
        places = []
        for i, (gain, cycles) in enumerate(gains[drawn]):
            if i == first or gain > -math.log(chance):
                own[i].take_out(drawn, cycles)
                places.append((i, len(own[i].cycles) - 1))
        if drawn != LOAD:
            yield drawn if by_order or len(near) == 1 else "angle or time", places


def _line(
    channel: str, own: Sequence[_Residual], dependence: What, places: Sequence[tuple[int, int]]
) -> Unexplained:
    """A line of the motor angle or of time, in all recordings that show it."""
    size, i, k = max((float(own[i].amplitudes[k]), i, k) for i, k in places)
    cycles, lengths = own[i].cycles[k], own[i].lengths
    order = math.nan if dependence == TIME else cycles / lengths[MOTOR]
    hertz = math.nan if dependence == MOTOR else cycles / lengths[TIME]
    shown = tuple(own[i].recording for i, _ in places)
    return Unexplained(channel, dependence, size, unit_of(channel), order, order, hertz, shown)


def _with_load(
    channel: str,
    own: Sequence[_Residual],
    repeating: Sequence[tuple[float, tuple[int, int] | None]],
) -> Iterator[Unexplained]:
    """What repeats with the load: a line of a load order, or a whole band."""
    shown = [
        (one.recording, size, orders)
        for one, (size, orders) in zip(own, repeating, strict=True)
        if orders is not None
    ]
    if shown:
        names, sizes, orders = zip(*shown, strict=True)
        low, high = min(first for first, _ in orders), max(last for _, last in orders)
        size = math.sqrt(2.0 * max(sizes))
        unit = unit_of(channel)
        yield Unexplained(channel, LOAD, size, unit, float(low), float(high), math.nan, names)


def _numbers(channel: str, own: Sequence[_Residual], tests: int) -> Iterator[Unexplained]:
    """What a channel has one of: the largest of those sure."""
    unit, nan = unit_of(channel), math.nan
    every: list[tuple[What, str, list[tuple[float, float]]]] = [
        ("offset", unit, [one.offset for one in own]),
        ("drift", f"{unit}/s", [one.drift_per_s for one in own]),
    ]
    for what, own_unit, unexplained in every:
        sure = {
            one.recording: value
            for one, (value, error) in zip(own, unexplained, strict=True)
            if 2.0 * float(norm.sf(abs(value) / error)) * tests <= SURE
        }
        if sure:
            largest = max(sure.values(), key=abs)
            yield Unexplained(channel, what, largest, own_unit, nan, nan, nan, tuple(sure))
