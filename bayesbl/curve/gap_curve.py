"""Curves from ringing amplitude A to backlash gap δ.

Every curve has the same parts: a polynomial, a smooth correction to it, draws of its uncertainty by
source, and the range over which it was made. All snapshots of a joint share the draws. An error of
the curve is thus the same for all of them, and largely cancels in the change of δ.

A curve also tells which local optimum is the ringing if the sum of squares may be misleading. Close
to the noise, pulses that are exchanged and shifted by half a ringing can fit almost as well, and
sometimes better. A sweep knows which frequency and decay belong to each amplitude. Used as a prior
on both, it separates the optima. Within the chosen optimum, A stays the least-squares amplitude
that defines the curve.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from bayesbl.errors import CurveError
from bayesbl.recording.types import FloatArray
from bayesbl.ringing.estimator import Estimator, PointEstimate
from bayesbl.ringing.symbols import AMPLITUDE
from bayesbl.sampling.convergence import Contender

KNOTS = 80


@dataclass(frozen=True, slots=True)
class Ringing:
    """Frequency and decay of the ringing at each amplitude, from a sweep.

    Attributes
    ----------
    log_frequency, log_decay
        ln ω (rad/s) and ln τ (1/s) at the curve's knots, shape (g,).
    frequency_draws, decay_draws
        Departures from these for each draw of the curve's ``bench`` source, shape (m, g); one row
        of zeros if the bench is assumed exact.
    scatter
        Covariance of (A, ln ω, ln τ) over start angles at the knots, shape (g, 3, 3).
    """

    log_frequency: FloatArray
    log_decay: FloatArray
    frequency_draws: FloatArray
    decay_draws: FloatArray
    scatter: FloatArray


@dataclass(frozen=True, slots=True)
class GapCurve:
    """δ(A) = Σ c_k A^k · exp(correction) with its uncertainty.

    Attributes
    ----------
    name
        ``published``, or what it was made from.
    coefficients
        c_0 … c_degree for A in rpm and δ in rad, shape (degree + 1,).
    knots_rpm
        Amplitudes at which the following are given, increasing, shape (g,). Their ends are the
        range over which the curve was made. Beyond it, δ follows the power law of the nearest end.
    correction
        Smooth departure of ln δ from the polynomial's, shape (g,).
    sources
        For each source of uncertainty (``rounding``, ``regression``, ``lack_of_fit``, ``bench``),
        draws of the departure of ln δ from the curve due to that source alone, (m, g).
    start_angle_sd_rpm
        Scatter of A with the start angle, shape (g,), independent per snapshot; 0 if not known.
    fingerprint
        Fingerprint of the estimator that defines A; ``None`` accepts any least-squares fit.
    ringing
        Frequency and decay along the curve, if it comes from a sweep.
    warnings
        What every user of this curve must know.
    reference_speed_rpm
        Mean motor speed of the bench it was made on, without sign; ``None`` if not known.
    """

    name: str
    coefficients: FloatArray
    knots_rpm: FloatArray
    correction: FloatArray
    sources: Mapping[str, FloatArray]
    start_angle_sd_rpm: FloatArray
    fingerprint: str | None = None
    ringing: Ringing | None = None
    warnings: tuple[str, ...] = ()
    reference_speed_rpm: float | None = None

    def __post_init__(self) -> None:
        low, high = self.amplitude_range_rpm
        grid = np.linspace(low, high, 400)
        value = self.gap(grid)
        if not (np.all(np.diff(value) > 0.0) and value[0] > 0.0):
            worst = int(np.argmin(np.diff(value)))
            raise CurveError(
                "The gap curve does not grow with the amplitude over its range, so an amplitude "
                "does not determine the gap.",
                file=self.name,
                found=f"dδ/dA {(value[worst + 1] - value[worst]) / (grid[1] - grid[0]):.3g} "
                f"rad/rpm at A = {grid[worst]:.3g} rpm",
                expected="dδ/dA > 0 and δ > 0 everywhere",
            )

    @property
    def amplitude_range_rpm(self) -> tuple[float, float]:
        """Range of A over which the curve was made, rpm."""
        return float(self.knots_rpm[0]), float(self.knots_rpm[-1])

    @property
    def gap_range_rad(self) -> tuple[float, float]:
        """δ at the ends of the amplitude range, rad."""
        low, high = self.gap(np.array(self.amplitude_range_rpm))
        return float(low), float(high)

    def gap(self, amplitude_rpm: FloatArray) -> FloatArray:
        """δ of the nominal curve in rad, same shape as A in rpm; 0 for A ≤ 0."""
        amplitude_rpm = np.asarray(amplitude_rpm, dtype=float)
        inside = np.clip(amplitude_rpm, *self.amplitude_range_rpm)
        value = self._inside(inside)
        positive = amplitude_rpm > 0.0
        extrapolated = positive & (inside != amplitude_rpm)
        if np.any(extrapolated):
            exponent = self._relative_slope(inside) * inside
            ratio = np.where(extrapolated, amplitude_rpm, inside) / inside
            value = value * ratio**exponent
        return np.where(positive, value, 0.0)

    def log_slope(self, amplitude_rpm: FloatArray) -> FloatArray:
        """d ln δ / dA in 1/rpm: the Jacobian of a prior that is flat in ln δ; 0 for A ≤ 0."""
        amplitude_rpm = np.asarray(amplitude_rpm, dtype=float)
        inside = np.clip(amplitude_rpm, *self.amplitude_range_rpm)
        positive = amplitude_rpm > 0.0
        share = np.where(positive, inside / np.where(positive, amplitude_rpm, 1.0), 0.0)
        return np.asarray(self._relative_slope(inside) * share)

    def outside(self, amplitude_rpm: FloatArray) -> FloatArray:
        """−1 below the range, 0 inside, +1 above; same shape as A."""
        low, high = self.amplitude_range_rpm
        return np.where(amplitude_rpm < low, -1.0, np.where(amplitude_rpm > high, 1.0, 0.0))

    def draw(self, count: int, generator: np.random.Generator) -> CurveDraws:
        """Draw ``count`` curves that could be the true one, shared by all snapshots."""
        rows = {n: generator.integers(len(d), size=count) for n, d in self.sources.items()}
        return CurveDraws(self, rows)

    def start_angle_sd(self, amplitude_rpm: FloatArray) -> FloatArray:
        """Standard deviation of A over start angles at the given A, rpm, same shape."""
        return np.asarray(np.interp(amplitude_rpm, self.knots_rpm, self.start_angle_sd_rpm))

    def ringing_at(self, amplitude_rpm: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Expected (ln ω, ln τ) at an amplitude, of a curve with ringing.

        Returns
        -------
        The two, linear in ln A between the knots, shape (2,). Covariances at the nearest knot: of
        (A, ln ω, ln τ) over start angles, (3, 3), and of (ln ω, ln τ) over the bench's tolerances,
        (2, 2).
        """
        ringing = self.ringing
        assert ringing is not None
        log_knots = np.log(self.knots_rpm)
        x = np.log(np.clip(amplitude_rpm, *self.amplitude_range_rpm))
        nearest = int(np.argmin(np.abs(log_knots - x)))
        draws = np.stack([ringing.frequency_draws[:, nearest], ringing.decay_draws[:, nearest]])
        bench = np.cov(draws) if draws.shape[1] > 1 else np.zeros((2, 2))
        lines = (ringing.log_frequency, ringing.log_decay)
        expected = np.array([np.interp(x, log_knots, line) for line in lines])
        return expected, ringing.scatter[nearest], bench

    def at_rows(
        self, table: FloatArray, rows: NDArray[np.int64], amplitude_rpm: FloatArray
    ) -> FloatArray:
        """Row ``rows[i]`` of a table (m, g) over the knots, at ``amplitude_rpm[i]``, shape
        (count,): linear in ln A between the knots, constant beyond them."""
        logs = np.log(self.knots_rpm)
        x = np.log(np.clip(amplitude_rpm, *self.amplitude_range_rpm))
        right = np.clip(np.searchsorted(logs, x), 1, logs.size - 1)
        weight = (x - logs[right - 1]) / (logs[right] - logs[right - 1])
        return np.asarray((1.0 - weight) * table[rows, right - 1] + weight * table[rows, right])

    def _inside(self, amplitude_rpm: FloatArray) -> FloatArray:
        departure = np.interp(np.log(amplitude_rpm), np.log(self.knots_rpm), self.correction)
        return np.asarray(polynomial.polyval(amplitude_rpm, self.coefficients) * np.exp(departure))

    def _relative_slope(self, amplitude_rpm: FloatArray) -> FloatArray:
        """d ln δ / dA inside the range, by a central difference of 1e-3 of A, in 1/rpm."""
        low, high = self.amplitude_range_rpm
        above = np.minimum(amplitude_rpm * 1.001, high)
        below = np.maximum(amplitude_rpm * 0.999, low)
        return np.asarray(np.log(self._inside(above) / self._inside(below)) / (above - below))


@dataclass(frozen=True, slots=True)
class CurveDraws:
    """Draws of a curve: for each source the row of its draws that each element uses."""

    curve: GapCurve
    rows: Mapping[str, NDArray[np.int64]]

    def only(self, source: str) -> CurveDraws:
        """The same draws of one source, the others at nominal."""
        return CurveDraws(self.curve, {source: self.rows[source]})

    def take(self, index: NDArray[np.int64]) -> CurveDraws:
        """The draws at these positions."""
        return CurveDraws(self.curve, {name: rows[index] for name, rows in self.rows.items()})

    def gap(self, amplitude_rpm: FloatArray) -> FloatArray:
        """δ in rad for A in rpm, both of shape (count,); departures by source add up in ln δ."""
        departure = np.zeros(amplitude_rpm.size)
        for name, rows in self.rows.items():
            departure += self.curve.at_rows(self.curve.sources[name], rows, amplitude_rpm)
        return np.asarray(self.curve.gap(amplitude_rpm) * np.exp(departure))


PUBLISHED_COEFFICIENTS = (-0.138809, 0.138764, 0.003122, -0.000009)
"""Of eq. 4, in 1e-4 rad over powers of rpm."""


def published_curve(draws: int = 4000) -> GapCurve:
    """Eq. 4 of the paper, with the rounding of its printed coefficients as uncertainty.

    The printed coefficients do not quite give the gaps that the paper prints beside them. Half a
    unit of the last digit explains the difference.
    """
    centre = np.array(PUBLISHED_COEFFICIENTS)
    coefficients = 1e-4 * centre  # eq. 4 gives δ in 0.1 mrad
    low, high = (_amplitude_of(coefficients, gap_rad) for gap_rad in (1e-4, 4e-3))
    knots = np.geomspace(low, high, KNOTS)
    half = 0.5e-6  # of the last digit
    generator = np.random.default_rng(20260301)
    rounded = centre + generator.uniform(-half, half, size=(draws, centre.size))
    powers = knots[None, :] ** np.arange(centre.size)[:, None]
    return GapCurve(
        name="published",
        coefficients=coefficients,
        knots_rpm=knots,
        correction=np.zeros(KNOTS),
        sources={"rounding": np.log((rounded @ powers) / (centre @ powers))},
        start_angle_sd_rpm=np.zeros(KNOTS),
        warnings=(
            "The published curve (the paper's eq. 4) belongs to the paper's test bench, at 2000 "
            "rpm: a speed that is assumed, as the paper does not state it. On another joint δ can "
            "be off by a factor of two or more, which the interval does not include, so there is "
            "no probability of a limit, no rate and no date. A bench of your joint (--bench) gives "
            "a curve of its own.",
        ),
        reference_speed_rpm=2000.0,
    )


def _amplitude_of(coefficients: FloatArray, gap_rad: float) -> float:
    """The smallest positive real A at which the polynomial equals ``gap_rad``."""
    shifted = coefficients.copy()
    shifted[0] -= gap_rad
    roots = polynomial.polyroots(shifted)
    real = roots[np.abs(roots.imag) < 1e-9].real
    positive = real[real > 0.0]
    return float(positive.min()) if positive.size else math.nan


LARGEST_DEFICIT = 15.0
"""Log likelihood below the optimum's at which a rival is no longer considered."""


def likeliest_branch(curve: GapCurve, estimator: Estimator, point: PointEstimate) -> PointEstimate:
    """The optimum, or a rival that is more probable given the curve's frequency and decay.

    The evidence of each is its likelihood times the density of its (ln ω, ln τ), as predicted by
    the curve at its amplitude. The covariance is that of fit, start angle and bench. A curve
    without ringing keeps the optimum.
    """
    if curve.ringing is None:
        return point
    candidates = [(_log_prior(curve, point), point)]
    for rival in point.optimum.rivals:
        excess = rival.sum_of_squares - point.optimum.sum_of_squares
        deficit = 0.5 * excess / point.spread.scale
        if deficit > LARGEST_DEFICIT:
            continue
        rival_point = estimator.at_rival(point, rival)
        candidates.append((_log_prior(curve, rival_point) - deficit, rival_point))
    evidence, best = max(candidates, key=lambda pair: pair[0])
    contenders = tuple(
        Contender(rival_point.optimum.symbols[AMPLITUDE], other_evidence - evidence)
        for other_evidence, rival_point in candidates
        if rival_point is not best
    )
    if best is point:
        return replace(point, contenders=contenders)
    note = (
        "The optimum of least RMSE does not ring like this bench at any gap. Another that does, "
        f"{100.0 * (best.optimum.rmse_rpm / point.optimum.rmse_rpm - 1.0):.2g} % larger in RMSE, "
        "was used instead."
    )
    return replace(best, notes=(*point.notes, note), contenders=contenders)


def _log_prior(curve: GapCurve, point: PointEstimate) -> float:
    """ln density of the measured (ln ω, ln τ), as predicted by the curve at the measured A."""
    centre, covariance = point.ringing
    expected, scatter, bench = curve.ringing_at(centre[0])
    total = (covariance + scatter)[1:, 1:] + bench
    # A fixed frequency or decay carries no information and has no variance.
    informative = np.diag(covariance)[1:] > 0.0
    difference = (centre[1:] - expected)[informative]
    total = total[np.ix_(informative, informative)]
    distance = difference @ np.linalg.solve(total, difference)
    return float(-0.5 * (distance + np.linalg.slogdet(total)[1]))
