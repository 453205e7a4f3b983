"""What a recording says of its joint beside the gap: the controller's gains, friction, the load.

Signals are folded over load rotations. Noise differs from one rotation to the next, so products of
two different rotations hold none of it on average: the size of a harmonic comes from them, and is
not enlarged by noise. Standard errors are those of a block bootstrap of what does not repeat.

The gains come from the law of the controller at every load order, by maximum likelihood with noise
in both speed and current (:func:`controller_gains`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.measurement.measurement import CheckItem, check_item
from bayesbl.recording.types import MOTOR_CURRENT, FloatArray
from bayesbl.ringing.estimator import PointEstimate
from bayesbl.ringing.symbols import ROTATION
from bayesbl.units import RPM_PER_RAD_PER_S

RESAMPLES = 100
"""Standard errors are then good to 7 %."""

BLOCKS_PER_ROTATION = 8
"""Blocks of an eighth of a rotation are far longer than the noise is correlated."""

SEED = 20260301
HARMONICS = (1, 2)

SMOOTHED = 31
"""Load orders over which the noise is taken for level: less than the ringing's own width."""

STANDS_OUT = 4.0
"""Power of the speed error over that of its noise from which on an order counts."""

FEWEST_ORDERS = 6
ROUNDS = 8

PROPORTIONAL, INTEGRAL = "proportional gain", "integral gain"
MEAN_CURRENT = "mean current"


@dataclass(frozen=True, slots=True)
class Feature:
    """A quantity of the joint with its standard error, in one unit."""

    name: str
    unit: str
    value: float
    standard_error: float


def harmonic_name(channel: str, order: int) -> str:
    """``current at load order 1``."""
    return f"{channel} at load order {order}"


def features_of(point: PointEstimate) -> list[Feature]:
    """Features of the recording that a fit was made of; those of the current where there is one.

    None of less than two whole rotations: nothing tells their noise.
    """
    folded, period_s = folded_rotations(point)
    return [] if folded.shape[1] < 2 else features(folded, period_s)


def folded_rotations(point: PointEstimate) -> tuple[FloatArray, float]:
    """As :func:`features` takes them, of the recording that a fit was made of."""
    recording, rotation_s = point.recording, point.optimum.symbols[ROTATION]
    direction = math.copysign(1.0, float(recording.motor_speed_rpm.mean()))
    rows = [recording.motor_speed_rpm]
    if MOTOR_CURRENT in recording.channels:
        rows.append(recording.channels[MOTOR_CURRENT])
    turn = rotation_s / recording.sampling_period_s
    folded = np.stack([folded_signal(direction * row, turn) for row in rows])
    return folded, rotation_s / folded.shape[2]


def beside_bench(
    point: PointEstimate, bench: Bench, delta_rad: FloatArray, rng: np.random.Generator
) -> list[CheckItem]:
    """Features of a recording beside those of its bench, drawn, at as many draws of δ, (k,).

    What does not repeat in the recording is added to the simulation: noise moves both alike.
    Nothing tells the noise of less than two rotations.
    """
    measured, period_s = folded_rotations(point)
    if measured.shape[1] < 2:
        return []
    scatter = measured - measured.mean(axis=1, keepdims=True)
    speed_rpm = float(point.recording.motor_speed_rpm.mean())
    count, simulated = measured.shape[2], []
    waves = _waves(count)
    for gap in delta_rad:
        drawn = bench.draw(rng).with_parameters(reference_speed_rpm=speed_rpm)
        made = drawn.simulate_many(
            float(gap),
            rotations=1.0,
            sampling_hz=count / drawn.rotation_period_s(speed_rpm),
            channels="all",
        )[0, 1:, :count]
        rotation = math.copysign(1.0, speed_rpm) * made[: len(measured), None] + scatter
        gains = {gain.name: gain.value for gain in controller_gains(rotation, period_s)}
        simulated.append(gains | _values(rotation, waves))
    items = []
    for feature in features(measured, period_s):
        values = [each[feature.name] for each in simulated if feature.name in each]
        if values:
            mean, sd = float(np.mean(values)), float(np.std(values))
            sd = math.hypot(feature.standard_error, sd)
            z = (feature.value - mean) / sd if sd > 0.0 else 0.0
            items.append(check_item(feature.name, feature.value, mean, feature.unit, z))
    return items


def features(folded: FloatArray, period_s: float) -> list[Feature]:
    """Features of folded signals.

    Parameters
    ----------
    folded
        Motor speed in rpm and, where there is one, current in A, both positive in the direction of
        the rotation; shape (1 or 2, rotations, samples of a rotation).
    period_s
        Between samples.
    """
    gains = controller_gains(folded, period_s)
    generator = np.random.default_rng(SEED)
    waves = _waves(folded.shape[2])
    drawn = [_values(_resampled(folded, generator), waves) for _ in range(RESAMPLES)]
    return gains + [
        Feature(name, _unit(name), value, float(np.std([d[name] for d in drawn], ddof=1)))
        for name, value in _values(folded, waves).items()
    ]


def controller_gains(folded: FloatArray, period_s: float) -> list[Feature]:
    """K_p/K_t and K_i/K_t from the law of the controller, I_k = (K_p + K_i/jω_k) E_k / K_t.

    At every load order k the rotations' mean of speed error E_k and current I_k has noise of a
    covariance that the scatter between rotations gives, smoothed over ``SMOOTHED`` orders. The true
    E_k is estimated beside the gains (errors in variables), by Gauss-Newton. Orders whose speed
    error is noise say nothing and are left out.

    Returns
    -------
    Nothing without a current, or where too few orders stand out; ``folded`` as :func:`features`
    takes it.
    """
    from scipy.ndimage import uniform_filter1d

    if len(folded) == 1:
        return []
    centred = folded - folded.mean(axis=2, keepdims=True)
    spectrum = np.fft.rfft(centred, axis=2)[:, :, 1:]
    spectrum[0] *= -1.0 / RPM_PER_RAD_PER_S
    rotations = spectrum.shape[1]
    error, current = spectrum.mean(axis=1)
    scatter = spectrum - spectrum.mean(axis=1, keepdims=True)
    noise = np.einsum("irk,jrk->ijk", scatter, scatter.conj()) / (rotations * (rotations - 1))
    noise = uniform_filter1d(noise.real, SMOOTHED) + 1j * uniform_filter1d(noise.imag, SMOOTHED)
    shown = np.abs(error) ** 2 > STANDS_OUT * noise[0, 0].real
    if np.count_nonzero(shown) < FEWEST_ORDERS:
        return []
    error, current, noise = error[shown], current[shown], noise[:, :, shown]
    order = 1.0 + np.flatnonzero(shown)
    integrated = folded.shape[2] * period_s / (2j * np.pi * order)
    plain = np.stack([error, error * integrated])
    gains = np.linalg.solve((plain @ plain.conj().T).real, (plain.conj() @ current).real)
    for _ in range(ROUNDS):
        response = gains[0] + gains[1] * integrated
        variance = (
            noise[1, 1] + np.abs(response) ** 2 * noise[0, 0] - 2.0 * response.conj() * noise[1, 0]
        ).real
        remaining = current - response * error
        crossed = response.conj() * noise[0, 0] - noise[0, 1]
        true_error = error + crossed / variance * remaining
        columns = np.stack([true_error, true_error * integrated]) / np.sqrt(0.5 * variance)
        white = remaining / np.sqrt(0.5 * variance)
        information = (columns @ columns.conj().T).real
        gains = gains + np.linalg.solve(information, (columns.conj() @ white).real)
    excess = float(np.sum(np.abs(white) ** 2)) / (2 * white.size - 2)
    sds = np.sqrt(np.diag(np.linalg.inv(information)) * max(excess, 1.0))
    return [
        Feature(name, _unit(name), float(value), float(sd))
        for name, value, sd in zip((PROPORTIONAL, INTEGRAL), gains, sds, strict=True)
    ]


def folded_signal(signal: FloatArray, samples_per_rotation: float) -> FloatArray:
    """Whole rotations below one another, shape (rotations, samples), between samples linear."""
    count = round(samples_per_rotation)
    # The last value read lies a step before the end of its rotation.
    recorded = signal.size - 1 + samples_per_rotation / count
    rotations = math.floor(recorded / samples_per_rotation + 1e-9)
    place = np.arange(rotations * count) * (samples_per_rotation / count)
    folded = np.interp(place, np.arange(signal.size), signal)
    return np.asarray(folded.reshape(rotations, count))


def _waves(count: int) -> FloatArray:
    """Cosines and sines over a rotation that give amplitudes, (count, 2, harmonic)."""
    angle = 2.0 * np.pi * np.outer(np.arange(count), HARMONICS) / count
    return np.stack([np.cos(angle), np.sin(angle)], axis=1) * (2.0 / count)


def _values(folded: FloatArray, waves: FloatArray) -> dict[str, float]:
    """By name: the mean current, and amplitudes at multiples of the load's rotation."""
    rotations = folded.shape[1]
    terms = np.tensordot(folded, waves, 1)
    power = np.sum(terms.sum(axis=1) ** 2 - np.sum(terms**2, axis=1), axis=1)
    sizes = np.sqrt(np.maximum(power / (rotations * (rotations - 1)), 0.0))
    values = {} if len(folded) == 1 else {MEAN_CURRENT: float(folded[1].mean())}
    for name, own in zip(("speed", "current"), sizes.tolist(), strict=False):
        values |= {harmonic_name(name, k): size for k, size in zip(HARMONICS, own, strict=True)}
    return values


def _resampled(folded: FloatArray, generator: np.random.Generator) -> FloatArray:
    """What repeats, with blocks of what does not put in other places, all channels together."""
    channels, rotations, count = folded.shape
    mean = folded.mean(axis=1, keepdims=True)
    rest = (folded - mean) * math.sqrt(rotations / (rotations - 1))
    rest = rest.reshape(channels, rotations * count)
    length = max(1, count // BLOCKS_PER_ROTATION)
    starts = generator.integers(0, rest.shape[1], size=-(-rest.shape[1] // length))
    places = (starts[:, None] + np.arange(length)).ravel()[: rest.shape[1]] % rest.shape[1]
    return np.asarray(mean + rest[:, places].reshape(folded.shape))


def _unit(name: str) -> str:
    if name == PROPORTIONAL:
        return "A s/rad"
    if name == INTEGRAL:
        return "A/rad"
    return "rpm" if name.startswith("speed") else "A"
