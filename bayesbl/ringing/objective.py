"""Sum of squares between a recording and the disturbance model, for many parameters at once.

Evenly spaced samples go by :mod:`bayesbl.ringing.sums_of_squares`; any others sample by sample,
which is exact and about fifty times the work.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesbl.compiled import compiled
from bayesbl.recording.lost_samples import deviation_from_grid
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
from bayesbl.ringing.waveform import baseline_columns, impacts, pulse_train


@compiled()
def _add_impact(train, time_s, start, sign, decay, frequency, window, period_s):  # type: ignore[no-untyped-def]
    """Add one impact to the unit pulse train: :func:`waveform.impact` in a loop, far quicker."""
    reach = max(window + 0.5 * period_s, period_s)
    i = np.searchsorted(time_s, start - period_s)
    while i < time_s.size and time_s[i] < start + reach:
        u = time_s[i] - start
        if u > 0.0:
            ramp = max(0.0, min(1.0, (window - u) / period_s + 0.5))
            train[i] += sign * ramp * math.exp(-decay * u) * math.sin(frequency * u)
        near = max(0.0, 1.0 - abs(u) / period_s)
        train[i] += sign * frequency * period_s * near**3 / 6.0
        i += 1


def sums_of_squares(
    parameters: FloatArray,
    time_s: FloatArray,
    y: FloatArray,
    y_square: float,
    period_s: float,
    harmonics: int,
    left_out: NDArray[np.intp],
    solve_amplitude: bool,
    solve_mean: bool,
    sse: FloatArray,
    log_determinant: FloatArray,
    coefficients: FloatArray,
    factors: FloatArray,
) -> None:
    """Like its namesake in :mod:`bayesbl.ringing.sums_of_squares`, on any time stamps."""
    n = y.size
    c = 2 + 2 * harmonics
    columns = np.empty((c, n))
    solution, factor = np.zeros(c), np.zeros((c, c))
    for row, p in enumerate(parameters):
        sse[row] = np.inf
        log_determinant[row] = 0.0
        if not (
            p[kernel.ROTATION] >= period_s
            and 0.5 * period_s < p[kernel.WINDOW] <= n * period_s
            and p[kernel.DECAY] > 0.0
            and p[kernel.FREQUENCY] > 0.0
        ):
            continue
        symbols = {
            START: p[kernel.FIRST_IMPACT],
            WINDOW_START: 0.0,
            WINDOW_END: p[kernel.WINDOW],
            SEPARATION: p[kernel.SEPARATION],
            ROTATION: p[kernel.ROTATION],
        }
        columns[:-1] = baseline_columns(time_s, p[kernel.ROTATION], harmonics).T
        columns[-1] = 0.0
        for sign, start, _ in impacts(symbols, time_s[0], time_s[-1], period_s):
            _add_impact(
                columns[-1],
                time_s,
                start,
                sign,
                p[kernel.DECAY],
                p[kernel.FREQUENCY],
                p[kernel.WINDOW],
                period_s,
            )
        columns[:, left_out] = 0.0
        sse[row], log_determinant[row] = kernel.solve(
            columns @ columns.T,
            columns @ y,
            y_square,
            p[kernel.AMPLITUDE],
            p[kernel.MEAN],
            solve_amplitude,
            solve_mean,
            solution,
            factor,
        )
        if coefficients.shape[0] > 0:
            coefficients[row] = solution
            factors[row] = factor


EVEN_TOLERANCE = 0.1
"""Largest distance of a time stamp from an even grid, in sampling periods, that counts as even.

Time stamps rounded to a tenth of the period are as common as real jitter of that size is harmless:
it moves a 10 Hz ringing of 30 rpm by less than 0.2 rpm at 1 kHz.
"""

HARMLESS_JITTER_S = 5e-4
"""RMS distance σ from the grid up to which time stamps count as even, whatever it is in periods.

It averages out as noise does; what stays is a ringing that is smaller by (ωσ)²/2, 0.05 % at 10 Hz.
"""

FURTHEST_START = 1e-3 / float(np.finfo(np.float64).eps)
"""Largest distance of the first impact from time zero, in sampling periods.

Beyond it the rounding of a time exceeds a thousandth of a sample, and pulses have no place.
"""


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
        Lower Cholesky factor of XᵀX, shape (m, c, c), zero in rows and columns not solved for.
    """

    sum_of_squares: FloatArray
    coefficients: FloatArray
    factor: FloatArray


class Objective:
    """Sum of squared residuals of one recording as a function of the searched symbols.

    Parameters
    ----------
    model
        Which symbols are free, and the number of baseline harmonics.
    time_s, speed_rpm
        Shape (n,). Even sampling takes the fast kernel, uneven sampling an exact slower one.
    shortest_rotation_s
        No rotation period below this is evaluated (the sum of squares is infinite there).
    excluded
        Shape (n,): samples to ignore; none by default.
    """

    def __init__(
        self,
        model: DisturbanceModel,
        time_s: FloatArray,
        speed_rpm: FloatArray,
        shortest_rotation_s: float = 0.2,
        excluded: BoolArray | None = None,
    ) -> None:
        self.model = model
        self.time_s = np.ascontiguousarray(time_s, dtype=np.float64)
        self.speed_rpm = np.ascontiguousarray(speed_rpm, dtype=np.float64)
        n = self.time_s.size
        self.period_s = float(self.time_s[-1] - self.time_s[0]) / (n - 1)
        self.shortest_rotation_s = shortest_rotation_s
        self.used = np.ones(n, dtype=bool) if excluded is None else ~excluded
        self._left_out = np.flatnonzero(~self.used)
        self.offset_rpm = float(self.speed_rpm[self.used].mean())
        self._y = self.speed_rpm - self.offset_rpm
        # The kernel assumes Σ y = 0, and one subtraction leaves the rounding of n large numbers.
        self._y -= self._y[self.used].mean()
        self._y[self._left_out] = 0.0
        self._y_square = float(self._y @ self._y)
        grid = self.time_s[0] + self.period_s * np.arange(n)
        self.is_even = bool(np.max(np.abs(self.time_s - grid)) <= EVEN_TOLERANCE * self.period_s)
        if not self.is_even:
            number = np.arange(n, dtype=np.float64)
            deviation, period = deviation_from_grid(self.time_s, number)
            if period * math.sqrt(float(np.mean(deviation**2))) <= HARMLESS_JITTER_S:
                self.is_even, self.period_s = True, period
                grid = self.time_s.mean() + period * (number - number.mean())
        self._columns = 2 + 2 * model.baseline_harmonics
        if self.is_even:
            self.time_s = grid
            length = kernel.grid_length(n)
            highest = max(model.baseline_harmonics, 1) / shortest_rotation_s
            rows = math.ceil(highest * self.period_s * length) + 2
            self._table = kernel.harmonic_table(self._y, min(rows, length // 2))
            self._left_out_table = np.empty((0, 2))
            if self._left_out.size:
                there = (~self.used).astype(np.float64)
                self._left_out_table = kernel.harmonic_table(there, min(2 * rows, length // 2))
            self._table_length = length

    @property
    def samples(self) -> int:
        """Number of samples n, including excluded ones."""
        return int(self.time_s.size)

    @property
    def samples_used(self) -> int:
        """Number of samples that count: n without those excluded."""
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
        """The same recording with some of the searched symbols held at these values."""
        other = copy.copy(self)
        other.model = self.model.holding(values)
        return other

    def sum_of_squares(self, searched: FloatArray) -> FloatArray:
        """Sum of squared residuals, free A, v_t and baseline solved exactly.

        Parameters
        ----------
        searched
            Shape (m, d), columns in the order of :attr:`searched`.

        Returns
        -------
        Shape (m,), rpm²; infinite where the symbols make no waveform.
        """
        return self._evaluate(self._matrix(searched), keep=False)[0]

    def sum_of_squares_and_volume(self, searched: FloatArray) -> tuple[FloatArray, FloatArray]:
        """As :meth:`sum_of_squares`, with log|XᵀX| of the columns solved for, shape (m,)."""
        return self._evaluate(self._matrix(searched), keep=False)[:2]

    def sum_of_squares_at(
        self, searched: FloatArray, amplitude_rpm: FloatArray, mean_speed_rpm: FloatArray
    ) -> FloatArray:
        """Sum of squares with A and v_t given, shape (m,) each, instead of solved for."""
        matrix = self._matrix(searched)
        matrix[:, kernel.AMPLITUDE] = amplitude_rpm
        matrix[:, kernel.MEAN] = mean_speed_rpm - self.offset_rpm
        return self._evaluate(matrix, keep=False, solve_linear=False)[0]

    def solve(self, searched: FloatArray) -> LinearSolution:
        """A, v_t and baseline at each row of ``searched`` (m, d)."""
        sse, _, coefficients, factor = self._evaluate(self._matrix(searched), keep=True)
        coefficients[:, 0] += self.offset_rpm
        return LinearSolution(sse, coefficients, factor)

    def symbols(self, searched: FloatArray, solution: LinearSolution) -> dict[str, FloatArray]:
        """All nine symbols by name, shape (m,) each."""
        rows = np.atleast_2d(searched)
        values = {n: np.full(len(rows), v) for n, v in self.model.fixed.items()}
        values |= {n: rows[:, i] for i, n in enumerate(self.searched)}
        values[AMPLITUDE] = solution.coefficients[:, -1]
        values[MEAN] = solution.coefficients[:, 0]
        return {name: values[name] for name in SYMBOLS}

    def columns(self, symbols: Mapping[str, float]) -> FloatArray:
        """Design matrix ``[1, cos, sin, …, q]`` of the linear symbols, shape (n, c)."""
        return np.column_stack(
            [
                baseline_columns(self.time_s, symbols[ROTATION], self.model.baseline_harmonics),
                pulse_train(self.time_s, symbols, self.period_s),
            ]
        )

    def _matrix(self, searched: FloatArray) -> FloatArray:
        """Kernel columns from the searched symbols and the fixed ones."""
        rows = np.atleast_2d(np.asarray(searched, dtype=np.float64))
        values = {n: np.full(len(rows), v) for n, v in self.model.fixed.items()}
        values |= {n: rows[:, i] for i, n in enumerate(self.searched)}
        zero = np.zeros(len(rows))
        matrix = np.empty((len(rows), 8))
        matrix[:, kernel.AMPLITUDE] = values.get(AMPLITUDE, zero)
        matrix[:, kernel.FIRST_IMPACT] = values[START] + values[WINDOW_START]
        matrix[:, kernel.DECAY] = values[DECAY]
        matrix[:, kernel.FREQUENCY] = values[FREQUENCY]
        matrix[:, kernel.MEAN] = values.get(MEAN, zero) - self.offset_rpm
        matrix[:, kernel.WINDOW] = values[WINDOW_END] - values[WINDOW_START]
        matrix[:, kernel.SEPARATION] = values[SEPARATION]
        matrix[:, kernel.ROTATION] = values[ROTATION]
        is_far = ~(np.abs(matrix[:, kernel.FIRST_IMPACT]) <= FURTHEST_START * self.period_s)
        is_short = matrix[:, kernel.ROTATION] < self.shortest_rotation_s
        matrix[is_far | is_short, kernel.ROTATION] = np.nan
        return matrix

    def _evaluate(
        self, matrix: FloatArray, *, keep: bool, solve_linear: bool = True
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        m, c = len(matrix), self._columns
        sse, volume = np.empty(m), np.empty(m)
        kept = m if keep else 0
        coefficients, factor = np.empty((kept, c)), np.empty((kept, c, c))
        solve = (
            solve_linear and self.model.amplitude_is_free,
            solve_linear and self.model.mean_is_free,
        )
        output = (sse, volume, coefficients, factor)
        if self.is_even:
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
                *solve,
                *output,
            )
        else:
            sums_of_squares(
                matrix,
                self.time_s,
                self._y,
                self._y_square,
                self.period_s,
                self.model.baseline_harmonics,
                self._left_out,
                *solve,
                *output,
            )
        return output
