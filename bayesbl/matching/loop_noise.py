"""Noise that moves the motor, and its effect on the impacts.

A controller responds to the noise of its speed sensor, so the motor moves with it; varying friction
moves it too. On a tooth flank this is linear. With S and H the loop's responses in speed and
current, sensor noise n appears in the channels as S n and H n, and a torque K_t d at the motor as
(S − 1) S d/H and (S − 1) d: both a normal part of their noise. At an impact it is not linear: the
load meets the flank earlier or harder, and the following ringing differs. So the noise is drawn,
subtracted from the reference as n or as S d/H, and simulated on the fitted bench with its gap.

Recordings hardly show where the noise comes from, so both origins are equally likely. The current
shows how much of it is in the loop: noise added by the recorder does not move it.
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
    """Noise of a recording that moves its motor, from one or two equally likely origins.

    Attributes
    ----------
    shares
        For each origin, equally likely values of the share of the noise that is in the loop, shape
        (o, k).
    fed_back, linear
        Whitened rotations, as by :func:`turns_of`, with all noise in the loop, and their linear
        approximation, shape (o, R, c lag).
    """

    shares: FloatArray
    fed_back: FloatArray
    linear: FloatArray

    def factors(self, direction: FloatArray) -> FloatArray:
        """Equally likely variances of the noise along a change of a recording's rotations, (o k,).

        ``direction``: change of the whitened rotations, (r, c lag). In units of the variance of
        whitened noise.
        """
        power = float(np.sum(direction**2))
        if power == 0.0:
            return np.ones(1)
        excess_power = np.sum((self.fed_back @ direction.T) ** 2, axis=(1, 2)) - np.sum(
            (self.linear @ direction.T) ** 2, axis=(1, 2)
        )
        excess = excess_power / (self.fed_back.shape[1] * power)
        return np.asarray(1.0 + self.shares * np.maximum(excess, 0.0)[:, None]).ravel()

    def degrees_of_freedom(self, parts: Callable[[FloatArray], FloatArray]) -> list[float]:
        """Effective degrees of freedom of the noise power in some parts of a rotation, o k values.

        Noise that is not fed back has the same spectrum, independently.

        ``parts``: from rotations (R, c lag) to (R, d).
        """
        degrees = []
        for shares, fed_back, linear in zip(self.shares, self.fed_back, self.linear, strict=True):
            in_loop, independent = parts(fed_back), parts(np.roll(linear, 1, axis=0))
            mixes = zip(np.sqrt(shares), np.sqrt(1.0 - shares), strict=True)
            degrees += [degrees_of_freedom(a * in_loop + b * independent) for a, b in mixes]
        return degrees

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


def noise_along(fit: SimulatedFit) -> Callable[[FloatArray], float]:
    """Function from a change of the whitened signals (N,) to the expected variance of all noise.

    In units of the recorder's variance, as :meth:`LoopNoise.factors` of each recording. For
    rounding that may be the same in all rotations, in units of its assumed variance.
    """
    of_recording = cache(partial(_factor, fit))

    def factor(change: FloatArray) -> float:
        total, summed = 0.0, 0.0
        for recording, rows in enumerate(fit.model.by_recording(change)):
            direction = turns_of(rows, fit.model.recordings[recording])
            power = float(np.sum(direction**2))
            if power > 0.0:
                summed += power * of_recording(recording)(direction)
                total += power
        return summed / total if total > 0.0 else 1.0

    return factor


def _factor(fit: SimulatedFit, recording: int) -> Callable[[FloatArray], float]:
    """Expected noise factor of a recording, by loop noise or by rounding that repeats."""
    if not fit.model.noise[recording].repeats:
        loop = loop_noise(fit, recording)
        return lambda direction: 1.0 if loop is None else float(loop.factors(direction).mean())
    rounded = rounded_rotations(fit, recording)

    def by_rounding(direction: FloatArray) -> float:
        total, power = direction.sum(axis=0), float(np.sum(direction**2))
        return max([1.0, *(float(np.mean((rows @ total) ** 2)) / power for rows in rounded)])

    return by_rounding


def loop_noise(fit: SimulatedFit, recording: int) -> LoopNoise | None:
    """Loop noise of a recording; ``None`` if there is none, or rounding hides it."""
    model = fit.model
    observation, noise = model.recordings[recording], model.noise[recording]
    spectra = None if noise.repeats else _spectra(fit, recording)
    if spectra is None:
        return None
    frequency, speed_power, cross_power = spectra
    vector = model.vectors(fit.point[None], observation)[0]
    frequencies = np.asarray(np.fft.rfftfreq(observation.samples), dtype=np.float64)
    at_lines = _loop_responses(vector, observation, frequency)
    responses = _loop_responses(vector, observation, frequencies)
    shares, rotations = [], []
    for origin in ("sensor", "motor"):
        in_speed, in_current = at_lines
        _, channels, beside = _of_origin(origin, *at_lines)
        # Where the loop suppresses noise, little is visible, and that may have other causes.
        is_seen = np.abs(channels[np.flatnonzero(beside)[0]]) >= 1.0
        is_seen[0] = False  # a constant is not noise
        usable = np.flatnonzero(is_seen & (speed_power > 0.0))
        if not usable.size:
            continue
        likely = UNKNOWN_SHARES
        if len(observation.signals) > 1:
            gain, power = in_current[usable] / in_speed[usable], speed_power[usable]
            weight = float(np.sum(power * np.abs(gain) ** 2))
            if weight == 0.0:
                continue  # a controller without gain does not respond
            share = float(np.sum(np.real(cross_power[usable] * gain.conj()))) / weight
            unexplained_power = np.abs(cross_power[usable] - share * gain * power)
            sd = math.sqrt(0.5 * float(np.sum((unexplained_power * np.abs(gain)) ** 2))) / weight
            if share < LEAST_SHARE:
                continue
            likely = np.clip(share + sd * QUANTILES, 0.0, 1.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            seen = speed_power / np.abs(channels[0]) ** 2
        lowest = frequency[usable] <= 2.0 * frequency[usable[0]]
        level = float(seen[usable][lowest].mean())
        # Elsewhere it is alike, but no more than all noise.
        power = np.fmin(np.interp(frequency, frequency[usable], seen[usable], left=level), seen)
        size = np.sqrt(np.interp(frequencies, frequency, power))
        size[0] = 0.0
        draws = _noise(fit, recording, size, *_of_origin(origin, *responses))
        drawn = _rotations(fit, recording, f"noise of the {origin}", draws)
        if np.all(np.isfinite(drawn)):
            shares.append(likely)
            rotations.append(drawn)
    if not rotations:
        return None
    fed_back, linear = np.stack(rotations, axis=1)
    return LoopNoise(np.stack(shares), fed_back, linear)


def _of_origin(
    origin: str, in_speed: ComplexArray, in_current: ComplexArray
) -> tuple[ComplexArray, ComplexArray, FloatArray]:
    """Responses to noise of the sensor, or to a torque of the motor, as a current.

    Returns what to subtract from the reference, (f,), the noise in speed and current, (2, f), and
    how much of the noise is in either channel without moving the motor, (2,).
    """
    if origin == "sensor":
        channels = np.stack([in_speed, in_current])
        return np.ones_like(in_speed), channels, np.array([1.0, 0.0])
    is_shown = in_current != 0.0
    reference = np.divide(in_speed, in_current, out=np.zeros_like(in_speed), where=is_shown)
    channels = (in_speed - 1.0) * np.stack([reference, np.ones_like(reference)])
    return reference, channels, np.array([0.0, -1.0])


def _loop_responses(
    parameters: FloatArray, observation: Observed, frequencies: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    """Responses S and H at frequencies in cycles per sample."""
    impulse = np.zeros(min(observation.samples, observation.lag))
    impulse[0] = 1.0
    speed_response, current_response = noise_through_loop(
        parameters, impulse, 1.0 / observation.sampling_hz
    )
    grid = np.asarray(np.fft.rfftfreq(impulse.size), dtype=np.float64)
    in_speed = np.interp(frequencies, grid, np.fft.rfft(impulse + speed_response))
    return in_speed, np.interp(frequencies, grid, np.fft.rfft(current_response))


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
    fit: SimulatedFit,
    recording: int,
    size: FloatArray,
    reference: ComplexArray,
    channels: ComplexArray,
    beside: FloatArray,
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Draws of noise in the loop, simulated and in the linear approximation.

    ``size``: gain from white to this noise by frequency, (n//2 + 1,); ``reference``, ``channels``,
    ``beside``: of :func:`_of_origin`.
    """
    model, observation = fit.model, fit.model.recordings[recording]
    undisturbed = _simulated(fit, recording, np.zeros(observation.samples), observation.sampling_hz)
    count = len(observation.signals)
    # A position loop also follows the integral of what is subtracted.
    position_gain = model.vectors(fit.point[None], observation)[0, Slot.position_gain_per_s]
    rate = 2.0j * math.pi * observation.sampling_hz * np.fft.rfftfreq(observation.samples)
    rate[0] = 1.0
    reference = reference * rate / (rate + position_gain)
    rng = np.random.default_rng(0)  # a fixed sample of an integral, not a draw of the answer
    while True:
        drawn = size * np.fft.rfft(rng.standard_normal(observation.samples))
        disturbance = np.fft.irfft(reference * drawn, observation.samples)
        added = _simulated(fit, recording, disturbance, observation.sampling_hz) - undisturbed
        added += np.outer(beside[:count], np.fft.irfft(drawn, observation.samples))
        yield added, np.fft.irfft(channels[:count] * drawn, observation.samples)


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
