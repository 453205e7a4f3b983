"""Noise of no fitted family is what it says."""

from __future__ import annotations

import numpy as np
import pytest
from outside_noise import encoder_harmonics, one_over_f, varied_speed

SIZE, SAMPLING_HZ, ROTATION_S = 18_000, 1000.0, 3.6


def turning() -> np.ndarray:
    """Position, speed and current at 2000 rpm with a ripple at the second load order."""
    time_s = np.arange(SIZE) / SAMPLING_HZ
    wave = np.sin(4.0 * np.pi * time_s / ROTATION_S)
    return np.stack([209.44 * time_s, 2000.0 + 5.0 * wave, 7.0 * wave])


def test_the_power_of_one_over_f_noise_falls_as_the_frequency_grows() -> None:
    noise = one_over_f(2**16, 1.5, np.random.default_rng(1))
    assert noise.std() == pytest.approx(1.5)
    power = np.abs(np.fft.rfft(noise)) ** 2
    low, high = power[100:1000].mean(), power[1000:10_000].mean()
    # Means over decades of 1/f differ by ten; 900 values of χ² scatter their mean by 3 %.
    assert low / high == pytest.approx(10.0, rel=0.15)


def test_errors_of_an_encoder_turn_with_the_motor() -> None:
    clean = turning()
    error = encoder_harmonics(clean[0], 0.5, np.random.default_rng(2))
    assert error.std() == pytest.approx(0.5, rel=0.01)
    orders = [np.exp(1j * k * clean[0]) for k in (1, 2, 4)]
    basis = np.column_stack([part for z in orders for part in (z.real, z.imag)])
    left = error - basis @ np.linalg.lstsq(basis, error, rcond=None)[0]
    assert left.std() < 1e-9


def test_a_speed_that_does_not_vary_leaves_the_recording_as_it_is() -> None:
    clean = turning()[1:]
    same = varied_speed(clean, SAMPLING_HZ, ROTATION_S, 1e-12, np.random.default_rng(3))
    assert np.allclose(same, clean, atol=1e-6)


def test_a_speed_that_varies_does_so_by_its_share_and_slowly() -> None:
    clean, share = turning()[1:], 1e-3
    varied = varied_speed(clean, SAMPLING_HZ, ROTATION_S, share, np.random.default_rng(4))
    change = varied[0] - clean[0]
    # The ripple of 5 rpm moves along with time, by far less than the speed varies by.
    assert change.std() == pytest.approx(2000.0 * share, rel=0.3)
    assert np.abs(np.diff(change)).max() < 0.1
