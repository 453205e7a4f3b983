"""Features of a joint other than its gap, from a recording: controller gains, friction, load.

Signals are folded over load rotations. Noise differs from one rotation to the next, so products of
two different rotations contain none of it on average. The amplitude of a harmonic is computed from
such products, so noise does not bias it upward. Standard errors come from a block bootstrap of the
part that does not repeat.

The gains come from the control law at every load order, by maximum likelihood with noise in both
speed and current (:func:`controller_gains`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.measurement.measurement import CheckItem, check_item
from bayesbl.recording.repetition import folded
from bayesbl.recording.types import MOTOR_CURRENT, FloatArray
from bayesbl.ringing.estimator import PointEstimate
from bayesbl.ringing.symbols import ROTATION
from bayesbl.units import RPM_PER_RAD_PER_S

RESAMPLES = 100
"""Bootstrap samples: standard errors are then good to 7 %."""

BLOCKS_PER_ROTATION = 8
"""Blocks of an eighth of a rotation are much longer than the noise is correlated."""

SEED = 20260301
HARMONICS = (1, 2)

SMOOTHED = 31
"""Load orders over which the noise spectrum is smoothed: less than the width of the ringing."""

STANDS_OUT = 4.0
"""Least ratio of the power of the speed error to that of its noise at an order that is used."""

FEWEST_ORDERS = 6
ROUNDS = 8

PROPORTIONAL, INTEGRAL = "proportional gain", "integral gain"
MEAN_CURRENT = "mean current"


@dataclass(frozen=True, slots=True)
class Feature:
    """A quantity of the joint with its standard error, both in ``unit``."""

    name: str
    unit: str
    value: float
    standard_error: float


def harmonic_name(channel: str, order: int) -> str:
    """Name of a harmonic, such as ``current at load order 1``."""
    return f"{channel} at load order {order}"


def features_of(point: PointEstimate) -> list[Feature]:
    """Features of a fit's recording, those of the current if it was recorded.

    Empty for fewer than two whole rotations, which do not show the noise.
    """
    folded, period_s = folded_rotations(point)
    return [] if folded.shape[1] < 2 else features(folded, period_s)


def folded_rotations(point: PointEstimate) -> tuple[FloatArray, float]:
    """The recording of a fit, folded as :func:`features` takes it, and its sampling period, s."""
    recording, rotation_s = point.recording, point.optimum.symbols[ROTATION]
    direction = math.copysign(1.0, float(recording.motor_speed_rpm.mean()))
    rows = [recording.motor_speed_rpm]
    if MOTOR_CURRENT in recording.channels:
        rows.append(recording.channels[MOTOR_CURRENT])
    turn = rotation_s / recording.sampling_period_s
    rotations = np.stack([folded(direction * row, turn) for row in rows])
    return rotations, rotation_s / rotations.shape[2]


def beside_bench(
    point: PointEstimate, bench: Bench, delta_rad: FloatArray, rng: np.random.Generator
) -> list[CheckItem]:
    """Compare features of a recording with those of drawn benches at draws of δ, shape (k,).

    The part of the recording that does not repeat is added to each simulation, so noise affects
    both alike. Empty for fewer than two rotations, which do not show the noise.
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
        signals = drawn.simulate_many(
            float(gap),
            rotations=1.0,
            sampling_hz=count / drawn.rotation_period_s(speed_rpm),
            channels="all",
        )[0, 1:, :count]
        rotation = math.copysign(1.0, speed_rpm) * signals[: len(measured), None] + scatter
        gains = {gain.name: gain.value for gain in controller_gains(rotation, period_s)}
        simulated.append(gains | _values(rotation, waves))
    items = []
    for feature in features(measured, period_s):
        values = [by_name[feature.name] for by_name in simulated if feature.name in by_name]
        if values:
            mean, sd = float(np.mean(values)), float(np.std(values))
            sd = math.hypot(feature.standard_error, sd)
            z = (feature.value - mean) / sd if sd > 0.0 else 0.0
            items.append(check_item(feature.name, feature.value, mean, feature.unit, z))
    return items


def features(folded: FloatArray, period_s: float) -> list[Feature]:
    """Features of folded signals.

    ``folded``: motor speed in rpm and, if recorded, current in A, both positive in the direction of
    rotation; shape (1 or 2, rotations, samples of a rotation). ``period_s``: sampling period.
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
    """K_p/K_t and K_i/K_t from the control law, I_k = (K_p + K_i/jω_k) E_k / K_t.

    At every load order k, the mean over rotations of speed error E_k and current I_k has noise. Its
    covariance comes from the scatter between rotations, smoothed over ``SMOOTHED`` orders. The true
    E_k is estimated with the gains (errors in variables), by Gauss-Newton. Orders at which the
    speed error is mostly noise are left out.

    Returns both gains; empty without a current, or if too few orders stand out. ``folded`` as
    :func:`features` takes it.
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
    used = np.abs(error) ** 2 > STANDS_OUT * noise[0, 0].real
    if np.count_nonzero(used) < FEWEST_ORDERS:
        return []
    error, current, noise = error[used], current[used], noise[:, :, used]
    order = 1.0 + np.flatnonzero(used)
    integrated = folded.shape[2] * period_s / (2j * np.pi * order)
    regressors = np.stack([error, error * integrated])
    gains = np.linalg.solve(
        (regressors @ regressors.conj().T).real, (regressors.conj() @ current).real
    )
    for _ in range(ROUNDS):
        response = gains[0] + gains[1] * integrated
        variance = (
            noise[1, 1] + np.abs(response) ** 2 * noise[0, 0] - 2.0 * response.conj() * noise[1, 0]
        ).real
        residual = current - response * error
        cross_term = response.conj() * noise[0, 0] - noise[0, 1]
        true_error = error + cross_term / variance * residual
        columns = np.stack([true_error, true_error * integrated]) / np.sqrt(0.5 * variance)
        whitened = residual / np.sqrt(0.5 * variance)
        information = (columns @ columns.conj().T).real
        gains = gains + np.linalg.solve(information, (columns.conj() @ whitened).real)
    excess = float(np.sum(np.abs(whitened) ** 2)) / (2 * whitened.size - 2)
    sds = np.sqrt(np.diag(np.linalg.inv(information)) * max(excess, 1.0))
    return [
        Feature(name, _unit(name), float(value), float(sd))
        for name, value, sd in zip((PROPORTIONAL, INTEGRAL), gains, sds, strict=True)
    ]


def _waves(count: int) -> FloatArray:
    """Cosines and sines over a rotation, scaled to give amplitudes, (count, 2, harmonic)."""
    angle = 2.0 * np.pi * np.outer(np.arange(count), HARMONICS) / count
    return np.stack([np.cos(angle), np.sin(angle)], axis=1) * (2.0 / count)


def _values(folded: FloatArray, waves: FloatArray) -> dict[str, float]:
    """Mean current and amplitudes at multiples of the load rotation, by name."""
    rotations = folded.shape[1]
    terms = np.tensordot(folded, waves, 1)
    power = np.sum(terms.sum(axis=1) ** 2 - np.sum(terms**2, axis=1), axis=1)
    sizes = np.sqrt(np.maximum(power / (rotations * (rotations - 1)), 0.0))
    values = {} if len(folded) == 1 else {MEAN_CURRENT: float(folded[1].mean())}
    for name, row in zip(("speed", "current"), sizes.tolist(), strict=False):
        values |= {harmonic_name(name, k): size for k, size in zip(HARMONICS, row, strict=True)}
    return values


def _resampled(folded: FloatArray, generator: np.random.Generator) -> FloatArray:
    """Bootstrap sample: the repeating part plus shuffled blocks of the rest, channels alike."""
    channels, rotations, count = folded.shape
    mean = folded.mean(axis=1, keepdims=True)
    residual = (folded - mean) * math.sqrt(rotations / (rotations - 1))
    residual = residual.reshape(channels, rotations * count)
    length = max(1, count // BLOCKS_PER_ROTATION)
    starts = generator.integers(0, residual.shape[1], size=-(-residual.shape[1] // length))
    places = (starts[:, None] + np.arange(length)).ravel()[: residual.shape[1]] % residual.shape[1]
    return np.asarray(mean + residual[:, places].reshape(folded.shape))


def _unit(name: str) -> str:
    if name == PROPORTIONAL:
        return "A s/rad"
    if name == INTEGRAL:
        return "A/rad"
    return "rpm" if name.startswith("speed") else "A"
