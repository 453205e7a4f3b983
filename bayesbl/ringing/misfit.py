"""The part of the residual that repeats every load rotation: what the waveform does not capture."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bayesbl.recording.types import FloatArray

PHASE_BINS = 360


@dataclass(frozen=True, slots=True)
class RepeatingMisfit:
    """Rotation-averaged residual.

    Attributes
    ----------
    phase_rad
        Load phase from the start of the recording, bin centres, shape (b,), in [0, 2π).
    mean_rpm, standard_error_rpm
        Average of the residual over rotations and its standard error from their scatter,
        shape (b,), rpm.
    """

    phase_rad: FloatArray
    mean_rpm: FloatArray
    standard_error_rpm: FloatArray

    @property
    def rms_rpm(self) -> float:
        """RMS of what repeats, without the noise that survives averaging, rpm."""
        excess = float(np.mean(self.mean_rpm**2 - self.standard_error_rpm**2))
        return math.sqrt(max(excess, 0.0))

    def at(
        self, since_begin_s: FloatArray, rotation_period_s: float
    ) -> tuple[FloatArray, FloatArray]:
        """Average and standard error at times since the recording's start, shape (n,) each, rpm."""
        phase = 2.0 * np.pi / rotation_period_s * since_begin_s
        turn = 2.0 * np.pi
        mean = np.interp(phase, self.phase_rad, self.mean_rpm, period=turn)
        return mean, np.interp(phase, self.phase_rad, self.standard_error_rpm, period=turn)


def repeating_misfit(
    time_s: FloatArray, residual_rpm: FloatArray, rotation_period_s: float
) -> RepeatingMisfit:
    """Average the residual, NaN where left out, at equal load phase over the rotations.

    Within a rotation each bin is averaged first; the scatter between rotations, which are
    independent but for noise slower than a rotation, gives the standard error.
    """
    known = np.isfinite(residual_rpm)
    turns = (time_s[known] - time_s[0]) / rotation_period_s
    residual_rpm = residual_rpm[known]
    rotation = np.floor(turns).astype(int)
    bins = np.minimum((PHASE_BINS * (turns - rotation)).astype(int), PHASE_BINS - 1)
    cell = rotation * PHASE_BINS + bins
    cells = (rotation[-1] + 1) * PHASE_BINS
    count = np.bincount(cell, minlength=cells).reshape(-1, PHASE_BINS)
    total = np.bincount(cell, residual_rpm, minlength=cells).reshape(-1, PHASE_BINS)
    filled = count > 0
    mean_by_rotation = np.where(filled, total / np.maximum(count, 1), np.nan)
    rotations = filled.sum(axis=0)
    mean = np.nansum(mean_by_rotation, axis=0) / np.maximum(rotations, 1)
    scatter = np.nansum((mean_by_rotation - mean) ** 2, axis=0)
    error = np.sqrt(scatter / np.maximum(rotations - 1, 1) / np.maximum(rotations, 1))
    phase = 2.0 * np.pi * (np.arange(PHASE_BINS) + 0.5) / PHASE_BINS
    return RepeatingMisfit(phase, mean, error)
