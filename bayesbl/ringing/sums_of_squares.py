"""Sum of squares of the disturbance model on an even grid, compiled.

Everything here is in samples and complex numbers. With z = e^{(−τ + iω)Δt} the ringing after one
impact is Im(w zʲ), w = e^{(−τ + iω)uΔt}, u ∈ [0, 1) the distance from the impact to the first
sample after it. One table of powers zʲ therefore serves every pulse:

* the inner product with the signal is two dot products per pulse, the only work that touches
  samples;
* inner products among pulses, with a constant and with the load-angle harmonics are geometric
  series in closed form;
* the signal's inner products with the harmonics depend on T_w alone and are interpolated from a
  table made once per recording.

A, v_t and the baseline are then solved from the normal equations. Work per evaluation does not
grow with the samples outside the pulse windows. Samples that a fit leaves out have the speed zero,
so every sum with the speed is right already; what they add to the inner products among the columns
[1, cos, sin, …, pulses] is subtracted, for those inside pulse windows one by one.

Everything that numba compiles together is in this one file: its cache looks only at the file of
the outermost function, so a part kept elsewhere could go stale unnoticed.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.fft import next_fast_len

from bayesbl.compiled import compiled
from bayesbl.recording.types import FloatArray

# Columns of the parameter matrix that the kernel takes.
AMPLITUDE, FIRST_IMPACT, DECAY, FREQUENCY, MEAN, WINDOW, SEPARATION, ROTATION = range(8)

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
    Shape (columns + 2 · INTERPOLATION_POINTS, 2), real and imaginary part; the first
    INTERPOLATION_POINTS rows continue to negative κ so that interpolation needs no special case.
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
    """cosine + i·sine = zʲ for j < count, by doubling."""
    cosine[0] = 1.0
    sine[0] = 0.0
    filled = 1
    factor = z
    while filled < count:
        more = min(filled, count - filled)
        re, im = factor.real, factor.imag
        old_c, old_s = cosine[:more], sine[:more]
        new_c, new_s = cosine[filled : filled + more], sine[filled : filled + more]
        for j in range(more):
            new_c[j] = old_c[j] * re - old_s[j] * im
            new_s[j] = old_c[j] * im + old_s[j] * re
        factor = factor * factor
        filled += more


@compiled(fastmath={"reassoc", "contract"})
def _dots(y: FloatArray, cosine: FloatArray, sine: FloatArray) -> tuple[float, float]:
    """(y·cosine, y·sine); summation order is free so that the loop vectorises."""
    c = 0.0
    s = 0.0
    for j in range(y.size):
        c += y[j] * cosine[j]
        s += y[j] * sine[j]
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
def _overlap(a, b, n0, w, begin, end, extra_at, extra, z, cosine, sine):  # type: ignore[no-untyped-def]
    """Inner product of two unit pulses that share samples.

    Each is a run of whole samples and three single ones: the two at its corner and the one on the
    ramp at its end.
    """
    product = 0.0
    low, high = max(begin[a], begin[b]), min(end[a], end[b])
    if low < high:
        ja, jb, count = low - n0[a], low - n0[b], high - low
        za, zb = complex(cosine[ja], sine[ja]), complex(cosine[jb], sine[jb])
        zc = complex(cosine[count], sine[count])
        square = z.real * z.real + z.imag * z.imag
        even = (1.0 - (zc.real * zc.real + zc.imag * zc.imag)) / (1.0 - square)
        odd = (1.0 - zc * zc) / (1.0 - z * z)
        product += 0.5 * (w[a] * za * (w[b] * zb).conjugate()).real * even
        product -= 0.5 * (w[a] * za * w[b] * zb * odd).real
    for p, q in ((a, b), (b, a)):
        for i in range(3):
            if begin[q] <= extra_at[p, i] < end[q]:
                j = extra_at[p, i] - n0[q]
                product += extra[p, i] * (w[q].real * sine[j] + w[q].imag * cosine[j])
    for i in range(3):
        for j in range(3):
            if extra_at[a, i] == extra_at[b, j]:
                product += extra[a, i] * extra[b, j]
    return product


@compiled()
def _pulses_at(  # type: ignore[no-untyped-def]
    left_out, count, sign, w, n0, begin, end, extra_at, extra, cosine, sine, train
):
    """The unit pulse train at the samples ``left_out`` (sorted), into ``train``, shape (m,)."""
    train[:] = 0.0
    for a in range(count):
        i = np.searchsorted(left_out, min(extra_at[a, 0], begin[a]))
        last = max(extra_at[a, 2], end[a])
        while i < left_out.size and left_out[i] <= last:
            sample = left_out[i]
            if begin[a] <= sample < end[a]:
                j = sample - n0[a]
                train[i] += sign[a] * (w[a].real * sine[j] + w[a].imag * cosine[j])
            for part in range(3):
                if extra_at[a, part] == sample:
                    train[i] += sign[a] * extra[a, part]
            i += 1


@compiled()
def _subtract(gram, left_out, train, sums, kappa, centre):  # type: ignore[no-untyped-def]
    """Subtract the left-out samples from the lower triangle of XᵀX.

    Parameters
    ----------
    train
        Of :func:`_pulses_at`, shape (m,).
    sums
        Σ e^{iκkt} over the samples left out, t from the middle of the grid, k = 0 … 2·harmonics.
    kappa
        Angle of the load per sample, rad.
    centre
        Sample number of the middle of the grid.
    """
    last = gram.shape[0] - 1
    harmonics = (last - 1) // 2
    gram[0, 0] -= sums[0].real
    for j in range(1, harmonics + 1):
        gram[2 * j - 1, 0] -= sums[j].real
        gram[2 * j, 0] = -sums[j].imag
        for k in range(1, j + 1):
            less, more = sums[j - k], sums[j + k]
            gram[2 * j - 1, 2 * k - 1] -= 0.5 * (less.real + more.real)
            gram[2 * j, 2 * k] -= 0.5 * (less.real - more.real)
            gram[2 * j, 2 * k - 1] = -0.5 * (more.imag + less.imag)
            if k < j:
                gram[2 * j - 1, 2 * k] = -0.5 * (more.imag - less.imag)
    for i in range(left_out.size):
        value = train[i]
        if value != 0.0:
            gram[last, 0] -= value
            gram[last, last] -= value * value
            for k in range(1, harmonics + 1):
                turned = value * np.exp(1j * kappa * k * (left_out[i] - centre))
                gram[last, 2 * k - 1] -= turned.real
                gram[last, 2 * k] -= turned.imag


@compiled()
def solve(gram, rhs, y_square, mean, solve_mean, solution, factor):  # type: ignore[no-untyped-def]
    """Solve XᵀX b = Xᵀy for columns ordered [1, cos, sin, …, pulses].

    Parameters
    ----------
    gram, rhs
        XᵀX (lower triangle read) and Xᵀy of all c columns, shapes (c, c) and (c,); ``rhs`` is
        overwritten.
    y_square
        Σ y², rpm².
    mean
        Value of the first coefficient where it is not solved for, rpm.
    solution, factor
        Output: coefficients (c,) and lower Cholesky factor (c, c), whose row and column of a
        given mean are left as they are.

    Returns
    -------
    Sum of squares left in rpm² (infinite where the columns are degenerate), and log|XᵀX| of the
    columns solved for.
    """
    c = rhs.size
    first = 0 if solve_mean else 1
    left = y_square
    if not solve_mean:
        left += mean * (mean * gram[0, 0] - 2.0 * rhs[0])
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
        left -= solution[i] ** 2
    for i in range(c - 1, first - 1, -1):
        v = solution[i]
        for k in range(i + 1, c):
            v -= factor[k, i] * solution[k]
        solution[i] = v / factor[i, i]
    return max(left, 0.0), log_determinant


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
        Shape (m, 8), columns as named at the top of this module; times in s, v_t in rpm relative
        to the signal's mean, read only where it is not solved for. A is always solved for.
    y, y_square
        Signal with its mean removed, shape (n,), rpm, and Σ y².
    table, table_length
        Of :func:`harmonic_table` and :func:`grid_length`.
    left_out, left_out_table
        Numbers of the samples to leave out, sorted, shape (l,), where ``y`` is zero; and
        :func:`harmonic_table` of a signal that is one there and zero elsewhere, for twice the
        harmonics. Neither is read where l is zero.
    sse, log_determinant
        Output, shape (m,): rpm², and log|XᵀX| of the columns solved for. Infinite sum of squares
        where the parameters make no waveform.
    coefficients, factors
        Output, shapes (m, c) and (m, c, c) with c = 2 + 2·harmonics, or (0, …) to leave out:
        solution in the order [v_t, cos, sin, …, A] and the Cholesky factor of XᵀX.
    """
    n = y.size
    c = 2 + 2 * harmonics
    keep = coefficients.shape[0] > 0
    centre = 0.5 * (n - 1)

    longest = 0.0
    shortest = np.inf
    for row in range(parameters.shape[0]):
        longest = max(longest, parameters[row, WINDOW] / period_s)
        if parameters[row, ROTATION] > 0.0:
            shortest = min(shortest, parameters[row, ROTATION] / period_s)
    shortest = max(shortest, 1.0)
    room = int(min(longest, n)) + 4
    most = 2 * (int((n + room) / shortest) + 4)
    cosine, sine = np.empty(room), np.empty(room)
    n0, begin, end = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most, np.int64)
    extra_at, extra = np.empty((most, 3), np.int64), np.empty((most, 3))
    sign = np.empty(most)
    w = np.empty(most, np.complex128)
    gram, rhs, solution = np.zeros((c, c)), np.zeros(c), np.zeros(c)
    factor = np.zeros((c, c))
    q_harmonic = np.zeros(harmonics + 1, np.complex128)
    rho = np.ones(harmonics + 1, np.complex128)
    dirichlet = np.zeros(2 * harmonics + 1)
    left_out_train = np.empty(left_out.size)
    left_out_sums = np.zeros(2 * harmonics + 1, np.complex128)

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
        z = np.exp(exponent)
        shortest_run = int(math.floor(window - 0.5))
        _fill_powers(z, cosine, sine, shortest_run + 3)
        whole_turn = math.floor(rotation)
        fraction = rotation - whole_turn
        step_back = np.exp(-exponent * fraction)
        step_on = step_back * z

        rho[1:] = np.exp(1j * kappa)
        for k in range(2, harmonics + 1):
            rho[k] = rho[k - 1] * rho[1]
        rho_run = np.exp(1j * kappa * shortest_run)
        turn_back = np.exp(-1j * kappa * fraction)
        turn_on = turn_back * rho[1] if harmonics > 0 else turn_back

        count = 0
        q_y = 0.0
        q_one = 0.0
        q_q = 0.0
        q_harmonic[:] = 0.0
        corner = p[FREQUENCY] * period_s / 6.0
        square = z.real * z.real + z.imag * z.imag
        series = 1.0 / (1.0 - z)
        series_square = 1.0 / (1.0 - z * z)
        series_norm = 1.0 / (1.0 - square)
        for pulse_sign in (1.0, -1.0):
            x = (p[FIRST_IMPACT] - first_time_s) / period_s
            if pulse_sign < 0.0:
                x -= p[SEPARATION] / period_s
            x += math.ceil((-window - 1.0 - x) / rotation) * rotation
            index = int(math.ceil(x))
            current = np.exp(exponent * (index - x))
            turn = np.exp(1j * kappa * (index - centre))
            number = 0
            while index <= n:
                u = index - (x + number * rotation)
                run = int(math.floor(window - 0.5 - u)) + 1
                run = max(run, 0)
                j0, j1 = max(0, -index), min(run, n - index)
                weight = window + 0.5 - u - run
                if not (0 <= index + run < n and weight > 0.0):
                    weight = 0.0
                before = corner * u * u * u if index >= 1 else 0.0
                after = corner * (1.0 - u) ** 3 if 0 <= index < n else 0.0
                if j1 > j0 or weight > 0.0 or index >= 0:
                    j1 = max(j1, j0)
                    if j1 > j0:
                        dot_c, dot_s = _dots(y[index + j0 : index + j1], cosine[j0:j1], sine[j0:j1])
                        q_y += pulse_sign * (current.real * dot_s + current.imag * dot_c)
                        z0, z1 = complex(cosine[j0], sine[j0]), complex(cosine[j1], sine[j1])
                        q_one += pulse_sign * (current * (z0 - z1) * series).imag
                        norm0 = z0.real * z0.real + z0.imag * z0.imag
                        norm1 = z1.real * z1.real + z1.imag * z1.imag
                        norm = current.real * current.real + current.imag * current.imag
                        q_q += 0.5 * norm * (norm0 - norm1) * series_norm
                        q_q -= 0.5 * (current * current * (z0 * z0 - z1 * z1) * series_square).real
                    value = current.real * sine[run] + current.imag * cosine[run]
                    if weight > 0.0:
                        q_y += pulse_sign * weight * value * y[index + run]
                        q_one += pulse_sign * weight * value
                        q_q += (weight * value) ** 2
                    if before > 0.0:
                        q_y += pulse_sign * before * y[index - 1]
                        q_q += before * before
                    if after > 0.0:
                        first = current.imag if run > 0 else weight * value
                        q_y += pulse_sign * after * y[index]
                        q_q += after * (after + 2.0 * first)
                    q_one += pulse_sign * (before + after)
                    if harmonics > 0:
                        rho_0 = 1.0 + 0.0j if j0 == 0 else np.exp(1j * kappa * j0)
                        if j1 == shortest_run:
                            rho_1 = rho_run
                        elif j1 == shortest_run + 1:
                            rho_1 = rho_run * rho[1]
                        else:
                            rho_1 = np.exp(1j * kappa * j1)
                        rho_e = rho_1
                        if weight > 0.0 and j1 != run:
                            rho_e = np.exp(1j * kappa * run)
                        r0, r1, re, turn_k, rc = rho_0, rho_1, rho_e, turn, rho[1].conjugate()
                        z0, z1 = complex(cosine[j0], sine[j0]), complex(cosine[j1], sine[j1])
                        for k in range(1, harmonics + 1):
                            up = current * (z0 * r0 - z1 * r1) / (1.0 - z * rho[k])
                            down = (
                                current.conjugate()
                                * (z0.conjugate() * r0 - z1.conjugate() * r1)
                                / (1.0 - z.conjugate() * rho[k])
                            )
                            total = -0.5j * (up - down) + weight * value * re
                            total += after + before * rc
                            q_harmonic[k] += pulse_sign * turn_k * total
                            r0, r1, re, turn_k = r0 * rho_0, r1 * rho_1, re * rho_e, turn_k * turn
                            rc *= rho[1].conjugate()
                    n0[count], begin[count], end[count] = index, index + j0, index + j1
                    extra_at[count, 0], extra[count, 0] = index - 1, before
                    extra_at[count, 1], extra[count, 1] = index, after
                    extra_at[count, 2], extra[count, 2] = index + run, weight * value
                    sign[count], w[count] = pulse_sign, current
                    count += 1
                number += 1
                following = int(math.ceil(x + number * rotation))
                step = following - index
                if step == whole_turn:
                    current *= step_back
                    turn *= turn_back
                elif step == whole_turn + 1:
                    current *= step_on
                    turn *= turn_on
                else:  # rounding, where pulses start on samples
                    current *= np.exp(exponent * (step - rotation))
                    turn *= np.exp(1j * kappa * (step - rotation))
                index = following

        nearest = p[SEPARATION] / period_s - math.floor(p[SEPARATION] / p[ROTATION]) * rotation
        if min(nearest, rotation - nearest) < window + 3.0 or rotation < window + 3.0:
            for a in range(count):
                for b in range(a):
                    if extra_at[a, 0] <= extra_at[b, 2] and extra_at[b, 0] <= extra_at[a, 2]:
                        shared = _overlap(a, b, n0, w, begin, end, extra_at, extra, z, cosine, sine)
                        q_q += 2.0 * sign[a] * sign[b] * shared

        dirichlet[0] = n
        for k in range(1, 2 * harmonics + 1):
            dirichlet[k] = math.sin(0.5 * n * k * kappa) / math.sin(0.5 * k * kappa)
        gram[0, 0] = n
        rhs[0] = 0.0
        for j in range(1, harmonics + 1):
            for k in range(1, j + 1):
                gram[2 * j - 1, 2 * k - 1] = 0.5 * (dirichlet[j - k] + dirichlet[j + k])
                gram[2 * j, 2 * k] = 0.5 * (dirichlet[j - k] - dirichlet[j + k])
            gram[2 * j - 1, 0] = dirichlet[j]
            at = _interpolate(table, j * kappa / (2.0 * math.pi) * table_length)
            rhs[2 * j - 1], rhs[2 * j] = at.real, at.imag
            gram[c - 1, 2 * j - 1], gram[c - 1, 2 * j] = q_harmonic[j].real, q_harmonic[j].imag
        gram[c - 1, 0], gram[c - 1, c - 1], rhs[c - 1] = q_one, q_q, q_y
        if left_out.size > 0:
            train = left_out_train
            _pulses_at(
                left_out, count, sign, w, n0, begin, end, extra_at, extra, cosine, sine, train
            )
            left_out_sums[0] = left_out.size
            for k in range(1, 2 * harmonics + 1):
                place = k * kappa / (2.0 * math.pi) * table_length
                left_out_sums[k] = _interpolate(left_out_table, place)
            _subtract(gram, left_out, left_out_train, left_out_sums, kappa, centre)

        sse[row], log_determinant[row] = solve(
            gram, rhs, y_square, p[MEAN], solve_mean, solution, factor
        )
        if keep:
            # Element by element: to compile the assignment of an array takes seconds.
            for i in range(c):
                coefficients[row, i] = solution[i]
                for j in range(c):
                    factors[row, i, j] = factor[i, j]
