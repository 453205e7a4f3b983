"""Least squares in A, v_t and the baseline from inner products alone."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True)
def solve(  # type: ignore[no-untyped-def]
    gram, rhs, y_square, amplitude, mean, solve_amplitude, solve_mean, solution, factor
):
    """Solve XᵀX b = Xᵀy for columns ordered [1, cos, sin, …, pulses].

    Parameters
    ----------
    gram, rhs
        XᵀX (lower triangle read) and Xᵀy of all c columns, shapes (c, c) and (c,); ``rhs`` is
        overwritten.
    y_square
        Σ y², rpm².
    amplitude, mean
        Values of the last and first coefficient where they are not solved for, rpm.
    solution, factor
        Output: coefficients (c,) and lower Cholesky factor (c, c), whose rows and columns of
        given coefficients are left as they are.

    Returns
    -------
    Sum of squares left in rpm² (infinite where the columns are degenerate), and log|XᵀX| of the
    columns solved for.
    """
    c = rhs.size
    first = 0 if solve_mean else 1
    last = c if solve_amplitude else c - 1
    left = y_square
    if not solve_amplitude:
        left += amplitude * (amplitude * gram[c - 1, c - 1] - 2.0 * rhs[c - 1])
        for k in range(c - 1):
            rhs[k] -= amplitude * gram[c - 1, k]
        solution[c - 1] = amplitude
    if not solve_mean:
        left += mean * (mean * gram[0, 0] - 2.0 * rhs[0])
        for k in range(1, c):
            rhs[k] -= mean * gram[k, 0]
        solution[0] = mean

    log_determinant = 0.0
    for i in range(first, last):
        for j in range(first, i + 1):
            s = gram[i, j]
            for k in range(first, j):
                s -= factor[i, k] * factor[j, k]
            if i > j:
                factor[i, j] = s / factor[j, j]
            elif s > 1e-13 * gram[i, i]:
                factor[i, i] = math.sqrt(s)
            else:
                return np.inf, 0.0
        log_determinant += 2.0 * math.log(factor[i, i])
        v = rhs[i]
        for k in range(first, i):
            v -= factor[i, k] * solution[k]
        solution[i] = v / factor[i, i]
        left -= solution[i] ** 2
    for i in range(last - 1, first - 1, -1):
        v = solution[i]
        for k in range(i + 1, last):
            v -= factor[k, i] * solution[k]
        solution[i] = v / factor[i, i]
    return max(left, 0.0), log_determinant
