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
from bayesbl.matching.observed import Observed, begin_of
from bayesbl.matching.predictive_check import whole_rotations
from bayesbl.matching.simulation_cache import RecentSimulations
from bayesbl.noise.channel_noise import ChannelNoise
from bayesbl.recording.types import FloatArray
from bayesbl.units import RPM_PER_RAD_PER_S

ComplexArray = NDArray[np.complex128]

ROTATIONS = 40
"""Simulated with noise, at least: the factor's root is then good to a ninth."""

LEAST_SHARE = 0.05
"""Of the noise's power: less in the loop widens no interval by a tenth."""

UNKNOWN_SHARES = (np.arange(10) + 0.5) / 10
"""Without a current any share is as likely as any other."""


def turns_of(rows: FloatArray, seen: Observed) -> FloatArray:
    """Whitened channels (c, n − p) of each rotation one after the other, (rotation, c lag).

    Of a motion its cycles; of one that does not repeat, a single one.
    """
    lag = seen.lag
    if seen.motion is not None and seen.cycle is None:
        lag = rows.shape[1] - begin_of(seen)
    return np.concatenate([whole_rotations(row[begin_of(seen) :], lag) for row in rows], axis=1)


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
    samples = seen.samples
    impulse = np.zeros(min(samples, seen.lag))
    impulse[0] = 1.0
    moved, answer = noise_through_loop(parameters, impulse, 1.0 / seen.sampling_hz)
    in_speed, in_current = (np.fft.rfft(row, samples) for row in (impulse + moved, answer))
    held_down = np.abs(in_speed) < 1.0
    shaping = _shaping(noise, samples)
    shares = UNKNOWN_SHARES
    if len(seen.signals) > 1:
        shares = np.array([_share(shaping[~held_down], (in_current / in_speed)[~held_down])])
        if shares[0] < LEAST_SHARE:
            return np.ones(1)
    # Of what the loop holds down only what is left is known, and that may come from elsewhere.
    sensor = shaping[:, 0] / np.where(held_down, 1.0, in_speed)[:, None]
    factor = _simulated_factor(fit, place, along, sensor)
    return 1.0 + shares * max(factor - 1.0, 0.0) if math.isfinite(factor) else np.ones(1)


def _shaping(noise: ChannelNoise, samples: int) -> ComplexArray:
    """Of white noise to that of the channels, by frequency, shape (n//2 + 1, c, c)."""
    turn = np.exp(-2j * math.pi * np.fft.rfftfreq(samples))
    powers = turn[:, None] ** np.arange(1, noise.order + 1)
    inverse = np.eye(len(noise.root)) - np.einsum("fk,kab->fab", powers, noise.coefficients)
    return np.asarray(np.linalg.solve(inverse, np.broadcast_to(noise.root, inverse.shape)))


def _share(shaping: ComplexArray, gain: ComplexArray) -> float:
    """Of the speed's noise that the current answers as the controller does, between 0 and 1.

    ``gain``: of current by speed around the loop, by frequency.
    """
    speed, current = shaping[:, 0], shaping[:, 1]
    both = np.sum(current * speed.conj(), axis=1)
    power = np.sum(np.abs(speed) ** 2, axis=1)
    answered = float(np.sum(np.real(both * gain.conj())) / np.sum(power * np.abs(gain) ** 2))
    return min(max(answered, 0.0), 1.0)


def _simulated_factor(
    fit: SimulatedFit, place: int, along: FloatArray, sensor: ComplexArray
) -> float:
    """Variance of what noise in the loop adds along some change, over that of the whitened noise.

    ``sensor``: of white noise to that of the speed sensor, by frequency, (n//2 + 1, c).
    """
    seen, noise = fit.model.recordings[place], fit.model.noise[place]
    undisturbed = _simulated(fit, place, np.zeros(seen.samples))
    rng = np.random.default_rng(0)  # a fixed sample of an integral, not a draw of the answer
    squares: list[float] = []
    while len(squares) < ROTATIONS:
        white = rng.standard_normal((seen.samples, sensor.shape[1]))
        drawn = np.einsum("fc,fc->f", sensor, np.fft.rfft(white, axis=0))
        disturbance = np.fft.irfft(drawn, seen.samples)
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
