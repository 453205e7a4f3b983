"""A drift of the speed: found by comparing rotations, removed and reported.

What repeats is never taken for a drift. A is then the least-squares amplitude of the recording as
it would be without it, as the gap curve means it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesbl.noise.rotation_noise import bridged, estimate_noise
from bayesbl.probabilities import chi2_isf
from bayesbl.recording.types import MOTOR_SPEED, FloatArray, Recording
from bayesbl.ringing.jacobian import jacobian, jacobian_columns
from bayesbl.ringing.optimum import Optimum
from bayesbl.ringing.symbols import MEAN, ROTATION, START

FALSE_ALARM = 1e-5
"""Per recording."""

SMALLEST_SHARE = 1e-5
"""A drift below this share of the speed moves no impact by more than 0.1 ms a minute."""

_DRIFT_DEGREE = 2


@dataclass(frozen=True, slots=True)
class Mended:
    """A recording without drift, and what the reader should know about it."""

    recording: Recording
    note: str


def without_drift(
    recording: Recording, optimum: Optimum, residual_rpm: FloatArray
) -> Mended | None:
    """Remove a drift of the speed, a parabola in time, and what it does to the impacts' times.

    Its coefficients are sums over the differences between rotations, in which a misfit cancels. As
    the load comes round sooner when the motor is faster, the time axis is stretched too, unless the
    impacts show that only the sensor drifts.
    """
    period_s, n = recording.sampling_period_s, recording.samples
    mean = optimum.symbols[MEAN]
    x = np.linspace(-1.0, 1.0, n)
    powers = np.stack([x**k for k in range(1, _DRIFT_DEGREE + 1)], axis=1)
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
    if size < chi2_isf(FALSE_ALARM, _DRIFT_DEGREE) or np.ptp(drift) < SMALLEST_SHARE * abs(mean):
        return None
    ahead_s = np.r_[0.0, np.cumsum(0.5 * (drift[1:] + drift[:-1]))] * period_s / mean
    ahead_s -= np.linspace(0.0, ahead_s[-1], n)
    follow = _impacts_follow(recording, optimum, residual_rpm - drift, ahead_s)
    level = recording.motor_speed_rpm - drift + drift.mean()
    note = f"The speed drifts by {np.ptp(drift):.2g} rpm over the recording"
    note += "; this was removed." if follow else ", the impacts do not; this was removed."
    return Mended(_turned_evenly(recording, level, ahead_s if follow else 0.0 * ahead_s), note)


def _turned_evenly(recording: Recording, speed_rpm: FloatArray, ahead_s: FloatArray) -> Recording:
    """The recording over a time in which the load turns evenly; ``ahead_s`` is its lead."""
    made = _with_speed(recording, speed_rpm)
    if not np.any(ahead_s):
        return made
    from scipy.interpolate import CubicSpline

    time_s, excluded = recording.time_s, recording.excluded
    # t + ahead(t) = u solved for t by substitution; ahead changes by parts in a thousand.
    at = time_s - np.interp(time_s - ahead_s, time_s, ahead_s)
    at = np.clip(at, time_s[0], time_s[-1])
    if excluded is not None:
        excluded = np.interp(at, time_s, excluded.astype(float)) > 0.0
    turned = {name: CubicSpline(time_s, row)(at) for name, row in made.channels.items()}
    return replace(made, channels=turned, excluded=excluded)


def _with_speed(recording: Recording, speed_rpm: FloatArray) -> Recording:
    """Another speed beside the other channels, which tell what else changed in the joint."""
    return replace(recording, channels={**recording.channels, MOTOR_SPEED: speed_rpm})


def _impacts_follow(
    recording: Recording, optimum: Optimum, residual_rpm: FloatArray, ahead_s: FloatArray
) -> bool:
    """Whether the impacts show more than half of the load's lead."""
    names = jacobian_columns(optimum.model)
    if START not in names:
        return True
    columns = jacobian(optimum.model, recording.time_s, optimum.symbols, optimum.baseline_rpm)
    earlier = -columns[:, names.index(START)] * ahead_s
    columns = columns / np.linalg.norm(columns, axis=0)
    own = earlier - columns @ np.linalg.lstsq(columns, earlier, rcond=None)[0]
    return bool(own @ residual_rpm > 0.5 * (own @ own))
