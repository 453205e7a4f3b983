"""Residuals of steady rotations, and what they repeat with: load angle, motor angle or time.

Averaging over load rotations separates what repeats from noise. Lines are sought in the periodogram
|X_k|²/n over time and over the motor angle: the motor turns unevenly, so a line on one scale has
side bands on the other. Over its floor, the periodogram of noise is standard exponential. With a
whole gear ratio, all that repeats with the motor repeats with the load too. So a line at a whole
load order is separate only if it stands out of the neighbouring load orders. A line belongs to the
scale that explains it best in all recordings together, at their several speeds.
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
"""Probability of any false line, over all channels of all recordings; of any false band that
repeats; and of any false offset, and drift."""

FEWEST_ROTATIONS = 2
MEDIAN_BINS = 201
"""Periodogram bins in the running median, which lines do not affect."""

CLEARLY = 10.0
"""Difference of log likelihoods beyond which a line is sharp on one scale and not on the other."""
NEIGHBOURS = 4
STANDS_OUT = 4.0
"""Power ratio to the neighbouring load orders above which a whole load order is a separate line."""

MOST_LINES = 6
"""Largest number of lines in a channel; weaker ones are mostly side bands."""

MOST_ORDERS = 3
"""Number of motor orders tried as ripples at once. It only limits time: others are sought in the
residual of the best set."""

SIDEBANDS = 2.5
"""Distance in load orders within which a line belongs to a whole motor order: the load torque
modulates it."""

What = Literal["load angle", "motor angle", "time", "angle or time", "offset", "drift"]
Scale = Literal["time", "motor angle", "load angle"]
TIME: Literal["time"] = "time"
MOTOR: Literal["motor angle"] = "motor angle"
LOAD: Literal["load angle"] = "load angle"
TURNING: tuple[What, ...] = (MOTOR, "angle or time")
BETWEEN_ORDERS: tuple[Scale, ...] = (TIME, MOTOR)
"""Scales of lines that need not be at a whole load order."""


@dataclass(frozen=True, slots=True)
class Unexplained:
    """One feature that the simulation does not explain, over all recordings that show it.

    Attributes
    ----------
    dependence
        What it repeats with, or ``offset``, or ``drift`` (over a recording).
    amplitude
        Largest over the recordings, in ``unit``: of the line; for the load angle, of a sine of the
        same RMS; the offset; the drift per second.
    lowest_order, highest_order
        Load orders for the load angle, else motor orders; ``nan`` for none.
    frequency_hz
        Of a line that is or may be periodic in time; else ``nan``.
    recordings
        Names of those that show it.
    chi_squared
        Of the line's test, if it has one.
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
    """Features that noise does not explain.

    ``power``: power of everything but the mean, over that of the noise, summed over recordings and
    channels. The mean is left out because any friction explains it.
    """

    remaining: tuple[Unexplained, ...]
    power: float

    def closes(self, before: ResidualAnalysis) -> float:
        """Share of another analysis' power that this one removes, repeating or not."""
        return 1.0 - self.power / before.power if before.power > 0.0 else 0.0


@dataclass(slots=True, eq=False)
class _Residual:
    """One channel of a recording over whole load rotations, (n,), from which lines are removed.

    Attributes
    ----------
    positions
        Time and motor angle, both in samples.
    lengths
        Length of the record on each scale: seconds, or motor turns.
    cycles
        Cycles in the record of each line that is not a load order.
    waves
        Slope of a drift, then cosine and sine of each of these lines, (n, k).
    of_load
        Load orders that stand out of their neighbours and repeat with nothing else.
    without_lines, noise
        Values without drift and lines, and these without the repeating part.
    floor
        Expected periodogram of the noise, (n // 2 + 1,).
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
    without_lines: FloatArray = field(init=False)
    noise: FloatArray = field(init=False)
    floor: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        self.fit()

    def fit(self) -> None:
        """Fit waves to the non-repeating part, and waves of whole load orders to all of it."""
        n, rotations = self.values.size, self.rotations
        is_whole = np.repeat([False, *(c % rotations == 0.0 for c in self.cycles)], 2)[1:]
        non_repeating_waves = self._without_repeating(self.waves[:, ~is_whole])
        non_repeating = self._without_repeating(self.values[:, None])[:, 0]
        self.coefficients = np.zeros(is_whole.size)
        self.coefficients[~is_whole] = np.linalg.lstsq(non_repeating_waves, non_repeating)[0]
        self.noise = non_repeating - non_repeating_waves @ self.coefficients[~is_whole]
        remainder = self.values - self.waves @ self.coefficients
        whole_waves = self.waves[:, is_whole]
        self.coefficients[is_whole] = np.linalg.lstsq(whole_waves, remainder - remainder.mean())[0]
        self.without_lines = remainder - whole_waves @ self.coefficients[is_whole]
        power = np.abs(np.fft.rfft(self.noise)) ** 2 / n
        between = np.flatnonzero(np.arange(power.size) % rotations)
        median = median_filter(power[between], min(MEDIAN_BINS, between.size)) / math.log(2.0)
        self.floor = np.interp(np.arange(power.size), between, median)

    def _without_repeating(self, columns: FloatArray) -> FloatArray:
        """Remove the part that repeats every rotation from each column, (n, k)."""
        transform = np.fft.rfft(columns, axis=0)
        transform[:: self.rotations] = 0.0
        return np.asarray(np.fft.irfft(transform, len(columns), axis=0))

    def scores(self, scale: Scale) -> FloatArray:
        """Periodogram of the values without lines, over its floor, for every bin of a scale."""
        values, time, position = self.without_lines, self.positions[TIME], self.positions[scale]
        if position is not time:
            values = CubicSpline(time, values)(np.interp(time, position, time))
        power = np.abs(np.fft.rfft(values)) ** 2 / values.size / self.floor
        comb = power[:: self.rotations].copy()
        comb[0] = 0.0
        is_neighbour = np.ones(2 * NEIGHBOURS + 1, dtype=bool)
        is_neighbour[NEIGHBOURS] = False
        windows = np.lib.stride_tricks.sliding_window_view(
            np.pad(comb, NEIGHBOURS), is_neighbour.size
        )
        comb[comb <= STANDS_OUT * windows[:, is_neighbour].max(axis=1)] = 0.0
        comb[self.of_load] = 0.0
        power[:: self.rotations] = comb
        power[: self.rotations] = 0.0  # below a cycle in a rotation is drift
        power[-1] = 0.0
        return power

    def gain(self, scale: Scale, cycles: float) -> tuple[float, float]:
        """Gain in log likelihood by a line near this number of cycles in the record; its position.

        The non-repeating part lacks the share of a line that averaging over rotations removed.
        """
        rotations, position = self.rotations, self.positions[scale]
        if not rotations <= cycles < self.floor.size - 1:
            return 0.0, cycles
        variance = self.values.size * float(self.floor[round(cycles)])
        order = cycles / rotations
        if abs(order - round(order)) * rotations < 0.5:
            whole_cycles = float(round(order) * rotations)
            return _power(
                self.without_lines - self.without_lines.mean(), position, whole_cycles
            ) / variance, whole_cycles

        def off_comb(cycles: float) -> float:
            denominator = rotations * math.sin(math.pi * cycles / rotations)
            kept_share = (
                1.0 - (math.sin(math.pi * cycles) / denominator) ** 2
                if abs(denominator) > 1e-9
                else 0.0
            )
            return -_power(self.noise, position, cycles) / max(kept_share, 1e-3) / variance

        ends = (cycles - 0.9, cycles + 0.9)
        best = minimize_scalar(off_comb, bounds=ends, method="bounded", options={"xatol": 1e-3})
        return -float(best.fun), float(best.x)

    def remove(self, scale: Scale, cycles: float) -> None:
        """Remove a line with its amplitude and phase; the part that repeats with the load stays."""
        if scale == LOAD:
            self.of_load.append(round(cycles / self.rotations))
            return
        angle = 2.0 * np.pi * cycles / self.values.size * self.positions[scale]
        self.waves = np.column_stack([self.waves, np.cos(angle), np.sin(angle)])
        self.cycles.append(cycles)
        self.fit()

    @property
    def amplitudes(self) -> FloatArray:
        """Amplitudes of the lines."""
        return np.asarray(np.hypot(*self.coefficients[1:].reshape(-1, 2).T))

    @property
    def offset(self) -> tuple[float, float]:
        """Mean and its standard error."""
        return float(self.without_lines.mean()), math.sqrt(float(self.floor[0]) / self.values.size)

    @property
    def drift_per_s(self) -> tuple[float, float]:
        """Slope over the recording and its standard error."""
        hertz = self.values.size / self.lengths[TIME]
        length = float(np.linalg.norm(self._without_repeating(self.waves[:, :1])))
        error = math.sqrt(float(self.floor[0])) / length
        return hertz * float(self.coefficients[0]), hertz * error

    def repeating(self, chance: float, tests: int) -> tuple[float, tuple[int, int] | None]:
        """Mean square of what repeats with the load, and the load orders where it stands out.

        ``None`` for the orders if nothing stands out. The mean, lines and the expected share of
        noise are subtracted. ``chance``: false-alarm probability of a single order. A whole band
        may stand out too (Bonferroni over ``tests`` and bands).
        """
        power = (
            np.abs(np.fft.rfft(self.without_lines)[:: self.rotations]) ** 2
            / self.without_lines.size
        )
        floor = self.floor[:: self.rotations]
        ratio = power / floor
        if self.without_lines.size % (2 * self.rotations) == 0:
            ratio[-1] = 0.0  # at half the sampling rate a bin has one degree of freedom only
        bands = []
        for highest in BANDS[1:]:
            band = ratio[1 : highest + 1]
            bands.append((float(chi2.sf(2.0 * band.sum(), 2 * band.size)), highest))
        probability, highest = min(bands)
        significant = np.flatnonzero(ratio > math.log(ratio.size / chance))
        highest = max(highest, int(significant.max(initial=0)))
        excess = 2.0 / self.without_lines.size * float((power - floor)[1 : highest + 1].sum())
        orders = (1, highest) if len(bands) * probability * tests <= FALSE_LINES else None
        if (significant := significant[significant > 0]).size:
            orders = int(significant[0]), int(significant[-1])
        return max(excess, 0.0), orders

    def over_noise(self, repeating: float) -> float:
        """Power of the repeating part, lines and drift, over the noise power."""
        removed = float(np.mean((self.values - self.without_lines) ** 2))
        return (repeating + removed) / float(np.mean(self.floor[:-1]))


def _power(values: FloatArray, position: FloatArray, cycles: float) -> float:
    return float(abs(values @ np.exp(-2j * np.pi * cycles / values.size * position)) ** 2)


def residuals_of(fit: SimulatedFit) -> ResidualAnalysis:
    """Analyse the residuals of a fit's steady rotations.

    Motions, and recordings whose motor lines are marginalised, are left out.
    """
    model = fit.model
    steady = [
        i for i, r in enumerate(model.recordings) if r.motion is None and r.motor_lines is None
    ]
    predictions = [fit.simulated(i) for i in steady]
    # Bridged samples contain nothing that repeats.
    observations = [
        replace(r, signals=prediction + r.residual_of(prediction))
        for r, prediction in zip((model.recordings[i] for i in steady), predictions, strict=True)
    ]
    return analyse_residuals(observations, predictions)


def motor_orders(fit: SimulatedFit) -> list[float]:
    """Whole motor orders in the residual of a fit, a few, the strongest first.

    Returns none for recordings that hold less than two rotations.
    """
    tolerance = SIDEBANDS / fit.model.bench.value("gear_ratio")
    try:
        remaining = residuals_of(fit).remaining
    except RecordingError:
        return []
    shares: dict[float, float] = {}
    for entry, share in with_shares(remaining):
        whole_order = float(round(entry.lowest_order)) if entry.dependence in TURNING else 0.0
        if whole_order and abs(entry.lowest_order - whole_order) < tolerance:
            shares[whole_order] = shares.get(whole_order, 0.0) + share
    return sorted(shares, key=lambda order: -shares[order])[:MOST_ORDERS]


def with_shares(remaining: Sequence[Unexplained]) -> Iterator[tuple[Unexplained, float]]:
    """Each entry with its share in the power of all entries of its channel."""
    for entry in remaining:
        power = sum(e.amplitude**2 for e in remaining if e.channel == entry.channel)
        yield entry, entry.amplitude**2 / power


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
        Probability of any false line.

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
        residuals = [
            _residual(observation, prediction, channel)
            for observation, prediction in pairs
            if channel in observation.channels
        ]
        lines = list(_lines(residuals, false_lines / tests))
        repeating = [residual.repeating(false_lines / tests, tests) for residual in residuals]
        power += sum(
            residual.over_noise(size)
            for residual, (size, _) in zip(residuals, repeating, strict=True)
        )
        remaining += _with_load(channel, residuals, repeating)
        remaining += (_line(channel, residuals, *line) for line in lines)
        remaining += _offset_and_drift(channel, residuals, tests)
    return ResidualAnalysis(tuple(remaining), power)


def _residual(observation: Observed, simulated: FloatArray, channel: str) -> _Residual:
    """Residual of one channel over whole load rotations, to the nearest sample.

    The motor angle is the integral of the simulated speed, which has no noise.
    """
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
    motor_angle = time
    if MOTOR_SPEED in observation.channels:
        from scipy.integrate import cumulative_trapezoid

        speed = np.abs(simulated[observation.channels.index(MOTOR_SPEED), :n]) / 60.0
        motor_angle = cumulative_trapezoid(
            speed, dx=n / observation.sampling_hz / turns, initial=0.0
        )
    lengths: dict[Scale, float] = {TIME: n / observation.sampling_hz, MOTOR: turns, LOAD: turns}
    positions: dict[Scale, FloatArray] = {TIME: time, MOTOR: motor_angle, LOAD: time}
    values = (observation.signals - simulated)[row, :n]
    return _Residual(
        observation.name, values, rotations, positions, lengths, (time - time.mean())[:, None]
    )


def _lines(
    residuals: Sequence[_Residual], chance: float
) -> Iterator[tuple[What, list[tuple[int, int]]]]:
    """Remove the lines of one channel from every recording that shows them, the strongest first.

    Yields what each line repeats with, unless that is the load alone, and its (recording, line)
    indices.
    """
    for _ in range(MOST_LINES):
        peaks: list[tuple[float, int, Scale, int]] = []
        for i, residual in enumerate(residuals):
            for scale in BETWEEN_ORDERS:
                score = residual.scores(scale)
                k = int(np.argmax(score))
                peaks.append((float(score[k]) - math.log(2.0 * score.size), i, scale, k))
        highest, strongest_index, _, k = max(peaks)
        if highest < -math.log(chance):
            return
        # Position of the line on each scale, per second or per motor turn.
        strongest = residuals[strongest_index]
        positions = {s: strongest.gain(s, k)[1] / strongest.lengths[s] for s in BETWEEN_ORDERS}
        if k % strongest.rotations == 0:
            positions[LOAD] = k / strongest.lengths[LOAD]
        gains = {
            s: [residual.gain(s, x * residual.lengths[s]) for residual in residuals]
            for s, x in positions.items()
        }
        totals = {s: sum(gain for gain, _ in pairs) for s, pairs in gains.items()}
        plausible = [s for s in totals if totals[s] >= max(totals.values()) - CLEARLY]
        half_orders = 2.0 * positions[MOTOR]
        is_whole = (
            round(half_orders) > 0
            and abs(half_orders - round(half_orders)) * strongest.lengths[MOTOR] < 1.0
        )
        by_order = MOTOR in plausible and is_whole
        best_scale = MOTOR if by_order else LOAD if LOAD in plausible else plausible[0]
        places = []
        for i, (gain, cycles) in enumerate(gains[best_scale]):
            if i == strongest_index or gain > -math.log(chance):
                residuals[i].remove(best_scale, cycles)
                places.append((i, len(residuals[i].cycles) - 1))
        if best_scale != LOAD:
            yield best_scale if by_order or len(plausible) == 1 else "angle or time", places


def _line(
    channel: str,
    residuals: Sequence[_Residual],
    dependence: What,
    places: Sequence[tuple[int, int]],
) -> Unexplained:
    """A line of the motor angle or of time, in all recordings that show it."""
    size, i, k = max((float(residuals[i].amplitudes[k]), i, k) for i, k in places)
    cycles, lengths = residuals[i].cycles[k], residuals[i].lengths
    order = math.nan if dependence == TIME else cycles / lengths[MOTOR]
    hertz = math.nan if dependence == MOTOR else cycles / lengths[TIME]
    shown = tuple(residuals[i].recording for i, _ in places)
    return Unexplained(channel, dependence, size, unit_of(channel), order, order, hertz, shown)


def _with_load(
    channel: str,
    residuals: Sequence[_Residual],
    repeating: Sequence[tuple[float, tuple[int, int] | None]],
) -> Iterator[Unexplained]:
    """What repeats with the load: a line of a load order, or a whole band."""
    shown = [
        (residual.recording, size, orders)
        for residual, (size, orders) in zip(residuals, repeating, strict=True)
        if orders is not None
    ]
    if shown:
        names, sizes, orders = zip(*shown, strict=True)
        low, high = min(first for first, _ in orders), max(last for _, last in orders)
        size = math.sqrt(2.0 * max(sizes))
        unit = unit_of(channel)
        yield Unexplained(channel, LOAD, size, unit, float(low), float(high), math.nan, names)


def _offset_and_drift(
    channel: str, residuals: Sequence[_Residual], tests: int
) -> Iterator[Unexplained]:
    """Significant offset and drift of a channel, the largest over the recordings."""
    unit, nan = unit_of(channel), math.nan
    quantities: list[tuple[What, str, list[tuple[float, float]]]] = [
        ("offset", unit, [residual.offset for residual in residuals]),
        ("drift", f"{unit}/s", [residual.drift_per_s for residual in residuals]),
    ]
    for kind, quantity_unit, unexplained in quantities:
        significant = {
            residual.recording: value
            for residual, (value, error) in zip(residuals, unexplained, strict=True)
            if 2.0 * float(norm.sf(abs(value) / error)) * tests <= FALSE_LINES
        }
        if significant:
            largest = max(significant.values(), key=abs)
            yield Unexplained(
                channel, kind, largest, quantity_unit, nan, nan, nan, tuple(significant)
            )
