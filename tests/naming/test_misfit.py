"""What repeats and no name explains is the noise that a name is held against."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from bayesbl.bench.simulation import Measurement
from bayesbl.config.bench import reference_bench
from bayesbl.matching.least_squares import SimulatedFit, fit_simulated
from bayesbl.matching.observed import observed
from bayesbl.matching.signals import SimulatedSignals, gap_unknown, start_angle_unknown
from bayesbl.naming.criteria import least_ratio, misfit_scale
from bayesbl.noise.channel_noise import estimate_channel_noise
from bayesbl.noise.process import NoiseModel

ORDERS = np.arange(1, 6)
FALSE_ALARM = 0.05
TRIALS = 300


@pytest.fixture(scope="module")
def fit() -> SimulatedFit:
    noise = Measurement(
        encoder_counts=None, speed_noise=NoiseModel(1.5), current_noise=NoiseModel(0.05)
    )
    recording = replace(reference_bench(), measurement=noise).simulate(
        8e-4,
        rotations=3.0,
        sampling_hz=250.0,
        start_angle_rad=1.0,
        name="one",
        seed=np.random.default_rng(1),
    )
    seen = observed(recording, reference_bench())
    unknowns = [gap_unknown(1e-4, 1e-2), start_angle_unknown("one")]
    known = estimate_channel_noise(seen.signals, seen.lag)
    model = SimulatedSignals(reference_bench(), [seen], unknowns, [known])
    return fit_simulated(model, np.array([math.log(8e-4), 1.0]))


def left_with(fit: SimulatedFit, waves: np.ndarray, rng: np.random.Generator) -> SimulatedFit:
    """White noise with waves of these amplitudes, cosine and sine, (channels, orders, 2)."""
    residual = rng.standard_normal(fit.residual.size)
    (rows,) = fit.model.by_recording(residual)
    phase = 2.0 * math.pi * np.outer(ORDERS, np.arange(rows.shape[1])) / fit.model.recordings[0].lag
    rows += waves[:, :, 0] @ np.cos(phase) + waves[:, :, 1] @ np.sin(phase)
    return replace(fit, residual=residual)


def test_noise_asks_nothing_more_of_a_name(fit: SimulatedFit) -> None:
    alone = left_with(fit, np.zeros((2, ORDERS.size, 2)), np.random.default_rng(2))
    assert misfit_scale(alone, 1e-3) == 1.0
    assert least_ratio(alone, 1, 20, 1e-3) == 0.0


def test_lines_of_equal_power_are_so_many_degrees_of_freedom(fit: SimulatedFit) -> None:
    from scipy.stats import f as f_distribution

    left = left_with(fit, np.ones((2, ORDERS.size, 2)), np.random.default_rng(3))
    (rows,) = fit.model.by_recording(fit.residual)
    degrees = 2 * 2 * ORDERS.size
    # n samples of cosine and sine of amplitude 1 have a sum of squares of n, less what is no
    # whole rotation; noise moves it by 5 %.
    assert misfit_scale(left, 1e-3) == pytest.approx(rows.size * ORDERS.size / degrees, rel=0.1)
    asked = f_distribution.isf(1e-3 / 20, 1, degrees) / degrees
    assert least_ratio(left, 1, 20, 1e-3) == pytest.approx(asked, rel=0.05)


def test_a_chance_column_stands_out_of_a_misfit_no_oftener_than_promised(
    fit: SimulatedFit,
) -> None:
    rng = np.random.default_rng(4)
    stood_out = 0
    for _ in range(TRIALS):
        misfit, column = rng.standard_normal((2, 2, ORDERS.size, 2))
        share = float(np.sum(misfit * column) ** 2 / np.sum(misfit**2) / np.sum(column**2))
        without = misfit - column * np.sum(misfit * column) / np.sum(column**2)
        least = least_ratio(left_with(fit, without, rng), 1, 1, FALSE_ALARM)
        stood_out += share / (1.0 - share) > least
    # 15 expected at the promised rate; more than 24 in one of a hundred runs.
    assert stood_out <= 24
