"""Sum of squares of the disturbance model on any time stamps: exact, sample by sample.

The path for recordings whose samples are not evenly spaced; about fifty times the work of
:mod:`bayesbl.ringing.sums_of_squares`, which it mirrors in arguments and results.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bayesbl.compiled import compiled
from bayesbl.recording.types import FloatArray
from bayesbl.ringing import sums_of_squares as kernel
from bayesbl.ringing.symbols import (
    ROTATION,
    SEPARATION,
    START,
    WINDOW_END,
    WINDOW_START,
)
from bayesbl.ringing.waveform import baseline_columns, impacts


@compiled()
def _add_impact(train, time_s, start, sign, decay, frequency, window, period_s):  # type: ignore[no-untyped-def]
    """Add one impact to the unit pulse train: :func:`waveform.impact` in a loop, far quicker."""
    reach = max(window + 0.5 * period_s, period_s)
    i = np.searchsorted(time_s, start - period_s)
    while i < time_s.size and time_s[i] < start + reach:
        u = time_s[i] - start
        if u > 0.0:
            ramp = max(0.0, min(1.0, (window - u) / period_s + 0.5))
            train[i] += sign * ramp * math.exp(-decay * u) * math.sin(frequency * u)
        near = max(0.0, 1.0 - abs(u) / period_s)
        train[i] += sign * frequency * period_s * near**3 / 6.0
        i += 1


def sums_of_squares(
    parameters: FloatArray,
    time_s: FloatArray,
    y: FloatArray,
    y_square: float,
    period_s: float,
    harmonics: int,
    left_out: NDArray[np.intp],
    solve_amplitude: bool,
    solve_mean: bool,
    sse: FloatArray,
    log_determinant: FloatArray,
    coefficients: FloatArray,
    factors: FloatArray,
) -> None:
    """Like its namesake in :mod:`bayesbl.ringing.sums_of_squares`, on any time stamps."""
    n = y.size
    c = 2 + 2 * harmonics
    columns = np.empty((c, n))
    solution, factor = np.zeros(c), np.zeros((c, c))
    for row, p in enumerate(parameters):
        sse[row] = np.inf
        log_determinant[row] = 0.0
        if not (
            p[kernel.ROTATION] >= period_s
            and 0.5 * period_s < p[kernel.WINDOW] <= n * period_s
            and p[kernel.DECAY] > 0.0
            and p[kernel.FREQUENCY] > 0.0
        ):
            continue
        symbols = {
            START: p[kernel.FIRST_IMPACT],
            WINDOW_START: 0.0,
            WINDOW_END: p[kernel.WINDOW],
            SEPARATION: p[kernel.SEPARATION],
            ROTATION: p[kernel.ROTATION],
        }
        columns[:-1] = baseline_columns(time_s, p[kernel.ROTATION], harmonics).T
        columns[-1] = 0.0
        for sign, start, _ in impacts(symbols, time_s[0], time_s[-1], period_s):
            _add_impact(
                columns[-1],
                time_s,
                start,
                sign,
                p[kernel.DECAY],
                p[kernel.FREQUENCY],
                p[kernel.WINDOW],
                period_s,
            )
        columns[:, left_out] = 0.0
        sse[row], log_determinant[row] = kernel.solve(
            columns @ columns.T,
            columns @ y,
            y_square,
            p[kernel.AMPLITUDE],
            p[kernel.MEAN],
            solve_amplitude,
            solve_mean,
            solution,
            factor,
        )
        if coefficients.shape[0] > 0:
            coefficients[row] = solution
            factors[row] = factor
