"""Sum of squares of the disturbance model on an even grid, compiled.

All quantities are in samples, and waves are complex. With z = e^{(−τ + iω)Δt}, the ringing after
one impact is Im(w zʲ), w = e^{(−τ + iω)uΔt}, where u ∈ [0, 1) is the distance from the impact to
the next sample. One table of powers zʲ therefore serves every pulse:

* The train of pulses is written into its windows. There, its inner products with itself, the signal
  and the load-angle harmonics are summed. Overlapping pulses are added first, so each sample counts
  once; samples left out of the fit are zero.
* The inner products of the signal with the harmonics depend on T_w alone. They are interpolated
  from a table made once per recording.

A, v_t and the baseline are then solved from the normal equations. The work per evaluation does not
grow with the samples outside the pulse windows.

Everything that numba compiles together is in this one file. Its cache checks only the file of the
outermost function, so a part kept elsewhere could go stale unnoticed.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.fft import next_fast_len

from bayesbl.compiled import compiled
from bayesbl.recording.types import FloatArray

# Columns of the parameter matrix that the kernel takes.
COLUMNS = 7
FIRST_IMPACT, DECAY, FREQUENCY, MEAN, WINDOW, SEPARATION, ROTATION = range(COLUMNS)

INTERPOLATION_POINTS = 12
OVERSAMPLING = 32
"""With 12-point Lagrange interpolation this keeps the harmonic sums to about 1e-15 relative."""


def harmonic_table(centred_speed_rpm: FloatArray, columns: int) -> FloatArray:
    """Σ_n y_n e^{iκ t_n}, t from the middle of the recording, on a fine grid of κ.

    Parameters
    ----------
    centred_speed_rpm
        Signal with its mean removed, shape (n,).
    columns
        Grid points needed, κ = 2π m / (length · Δt).

    Returns
    -------
    Shape (columns + 2 · INTERPOLATION_POINTS, 2), real and imaginary part. The first
    INTERPOLATION_POINTS rows continue to negative κ, so that interpolation needs no special case.
    """
    n = centred_speed_rpm.size
    length = grid_length(n)
    margin = INTERPOLATION_POINTS
    spectrum = np.fft.rfft(centred_speed_rpm, length)[: columns + margin]
    m = np.arange(spectrum.size)
    centred = np.conj(spectrum) * np.exp(-1j * np.pi * m * (n - 1) / length)
    both = np.concatenate([np.conj(centred[margin:0:-1]), centred])
    return np.stack([both.real, both.imag], axis=1)


def grid_length(samples: int) -> int:
    """Length of the zero-padded transform behind :func:`harmonic_table`."""
    return int(next_fast_len(OVERSAMPLING * samples, real=True))


@compiled()
def _fill_powers(z: complex, cosine: FloatArray, sine: FloatArray, count: int) -> None:
    """Fill cosine + i·sine = zʲ for j < count, by doubling."""
    cosine[0] = 1.0
    sine[0] = 0.0
    filled = 1
    factor = z
    while filled < count:
        added = min(filled, count - filled)
        re, im = factor.real, factor.imag
        old_c, old_s = cosine[:added], sine[:added]
        new_c, new_s = cosine[filled : filled + added], sine[filled : filled + added]
        for j in range(added):
            new_c[j] = old_c[j] * re - old_s[j] * im
            new_s[j] = old_c[j] * im + old_s[j] * re
        factor = factor * factor
        filled += added


@compiled(fastmath={"reassoc", "contract"})
def _add_wave(train, start, cosine, sine):  # type: ignore[no-untyped-def]
    """Add Im(start · zʲ) to consecutive samples."""
    for j in range(train.size):
        train[j] += start.real * sine[j] + start.imag * cosine[j]


# The order of summation is free, so that these loops vectorise.
@compiled(fastmath={"reassoc", "contract"})
def _sums(part, y):  # type: ignore[no-untyped-def]
    """Σ q, Σ q² and Σ q y."""
    total, square, product = 0.0, 0.0, 0.0
    for j in range(part.size):
        total += part[j]
        square += part[j] * part[j]
        product += part[j] * y[j]
    return total, square, product


@compiled(fastmath={"reassoc", "contract"})
def _dots(part, cosine, sine):  # type: ignore[no-untyped-def]
    """Σ q cos and Σ q sin."""
    c, s = 0.0, 0.0
    for j in range(part.size):
        c += part[j] * cosine[j]
        s += part[j] * sine[j]
    return c, s


@compiled()
def _interpolate(table: FloatArray, position: float) -> complex:
    """Lagrange interpolation of the harmonic table at a fractional row (barycentric form)."""
    half = INTERPOLATION_POINTS // 2
    base = int(math.floor(position))
    x = position - base
    if x == 0.0:
        row = base + INTERPOLATION_POINTS
        return complex(table[row, 0], table[row, 1])
    first = base - half + 1
    weight = -1.0  # (−1)^i binomial(11, i), built by recurrence
    total = 0.0
    re = 0.0
    im = 0.0
    for i in range(INTERPOLATION_POINTS):
        share = weight / (x - (i - half + 1))
        row = first + i + INTERPOLATION_POINTS
        total += share
        re += share * table[row, 0]
        im += share * table[row, 1]
        weight *= -(INTERPOLATION_POINTS - 1.0 - i) / (i + 1.0)
    return complex(re / total, im / total)


@compiled()
def solve(gram, rhs, y_square, mean, solve_mean, solution, factor):  # type: ignore[no-untyped-def]
    """Solve XᵀX b = Xᵀy for columns ordered [1, cos, sin, …, pulses].

    Parameters
    ----------
    gram, rhs
        XᵀX (only the lower triangle is read) and Xᵀy of all c columns, shapes (c, c) and (c,);
        ``rhs`` is overwritten.
    y_square
        Σ y², rpm².
    mean
        Value of the first coefficient if it is fixed, rpm.
    solution, factor
        Output: coefficients (c,) and lower Cholesky factor (c, c), whose row and column of a fixed
        mean stay unchanged.

    Returns
    -------
    Residual sum of squares in rpm² (infinite if the columns are degenerate), and log|XᵀX| of the
    solved columns.
    """
    c = rhs.size
    first = 0 if solve_mean else 1
    residual_square = y_square
    if not solve_mean:
        residual_square += mean * (mean * gram[0, 0] - 2.0 * rhs[0])
        for k in range(1, c):
            rhs[k] -= mean * gram[k, 0]
        solution[0] = mean

    log_determinant = 0.0
    for i in range(first, c):
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
        residual_square -= solution[i] ** 2
    for i in range(c - 1, first - 1, -1):
        v = solution[i]
        for k in range(i + 1, c):
            v -= factor[k, i] * solution[k]
        solution[i] = v / factor[i, i]
    return max(residual_square, 0.0), log_determinant


@compiled()
def sums_of_squares(  # type: ignore[no-untyped-def]
    parameters,
    y,
    y_square,
    first_time_s,
    period_s,
    harmonics,
    table,
    table_length,
    left_out,
    left_out_table,
    solve_mean,
    sse,
    log_determinant,
    coefficients,
    factors,
):
    """Sum of squared residuals for each row of ``parameters``.

    Parameters
    ----------
    parameters
        Shape (m, 7), columns as named at the top of this module; times in s, v_t in rpm relative to
        the signal's mean, read only if it is fixed. A is always solved for.
    y, y_square
        Signal with its mean removed, shape (n,), rpm, and Σ y².
    table, table_length
        Of :func:`harmonic_table` and :func:`grid_length`.
    left_out, left_out_table
        Sorted indices of the samples to leave out, shape (l,), where ``y`` is zero; and
        :func:`harmonic_table` of a signal that is one there and zero elsewhere, for twice the
        harmonics. Neither is read if l is zero.
    sse, log_determinant
        Output, shape (m,): rpm², and log|XᵀX| of the solved columns. The sum of squares is infinite
        where the parameters give no waveform.
    coefficients, factors
        Output, shapes (m, c) and (m, c, c) with c = 2 + 2·harmonics, or (0, …) to skip: solution in
        the order [v_t, cos, sin, …, A] and the Cholesky factor of XᵀX.
    """
    n = y.size
    c = 2 + 2 * harmonics
    keep = coefficients.shape[0] > 0
    centre = 0.5 * (n - 1)

    longest, shortest = 0.0, np.inf
    for row in range(parameters.shape[0]):
        longest = max(longest, parameters[row, WINDOW] / period_s)
        if parameters[row, ROTATION] > 0.0:
            shortest = min(shortest, parameters[row, ROTATION] / period_s)
    room = int(min(longest, n)) + 4
    most_pulses = 2 * (int((n + room) / max(shortest, 1.0)) + 4)
    first, last = np.empty(most_pulses, np.int64), np.empty(most_pulses, np.int64)
    cosine, sine = np.empty(room), np.empty(room)
    turning_c, turning_s = np.empty((harmonics, room)), np.empty((harmonics, room))
    train = np.zeros(n)
    gram, rhs, solution = np.zeros((c, c)), np.zeros(c), np.zeros(c)
    factor = np.zeros((c, c))
    # Σ e^{iκkt} over the samples used, t from the middle, k = 0 … 2·harmonics.
    waves = np.zeros(2 * harmonics + 1, np.complex128)
    waves[0] = gram[0, 0] = n - left_out.size

    for row in range(parameters.shape[0]):
        p = parameters[row]
        rotation = p[ROTATION] / period_s
        window = p[WINDOW] / period_s
        kappa = 2.0 * math.pi / rotation if rotation > 0.0 else 0.0
        sse[row] = np.inf
        log_determinant[row] = 0.0
        if (
            not (rotation >= 1.0 and 0.5 < window <= n and p[DECAY] > 0.0 and p[FREQUENCY] > 0.0)
            or harmonics * kappa / (2.0 * math.pi) * table_length
            >= table.shape[0] - 2 * INTERPOLATION_POINTS
        ):
            continue

        exponent = complex(-p[DECAY], p[FREQUENCY]) * period_s
        length = int(window) + 3
        _fill_powers(np.exp(exponent), cosine, sine, length)
        for k in range(harmonics):
            _fill_powers(np.exp(1j * kappa * (k + 1)), turning_c[k], turning_s[k], length)

        count = 0
        corner = p[FREQUENCY] * period_s / 6.0
        for sign in (1.0, -1.0):
            x = (p[FIRST_IMPACT] - first_time_s) / period_s
            if sign < 0.0:
                x -= p[SEPARATION] / period_s
            x += math.ceil((-window - 1.0 - x) / rotation) * rotation
            while x <= n:
                # begin: first sample after the impact; begin + run: sample on the final ramp.
                begin = int(math.ceil(x))
                u = begin - x
                run = max(int(math.floor(window - 0.5 - u)) + 1, 0)
                start = sign * np.exp(exponent * u)
                j0 = max(0, -begin)
                j1 = max(j0, min(run, n - begin))
                _add_wave(train[begin + j0 : begin + j1], start, cosine[j0:j1], sine[j0:j1])
                weight = window + 0.5 - u - run
                if 0 <= begin + run < n and weight > 0.0:
                    value = start.real * sine[run] + start.imag * cosine[run]
                    train[begin + run] += weight * value
                if 1 <= begin <= n:
                    train[begin - 1] += sign * corner * u**3
                if 0 <= begin < n:
                    train[begin] += sign * corner * (1.0 - u) ** 3
                first[count], last[count] = max(begin - 1, 0), min(begin + run + 1, n)
                count += last[count] > first[count]
                x += rotation

        for i in range(left_out.size):
            train[left_out[i]] = 0.0
        rhs[c - 1] = gram[c - 1, 0] = gram[c - 1, c - 1] = 0.0
        gram[c - 1, 1 : c - 1] = 0.0
        for pulse in range(count):
            pulse_samples, y_part = train[first[pulse] : last[pulse]], y[first[pulse] : last[pulse]]
            total, square, product = _sums(pulse_samples, y_part)
            gram[c - 1, 0] += total
            gram[c - 1, c - 1] += square
            rhs[c - 1] += product
            for k in range(harmonics):
                even, odd = _dots(pulse_samples, turning_c[k], turning_s[k])
                phased = complex(even, odd) * np.exp(1j * kappa * (k + 1) * (first[pulse] - centre))
                gram[c - 1, 2 * k + 1] += phased.real
                gram[c - 1, 2 * k + 2] += phased.imag
            pulse_samples[:] = 0.0  # where pulses overlap, each sample counts once

        for k in range(1, 2 * harmonics + 1):
            waves[k] = math.sin(0.5 * n * k * kappa) / math.sin(0.5 * k * kappa)
            if left_out.size > 0:
                position = k * kappa / (2.0 * math.pi) * table_length
                waves[k] -= _interpolate(left_out_table, position)
        rhs[0] = 0.0
        for j in range(1, harmonics + 1):
            gram[2 * j - 1, 0], gram[2 * j, 0] = waves[j].real, waves[j].imag
            for k in range(1, j + 1):
                difference, total_order = waves[j - k], waves[j + k]
                gram[2 * j - 1, 2 * k - 1] = 0.5 * (difference.real + total_order.real)
                gram[2 * j - 1, 2 * k] = 0.5 * (total_order.imag - difference.imag)
                gram[2 * j, 2 * k - 1] = 0.5 * (total_order.imag + difference.imag)
                gram[2 * j, 2 * k] = 0.5 * (difference.real - total_order.real)
            product_sum = _interpolate(table, j * kappa / (2.0 * math.pi) * table_length)
            rhs[2 * j - 1], rhs[2 * j] = product_sum.real, product_sum.imag

        sse[row], log_determinant[row] = solve(
            gram, rhs, y_square, p[MEAN], solve_mean, solution, factor
        )
        if keep:
            # Element by element: compiling the assignment of an array takes seconds.
            for i in range(c):
                coefficients[row, i] = solution[i]
                for j in range(c):
                    factors[row, i, j] = factor[i, j]
