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
from bayesbl.ringing.sums_of_squares import (
    AMPLITUDE,
    DECAY,
    FIRST_IMPACT,
    FREQUENCY,
    MEAN,
    ROTATION,
    SEPARATION,
    WINDOW,
    solve,
)


@compiled()
def _add_pulses(train, t, start, sign, decay, frequency, window, rotation, period_s):  # type: ignore[no-untyped-def]
    """Add the impacts start + i·rotation of one sign to the unit pulse train."""
    reach = max(window + 0.5 * period_s, period_s)
    start += math.ceil((t[0] - reach - start) / rotation) * rotation
    while start <= t[-1] + period_s:
        i = np.searchsorted(t, start - period_s)
        while i < t.size and t[i] < start + reach:
            u = t[i] - start
            if u > 0.0:
                ramp = max(0.0, min(1.0, (window - u) / period_s + 0.5))
                train[i] += sign * ramp * math.exp(-decay * u) * math.sin(frequency * u)
            near = max(0.0, 1.0 - abs(u) / period_s)
            train[i] += sign * frequency * period_s * near**3 / 6.0
            i += 1
        start += rotation


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
    columns = np.ones((c, n))
    solution, factor = np.zeros(c), np.zeros((c, c))
    elapsed = time_s - 0.5 * (time_s[0] + time_s[-1])
    order = np.arange(1, harmonics + 1)[:, None]
    for row, p in enumerate(parameters):
        sse[row] = np.inf
        log_determinant[row] = 0.0
        if not (
            p[ROTATION] >= period_s
            and 0.5 * period_s < p[WINDOW] <= n * period_s
            and p[DECAY] > 0.0
            and p[FREQUENCY] > 0.0
        ):
            continue
        turned = 2.0 * math.pi / p[ROTATION] * order * elapsed
        columns[0] = 1.0
        columns[1:-1:2], columns[2:-1:2] = np.cos(turned), np.sin(turned)
        columns[-1] = 0.0
        for sign, start in ((1.0, p[FIRST_IMPACT]), (-1.0, p[FIRST_IMPACT] - p[SEPARATION])):
            _add_pulses(
                columns[-1],
                time_s,
                start,
                sign,
                p[DECAY],
                p[FREQUENCY],
                p[WINDOW],
                p[ROTATION],
                period_s,
            )
        columns[:, left_out] = 0.0
        sse[row], log_determinant[row] = solve(
            columns @ columns.T,
            columns @ y,
            y_square,
            p[AMPLITUDE],
            p[MEAN],
            solve_amplitude,
            solve_mean,
            solution,
            factor,
        )
        if coefficients.shape[0] > 0:
            coefficients[row] = solution
            factors[row] = factor
