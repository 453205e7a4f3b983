"""A speed that drifts slowly over the recording, found in what does not repeat and taken out.

A drift makes every rotation differ from the last by the same step, where a misfit cancels. It moves
the later impacts too: the load comes round sooner as the motor gets faster.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import matmul_toeplitz
from scipy.stats import chi2

from bayesbl.inference.noise import Noise, estimate_noise
from bayesbl.inference.optimum import Optimum
from bayesbl.recording.types import MOTOR_SPEED, FloatArray, Recording
from bayesbl.signal.jacobian import jacobian, jacobian_columns
from bayesbl.signal.parameters import MEAN, ROTATION, START

FALSE_ALARM = 1e-5
SMALLEST_SHARE = 1e-5
"""A drift below this share of the speed moves no impact by more than 0.1 ms a minute."""

_DEGREE = 2


@dataclass(frozen=True, slots=True)
class SpeedDrift:
    """A parabola in time.

    Attributes
    ----------
    speed_rpm
        What the drift adds to the mean speed, shape (n,), rpm.
    delay_s
        By how much the load is ahead of steady rotation, zero at both ends, shape (n,), s.
    moves_impacts
        Whether the impacts follow it; they do not where only the sensor drifts.
    """

    speed_rpm: FloatArray
    delay_s: FloatArray
    moves_impacts: bool

    @property
    def change_rpm(self) -> float:
        """Between the slowest and the fastest time of the recording."""
        return float(np.ptp(self.speed_rpm))

    def removed(self, recording: Recording) -> Recording:
        """The recording as it would be at constant speed; it holds no channel but the speed."""
        time_s = recording.time_s
        speed = recording.motor_speed_rpm - self.speed_rpm
        if self.moves_impacts:
            # t + delay(t) = u solved for t by two substitutions; the delay changes by 1e-3 at most.
            at = time_s - np.interp(time_s - self.delay_s, time_s, self.delay_s)
            speed = CubicSpline(time_s, speed)(np.clip(at, time_s[0], time_s[-1]))
        return replace(recording, channels={MOTOR_SPEED: speed})


def speed_drift(
    optimum: Optimum, time_s: FloatArray, residual_rpm: FloatArray
) -> SpeedDrift | None:
    """The drift of a recording around its optimum, or ``None`` where it shows none.

    Raises
    ------
    RecordingError
        If there are too few rotations to tell.
    """
    rotation_s = optimum.symbols[ROTATION]
    period_s = float(time_s[-1] - time_s[0]) / (time_s.size - 1)
    x = np.linspace(-1.0, 1.0, time_s.size)
    powers = np.stack([x**k for k in range(1, _DEGREE + 1)], axis=1)
    lag = max(1, round(rotation_s / period_s))
    steps = powers[lag:] - powers[:-lag]
    weights = np.linalg.pinv(steps).T
    # Coefficients as sums over the residual itself, whose covariance is known.
    on_residual = np.pad(weights, ((lag, 0), (0, 0))) - np.pad(weights, ((0, lag), (0, 0)))
    coefficients = residual_rpm @ on_residual
    drift = powers @ coefficients
    noise = estimate_noise(residual_rpm - drift, rotation_s, period_s)
    spread = on_residual.T @ _noisy(noise, on_residual)
    size = float(coefficients @ np.linalg.solve(spread, coefficients))
    speed = abs(optimum.symbols[MEAN])
    if size < chi2.isf(FALSE_ALARM, _DEGREE) or np.ptp(drift) < SMALLEST_SHARE * speed:
        return None
    ahead = np.r_[0.0, np.cumsum(0.5 * (drift[1:] + drift[:-1]))] * period_s
    ahead *= 1.0 / optimum.symbols[MEAN]
    delay = ahead - np.linspace(0.0, ahead[-1], ahead.size)
    follows = _follows(optimum, time_s, residual_rpm - drift, delay)
    return SpeedDrift(drift - drift.mean(), delay, follows)


def _noisy(noise: Noise, columns: FloatArray) -> FloatArray:
    return np.asarray(matmul_toeplitz(noise.autocovariance(len(columns)), columns))


def _follows(
    optimum: Optimum, time_s: FloatArray, residual_rpm: FloatArray, delay_s: FloatArray
) -> bool:
    """Whether more than half the delay is seen in the impacts."""
    columns = jacobian(optimum.model, time_s, optimum.symbols, optimum.baseline_rpm)
    names = jacobian_columns(optimum.model)
    if START not in names:
        return True
    earlier = -columns[:, names.index(START)] * delay_s
    fitted, *_ = np.linalg.lstsq(columns / np.linalg.norm(columns, axis=0), earlier, rcond=None)
    own = earlier - columns / np.linalg.norm(columns, axis=0) @ fitted
    return bool(own @ residual_rpm > 0.5 * (own @ own))
