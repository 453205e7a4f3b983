"""What a recording says of its joint beside the gap: the controller's gains, friction, the load.

Signals are folded over load rotations. Noise differs from one rotation to the next, so products of
two different rotations hold none of it on average: the gains come from such products (instrumental
variables, the instrument being another rotation), and are not pulled towards zero by the noise of
the speed; the size of a harmonic comes from them too, and is not enlarged. Standard errors are
those of a block bootstrap of what does not repeat.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bayesbl.recording.types import MOTOR_CURRENT, FloatArray
from bayesbl.ringing.estimator import PointEstimate
from bayesbl.ringing.symbols import ROTATION
from bayesbl.units import RPM_PER_RAD_PER_S

RESAMPLES = 200
"""Standard errors are then good to 5 %."""

BLOCKS_PER_ROTATION = 8
"""Blocks of an eighth of a rotation are far longer than the noise is correlated."""

SEED = 20260301
HARMONICS = (1, 2)

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
    """Features of the recording that a fit was made of; those of the current where there is one."""
    recording, rotation_s = point.recording, point.optimum.symbols[ROTATION]
    direction = math.copysign(1.0, float(recording.motor_speed_rpm.mean()))
    rows = [recording.motor_speed_rpm]
    if MOTOR_CURRENT in recording.channels:
        rows.append(recording.channels[MOTOR_CURRENT])
    period_s = recording.sampling_period_s
    folded = np.stack([folded_signal(direction * row, rotation_s / period_s) for row in rows])
    return features(folded, rotation_s / folded.shape[2])


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
    values = _values(folded, period_s)
    generator = np.random.default_rng(SEED)
    drawn = [_values(_resampled(folded, generator), period_s) for _ in range(RESAMPLES)]
    return [
        Feature(name, _unit(name), value, float(np.std([d[name] for d in drawn], ddof=1)))
        for name, value in values.items()
    ]


def folded_signal(signal: FloatArray, samples_per_rotation: float) -> FloatArray:
    """Whole rotations below one another, shape (rotations, samples), between samples linear."""
    rotations = math.floor((signal.size - 1) / samples_per_rotation)
    count = round(samples_per_rotation)
    place = np.arange(rotations * count) * (samples_per_rotation / count)
    folded = np.interp(place, np.arange(signal.size), signal)
    return np.asarray(folded.reshape(rotations, count))


def _values(folded: FloatArray, period_s: float) -> dict[str, float]:
    centred = folded - folded.mean(axis=2, keepdims=True)
    found = {}
    if len(folded) > 1:
        current = centred[1]
        error = -centred[0] / RPM_PER_RAD_PER_S
        integral = np.cumsum(error, axis=1) * period_s
        integral -= integral.mean(axis=1, keepdims=True)
        terms = [error, integral]
        normal = np.array([[_between_rotations(a, b) for b in terms] for a in terms])
        found[PROPORTIONAL], found[INTEGRAL] = np.linalg.solve(
            normal, [_between_rotations(a, current) for a in terms]
        )
        found[MEAN_CURRENT] = float(folded[1].mean())
    for name, channel in zip(("speed", "current"), centred, strict=False):
        for order in HARMONICS:
            found[harmonic_name(name, order)] = _harmonic(channel, order)
    return found


def _between_rotations(first: FloatArray, second: FloatArray) -> float:
    """Mean of the products of different rotations, (rotations, samples) each."""
    count = len(first)
    of_all = float(first.sum(axis=0) @ second.sum(axis=0))
    of_same = float(np.einsum("ij,ij->", first, second))
    return (of_all - of_same) / (count * (count - 1))


def _harmonic(channel: FloatArray, order: int) -> float:
    """Amplitude at a multiple of the load's rotation, in the channel's unit."""
    count = channel.shape[1]
    wave = np.exp(-2j * np.pi * order * np.arange(count) / count)
    terms = channel @ wave * (2.0 / count)
    power = (abs(terms.sum()) ** 2 - np.sum(np.abs(terms) ** 2)) / (terms.size * (terms.size - 1))
    return math.sqrt(max(float(power), 0.0))


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
