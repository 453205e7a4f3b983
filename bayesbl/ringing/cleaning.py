"""What makes one rotation unlike the next, apart from noise: found, removed and reported.

Three faults, in the order they are looked for. Each finder compares rotations with one another, so
that a misfit which repeats is never taken for a fault, and returns the recording as it would be
without it. A is then the least-squares amplitude of that recording, as the gap curve means it.

Before them lines of the motor are taken out. A ripple of the torque, a transmission error or an
encoder off centre makes a wave at a whole order of the motor's angle that goes on all the time.
Near the ringing's frequency pulses at every few turns of the motor explain it better than any
explain the impacts. Ringing is there for a short time behind each impact only, so the median over
the turns is the line alone. What that takes from the ringing is a single one of hundreds of load
orders. Behind a gear of a low ratio the motor turns only a few times between two impacts, and
ringing may fill most of its turns: it has another phase in each, where a line has the same in all.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesbl.noise.rotation_noise import (
    Noise,
    bridged,
    estimate_noise,
    innovations,
    rotation_difference,
)
from bayesbl.probabilities import chi2_isf, normal_isf, poisson_isf
from bayesbl.recording.types import MOTOR_CURRENT, MOTOR_SPEED, ComplexArray, FloatArray, Recording
from bayesbl.ringing.optimum import Optimum
from bayesbl.ringing.symbols import (
    AMPLITUDE,
    FREQUENCY,
    MEAN,
    ROTATION,
    SEPARATION,
    START,
    WINDOW_END,
    WINDOW_START,
)
from bayesbl.ringing.waveform import impacts, jacobian, jacobian_columns
from bayesbl.units import RPM_PER_RAD_PER_S

FALSE_ALARM = 1e-5
"""Of each finder, per recording; of lines over all orders."""

HIGHEST_ORDER = 12
FEWEST_SAMPLES = 2.5
"""In a period of the line."""

FEWEST_TURNS = 20
SMALLEST_LINE = 0.02
"""As a share of half the range of the speed, about the ringing's amplitude: a smaller line moves
that by no more than such a share, and a bench without noise has some of every order."""

UNSTEADY_SHARE = 0.75
"""Of its size, by which the quartiles over the turns may be off it along its phase. Of ringing
that filled the turns, 37 cases at gear ratios 6 to 10, the lower one was off by 0.97 or more; of
lines of 1 rpm in noise of 1.5 rpm at 1 kHz by 0.58 at most."""

ROUNDS = 3
"""Each leaves a few per cent of the line, as no turn has a whole number of samples."""


@dataclass(frozen=True, slots=True)
class MotorLine:
    """Amplitude of a line in the speed, at a whole order of the motor, with its standard error."""

    order: int
    size_rpm: float
    standard_error_rpm: float


def without_motor_lines(recording: Recording) -> tuple[Recording, tuple[MotorLine, ...]]:
    """The recording without such lines, and each of them that stands out."""
    speed = recording.motor_speed_rpm
    angle = np.cumsum(speed * np.gradient(recording.time_s)) / RPM_PER_RAD_PER_S
    turns = np.maximum.accumulate(np.abs(angle - angle[0])) // (2.0 * math.pi)
    begins = np.searchsorted(turns, np.arange(turns[-1] + 1.0))
    if begins.size - 1 < FEWEST_TURNS:
        return recording, ()
    samples_per_turn = (begins[-1] - begins[0]) / (begins.size - 1)
    highest = min(HIGHEST_ORDER, int(samples_per_turn / FEWEST_SAMPLES))
    bound = normal_isf(0.5 * FALSE_ALARM / max(2 * highest, 1))
    least = SMALLEST_LINE * 0.5 * float(np.ptp(speed))
    # The controller answers the line: with one of the two left, its law would not hold.
    left = {n: row for n, row in recording.channels.items() if n in (MOTOR_SPEED, MOTOR_CURRENT)}
    sizes: dict[int, complex] = {}
    errors: dict[int, float] = {}
    for order in range(1, highest + 1):
        each = _each_turn(left[MOTOR_SPEED], np.exp(1j * order * angle), begins)
        line, error = _line(each)
        if abs(line) > max(least, bound * error) and _is_steady(each, line):
            errors[order] = error
            sizes[order] = _take(left, np.exp(1j * order * angle), begins)
    if not sizes:
        return recording, ()
    for _ in range(ROUNDS):
        for order in sizes:
            sizes[order] += _take(left, np.exp(1j * order * angle), begins)
    lines = tuple(MotorLine(order, abs(size), errors[order]) for order, size in sizes.items())
    return replace(recording, channels={**recording.channels, **left}), lines


def in_words(lines: Sequence[MotorLine]) -> str:
    """What was taken out, as a note."""
    listed = " and ".join(f"{line.size_rpm:.2g} rpm at motor order {line.order}" for line in lines)
    return (
        f"A line of {listed} was taken out of the speed: a ripple of the torque, an error of "
        "transmission or encoder, not the impacts."
    )


def _take(channels: dict[str, FloatArray], wave: ComplexArray, begins: NDArray[np.intp]) -> complex:
    """Subtract the line from each channel; returns what it was in the speed."""
    lines = {n: _line(_each_turn(row, wave, begins))[0] for n, row in channels.items()}
    for name, line in lines.items():
        channels[name] = channels[name] - (line * wave).real
    return lines[MOTOR_SPEED]


def _each_turn(values: FloatArray, wave: ComplexArray, begins: NDArray[np.intp]) -> ComplexArray:
    """Amplitude c of Re(c · wave) in each turn, about its mean, shape (turns,)."""
    whole = slice(int(begins[0]), int(begins[-1]))
    starts, counts = begins[:-1] - begins[0], np.diff(begins)
    mean = np.repeat(np.add.reduceat(values[whole], starts) / counts, counts)
    turned = (values[whole] - mean) * wave[whole].conj()
    return np.asarray(2.0 * np.add.reduceat(turned, starts) / counts)


def _line(each: ComplexArray) -> tuple[complex, float]:
    """Median over turns (turns,), and its standard error."""
    parts = np.stack([each.real, each.imag])
    middle = np.median(parts, axis=1)
    scatter = 1.4826 * np.median(np.abs(parts - middle[:, None]), axis=1)
    # A median is less sharp than a mean by the square root of π/2.
    error = math.sqrt(0.5 * math.pi / each.size) * float(np.linalg.norm(scatter))
    return complex(middle[0], middle[1]), error


def _is_steady(each: ComplexArray, line: complex) -> bool:
    """Whether the middle half of the turns, (turns,), have the line with its size and phase."""
    along = np.real(each * np.conj(line)) / abs(line) ** 2
    low, high = np.quantile(along, [0.25, 0.75])
    return bool(max(1.0 - low, high - 1.0) < UNSTEADY_SHARE)


SMALLEST_SHARE = 1e-5
"""A drift below this share of the speed moves no impact by more than 0.1 ms a minute."""

_DRIFT_DEGREE = 2
_OUTLIER = 6.0
_SMALLEST_OUTLIER = 0.01
_SMALLEST_LOSS = 0.01
_BURST_S = 0.05


@dataclass(frozen=True, slots=True)
class Mended:
    """A recording without a fault, and what the reader should know about it."""

    recording: Recording
    note: str


def without_bursts(
    recording: Recording, optimum: Optimum, residual_rpm: FloatArray, noise: Noise
) -> Mended | None:
    """Bursts of outliers replaced by what the nearest other rotation shows at that angle.

    A burst is a stretch of 0.05 s that holds more innovations beyond six robust standard deviations
    than their rate over the recording, high with Student-t noise, explains. Outliers below a
    hundredth of A do not count: with hardly any noise, impacts themselves are not quite alike.
    """
    if noise.differentiated:
        return None
    period_s, rotation_s = recording.sampling_period_s, optimum.symbols[ROTATION]
    lag, n = round(rotation_s / period_s), recording.samples
    e = innovations(rotation_difference(residual_rpm, rotation_s, period_s), noise.coefficients)
    limit = max(
        _OUTLIER * 1.4826 * float(np.nanmedian(np.abs(e))),
        _SMALLEST_OUTLIER * optimum.symbols[AMPLITUDE],
    )
    width = max(3, round(_BURST_S / period_s))
    outlier = np.abs(e) > limit
    count = np.convolve(outlier, np.ones(width), "same")
    # Bursts would hide in their own rate. So it is the rate of all but the worst tenth of the
    # stretches, doubled, which more than makes up for leaving those out.
    stretches = np.sort(outlier[: e.size // width * width].reshape(-1, width).sum(axis=1))
    rate = 2.0 * float(stretches[: int(0.9 * len(stretches))].mean()) + 0.01
    many = max(3.0, float(poisson_isf(FALSE_ALARM / e.size, rate)))
    at = np.flatnonzero((count > many) & outlier)
    if not at.size:
        return None
    residual_rpm = bridged(residual_rpm)
    # A difference shows only that one of two rotations is off: take the one further from zero.
    bad = np.zeros(n, dtype=bool)
    for i in at + noise.order:
        middle = int(i)
        begin, end = max(0, middle - width // 2), middle + width // 2 + 1
        pair = (slice(begin, end), slice(begin + lag, end + lag))
        bad[max(pair, key=lambda part: float(np.sum(residual_rpm[part] ** 2)))] = True
    sources = np.stack([np.arange(n) + lag, np.arange(n) - lag])
    usable = (sources >= 0) & (sources < n)
    usable &= ~bad[np.clip(sources, 0, n - 1)]
    source = np.where(usable[0], sources[0], sources[1])
    replaced = bad & usable.any(axis=0)
    model = recording.motor_speed_rpm - residual_rpm
    speed = recording.motor_speed_rpm.copy()
    speed[replaced] = model[replaced] + residual_rpm[source[replaced]]
    share = 100.0 * float(bad.mean())
    note = f"Bursts of outliers, {share:.2g} % of the recording, were replaced by other rotations."
    if not np.array_equal(replaced, bad):
        note = f"Bursts of outliers, {share:.2g} % of the recording, could not all be replaced."
    return Mended(_with_speed(recording, speed), note)


def without_drift(
    recording: Recording, optimum: Optimum, residual_rpm: FloatArray, noise: Noise
) -> Mended | None:
    """Remove a drift of the speed, a parabola in time, and what it does to the impacts' times.

    Its coefficients are sums over the differences between rotations, in which a misfit cancels. As
    the load comes round sooner when the motor is faster, the time axis is stretched too, unless the
    impacts show that only the sensor drifts.
    """
    period_s, n = recording.sampling_period_s, recording.samples
    mean = optimum.symbols[MEAN]
    x = np.linspace(-1.0, 1.0, n)
    powers = np.stack([x**k for k in range(1, _DRIFT_DEGREE + 1)], axis=1)
    lag = max(1, round(optimum.symbols[ROTATION] / period_s))
    weights = np.linalg.pinv(powers[lag:] - powers[:-lag]).T
    # As sums over the residual itself, whose covariance is known.
    on_residual = np.pad(weights, ((lag, 0), (0, 0))) - np.pad(weights, ((0, lag), (0, 0)))
    residual_rpm = bridged(residual_rpm)
    coefficients = residual_rpm @ on_residual
    drift = powers @ coefficients
    steady = estimate_noise(residual_rpm - drift, optimum.symbols[ROTATION], period_s)
    spread = on_residual.T @ steady.covariance_times(on_residual)
    size = float(coefficients @ np.linalg.solve(spread, coefficients))
    if size < chi2_isf(FALSE_ALARM, _DRIFT_DEGREE) or np.ptp(drift) < SMALLEST_SHARE * abs(mean):
        return None
    ahead_s = np.r_[0.0, np.cumsum(0.5 * (drift[1:] + drift[:-1]))] * period_s / mean
    ahead_s -= np.linspace(0.0, ahead_s[-1], n)
    follow = _impacts_follow(recording, optimum, residual_rpm - drift, ahead_s)
    level = recording.motor_speed_rpm - drift + drift.mean()
    note = f"The speed drifts by {np.ptp(drift):.2g} rpm over the recording"
    note += "; this was removed." if follow else ", the impacts do not; this was removed."
    return Mended(_turned_evenly(recording, level, ahead_s if follow else 0.0 * ahead_s), note)


def without_jitter(
    recording: Recording, optimum: Optimum, residual_rpm: FloatArray, noise: Noise
) -> Mended | None:
    """Move impacts that come early or late to where steady rotation has them.

    Each impact's delay is the residual's regression on the slope of the model there. Two rotations
    are too few to tell.
    """
    time_s = recording.time_s
    columns = jacobian(optimum.model, time_s, optimum.symbols, optimum.baseline_rpm)
    names = jacobian_columns(optimum.model)
    if not {START, SEPARATION, ROTATION} <= set(names):
        return None
    later = columns[:, names.index(START)]
    starts, signs = _impacts(optimum, recording)
    window = optimum.symbols[WINDOW_END] - optimum.symbols[WINDOW_START]
    inside = (time_s[:, None] >= starts) & (time_s[:, None] < starts + window)
    power = (inside * later[:, None] ** 2).sum(axis=0)
    whole = power > 0.5 * power.max()
    starts, signs = starts[whole], signs[whole]
    on_residual = inside[:, whole] * later[:, None] / power[whole]
    delay_s = np.nan_to_num(residual_rpm) @ on_residual
    spread = on_residual.T @ noise.covariance_times(on_residual)
    # What the steady model is free to do: start, period and separation.
    steady = np.stack([np.ones(starts.size), starts, signs], axis=1)
    if starts.size < steady.shape[1] + 3:
        return None
    # One outlier can move one impact: the others alone must be uneven as well.
    uneven = min(
        _unevenness(np.delete(delay_s, i), np.delete(np.delete(spread, i, 0), i, 1), others)
        for i, others in enumerate(np.delete(steady, i, axis=0) for i in range(starts.size))
    )
    freedom = starts.size - steady.shape[1]
    left = np.linalg.svd(steady)[0][:, steady.shape[1] :]
    delay_s = left @ (left.T @ delay_s)
    excess = float(delay_s @ delay_s - np.trace(left.T @ spread @ left)) / freedom
    if uneven < chi2_isf(FALSE_ALARM, freedom - 1) or excess <= 0.0:
        return None
    order = np.argsort(starts)
    middle = starts[order] + 0.5 * window
    ahead_s = -np.interp(time_s, middle, delay_s[order])
    jitter_s = math.sqrt(excess)
    # Sums of waves out of step by s lose ω²s²/2.
    loss = 50.0 * (optimum.symbols[FREQUENCY] * jitter_s) ** 2
    if loss < _SMALLEST_LOSS:
        return None
    note = (
        f"Impacts come {1e3 * jitter_s:.2g} ms (sd) early or late, which would make A {loss:.2g} % "
        "too small; they were moved back to even rotations."
    )
    return Mended(_turned_evenly(recording, recording.motor_speed_rpm, ahead_s), note)


Finder = Callable[[Recording, Optimum, FloatArray, Noise], Mended | None]

FINDERS: tuple[Finder, ...] = (without_bursts, without_drift, without_jitter)


def _turned_evenly(recording: Recording, speed_rpm: FloatArray, ahead_s: FloatArray) -> Recording:
    """The recording over a time in which the load turns evenly; ``ahead_s`` is its lead."""
    made = _with_speed(recording, speed_rpm)
    if not np.any(ahead_s):
        return made
    from scipy.interpolate import CubicSpline

    time_s, excluded = recording.time_s, recording.excluded
    # t + ahead(t) = u solved for t by substitution; ahead changes by parts in a thousand.
    at = time_s - np.interp(time_s - ahead_s, time_s, ahead_s)
    at = np.clip(at, time_s[0], time_s[-1])
    if excluded is not None:
        excluded = np.interp(at, time_s, excluded.astype(float)) > 0.0
    turned = {name: CubicSpline(time_s, row)(at) for name, row in made.channels.items()}
    return replace(made, channels=turned, excluded=excluded)


def _with_speed(recording: Recording, speed_rpm: FloatArray) -> Recording:
    """Another speed beside the other channels, which tell what else changed in the joint."""
    return replace(recording, channels={**recording.channels, MOTOR_SPEED: speed_rpm})


def _unevenness(delay_s: FloatArray, spread: FloatArray, steady: FloatArray) -> float:
    """χ² of the delays after a fit of ``steady``'s columns."""
    left = np.linalg.svd(steady)[0][:, steady.shape[1] :]
    over = left.T @ delay_s
    return float(over @ np.linalg.solve(left.T @ spread @ left, over))


def _impacts(optimum: Optimum, recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Start and sign of every impact in the recording, shapes (i,)."""
    begin_s, end_s = float(recording.time_s[0]), float(recording.time_s[-1])
    found = impacts(optimum.symbols, begin_s, end_s, recording.sampling_period_s)
    starts_and_signs = np.array([(start, sign) for sign, start, _ in found])
    return starts_and_signs[:, 0], starts_and_signs[:, 1]


def _impacts_follow(
    recording: Recording, optimum: Optimum, residual_rpm: FloatArray, ahead_s: FloatArray
) -> bool:
    """Whether the impacts show more than half of the load's lead."""
    names = jacobian_columns(optimum.model)
    if START not in names:
        return True
    columns = jacobian(optimum.model, recording.time_s, optimum.symbols, optimum.baseline_rpm)
    earlier = -columns[:, names.index(START)] * ahead_s
    columns = columns / np.linalg.norm(columns, axis=0)
    own = earlier - columns @ np.linalg.lstsq(columns, earlier, rcond=None)[0]
    return bool(own @ residual_rpm > 0.5 * (own @ own))
