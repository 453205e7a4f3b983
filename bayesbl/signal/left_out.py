"""Samples that a fit leaves out, taken off the closed forms of the even grid.

The speed is zero at them, so every sum with the speed is right already; what they add to the inner
products among the columns [1, cos, sin, …, pulses] is subtracted here. Work grows with the samples
left out inside pulse windows only.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def pulses_at(  # type: ignore[no-untyped-def]
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


@njit(cache=True)
def subtract(gram, left_out, train, sums, kappa, centre):  # type: ignore[no-untyped-def]
    """Subtract the left-out samples from the lower triangle of XᵀX.

    Parameters
    ----------
    train
        Of :func:`pulses_at`, shape (m,).
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
