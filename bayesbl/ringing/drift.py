"""A drift of the speed: found by comparing rotations, removed and reported.

What repeats is never taken for a drift. What it does to the impacts' times is left to
:mod:`bayesbl.noise.impact_scatter`: they come early and late.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayesbl.noise.rotation_noise import bridged, estimate_noise
from bayesbl.probabilities import chi2_isf
from bayesbl.recording.types import MOTOR_SPEED, FloatArray, Recording
from bayesbl.ringing.optimum import Optimum
from bayesbl.ringing.symbols import MEAN, ROTATION

FALSE_ALARM = 1e-5
"""Per recording."""

SMALLEST_SHARE = 1e-5
"""A drift below this share of the speed moves no impact by more than 0.1 ms a minute."""

DEGREE = 2


def without_drift(
    recording: Recording, optimum: Optimum, residual_rpm: FloatArray
) -> tuple[Recording, str] | None:
    """The recording without a drift of its speed, a parabola in time, and a note.

    Its coefficients are sums over the differences between rotations, in which a misfit cancels.
    """
    period_s, n = recording.sampling_period_s, recording.samples
    x = np.linspace(-1.0, 1.0, n)
    powers = np.stack([x**k for k in range(1, DEGREE + 1)], axis=1)
    lag = max(1, round(optimum.symbols[ROTATION] / period_s))
    weights = np.linalg.pinv(powers[lag:] - powers[:-lag]).T
    # As sums over the residual itself, whose covariance is known.
    on_residual = np.pad(weights, ((lag, 0), (0, 0))) - np.pad(weights, ((0, lag), (0, 0)))
    residual_rpm = bridged(residual_rpm)
    coefficients = residual_rpm @ on_residual
    drift = powers @ coefficients
    steady = estimate_noise(residual_rpm - drift, optimum.symbols[ROTATION], period_s)
    spread = on_residual.T @ steady.covariance_times(on_residual)
    size = float(coefficients @ np.linalg.solve(spread, coefficients))
    least = SMALLEST_SHARE * abs(optimum.symbols[MEAN])
    if size < chi2_isf(FALSE_ALARM, DEGREE) or np.ptp(drift) < least:
        return None
    level = recording.motor_speed_rpm - drift + drift.mean()
    note = f"The speed drifts by {np.ptp(drift):.2g} rpm over the recording; this was removed."
    return replace(recording, channels={**recording.channels, MOTOR_SPEED: level}), note
