"""Sum of squares between a recording and the disturbance model, vectorised over parameters."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesbl.recording.types import BoolArray, FloatArray
from bayesbl.ringing import sums_of_squares as kernel
from bayesbl.ringing.symbols import (
    AMPLITUDE,
    DECAY,
    FREQUENCY,
    MEAN,
    ROTATION,
    SEPARATION,
    START,
    SYMBOLS,
    WINDOW_END,
    WINDOW_START,
    DisturbanceModel,
)

FURTHEST_START = 1e-3 / float(np.finfo(np.float64).eps)
"""Largest distance of the first impact from time zero, in sampling periods. Beyond it, times are
rounded by more than a thousandth of a sample, so pulses cannot be placed."""


@dataclass(frozen=True, slots=True)
class LinearSolution:
    """Exact solution in A, v_t and the baseline for m settings of the other symbols.

    Attributes
    ----------
    sum_of_squares
        Shape (m,), rpm².
    coefficients
        Shape (m, c): v_t, then cos and sin of each harmonic, then A; rpm. Fixed ones hold their
        value.
    factor
        Lower Cholesky factor of XᵀX, shape (m, c, c), zero in rows and columns of fixed
        coefficients.
    """

    sum_of_squares: FloatArray
    coefficients: FloatArray
    factor: FloatArray


SHORTEST_ROTATION_S = 0.2
"""Shortest rotation period; below it the sum of squares is infinite."""


class Objective:
    """Sum of squared residuals of one recording as a function of the searched symbols.

    Parameters
    ----------
    model
        Which symbols are free, and the number of baseline harmonics.
    time_s, speed_rpm
        Shape (n,), evenly sampled.
    excluded
        Shape (n,): samples to ignore; none by default.
    """

    def __init__(
        self,
        model: DisturbanceModel,
        time_s: FloatArray,
        speed_rpm: FloatArray,
        excluded: BoolArray | None = None,
    ) -> None:
        self.model = model
        self.speed_rpm = np.ascontiguousarray(speed_rpm, dtype=np.float64)
        n = self.speed_rpm.size
        self.period_s = float(time_s[-1] - time_s[0]) / (n - 1)
        self.time_s = time_s[0] + self.period_s * np.arange(n)
        self.used = np.ones(n, dtype=bool) if excluded is None else ~excluded
        self._left_out = np.flatnonzero(~self.used)
        self.offset_rpm = float(self.speed_rpm[self.used].mean())
        self._y = self.speed_rpm - self.offset_rpm
        # The kernel assumes Σ y = 0; a single subtraction leaves the rounding of n large numbers.
        self._y -= self._y[self.used].mean()
        self._y[self._left_out] = 0.0
        self._y_square = float(self._y @ self._y)
        length = kernel.grid_length(n)
        highest = max(model.baseline_harmonics, 1) / SHORTEST_ROTATION_S
        rows = math.ceil(highest * self.period_s * length) + 2
        self._table = kernel.harmonic_table(self._y, min(rows, length // 2))
        self._left_out_table = np.empty((0, 2))
        if self._left_out.size:
            is_left_out = (~self.used).astype(np.float64)
            self._left_out_table = kernel.harmonic_table(is_left_out, min(2 * rows, length // 2))
        self._table_length = length

    @property
    def samples(self) -> int:
        """Number of samples n, including excluded ones."""
        return int(self.time_s.size)

    @property
    def samples_used(self) -> int:
        """Number of samples that are not excluded."""
        return int(self.used.sum())

    @property
    def duration_s(self) -> float:
        """n · Δt in s."""
        return self.samples * self.period_s

    @property
    def searched(self) -> tuple[str, ...]:
        """Names of the columns that :meth:`sum_of_squares` takes."""
        return self.model.searched

    def holding(self, values: Mapping[str, float]) -> Objective:
        """The same recording with some searched symbols fixed at these values."""
        other = copy.copy(self)
        other.model = self.model.holding(values)
        return other

    def sum_of_squares(self, searched: FloatArray) -> FloatArray:
        """Sum of squared residuals, with free A, v_t and baseline solved exactly.

        Parameters
        ----------
        searched
            Shape (m, d), columns in the order of :attr:`searched`.

        Returns
        -------
        Shape (m,), rpm²; infinite where the symbols give no waveform.
        """
        return self._evaluate(searched, keep=False)[0]

    def sum_of_squares_and_volume(self, searched: FloatArray) -> tuple[FloatArray, FloatArray]:
        """As :meth:`sum_of_squares`, with log|XᵀX| of the solved columns, shape (m,)."""
        return self._evaluate(searched, keep=False)[:2]

    def solve(self, searched: FloatArray) -> LinearSolution:
        """A, v_t and baseline at each row of ``searched`` (m, d)."""
        sse, _, coefficients, factor = self._evaluate(searched, keep=True)
        coefficients[:, 0] += self.offset_rpm
        return LinearSolution(sse, coefficients, factor)

    def solved(self, point: FloatArray) -> tuple[dict[str, float], LinearSolution]:
        """All nine symbols by name at one point, (d,), and the solution there (m = 1)."""
        solution = self.solve(point[None])
        amplitude, mean = solution.coefficients[0, [-1, 0]].tolist()
        values = self.model.named(point) | {AMPLITUDE: amplitude, MEAN: mean}
        return {name: values[name] for name in SYMBOLS}, solution

    def _evaluate(
        self, searched: FloatArray, *, keep: bool
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        rows = np.atleast_2d(np.asarray(searched, dtype=np.float64))
        values: dict[str, Any] = {MEAN: 0.0, **self.model.fixed}
        values |= zip(self.searched, rows.T, strict=True)
        matrix = np.empty((len(rows), kernel.COLUMNS))
        matrix[:, kernel.FIRST_IMPACT] = values[START] + values[WINDOW_START]
        matrix[:, kernel.DECAY] = values[DECAY]
        matrix[:, kernel.FREQUENCY] = values[FREQUENCY]
        matrix[:, kernel.MEAN] = values[MEAN] - self.offset_rpm
        matrix[:, kernel.WINDOW] = values[WINDOW_END] - values[WINDOW_START]
        matrix[:, kernel.SEPARATION] = values[SEPARATION]
        matrix[:, kernel.ROTATION] = values[ROTATION]
        out_of_reach = ~(np.abs(matrix[:, kernel.FIRST_IMPACT]) <= FURTHEST_START * self.period_s)
        too_short = matrix[:, kernel.ROTATION] < SHORTEST_ROTATION_S
        matrix[out_of_reach | too_short, kernel.ROTATION] = np.nan
        m, c = len(matrix), 2 + 2 * self.model.baseline_harmonics
        stored_rows = m if keep else 0
        solutions = np.empty((stored_rows, c)), np.empty((stored_rows, c, c))
        output = (np.empty(m), np.empty(m), *solutions)
        kernel.sums_of_squares(
            matrix,
            self._y,
            self._y_square,
            self.time_s[0],
            self.period_s,
            self.model.baseline_harmonics,
            self._table,
            self._table_length,
            self._left_out,
            self._left_out_table,
            MEAN not in self.model.fixed,
            *output,
        )
        return output
