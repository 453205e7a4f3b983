"""Sum of squares of the disturbance model on any time stamps: exact, sample by sample.

The path for recordings whose samples are not evenly spaced; about fifty times the work of
:mod:`bayesbl.signal.kernel`, which it mirrors in arguments and results.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from bayesbl.signal.kernel import (
    AMPLITUDE,
    DECAY,
    FIRST_IMPACT,
    FREQUENCY,
    MEAN,
    ROTATION,
    SEPARATION,
    WINDOW,
)
from bayesbl.signal.normal_equations import solve


@njit(cache=True)
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


@njit(cache=True)
def sums_of_squares(  # type: ignore[no-untyped-def]
    parameters,
    time_s,
    y,
    y_square,
    period_s,
    harmonics,
    left_out,
    solve_amplitude,
    solve_mean,
    sse,
    log_determinant,
    coefficients,
    factors,
):
    """As :func:`bayesbl.signal.kernel.sums_of_squares`, with time stamps for a grid."""
    n = y.size
    c = 2 + 2 * harmonics
    columns = np.ones((c, n))
    train = columns[c - 1]
    gram, rhs, solution = np.zeros((c, c)), np.zeros(c), np.zeros(c)
    factor = np.zeros((c, c))
    middle = 0.5 * (time_s[0] + time_s[-1])
    for row in range(parameters.shape[0]):
        p = parameters[row]
        sse[row] = np.inf
        log_determinant[row] = 0.0
        if not (
            p[ROTATION] >= period_s
            and 0.5 * period_s < p[WINDOW] <= n * period_s
            and p[DECAY] > 0.0
            and p[FREQUENCY] > 0.0
        ):
            continue
        train[:] = 0.0
        for sign, start in (
            (1.0, p[FIRST_IMPACT]),
            (-1.0, p[FIRST_IMPACT] - p[SEPARATION]),
        ):
            _add_pulses(
                train, time_s, start, sign, p[DECAY], p[FREQUENCY], p[WINDOW], p[ROTATION], period_s
            )
        for k in range(1, harmonics + 1):
            kappa = 2.0 * math.pi * k / p[ROTATION]
            for i in range(n):
                columns[2 * k - 1, i] = math.cos(kappa * (time_s[i] - middle))
                columns[2 * k, i] = math.sin(kappa * (time_s[i] - middle))
        for i in left_out:
            columns[:, i] = 0.0
        for i in range(c):
            rhs[i] = np.dot(columns[i], y)
            for j in range(i + 1):
                gram[i, j] = np.dot(columns[i], columns[j])
        sse[row], log_determinant[row] = solve(
            gram,
            rhs,
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
