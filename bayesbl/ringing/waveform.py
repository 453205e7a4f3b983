"""The disturbance model as the paper writes it: eq. 3, 5 and 6 over an array of times.

This is the reference that the fast kernel is tested against, and the path for recordings whose
samples are not evenly spaced.

Two things differ from eq. 3, in three samples per pulse: its edges are resolved to the sampling.

* The hard end of the window is a ramp one sample wide, centred on t2. A hard edge makes the sum of
  squares jump whenever t0, T or T_w moves a pulse's last sample across it, and then neither a
  least-squares amplitude nor a likelihood is continuous.
* The corner at the impact is averaged over a triangle that reaches one sample to either side (the
  band-limited corner of Esqueda, Välimäki and Bilbao 2016). A sharp corner meets the misfit there,
  several rpm on a virtual bench, with a weight that depends on where between two samples the
  impact falls: at 1 kHz and δ = 3.3e-3 rad that scatters A by 0.1 rpm.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from bayesbl.recording.types import FloatArray
from bayesbl.ringing.symbols import (
    DECAY,
    FREQUENCY,
    ROTATION,
    SEPARATION,
    START,
    WINDOW_END,
    WINDOW_START,
)


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
        Time u = t − t1 since the impact, any shape, s.
    window_length_s
        t2 − t1 in s.
    sampling_period_s
        Δt in s, which the edges are resolved to.

    Returns
    -------
    Same shape as ``since_start_s``, dimensionless.
    """
    u = np.maximum(since_start_s, 0.0)
    ramp = np.clip((window_length_s - since_start_s) / sampling_period_s + 0.5, 0.0, 1.0)
    ringing = np.exp(-decay_rate_per_s * u) * np.sin(angular_frequency_rad_per_s * u)
    near = np.maximum(1.0 - np.abs(since_start_s) / sampling_period_s, 0.0)
    corner = angular_frequency_rad_per_s * sampling_period_s * near**3 / 6.0
    return np.asarray(ramp * ringing + corner)


def impacts(
    symbols: Mapping[str, float], begin_s: float, end_s: float, sampling_period_s: float
) -> Iterator[tuple[float, float, int]]:
    """(sign, start in s, rotation counted from the first one) of every impact with samples there.

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


def pulse_train(
    time_s: FloatArray, symbols: Mapping[str, float], sampling_period_s: float
) -> FloatArray:
    """Σ_i f(t − i·T_w) of eq. 6 with A = 1 and f(t) = g(t) − g(t + T).

    All pulses that fall into the recording are included, also those cut by its ends, however many
    rotations it holds.

    Parameters
    ----------
    time_s
        Shape (n,), s, increasing.
    symbols
        By name; A and v_t are not asked for.

    Returns
    -------
    Shape (n,), dimensionless.
    """
    train = np.zeros_like(time_s)
    window = symbols[WINDOW_END] - symbols[WINDOW_START]
    for sign, start, _ in impacts(symbols, time_s[0], time_s[-1], sampling_period_s):
        inside = slice(
            *np.searchsorted(
                time_s, (start - sampling_period_s, start + window + sampling_period_s)
            )
        )
        train[inside] += sign * impact(
            time_s[inside] - start,
            symbols[DECAY],
            symbols[FREQUENCY],
            window,
            sampling_period_s,
        )
    return train


def baseline_columns(time_s: FloatArray, rotation_period_s: float, harmonics: int) -> FloatArray:
    """The speed without impacts: constant, cos and sin of each load-angle harmonic.

    Gravity leaks into the speed once per load rotation through the finite speed loop; without
    these columns it would be fitted by the pulses.

    Returns
    -------
    Shape (n, 1 + 2·harmonics): ``[1, cos φ, sin φ, cos 2φ, sin 2φ, …]`` with φ = 2π t / T_w and
    t counted from the middle of the recording.
    """
    middle = 0.5 * (time_s[0] + time_s[-1])
    angle = 2.0 * np.pi / rotation_period_s * (time_s - middle)
    columns = [np.ones_like(time_s)]
    for k in range(1, harmonics + 1):
        columns += [np.cos(k * angle), np.sin(k * angle)]
    return np.stack(columns, axis=1)
