"""Sum of squares of the disturbance model on any time stamps: exact, sample by sample.

The path for recordings whose samples are not evenly spaced; about fifty times the work of
:mod:`bayesbl.ringing.sums_of_squares`, which it mirrors in arguments and results.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesbl.recording.types import FloatArray
from bayesbl.ringing import sums_of_squares as kernel
from bayesbl.ringing.symbols import (
    DECAY,
    FREQUENCY,
    ROTATION,
    SEPARATION,
    START,
    WINDOW_END,
    WINDOW_START,
)
from bayesbl.ringing.waveform import baseline_columns, pulse_train


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
            DECAY: p[kernel.DECAY],
            FREQUENCY: p[kernel.FREQUENCY],
            SEPARATION: p[kernel.SEPARATION],
            ROTATION: p[kernel.ROTATION],
        }
        columns[:-1] = baseline_columns(time_s, p[kernel.ROTATION], harmonics).T
        columns[-1] = pulse_train(time_s, symbols, period_s)
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
