"""Noise that goes round in the speed loop, and what it does to the impacts.

A controller answers the noise of its speed sensor, so the motor moves with it. On a tooth flank
that is linear: with S and H the loop's answer in speed and current, noise n of the sensor is S n
and H n in the channels, part of their noise like any other. At an impact it is not: the load meets
the flank earlier or harder, and the ringing after it differs. So n is drawn and simulated, as a
reference that is less by it, on the fitted bench with its gap.

How much of the noise goes round is seen by the current: what the recorder adds does not move it.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bayesbl.bench.motion import Motion, held_motion, through
from bayesbl.bench.steady import noise_through_loop
from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.observed import ROUNDING, Observed, begin_of
from bayesbl.matching.simulation_cache import RecentSimulations
from bayesbl.recording.types import FloatArray
from bayesbl.units import RPM_PER_RAD_PER_S

ComplexArray = NDArray[np.complex128]

ROTATIONS = 40
"""Simulated with noise, at least: the factor's root is then good to a ninth."""

LEAST_SHARE = 0.05
"""Of the noise's power: less in the loop widens no interval by a tenth."""

STRETCHES = 16
"""Of a recording, whose spectra are averaged."""

UNKNOWN_SHARES = (np.arange(10) + 0.5) / 10
"""Without a current any share is as likely as any other."""


def turns_of(rows: FloatArray, seen: Observed) -> FloatArray:
    """Whitened channels (c, n − p) of each rotation one after the other, (rotation, c lag).

    Of a motion its cycles; of one that does not repeat, a single one. What the last lacks by its
    rounding is taken for zero.
    """
    rows = rows[:, begin_of(seen) :]
    lag = seen.lag if seen.motion is None or seen.cycle is not None else rows.shape[1]
    count = math.floor(rows.shape[1] / lag + ROUNDING)
    whole = np.pad(rows, ((0, 0), (0, lag)))[:, : count * lag]
    return whole.reshape(len(rows), count, lag).swapaxes(0, 1).reshape(count, -1)


def impact_factors(fit: SimulatedFit, place: int, along: FloatArray) -> FloatArray:
    """By how much noise in the loop raises the variance of a recording's gap, some likely values.

    ``along``: change of the whitened rotations that the gap is read by, as :func:`turns_of` has
    them. 1 where noise is not in the loop, or where it cannot be told from rounding.
    """
    model = fit.model
    seen, noise = model.recordings[place], model.noise[place]
    if noise.repeats:
        return np.ones(1)
    parameters = model.vectors(fit.point[None], seen)[0]
    frequency, speed_power, cross_power = _spectra(fit, place)
    in_speed, in_current = _around_the_loop(parameters, seen, frequency)
    # What the loop holds down is hardly seen, and what is seen there may come from elsewhere.
    passed = np.flatnonzero(np.abs(in_speed) >= 1.0)
    shares = UNKNOWN_SHARES
    if len(seen.signals) > 1:
        gain, power = in_current[passed] / in_speed[passed], speed_power[passed]
        answered = np.sum(np.real(cross_power[passed] * gain.conj()))
        share = float(answered / np.sum(power * np.abs(gain) ** 2))
        if share < LEAST_SHARE:
            return np.ones(1)
        shares = np.array([min(share, 1.0)])
    sensor_power = speed_power[passed] / np.abs(in_speed[passed]) ** 2
    lowest = frequency[passed] <= 2.0 * frequency[passed[0]]
    level = float(sensor_power[lowest].mean())
    every = np.fft.rfftfreq(seen.samples)
    sensor = np.sqrt(np.interp(every, frequency[passed], sensor_power, left=level))
    factor = _simulated_factor(fit, place, along, sensor)
    return 1.0 + shares * max(factor - 1.0, 0.0) if math.isfinite(factor) else np.ones(1)


def _around_the_loop(
    parameters: FloatArray, seen: Observed, frequency: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    """S and H at frequencies in cycles per sample, each of their shape."""
    impulse = np.zeros(min(seen.samples, seen.lag))
    impulse[0] = 1.0
    moved, answer = noise_through_loop(parameters, impulse, 1.0 / seen.sampling_hz)
    grid = np.fft.rfftfreq(impulse.size)
    found = (np.fft.rfft(row) for row in (impulse + moved, answer))
    in_speed, in_current = (np.interp(frequency, grid, row) for row in found)
    return in_speed, in_current


def _spectra(fit: SimulatedFit, place: int) -> tuple[FloatArray, FloatArray, ComplexArray]:
    """Frequency in cycles per sample, power of the speed's noise, current times speed conjugate.

    By Welch's method, of what does not repeat; white noise has its variance for power.
    """
    model, seen = fit.model, fit.model.recordings[place]
    left = seen.left_by(model.signals(fit.point[None], place)[0])
    if seen.motion is None or seen.cycle is not None:
        left = (left[:, seen.lag :] - left[:, : -seen.lag]) / math.sqrt(2.0)
    size = left.shape[1] // STRETCHES
    window = np.hanning(size + 2)[1:-1]
    stretches = np.lib.stride_tricks.sliding_window_view(left, size, axis=1)[:, :: size // 2]
    found = np.fft.rfft(stretches * window, axis=2) / np.sqrt(np.sum(window**2))
    power: FloatArray = np.mean(np.abs(found[0]) ** 2, axis=0)
    cross: ComplexArray = np.mean(found[-1] * found[0].conj(), axis=0)
    return np.asarray(np.fft.rfftfreq(size), dtype=np.float64), power, cross


def _simulated_factor(
    fit: SimulatedFit, place: int, along: FloatArray, sensor: FloatArray
) -> float:
    """Variance of what noise in the loop adds along some change, over that of the whitened noise.

    ``sensor``: of white noise to that of the speed sensor, by frequency, (n//2 + 1,).
    """
    seen, noise = fit.model.recordings[place], fit.model.noise[place]
    undisturbed = _simulated(fit, place, np.zeros(seen.samples))
    rng = np.random.default_rng(0)  # a fixed sample of an integral, not a draw of the answer
    squares: list[float] = []
    while len(squares) < ROTATIONS:
        white = np.fft.rfft(rng.standard_normal(seen.samples))
        disturbance = np.fft.irfft(sensor * white, seen.samples)
        added = _simulated(fit, place, disturbance) - undisturbed
        added[0] += disturbance
        projected = np.sum(turns_of(noise.whiten(added), seen) * along, axis=1)
        squares += list(projected**2 / np.sum(along**2, axis=1))
    return float(np.mean(squares))


def _simulated(fit: SimulatedFit, place: int, disturbance_rpm: FloatArray) -> FloatArray:
    """Channels (c, n) of a recording whose loop is asked for that much less from tick to tick."""
    model, seen = fit.model, fit.model.recordings[place]
    time = np.arange(seen.samples) / seen.sampling_hz
    asked = np.full(seen.samples, seen.reference_speed_rpm)
    known = {"reference_speed_rpm": seen.reference_speed_rpm, **seen.known}
    if seen.motion is not None:
        asked, known = seen.motion.speed_rpm(time), dict(seen.known)
    speed = (asked - disturbance_rpm) / RPM_PER_RAD_PER_S
    ticks = held_motion(Motion(through(time, speed), time[-1]), seen.samples, seen.sampling_hz)
    alone = replace(
        model,
        recordings=[replace(seen, motion=ticks, cycle=None, known=known)],
        noise=[model.noise[place]],
        recent=RecentSimulations(),
    )
    return np.asarray(alone.signals(fit.point[None], 0)[0])
