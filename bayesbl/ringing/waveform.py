"""The disturbance model as the paper writes it: eq. 3, 5 and 6 over an array of times.

This is the reference that the fast kernel is tested against. Times are evenly spaced.

It differs from eq. 3 in three samples per pulse, because the edges are resolved to the sampling.

* The hard end of the window is a ramp one sample wide, centred on t2. With a hard edge, the sum of
  squares jumps whenever t0, T or T_w moves a pulse's last sample across it. Then neither a
  least-squares amplitude nor a likelihood is continuous.
* The corner at the impact is averaged over a triangle that reaches one sample to either side (the
  band-limited corner of Esqueda, Välimäki and Bilbao 2016). The misfit there is several rpm on a
  virtual bench. A sharp corner weights it depending on where between two samples the impact falls.
  At 1 kHz and δ = 3.3e-3 rad this scatters A by 0.1 rpm.

Its derivatives are the Jacobian behind every covariance in the package.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from bayesbl.compiled import compiled
from bayesbl.recording.types import ComplexArray, FloatArray
from bayesbl.ringing.symbols import (
    AMPLITUDE,
    DECAY,
    FREQUENCY,
    MEAN,
    ROTATION,
    SEPARATION,
    START,
    WINDOW_END,
    WINDOW_START,
    DisturbanceModel,
)


@compiled()
def impact(
    since_start_s: FloatArray,
    decay_rate_per_s: float,
    angular_frequency_rad_per_s: float,
    window_length_s: float,
    sampling_period_s: float,
) -> FloatArray:
    """Ringing after one impact of unit amplitude, eq. 3: e^{−τu} sin(ωu) within the window.

    Parameters
    ----------
    since_start_s
        Time u = t − t1 since the impact, shape (n,), s.
    window_length_s
        t2 − t1 in s.
    sampling_period_s
        Sampling period Δt in s, to which the edges are resolved.

    Returns
    -------
    Same shape as ``since_start_s``, dimensionless.
    """
    wave = np.empty(since_start_s.size)
    for i, since in enumerate(since_start_s):
        u = max(since, 0.0)
        ramp = min(max((window_length_s - since) / sampling_period_s + 0.5, 0.0), 1.0)
        closeness = max(1.0 - abs(since) / sampling_period_s, 0.0)
        wave[i] = ramp * math.exp(-decay_rate_per_s * u) * math.sin(angular_frequency_rad_per_s * u)
        wave[i] += angular_frequency_rad_per_s * sampling_period_s * closeness**3 / 6.0
    return wave


def _edges(
    since_start_s: FloatArray, window_length_s: float, sampling_period_s: float
) -> tuple[FloatArray, FloatArray]:
    """Weight of the ringing (0 before the impact, a ramp at the window's end), and closeness of a
    sample to the corner, from 0 to 1."""
    ramp = np.clip((window_length_s - since_start_s) / sampling_period_s + 0.5, 0.0, 1.0)
    closeness = np.maximum(1.0 - np.abs(since_start_s) / sampling_period_s, 0.0)
    return ramp * (since_start_s >= 0.0), closeness


def impacts(
    symbols: Mapping[str, float], begin_s: float, end_s: float, sampling_period_s: float
) -> Iterator[tuple[float, float, int]]:
    """(sign, start in s, index of the rotation) of every impact with samples in an interval.

    Positive pulses start at t0 + t1 + i·T_w, negative ones T earlier, i any integer.
    """
    rotation, edge = symbols[ROTATION], sampling_period_s
    window = symbols[WINDOW_END] - symbols[WINDOW_START]
    first = symbols[START] + symbols[WINDOW_START]
    for sign, origin in ((1.0, first), (-1.0, first - symbols[SEPARATION])):
        lowest = math.ceil((begin_s - window - edge - origin) / rotation)
        highest = math.floor((end_s + edge - origin) / rotation)
        for i in range(lowest, highest + 1):
            yield sign, origin + rotation * i, i


def _pulses(
    time_s: FloatArray, symbols: Mapping[str, float], sampling_period_s: float
) -> Iterator[tuple[float, int, slice, FloatArray]]:
    """(sign, rotation, slice of samples, times since the impact in s) of every impact."""
    reach = symbols[WINDOW_END] - symbols[WINDOW_START] + sampling_period_s
    for sign, start, number in impacts(symbols, time_s[0], time_s[-1], sampling_period_s):
        inside = slice(*np.searchsorted(time_s, (start - sampling_period_s, start + reach)))
        yield sign, number, inside, time_s[inside] - start


def pulse_train(
    time_s: FloatArray, symbols: Mapping[str, float], sampling_period_s: float
) -> FloatArray:
    """Σ_i f(t − i·T_w) of eq. 6 with A = 1 and f(t) = g(t) − g(t + T).

    All pulses within the recording are included, also those cut by its ends, for any number of
    rotations.

    Parameters
    ----------
    time_s
        Shape (n,), s, increasing.
    symbols
        By name; A and v_t are not needed.

    Returns
    -------
    Shape (n,), dimensionless.
    """
    train = np.zeros_like(time_s)
    window = symbols[WINDOW_END] - symbols[WINDOW_START]
    for sign, _, inside, since in _pulses(time_s, symbols, sampling_period_s):
        train[inside] += sign * impact(
            since, symbols[DECAY], symbols[FREQUENCY], window, sampling_period_s
        )
    return train


def baseline_columns(time_s: FloatArray, rotation_period_s: float, harmonics: int) -> FloatArray:
    """The speed without impacts: constant, cos and sin of each load-angle harmonic.

    Gravity leaks into the speed once per load rotation through the finite speed loop. Without these
    columns, the pulses would fit it.

    Returns
    -------
    Shape (n, 1 + 2·harmonics): ``[1, cos φ, sin φ, cos 2φ, sin 2φ, …]`` with φ = 2π t / T_w and t
    from the middle of the recording.
    """
    rows, columns_of_row = _turning(time_s, rotation_period_s, harmonics)
    columns = np.ones((time_s.size, 1 + 2 * harmonics))
    for k in range(harmonics):
        wave = np.outer(rows[k], columns_of_row[k]).ravel()[: time_s.size]
        columns[:, 2 * k + 1], columns[:, 2 * k + 2] = wave.real, wave.imag
    return columns


def _turning(
    time_s: FloatArray, rotation_period_s: float, harmonics: int
) -> tuple[ComplexArray, ComplexArray]:
    """Factors (k, r) and (k, c) of e^{ikφ} at even times, whose outer product, row by row, has at
    least n elements: two short series take a tenth of the time of cos and sin."""
    width = math.isqrt(time_s.size) + 1
    begins = np.arange(0, time_s.size, width) - 0.5 * (time_s.size - 1)
    step = 2.0 * np.pi / rotation_period_s * (time_s[-1] - time_s[0]) / (time_s.size - 1)
    rates = 1j * step * np.arange(1, harmonics + 1)[:, None]
    return np.exp(rates * begins), np.exp(rates * np.arange(width))


def model_speed(
    time_s: FloatArray,
    symbols: Mapping[str, float],
    baseline_rpm: Sequence[float] | FloatArray = (),
) -> FloatArray:
    """The model h(t) of eq. 6 with its baseline, shape (n,), rpm.

    Parameters
    ----------
    symbols
        All nine by name.
    baseline_rpm
        cos and sin of each load-angle harmonic, shape (2k,).
    """
    # a cos kφ + b sin kφ = Re((a − ib) e^{ikφ}), summed over k by a product of the two series.
    cosines, sines = np.asarray(baseline_rpm, dtype=float).reshape(-1, 2).T
    rows, columns = _turning(time_s, symbols[ROTATION], cosines.size)
    harmonics = ((cosines - 1j * sines) * rows.T @ columns).real.ravel()[: time_s.size]
    period_s = float(time_s[-1] - time_s[0]) / (time_s.size - 1)
    pulses = pulse_train(time_s, symbols, period_s)
    return np.asarray(symbols[MEAN] + (symbols[AMPLITUDE] * pulses + harmonics))


def jacobian(
    model: DisturbanceModel,
    time_s: FloatArray,
    symbols: Mapping[str, float],
    baseline_rpm: FloatArray,
) -> FloatArray:
    """Jacobian J = ∂h/∂θ of the model, analytic.

    The position of the window's hard edge is not differentiated (except for a free window end). The
    jump there belongs to the model, not to the data, and would add false information about t0, T
    and T_w.

    Parameters
    ----------
    symbols
        The nine symbols by name.
    baseline_rpm
        Coefficients of cos and sin of each harmonic, shape (2k,), rpm.

    Returns
    -------
    Shape (n, p), columns in the order of :func:`jacobian_columns`.
    """
    period_s = float(time_s[-1] - time_s[0]) / (time_s.size - 1)
    amplitude, decay, frequency = symbols[AMPLITUDE], symbols[DECAY], symbols[FREQUENCY]
    window = symbols[WINDOW_END] - symbols[WINDOW_START]

    derivative: dict[str, FloatArray] = {
        name: np.zeros_like(time_s)
        for name in (AMPLITUDE, START, DECAY, FREQUENCY, SEPARATION, ROTATION, WINDOW_END)
    }
    for sign, rotation_index, inside, u in _pulses(time_s, symbols, period_s):
        ramp, closeness = _edges(u, window, period_s)
        envelope = sign * ramp * np.exp(-decay * u)
        sine, cosine = np.sin(frequency * u), np.cos(frequency * u)
        corner = sign * period_s * closeness**3 / 6.0
        start_derivative = -amplitude * (
            envelope * (frequency * cosine - decay * sine)
            - 0.5 * sign * frequency * np.copysign(closeness**2, u)
        )  # ∂/∂start
        derivative[AMPLITUDE][inside] += envelope * sine + frequency * corner
        derivative[DECAY][inside] -= amplitude * envelope * sine * u
        derivative[FREQUENCY][inside] += amplitude * (envelope * cosine * u + corner)
        derivative[START][inside] += start_derivative
        derivative[ROTATION][inside] += start_derivative * rotation_index
        if sign < 0.0:
            derivative[SEPARATION][inside] -= start_derivative
        on_ramp = (ramp > 0.0) & (ramp < 1.0)
        derivative[WINDOW_END][inside] += (
            on_ramp * sign * amplitude * np.exp(-decay * u) * sine / period_s
        )
    derivative[WINDOW_START] = derivative[START] - derivative[WINDOW_END]

    rotation = symbols[ROTATION]
    columns = baseline_columns(time_s, rotation, model.baseline_harmonics)
    middle = 0.5 * (time_s[0] + time_s[-1])
    for k in range(1, model.baseline_harmonics + 1):
        cosine, sine = columns[:, 2 * k - 1], columns[:, 2 * k]
        angle_rate = -2.0 * np.pi * k * (time_s - middle) / rotation**2
        in_phase, in_quadrature = baseline_rpm[2 * k - 2], baseline_rpm[2 * k - 1]
        derivative[ROTATION] += angle_rate * (in_quadrature * cosine - in_phase * sine)
    derivative[MEAN] = np.ones_like(time_s)
    free = [derivative[name] for name in _free_amplitude_first(model)]
    return np.column_stack([*free, columns[:, 1:]])


def misfit_curvature(
    model: DisturbanceModel,
    time_s: FloatArray,
    symbols: Mapping[str, float],
    residual_rpm: FloatArray,
) -> FloatArray:
    """Σ_n r_n ∂²h_n/∂θ∂θ: the contribution of a non-zero residual to the curvature.

    Half the second derivative of the sum of squares is JᵀJ minus this matrix. It is analytic, with
    the window's end fixed as in :func:`jacobian`. Rows of A and v_t vanish at an optimum, because
    the residual is orthogonal to their columns, and are zero here. Those of a free window and of
    the baseline are left out: they carry no ringing.

    Parameters
    ----------
    residual_rpm
        Recording minus model, shape (n,), rpm.

    Returns
    -------
    Shape (p, p), in the order of :func:`jacobian_columns`.
    """
    period_s = float(time_s[-1] - time_s[0]) / (time_s.size - 1)
    exponent = complex(-symbols[DECAY], symbols[FREQUENCY])
    window = symbols[WINDOW_END] - symbols[WINDOW_START]
    names = (DECAY, FREQUENCY, START, SEPARATION, ROTATION)
    total = np.zeros((5, 5))
    for sign, rotation_index, inside, u in _pulses(time_s, symbols, period_s):
        ramp, closeness = _edges(u, window, period_s)
        weight = sign * symbols[AMPLITUDE] * residual_rpm[inside]
        corner_term = symbols[FREQUENCY] / period_s * (weight @ closeness)
        corner_cross = 0.5 * (weight @ np.copysign(closeness**2, u))
        wave = weight * ramp * np.exp(exponent * u)
        # d/dτ is −u, d/dω is iu, d/d(start) is −λ, all acting on e^{λu}; λ depends on τ and ω too.
        mixed = wave @ (1.0 + exponent * u)
        shape = np.array([[1.0, -1.0j], [-1.0j, -1.0]]) * (wave @ u**2)
        start_derivatives = np.array([1.0, -1.0 if sign < 0.0 else 0.0, rotation_index])
        total[:2, :2] += shape.imag
        cross = np.outer([mixed.imag, corner_cross - mixed.real], start_derivatives)
        total[:2, 2:] += cross
        total[2:, :2] += cross.T
        total[2:, 2:] += np.outer(start_derivatives, start_derivatives) * (
            (exponent**2 * wave.sum()).imag + corner_term
        )
    columns = jacobian_columns(model)
    curvature = np.zeros((len(columns), len(columns)))
    free = [i for i, name in enumerate(names) if name in columns]
    free_columns = [columns.index(names[i]) for i in free]
    curvature[np.ix_(free_columns, free_columns)] = total[np.ix_(free, free)]
    return curvature


def jacobian_columns(model: DisturbanceModel) -> tuple[str, ...]:
    """Names of the columns: A first (if free), the other free symbols, then the baseline's."""
    baseline = [
        f"baseline_{part}_{k}_rpm"
        for k in range(1, model.baseline_harmonics + 1)
        for part in ("cos", "sin")
    ]
    return (*_free_amplitude_first(model), *baseline)


def _free_amplitude_first(model: DisturbanceModel) -> tuple[str, ...]:
    return tuple(sorted(model.free, key=lambda name: name != AMPLITUDE))
