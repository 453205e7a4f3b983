"""What disturbs the speed of a real motor and is no noise of the fitted families.

Encoder errors go with the motor's position, the variation of the speed bends time itself.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

ENCODER_ORDERS = (1, 2, 4)
"""Orders of the motor: eccentricity of the disc, and its sine tracks of other size and phase."""

RINGING_ABOVE = 8.5
"""Orders of the load: slower is gravity's wave."""

ENVELOPE_S = 0.05
LOUD_SHARE = 0.25
"""Of the ringing's largest RMS: where it is louder is around an impact."""

SLOWEST_SHARE = 0.1
"""Speed varies over tenths of a rotation and longer."""


def one_over_f(size: int, sd: float, rng: np.random.Generator) -> FloatArray:
    """Gaussian noise with a power that falls as 1/f from the longest period on, shape (size,)."""
    orders = np.fft.rfftfreq(size, 1.0 / size)
    spectrum = rng.standard_normal(orders.size) + 1j * rng.standard_normal(orders.size)
    spectrum[0] = 0.0
    spectrum[1:] /= np.sqrt(orders[1:])
    noise = np.fft.irfft(spectrum, size)
    return np.asarray(noise * (sd / noise.std()))


def encoder_harmonics(
    position_rad: FloatArray, sd_rpm: float, rng: np.random.Generator
) -> FloatArray:
    """Errors of an encoder's disc in the recorded speed, of random phase; shape (n,), rpm."""
    amplitudes = rng.standard_normal(len(ENCODER_ORDERS))
    amplitudes *= sd_rpm * math.sqrt(2.0) / np.linalg.norm(amplitudes)
    phases = rng.uniform(0.0, 2.0 * math.pi, len(ENCODER_ORDERS))
    return np.asarray(
        sum(
            a * np.sin(order * position_rad + phase)
            for a, order, phase in zip(amplitudes, ENCODER_ORDERS, phases, strict=True)
        )
    )


def varied_speed(
    clean: FloatArray, sampling_hz: float, rotation_s: float, share: float, rng: np.random.Generator
) -> FloatArray:
    """Speed (rpm) and current (A) of the same rotations, passed a little faster or slower.

    ``clean`` and the result: shape (2, n), without noise.

    The variation, sd ``share`` of the speed, is slow against the ringing: everything happens as at
    constant speed when the load reaches the angle at which it happens.
    """
    size = clean.shape[1]
    time_s = np.arange(size) / sampling_hz
    spacing = max(2, int(SLOWEST_SHARE * rotation_s * sampling_hz))
    knots = np.arange(0, size + 4 * spacing, spacing) / sampling_hz
    walk = one_over_f(knots.size, share, rng)
    faster = np.interp(time_s, knots, walk)
    reached_s = time_s + np.concatenate(([0.0], np.cumsum(0.5 * (faster[1:] + faster[:-1])))) / (
        sampling_hz
    )
    # What lies beyond the recording is the rotation before it.
    period = rotation_s * sampling_hz
    places = reached_s * sampling_hz
    wrapped = np.where(
        places > size - 1, places - np.ceil((places - size + 1) / period) * period, places
    )
    varied = np.stack([np.interp(np.maximum(wrapped, 0.0), np.arange(size), row) for row in clean])
    varied[0] *= 1.0 + faster
    return varied


def around_impacts(speed_rpm: FloatArray, sampling_hz: float, rotation_s: float) -> FloatArray:
    """1 around each impact of a clean speed, (n,), 0 between them."""
    envelope = _envelope(_ringing(speed_rpm[None], sampling_hz, rotation_s)[0], sampling_hz)
    return np.asarray(envelope > LOUD_SHARE * envelope.max(), dtype=np.float64)


def unlike_impacts(
    clean: FloatArray, sampling_hz: float, rotation_s: float, share: float, rng: np.random.Generator
) -> FloatArray:
    """Clean channels (c, n), speed first, with each impact's ringing times 1 + ``share`` ξ."""
    ringing = _ringing(clean, sampling_hz, rotation_s)
    envelope = _envelope(ringing[0], sampling_hz)
    half = 0.5 * rotation_s * sampling_hz
    at = np.arange(clean.shape[1])
    phase = (at % half).astype(int)
    quietest = np.argmin(np.bincount(phase, envelope) / np.bincount(phase))
    number = np.floor((at - quietest) / half).astype(int) + 1
    factors = share * rng.standard_normal(number[-1] + 1)
    return np.asarray(clean + factors[number] * ringing)


def _ringing(clean: FloatArray, sampling_hz: float, rotation_s: float) -> FloatArray:
    """What of channels (c, n) is faster than the load turns."""
    size = clean.shape[1]
    # Mirrored, so that ends that do not meet are no step.
    spectrum = np.fft.rfft(np.concatenate([clean, clean[:, ::-1]], axis=1))
    frequency = np.fft.rfftfreq(2 * size, 1.0 / sampling_hz)
    spectrum[:, frequency * rotation_s < RINGING_ABOVE] = 0.0
    return np.asarray(np.fft.irfft(spectrum, 2 * size)[:, :size])


def _envelope(ringing: FloatArray, sampling_hz: float) -> FloatArray:
    window = np.ones(max(1, round(ENVELOPE_S * sampling_hz)))
    squares: FloatArray = np.convolve(ringing**2, window / window.size, "same")
    return np.asarray(np.sqrt(squares))
