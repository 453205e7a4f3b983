"""Curves from ringing amplitude A to backlash gap δ.

Wherever a curve comes from, it is one kind of thing: a polynomial, draws of what is uncertain
about it, by source, and the range over which it was made. Draws are shared by all snapshots of a
joint: what is wrong with the curve is wrong the same way for each of them, and largely cancels in
the change of δ.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.polynomial import polynomial

from bayesbl.errors import CurveError
from bayesbl.recording.types import FloatArray


@dataclass(frozen=True, slots=True)
class GapCurve:
    """δ(A) = Σ c_k A^k with its uncertainty.

    Attributes
    ----------
    name
        ``published``, or what it was made from.
    coefficients
        c_0 … c_degree for A in rpm and δ in rad, shape (degree + 1,).
    sources
        What is uncertain, by name (``rounding``, ``regression``, ``bench``): draws of all
        coefficients with only that source at work, shape (m, degree + 1).
    amplitude_range_rpm
        Where the curve was made; beyond it δ follows the power law of the nearest end.
    start_angle_sd_rpm
        Scatter of A with the start angle, as (A, sd) pairs, shape (k, 2); independent per
        snapshot. Empty where it is not known.
    fingerprint
        Of the estimator whose A the curve means; ``None`` accepts any least-squares fit.
    warnings
        What every user of this curve must be told.
    """

    name: str
    coefficients: FloatArray
    sources: Mapping[str, FloatArray]
    amplitude_range_rpm: tuple[float, float]
    start_angle_sd_rpm: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    fingerprint: str | None = None
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        low, high = self.amplitude_range_rpm
        grid = np.linspace(low, high, 400)
        slope = polynomial.polyval(grid, polynomial.polyder(self.coefficients))
        if not (np.all(slope > 0.0) and polynomial.polyval(low, self.coefficients) > 0.0):
            raise CurveError(
                "The gap curve does not grow with the amplitude over its range, so an amplitude "
                "does not tell the gap.",
                file=self.name,
                found=f"smallest dδ/dA {slope.min():.3g} rad/rpm in [{low:.3g}, {high:.3g}] rpm",
                expected="dδ/dA > 0 and δ > 0 everywhere",
            )

    @property
    def gap_range_rad(self) -> tuple[float, float]:
        """δ at the ends of the amplitude range, rad."""
        low, high = self.gap(np.array(self.amplitude_range_rpm))
        return float(low), float(high)

    def gap(self, amplitude_rpm: FloatArray) -> FloatArray:
        """δ of the nominal curve in rad, same shape as A in rpm; 0 for A ≤ 0."""
        return evaluate(self.coefficients, amplitude_rpm, self.amplitude_range_rpm)

    def log_slope(self, amplitude_rpm: FloatArray) -> FloatArray:
        """d ln δ / dA in 1/rpm: the Jacobian of a prior that is flat in ln δ; 0 for A ≤ 0."""
        low, high = self.amplitude_range_rpm
        inside = np.clip(amplitude_rpm, low, high)
        slope = polynomial.polyval(inside, polynomial.polyder(self.coefficients))
        relative = slope / polynomial.polyval(inside, self.coefficients)
        with np.errstate(divide="ignore"):
            value = relative * np.where(amplitude_rpm > 0.0, inside / amplitude_rpm, 0.0)
        return np.asarray(value)

    def outside(self, amplitude_rpm: FloatArray) -> FloatArray:
        """−1 below the range, 0 inside, +1 above; same shape as A."""
        low, high = self.amplitude_range_rpm
        return np.where(amplitude_rpm < low, -1.0, np.where(amplitude_rpm > high, 1.0, 0.0))

    def draw(
        self, count: int, generator: np.random.Generator, sources: Collection[str] | None = None
    ) -> CurveDraws:
        """``count`` curves that could be the true one, all snapshots to share them.

        Parameters
        ----------
        sources
            Only these are drawn, the others held at nominal; all of them by default.
        """
        chosen = self.sources if sources is None else sources
        picked = {
            name: draws[generator.integers(len(draws), size=count)]
            for name, draws in self.sources.items()
            if name in chosen and len(draws)
        }
        return CurveDraws(self, picked)

    def start_angle_sd(self, amplitude_rpm: FloatArray) -> FloatArray:
        """Standard deviation of A over start angles at the given A, rpm, same shape."""
        if not len(self.start_angle_sd_rpm):
            return np.zeros_like(amplitude_rpm)
        known, sd = self.start_angle_sd_rpm.T
        return np.asarray(np.interp(amplitude_rpm, known, sd))


@dataclass(frozen=True, slots=True)
class CurveDraws:
    """Draws of a curve; :meth:`gap` takes one amplitude per draw."""

    curve: GapCurve
    coefficients: Mapping[str, FloatArray]

    def gap(self, amplitude_rpm: FloatArray) -> FloatArray:
        """δ in rad for A in rpm, both of shape (count,).

        Sources multiply: each acts on ln δ as it does alone.
        """
        nominal = self.curve.gap(amplitude_rpm)
        total = nominal.copy()
        span = self.curve.amplitude_range_rpm
        positive = nominal > 0.0
        for coefficients in self.coefficients.values():
            alone = evaluate(coefficients, amplitude_rpm, span)
            total[positive] *= alone[positive] / nominal[positive]
        return total


def evaluate(
    coefficients: FloatArray, amplitude_rpm: FloatArray, span_rpm: tuple[float, float]
) -> FloatArray:
    """Polynomial inside ``span_rpm``, the power law of its nearest end beyond, 0 for A ≤ 0.

    Parameters
    ----------
    coefficients
        Shape (k,), or (count, k) with one row per amplitude.
    amplitude_rpm
        Any shape, or (count,).
    """
    inside = np.clip(amplitude_rpm, *span_rpm)
    columns = np.moveaxis(np.atleast_2d(coefficients), -1, 0)
    if coefficients.ndim == 1:
        columns = coefficients
    value = polynomial.polyval(inside, columns, tensor=False)
    if np.array_equal(inside, amplitude_rpm):
        return np.asarray(value)
    slope = polynomial.polyval(inside, polynomial.polyder(columns, axis=0), tensor=False)
    exponent = slope * inside / value
    positive = amplitude_rpm > 0.0
    ratio = np.where(positive, amplitude_rpm, 1.0) / inside
    return np.asarray(np.where(positive, value * ratio**exponent, 0.0))


PUBLISHED_SCALE_RAD = 1e-4
PUBLISHED_COEFFICIENTS = (-0.138809, 0.138764, 0.003122, -0.000009)
PUBLISHED_LAST_DIGIT = 1e-6
PUBLISHED_GAP_RANGE_RAD = (1e-4, 4e-3)


def published_curve(draws: int = 4000, seed: int = 20260301) -> GapCurve:
    """Eq. 4 of the paper, with the rounding of its printed coefficients as uncertainty.

    The printed coefficients do not quite give the gaps that the paper prints beside them; half a
    unit of their last digit explains it.
    """
    centre = np.array(PUBLISHED_COEFFICIENTS)
    generator = np.random.default_rng(seed)
    half = 0.5 * PUBLISHED_LAST_DIGIT
    rounded = centre + generator.uniform(-half, half, size=(draws, centre.size))
    coefficients = PUBLISHED_SCALE_RAD * centre
    return GapCurve(
        name="published",
        coefficients=coefficients,
        sources={"rounding": PUBLISHED_SCALE_RAD * rounded},
        amplitude_range_rpm=(
            _amplitude_of(coefficients, PUBLISHED_GAP_RANGE_RAD[0]),
            _amplitude_of(coefficients, PUBLISHED_GAP_RANGE_RAD[1]),
        ),
        warnings=(
            "The published curve (the paper's eq. 4) belongs to the paper's test bench. On another "
            "joint δ can be off by several percent or more, which the interval does not include; "
            "sweep a bench of your joint for a curve of its own.",
        ),
    )


def _amplitude_of(coefficients: FloatArray, gap_rad: float) -> float:
    """The smallest positive real A at which the polynomial equals ``gap_rad``."""
    shifted = coefficients.copy()
    shifted[0] -= gap_rad
    roots = polynomial.polyroots(shifted)
    real = roots[np.abs(roots.imag) < 1e-9].real
    positive = real[real > 0.0]
    return float(positive.min()) if positive.size else math.nan
