"""The disturbance model with its nine symbols by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bayesbl.recording.types import FloatArray
from bayesbl.ringing.symbols import (
    AMPLITUDE,
    MEAN,
    ROTATION,
)
from bayesbl.ringing.waveform import baseline_columns, pulse_train


def model_speed(
    time_s: FloatArray, symbols: Mapping[str, float], baseline_rpm: Sequence[float] = ()
) -> FloatArray:
    """The model h(t) of eq. 6 with its baseline, shape (n,), rpm.

    Parameters
    ----------
    symbols
        All nine by name.
    baseline_rpm
        cos and sin of each load-angle harmonic, shape (2k,).
    """
    harmonics = baseline_columns(time_s, symbols[ROTATION], len(baseline_rpm) // 2)[:, 1:]
    period_s = float(time_s[-1] - time_s[0]) / (time_s.size - 1)
    pulses = pulse_train(time_s, symbols, period_s)
    waveform = symbols[AMPLITUDE] * pulses + harmonics @ np.asarray(baseline_rpm, dtype=float)
    return np.asarray(symbols[MEAN] + waveform)
