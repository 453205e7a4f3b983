"""Sensor noise fed back by the speed loop, and its effect on the impacts.

A controller responds to the noise of its speed sensor, so the motor moves with it. On a tooth flank
this is linear. With S and H the loop's responses in speed and current, sensor noise n appears in
the channels as S n and H n, a normal part of their noise. At an impact it is not linear: the load
meets the flank earlier or harder, and the following ringing differs. So n is drawn, subtracted from
the reference, and simulated on the fitted bench with its gap.

The current shows how much of the noise is fed back: noise added by the recorder does not move it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from bayesbl.bench.kernel import Slot
from bayesbl.bench.motion import Motion, held_motion, through
from bayesbl.bench.steady import noise_through_loop
from bayesbl.matching.as_observed import RecentSimulations
from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.observed import ROUNDING, Observed, whole_rotations
from bayesbl.matching.signals import REFERENCE_DELAY
from bayesbl.probabilities import f_sf, normal_isf
from bayesbl.recording.types import ComplexArray, FloatArray
from bayesbl.units import RPM_PER_RAD_PER_S

ROTATIONS = 40
"""Smallest number of rotations simulated with noise: the root of the factor is then exact to a
ninth."""

QUANTILES = np.array([normal_isf(p) for p in (np.arange(10) + 0.5) / 10])
"""Equally likely values of a standard normal."""

FEWEST_STRETCHES = 4
"""Fewest stretches without lost samples for a spectrum."""

LEAST_SHARE = 0.05
"""Smallest share of the noise power that counts: less in the loop widens no interval by a tenth."""

STRETCHES = 16
"""Number of stretches of a recording whose spectra are averaged."""

UNKNOWN_SHARES = (np.arange(10) + 0.5) / 10
"""Without a current, all shares are equally likely."""


def turns_of(rows: FloatArray, observation: Observed) -> FloatArray:
    """Whitened channels (c, n − p) by rotation, one channel after the other, (rotation, c lag).

    Cycles of a motion; a motion that does not repeat is a single one. Samples missing from the last
    rotation by rounding are zero.
    """
    rows = rows[:, observation.first_compared :]
    lag = observation.lag if observation.repeats else rows.shape[1]
    return np.concatenate([whole_rotations(row, lag) for row in rows], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class LoopNoise:
    """Noise of a recording that its loop feeds back.

    Attributes
    ----------
    shares
        Equally likely values of the share of its noise that is fed back, shape (k,).
    fed_back, linear
        Whitened rotations, as by :func:`turns_of`, with all noise fed back, and their linear
        approximation, shape (R, c lag).
    """

    shares: FloatArray
    fed_back: FloatArray
    linear: FloatArray

    def factors(self, direction: FloatArray) -> FloatArray:
        """Equally likely variances of the recording's noise along a change of its rotations, (k,).

        ``direction``: change of the whitened rotations, (r, c lag). In units of the variance of
        whitened noise.
        """
        power = float(np.sum(direction**2))
        if power == 0.0:
            return np.ones(1)
        excess_power = np.sum((self.fed_back @ direction.T) ** 2) - np.sum(
            (self.linear @ direction.T) ** 2
        )
        excess = float(excess_power) / (len(self.fed_back) * power)
        return 1.0 + self.shares * max(excess, 0.0)

    def degrees_of_freedom(self, parts: Callable[[FloatArray], FloatArray]) -> list[float]:
        """Effective degrees of freedom of the noise power in some parts of a rotation, k values.

        Noise that is not fed back has the same spectrum, independently.

        ``parts``: from rotations (R, c lag) to (R, d).
        """
        fed_back, independent = parts(self.fed_back), parts(np.roll(self.linear, 1, axis=0))
        mixes = zip(np.sqrt(self.shares), np.sqrt(1.0 - self.shares), strict=True)
        return [degrees_of_freedom(a * fed_back + b * independent) for a, b in mixes]

    def chance(
        self, ratio: float, parts: Callable[[FloatArray], FloatArray], rotations: int
    ) -> float:
        """Probability that noise gives at least this ratio of the mean's power to the scatter.

        ``parts``: parts of rotations with this power, as for :meth:`degrees_of_freedom`.
        """
        degrees = self.degrees_of_freedom(parts)
        return float(np.mean([f_sf(ratio, count, count * (rotations - 1)) for count in degrees]))


def degrees_of_freedom(rows: FloatArray) -> float:
    """Effective degrees of freedom of the power of normal rows, (R, d), by its mean and variance.

    With Σ their covariance, (tr Σ)²/tr Σ² (Satterthwaite 1946), with an unbiased estimate of tr Σ².
    """
    centred = rows - rows.mean(axis=0)
    products = centred @ centred.T
    free = len(rows) - 1
    trace = float(np.trace(products))
    squares = (float(np.sum(products**2)) - trace**2 / free) * free**2
    squares /= (free - 1) * (free + 2)
    degrees = trace**2 / squares if squares > 0.0 else math.inf
    return float(np.clip(degrees, 1.0, rows.shape[1]))


def noise_along(fit: SimulatedFit) -> Callable[[FloatArray], FloatArray]:
    """Function from a change of the whitened signals (N,) to likely variances of all noise.

    In units of the recorder's variance, as :meth:`LoopNoise.factors` of each recording. For
    rounding that may be the same in all rotations, in units of its assumed variance.
    """
    of_recording = cache(partial(_factors, fit))

    def factors(change: FloatArray) -> FloatArray:
        total, summed = 0.0, np.zeros(len(QUANTILES))
        for recording, rows in enumerate(fit.model.by_recording(change)):
            direction = turns_of(rows, fit.model.recordings[recording])
            power = float(np.sum(direction**2))
            if power > 0.0:
                summed += power * of_recording(recording)(direction)
                total += power
        return summed / total if total > 0.0 else np.ones(1)

    return factors


def _factors(fit: SimulatedFit, recording: int) -> Callable[[FloatArray], FloatArray]:
    """Noise factors of a recording, by loop noise or by rounding that repeats, (k,) or (1,)."""
    if not fit.model.noise[recording].repeats:
        loop = loop_noise(fit, recording)
        return loop.factors if loop is not None else lambda direction: np.ones(1)
    rounded = rounded_rotations(fit, recording)

    def by_rounding(direction: FloatArray) -> FloatArray:
        total, power = direction.sum(axis=0), float(np.sum(direction**2))
        return np.array([max([1.0, *(np.mean((rows @ total) ** 2) / power for rows in rounded)])])

    return by_rounding


def loop_noise(fit: SimulatedFit, recording: int) -> LoopNoise | None:
    """Loop noise of a recording; ``None`` if there is none, or rounding hides it."""
    model = fit.model
    observation, noise = model.recordings[recording], model.noise[recording]
    spectra = None if noise.repeats else _spectra(fit, recording)
    if spectra is None:
        return None
    frequency, speed_power, cross_power = spectra
    vector = model.vectors(fit.point[None], observation)
    loop = _loop_responses(vector[0], observation)
    in_speed, in_current = (np.interp(frequency, *row) for row in loop)
    # Where the loop suppresses noise, little is visible, and that may have other causes.
    usable = np.flatnonzero((np.abs(in_speed) >= 1.0) & (speed_power > 0.0))
    if not usable.size:
        return None
    shares = UNKNOWN_SHARES
    if len(observation.signals) > 1:
        gain, power = in_current[usable] / in_speed[usable], speed_power[usable]
        weight = float(np.sum(power * np.abs(gain) ** 2))
        share = float(np.sum(np.real(cross_power[usable] * gain.conj()))) / weight
        unexplained_power = np.abs(cross_power[usable] - share * gain * power)
        sd = math.sqrt(0.5 * float(np.sum((unexplained_power * np.abs(gain)) ** 2))) / weight
        if share < LEAST_SHARE:
            return None
        shares = np.clip(share + sd * QUANTILES, 0.0, 1.0)
    sensor_power = speed_power[usable] / np.abs(in_speed[usable]) ** 2
    lowest = frequency[usable] <= 2.0 * frequency[usable[0]]
    level = float(sensor_power[lowest].mean())
    frequencies = np.fft.rfftfreq(observation.samples)
    sensor = np.sqrt(np.interp(frequencies, frequency[usable], sensor_power, left=level))
    linear = np.stack([np.interp(frequencies, *row) for row in loop])[: len(observation.signals)]
    rotations = _rotations(
        fit, recording, "noise in the loop", _noise(fit, recording, sensor, linear)
    )
    return LoopNoise(shares, *rotations) if np.all(np.isfinite(rotations)) else None


def _loop_responses(
    parameters: FloatArray, observation: Observed
) -> tuple[tuple[FloatArray, ComplexArray], tuple[FloatArray, ComplexArray]]:
    """Frequency responses S and H, each with its frequencies in cycles per sample."""
    impulse = np.zeros(min(observation.samples, observation.lag))
    impulse[0] = 1.0
    speed_response, current_response = noise_through_loop(
        parameters, impulse, 1.0 / observation.sampling_hz
    )
    grid = np.asarray(np.fft.rfftfreq(impulse.size), dtype=np.float64)
    return (grid, np.fft.rfft(impulse + speed_response)), (grid, np.fft.rfft(current_response))


def _spectra(
    fit: SimulatedFit, recording: int
) -> tuple[FloatArray, FloatArray, ComplexArray] | None:
    """Frequency in cycles per sample, power of the speed noise, and current times conjugate speed.

    By Welch's method on the part that does not repeat; the power of white noise is its variance.
    ``None`` if almost no stretch is without lost samples.
    """
    observation = fit.model.recordings[recording]
    unexplained = fit.unexplained(recording)
    kept = observation.compared
    if observation.repeats:
        unexplained = (
            unexplained[:, observation.lag :] - unexplained[:, : -observation.lag]
        ) / math.sqrt(2.0)
        kept = kept[observation.lag :] & kept[: -observation.lag]
    length = unexplained.shape[1] // STRETCHES
    if length < STRETCHES:
        return None
    window = np.hanning(length + 2)[1:-1]
    stretches = sliding_window_view(unexplained, length, axis=1)[:, :: length // 2]
    is_complete = sliding_window_view(kept, length)[:: length // 2].all(axis=1)
    if is_complete.sum() < FEWEST_STRETCHES:
        return None
    spectra = np.fft.rfft(stretches[:, is_complete] * window, axis=2) / np.sqrt(np.sum(window**2))
    power: FloatArray = np.mean(np.abs(spectra[0]) ** 2, axis=0)
    cross: ComplexArray = np.mean(spectra[-1] * spectra[0].conj(), axis=0)
    return np.asarray(np.fft.rfftfreq(length), dtype=np.float64), power, cross


def _rotations(
    fit: SimulatedFit, recording: int, label: str, draws: Iterator[tuple[FloatArray, FloatArray]]
) -> FloatArray:
    """Whitened rotations of a recording with two kinds of noise, (2, R, c lag).

    ``draws``: of both kinds, as channels (c, n). They are made once for this point and noise model.
    """
    model = fit.model
    observation, noise = model.recordings[recording], model.noise[recording]

    def made(_: FloatArray) -> FloatArray:
        turns: list[list[FloatArray]] = []
        while sum(len(first) for first, _ in turns) < ROTATIONS:
            turns.append(
                [turns_of(noise.whiten(channels), observation) for channels in next(draws)]
            )
        return np.stack([np.concatenate(kind) for kind in zip(*turns, strict=True)])[None]

    vector = model.vectors(fit.point[None], observation)
    key = (label, observation.name, noise.coefficients.tobytes(), noise.root.tobytes())
    return np.asarray(model.recent.signals(vector, key, made)[0])


def _noise(
    fit: SimulatedFit, recording: int, sensor: FloatArray, linear: ComplexArray
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Draws of noise in the loop, simulated and in the linear approximation.

    ``sensor``: gain from white to sensor noise by frequency, (n//2 + 1,); ``linear``: response from
    sensor noise to the channels, (c, n//2 + 1).
    """
    observation = fit.model.recordings[recording]
    undisturbed = _simulated(fit, recording, np.zeros(observation.samples), observation.sampling_hz)
    rng = np.random.default_rng(0)  # a fixed sample of an integral, not a draw of the answer
    while True:
        drawn = sensor * np.fft.rfft(rng.standard_normal(observation.samples))
        disturbance = np.fft.irfft(drawn, observation.samples)
        added = _simulated(fit, recording, disturbance, observation.sampling_hz) - undisturbed
        added[0] += disturbance
        yield added, np.fft.irfft(linear * drawn, observation.samples)


def rounded_rotations(fit: SimulatedFit, recording: int) -> list[FloatArray]:
    """Whitened rotations of a recording's rounding, (R, c lag), in one or two cases.

    The cases are rounding by the recorder, and by an encoder. The controller also uses the
    encoder's counts, so the loop feeds this error back. Empty if nothing is rounded or it cannot be
    simulated.
    """
    if all(rounding.steps is None for rounding in fit.model.recordings[recording].rounding):
        return []
    rotations = _rotations(fit, recording, "rounding", _rounded(fit, recording))
    return [rows for rows in rotations if np.all(np.isfinite(rows))]


def _rounded(fit: SimulatedFit, recording: int) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Draws of both cases; the second is nan if the speed has no steps."""
    model, observation = fit.model, fit.model.recordings[recording]
    exact, unexplained = fit.simulated(recording), fit.unexplained(recording)
    # A controller with another rate than the recorder differentiates from tick to tick.
    vector = model.vectors(fit.point[None], observation)
    period = float(vector[0, Slot.sampled_control__period_s])
    ticks_hz = 1.0 / period if period > 0.0 else observation.sampling_hz
    time = np.arange(observation.samples) / observation.sampling_hz
    shown = np.floor(time * ticks_hz + ROUNDING).astype(int)
    at_ticks = np.interp(np.arange(shown[-1] + 1) / ticks_hz, time, exact[0])
    steps = observation.rounding[0].steps
    if steps is not None and period > 0.0:
        steps = replace(steps, differentiated=True)
    undisturbed = _simulated(fit, recording, np.zeros(at_ticks.size), ticks_hz)
    rng = np.random.default_rng(0)
    while True:
        recorder_rounding = np.stack(
            [
                rounding.drawn(a, b, rng)
                for rounding, a, b in zip(observation.rounding, exact, unexplained, strict=False)
            ]
        )
        loop_rounding = np.full_like(recorder_rounding, np.nan)
        if steps is not None:
            disturbance = steps.drawn(at_ticks, rng)
            loop_rounding = _simulated(fit, recording, disturbance, ticks_hz) - undisturbed
            loop_rounding[0] += disturbance[shown]
            loop_rounding[1:] += recorder_rounding[1:]
        yield recorder_rounding, loop_rounding


def _simulated(
    fit: SimulatedFit, recording: int, disturbance_rpm: FloatArray, ticks_hz: float
) -> FloatArray:
    """Channels (c, n) of a recording with the reference reduced by this disturbance at each tick.

    From the second tick on: a motion starts at its reference speed, load included, and sensor noise
    does not turn the load faster.
    """
    model, observation = fit.model, fit.model.recordings[recording]
    point = fit.point.copy()
    time = np.arange(disturbance_rpm.size) / ticks_hz
    reference = np.full(time.size, observation.reference_speed_rpm)
    settings = {"reference_speed_rpm": observation.reference_speed_rpm, **observation.known}
    if observation.motion is not None:
        settings = dict(observation.known)
        delay_index = model.place_of(REFERENCE_DELAY, observation.name)
        # The delay is that of the reference; the noise added to it has none.
        reference = observation.motion.speed_rpm(
            time - (0.0 if delay_index is None else float(point[delay_index]))
        )
        if delay_index is not None:
            point[delay_index] = 0.0
    reference[1:] -= disturbance_rpm[1:]
    speed = reference / RPM_PER_RAD_PER_S
    ticks = held_motion(Motion(through(time, speed), time[-1]), time.size, ticks_hz)
    single = replace(
        model,
        recordings=[replace(observation, motion=ticks, cycle=None, known=settings)],
        noise=[model.noise[recording]],
        recent=RecentSimulations(),
    )
    return np.asarray(single.signals(point[None], 0)[0])
