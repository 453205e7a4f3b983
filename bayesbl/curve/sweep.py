"""Sweep a virtual bench over gaps, and fit the gap curve through the amplitudes.

Each simulated recording goes through the estimator used for measured ones (model, window, baseline,
sampling), so that curve and measurement define A alike. The search is warm-started along the gap.
It finds the same least-squares optimum.

The bench is also swept at some draws of its parameters. At each gap, ln A, ln ω and ln τ are then
described as smooth functions of the parameters: A is regressed on the parameters at fixed gap;
points of δ against A are never pooled. This gives as many further draws as inference needs.
Residuals of the swept draws are added back.

The regression of δ on A has relative weights throughout. The model of one sweep point is

    1 = Σ c_k A^k / δ + g(ln A) + scatter,

with coefficients c under a flat prior, a smooth lack of fit g (Gaussian process with squared
exponential covariance), and the scatter of the start angle. Coefficients and lack of fit are
inferred together (universal kriging; Rasmussen and Williams 2006, section 2.7), the size and length
of the process by restricted maximum likelihood on a grid.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Literal, TypedDict

import numpy as np
from numpy.polynomial import polynomial
from scipy.linalg import cho_factor, cho_solve

from bayesbl.bench.bench import Bench, require_flank_change
from bayesbl.curve.gap_curve import KNOTS, GapCurve, Ringing
from bayesbl.errors import CurveError
from bayesbl.recording.types import FloatArray
from bayesbl.ringing.objective import Objective
from bayesbl.ringing.optimum import exchanged, find_optimum
from bayesbl.ringing.search import refine
from bayesbl.ringing.symbols import DECAY, FREQUENCY, START, DisturbanceModel

LEAST_LEAP = 0.2
"""Smallest jump of ln ω. Neighbours scatter by some per cent with the start angle; jumps lead to
another mode of the joint, 40 % away on the benches that had one."""

FEWEST_GAPS = 8
"""Gaps that a polynomial of the highest degree needs."""


@dataclass(frozen=True, slots=True)
class SweepSettings:
    """Gaps and start angles at which a bench is simulated, and its sampling.

    Attributes
    ----------
    low_rad, high_rad, count, spacing
        The gaps, ``log`` or ``linear``.
    start_angles
        Number of load angles at the first sample.
    rotations, sampling_hz
        Length in load rotations and rate of each simulated recording.
    """

    low_rad: float = 1e-4
    high_rad: float = 4e-3
    count: int = 40
    spacing: Literal["log", "linear"] = "log"
    start_angles: int = 4
    rotations: float = 5.0
    sampling_hz: float = 1000.0

    @property
    def gap_rad(self) -> FloatArray:
        """The gaps, increasing, shape (g,), rad."""
        spread = np.geomspace if self.spacing == "log" else np.linspace
        return np.asarray(spread(self.low_rad, self.high_rad, self.count))

    @property
    def start_angle_rad(self) -> FloatArray:
        """The start angles at each gap, shape (g, s), rad.

        All differ, spread by the golden ratio. Equal parts of a rotation are often whole numbers of
        samples; every recording would then meet the window's end at the same point between samples.
        """
        number = np.arange(self.count * self.start_angles)
        turns = (0.05 + number * (math.sqrt(5.0) - 1.0) / 2.0) % 1.0
        return np.asarray(2.0 * math.pi * turns).reshape(self.count, self.start_angles)


@dataclass(frozen=True, slots=True)
class SweepRow:
    """One bench at all gaps and some start angles.

    Attributes
    ----------
    gap_rad, start_angle_rad
        Shapes (g,) and (g, s), rad.
    searched
        Optimum of the searched symbols, shape (g, s, d), in the order of ``model.searched``.
    amplitude_rpm, rmse_rpm
        Shape (g, s), rpm.
    names
        The searched symbols.
    """

    gap_rad: FloatArray
    start_angle_rad: FloatArray
    searched: FloatArray
    amplitude_rpm: FloatArray
    rmse_rpm: FloatArray
    names: tuple[str, ...]

    def on_one_branch(self, fixed: Mapping[str, float]) -> SweepRow:
        """Drop the gaps below which the optimum belongs to another ringing.

        At small gaps another oscillation may fit better, and A has another meaning. Where the
        optimum changes over, ω jumps. Along one branch ω changes far less than proportionally to
        the gap.

        Raises
        ------
        CurveError
            If fewer than :data:`FEWEST_GAPS` are left.
        """
        steps = np.abs(np.diff(np.log(self.symbol(FREQUENCY, fixed)[:, 0])))
        jumps = np.flatnonzero(steps > np.maximum(np.diff(np.log(self.gap_rad)), LEAST_LEAP))
        kept = slice(int(jumps[-1]) + 1 if jumps.size else 0, None)
        if jumps.size and self.gap_rad[kept].size < FEWEST_GAPS:
            raise CurveError(
                "The best fit jumps from one ringing to another, and too few gaps are beyond.",
                where=f"δ = {self.gap_rad[jumps[-1]]:.3g} to {self.gap_rad[jumps[-1] + 1]:.3g} rad",
                found=f"{self.gap_rad[kept].size} gaps",
                expected=f"at least {FEWEST_GAPS}; larger gaps, or another bench",
            )
        rows = {f.name: getattr(self, f.name)[kept] for f in fields(self) if f.name != "names"}
        return replace(self, **rows)

    def symbol(self, name: str, fixed: Mapping[str, float]) -> FloatArray:
        """A searched or fixed symbol, shape (g, s)."""
        if name in fixed:
            return np.full_like(self.amplitude_rpm, fixed[name])
        return np.asarray(self.searched[:, :, self.names.index(name)])


def sweep_nominal(
    bench: Bench,
    model: DisturbanceModel,
    settings: SweepSettings,
    generator: np.random.Generator,
    workers: int = 1,
) -> SweepRow:
    """Sweep the nominal bench: a full search at the largest gap, then follow one branch downward.

    At every gap the exchanged neighbours (both pulses shifted by half a ringing) are tried too,
    because they are the other candidates for the least sum of squares.

    Raises
    ------
    BenchError
        If the load stays on one tooth flank, or a simulation fails.
    """
    require_flank_change(bench)
    angles = settings.start_angle_rad
    objectives = _objectives(bench, model, settings, settings.gap_rad, angles, workers)
    point = find_optimum(objectives[-1][0], "guess", generator).searched
    searched = np.empty((*angles.shape, point.size))
    trend = np.zeros_like(point)
    for g in reversed(range(settings.count)):
        first, previous = objectives[g][0], point
        if g < settings.count - 1:
            point = _turned(model, point, angles[g, 0] - angles[g + 1, 0], bench)
            previous = point
        # Following the trend alone could end where there is no ringing.
        starts = [point + trend, point, *exchanged(model, point + trend)]
        ends = np.array([refine(first, start) for start in starts])
        best = int(np.argmin(first.sum_of_squares(ends)))
        point = ends[best]
        same_branch = best < 2 and g < settings.count - 1
        trend = point - previous if same_branch else np.zeros_like(point)
        for s, angle in enumerate(angles[g]):
            start = _turned(model, point, angle - angles[g, 0], bench)
            searched[g, s] = point if s == 0 else refine(objectives[g][s], start)
    row = _row(model, settings.gap_rad, angles, objectives, searched)
    return row.on_one_branch(model.fixed)


def sweep_like(
    bench: Bench,
    nominal: SweepRow,
    model: DisturbanceModel,
    settings: SweepSettings,
) -> SweepRow:
    """Sweep a bench near the nominal one, first start angles only, warm-started from the nominal
    sweep.

    It uses the nominal sweep's start angles, so that their scatter cancels in the difference.
    """
    angles = nominal.start_angle_rad[:, :1]
    objectives = _objectives(bench, model, settings, nominal.gap_rad, angles, 1)
    searched = np.empty_like(nominal.searched[:, :1])
    shift = np.zeros(nominal.searched.shape[2])
    for g in reversed(range(nominal.gap_rad.size)):
        nominal_point = nominal.searched[g, 0]
        point = refine(objectives[g][0], nominal_point + shift)
        shift = point - nominal_point
        searched[g, 0] = point
    return _row(model, nominal.gap_rad, angles, objectives, searched)


def _row(
    model: DisturbanceModel,
    gap_rad: FloatArray,
    start_angle_rad: FloatArray,
    objectives: Sequence[Sequence[Objective]],
    searched: FloatArray,
) -> SweepRow:
    """Make the row from optima (g, s, d)."""
    solutions = [
        objective.solve(point[None])
        for of_gap, points in zip(objectives, searched, strict=True)
        for objective, point in zip(of_gap, points, strict=True)
    ]
    shape = start_angle_rad.shape
    amplitude = np.abs([solution.coefficients[0, -1] for solution in solutions])
    squares = np.array([solution.sum_of_squares[0] for solution in solutions])
    rmse = np.sqrt(squares / objectives[0][0].samples_used)
    return SweepRow(
        gap_rad,
        start_angle_rad,
        searched,
        amplitude.reshape(shape),
        rmse.reshape(shape),
        model.searched,
    )


def _objectives(
    bench: Bench,
    model: DisturbanceModel,
    settings: SweepSettings,
    gap_rad: FloatArray,
    start_angle_rad: FloatArray,
    workers: int,
) -> list[list[Objective]]:
    width = start_angle_rad.shape[1]
    speeds = bench.simulate_many(
        np.repeat(gap_rad, width),
        rotations=settings.rotations,
        sampling_hz=settings.sampling_hz,
        start_angle_rad=start_angle_rad.ravel(),
        workers=workers,
    )
    time_s = np.arange(speeds.shape[1]) / settings.sampling_hz
    flat = [Objective(model, time_s, speed) for speed in speeds]
    return [flat[i : i + width] for i in range(0, len(flat), width)]


def _turned(
    model: DisturbanceModel, point: FloatArray, angle_rad: float, bench: Bench
) -> FloatArray:
    """Shift a point to a recording that starts ``angle_rad`` later."""
    if START not in model.searched:
        return point
    shifted = point.copy()
    direction = math.copysign(1.0, bench.value("reference_speed_rpm"))
    period = bench.rotation_period_s()
    shifted[model.searched.index(START)] -= direction * angle_rad / (2.0 * math.pi) * period
    return shifted


VIRTUAL_DRAWS = 3000


@dataclass(frozen=True, slots=True)
class SweptDraws:
    """Sweeps of benches drawn within the tolerances.

    Attributes
    ----------
    names
        The p parameters that have a tolerance.
    shifts
        Departure of each parameter in units of its tolerance, shape (b, p); in [−1, 1] unless it
        was identified.
    departures
        Departure of (ln A, ln ω, ln τ) from the nominal sweep at each gap, shape (b, g, 3).
    root
        Root of the covariance of normal shifts, shape (p, p); ``None`` for uniform ones.
    """

    names: tuple[str, ...]
    shifts: FloatArray
    departures: FloatArray
    root: FloatArray | None = None


def virtual_departures(swept: SweptDraws, generator: np.random.Generator) -> FloatArray:
    """Departures (ln A, ln ω, ln τ) of :data:`VIRTUAL_DRAWS` benches drawn within the tolerances.

    The model is linear in the parameters. What is not stays in its residuals, which are added back.
    With too few swept draws for it, these are repeated.

    Returns
    -------
    Shape (VIRTUAL_DRAWS, g, 3).
    """
    count = VIRTUAL_DRAWS
    draws, parameters = swept.shifts.shape
    if draws < 2 * (1 + parameters):
        return np.asarray(swept.departures[generator.integers(draws, size=count)])
    design = np.column_stack([np.ones(draws), swept.shifts])
    flat = swept.departures.reshape(draws, -1)
    solution = np.linalg.lstsq(design, flat, rcond=None)[0]
    freedom = max(draws - design.shape[1], 1)
    residual = (flat - design @ solution) * np.sqrt(draws / freedom)
    if swept.root is None:
        virtual = generator.uniform(-1.0, 1.0, size=(count, parameters))
    else:
        virtual = generator.standard_normal((count, parameters)) @ swept.root.T
    predicted = np.column_stack([np.ones(count), virtual]) @ solution
    predicted += residual[generator.integers(draws, size=count)]
    return np.asarray(predicted.reshape(count, *swept.departures.shape[1:]))


REGRESSION_DRAWS = 2000
DEGREES = (1, 2, 3, 4, 5)


class DegreeSummary(TypedDict):
    """How well a polynomial of one degree describes the sweep.

    Departures are relative differences between δ and the polynomial alone, at the mean amplitude of
    each gap.
    ``log_evidence``: restricted log likelihood, with the smooth lack of fit included.
    """

    rms_departure: float
    largest_departure: float
    log_evidence: float


def swept_curve(
    name: str,
    nominal: SweepRow,
    model: DisturbanceModel,
    degree: int,
    fingerprint: str,
    seed: np.random.SeedSequence,
    draws: SweptDraws | None = None,
) -> GapCurve:
    """Regress δ on A over a nominal sweep, with the uncertainty of the bench as a source.

    Raises
    ------
    CurveError
        If A does not grow with δ, or the curve does not grow with A.
    """
    regression_seed, bench_seed = seed.spawn(2)
    mean = nominal.amplitude_rpm.mean(axis=1)
    _require_growing(name, nominal.gap_rad, mean)
    regression = _regression(nominal, degree)
    knots = regression.knots_rpm
    by_coefficients, by_lack_of_fit = regression.draws(
        REGRESSION_DRAWS, np.random.default_rng(regression_seed)
    )
    coefficients = relative_fit(mean, nominal.gap_rad, degree)
    sources = {"regression": by_coefficients, "lack_of_fit": by_lack_of_fit}
    values = _log_values(nominal, model)
    departures = np.zeros((1, *values.shape[:1], 3))
    if draws is not None:
        departures = virtual_departures(draws, np.random.default_rng(bench_seed))
    by_bench, ringing = _bench_source(nominal, values, departures, knots)
    if draws is not None:
        sources["bench"] = by_bench
    return GapCurve(
        name=name,
        coefficients=coefficients,
        knots_rpm=knots,
        correction=regression.log_gap - np.log(polynomial.polyval(knots, coefficients)),
        sources=sources,
        start_angle_sd_rpm=np.interp(knots, mean, start_angle_scatter(nominal.amplitude_rpm)),
        fingerprint=fingerprint,
        ringing=ringing,
    )


def degree_reports(nominal: SweepRow) -> dict[int, DegreeSummary]:
    """Fit polynomials of several degrees, so that a cubic is a result, not an assumption."""
    mean = nominal.amplitude_rpm.mean(axis=1)
    reports: dict[int, DegreeSummary] = {}
    for degree in DEGREES:
        if nominal.gap_rad.size < degree + 3:
            break
        coefficients = relative_fit(mean, nominal.gap_rad, degree)
        departure = polynomial.polyval(mean, coefficients) / nominal.gap_rad - 1.0
        reports[degree] = {
            "rms_departure": float(np.sqrt(np.mean(departure**2))),
            "largest_departure": float(np.abs(departure).max()),
            "log_evidence": _regression(nominal, degree).log_evidence,
        }
    return reports


def start_angle_scatter(values: FloatArray) -> FloatArray:
    """Standard deviation over start angles at each gap, (g, s) to (g,), 0 for a single angle.

    Variances are averaged over five neighbouring gaps, because a few start angles alone estimate a
    standard deviation poorly.
    """
    if values.shape[1] < 2:
        return np.zeros(len(values))
    variance = np.pad(values.var(axis=1, ddof=1), 2, mode="edge")
    return np.asarray(np.sqrt(np.convolve(variance, np.full(5, 0.2), "valid") + 1e-18))


def _regression(nominal: SweepRow, degree: int) -> Regression:
    """Regress the gaps on all amplitudes, with knots over their range."""
    mean = nominal.amplitude_rpm.mean(axis=1)
    sd_rpm = start_angle_scatter(nominal.amplitude_rpm)
    slope = np.gradient(np.log(nominal.gap_rad), mean)
    shape = nominal.amplitude_rpm.shape
    return regress(
        nominal.amplitude_rpm.ravel(),
        np.broadcast_to(nominal.gap_rad[:, None], shape).ravel(),
        np.broadcast_to((slope * sd_rpm)[:, None], shape).ravel(),
        np.geomspace(mean[0], mean[-1], KNOTS),
        degree,
    )


def _require_growing(name: str, gap_rad: FloatArray, amplitude_rpm: FloatArray) -> None:
    falls = np.flatnonzero(np.diff(amplitude_rpm) <= 0.0)
    if falls.size:
        i = int(falls[0])
        raise CurveError(
            "The amplitude does not grow with the gap, so it does not determine the gap.",
            file=name,
            where=f"δ = {gap_rad[i]:.3g} to {gap_rad[i + 1]:.3g} rad",
            found=f"A = {amplitude_rpm[i]:.4g} to {amplitude_rpm[i + 1]:.4g} rpm",
            expected="A that grows with δ; a narrower range of gaps, or another bench",
        )


def _log_values(row: SweepRow, model: DisturbanceModel) -> FloatArray:
    """(ln A, ln ω, ln τ) at each gap and start angle, shape (g, s, 3)."""
    symbols = [row.symbol(name, model.fixed) for name in (FREQUENCY, DECAY)]
    return np.log(np.stack([row.amplitude_rpm, *symbols], axis=-1))


def departures(row: SweepRow, nominal: SweepRow, model: DisturbanceModel) -> FloatArray:
    """Departure of (ln A, ln ω, ln τ) of a drawn bench from the nominal sweep, shape (g, 3)."""
    return np.asarray(_log_values(row, model)[:, 0] - _log_values(nominal, model)[:, 0])


def _bench_source(
    nominal: SweepRow, values: FloatArray, departures: FloatArray, knots_rpm: FloatArray
) -> tuple[FloatArray, Ringing]:
    """Convert departures at given gaps to departures at given amplitudes."""
    centre = values.mean(axis=1)
    log_gap, at_knots = np.log(nominal.gap_rad)[:, None], np.log(knots_rpm)
    at_nominal = _interpolate(at_knots, centre[:, 0], np.hstack([log_gap, centre[:, 1:]]))
    _, frequency, decay = at_nominal.T
    gap, by_frequency, by_decay = by_gap = np.empty((3, len(departures), knots_rpm.size))
    for i, departure in enumerate(departures):
        drawn = centre + departure
        order = np.maximum.accumulate(drawn[:, 0] + 1e-9 * np.arange(len(drawn)))
        interpolated = _interpolate(at_knots, order, np.hstack([log_gap, drawn[:, 1:]]))
        by_gap[:, i] = (interpolated - at_nominal).T
    scatter = _scatter(nominal, values, knots_rpm)
    return gap, Ringing(frequency, decay, by_frequency, by_decay, scatter)


def _interpolate(x: FloatArray, known: FloatArray, values: FloatArray) -> FloatArray:
    """Interpolate columns (n, k) linearly at (m,); extrapolate by the slope of the outer tenth."""
    above = np.clip(np.searchsorted(known, x), 1, known.size - 1)
    outer = max(1, known.size // 10)
    first = np.where(x < known[0], 0, np.where(x > known[-1], known.size - 1 - outer, above - 1))
    last = np.where(x < known[0], outer, np.where(x > known[-1], known.size - 1, above))
    slope = (values[last] - values[first]) / (known[last] - known[first])[:, None]
    base = np.where(x > known[-1], last, first)
    return np.asarray(values[base] + slope * (x - known[base])[:, None])


def _scatter(nominal: SweepRow, values: FloatArray, knots_rpm: FloatArray) -> FloatArray:
    """Covariance of (A, ln ω, ln τ) over start angles at the knots, shape (k, 3, 3). Correlations
    are pooled over all gaps, standard deviations over neighbouring ones."""
    columns = np.stack([nominal.amplitude_rpm, values[:, :, 1], values[:, :, 2]], axis=-1)
    sds = np.stack([start_angle_scatter(columns[:, :, k]) for k in range(3)], axis=-1)
    mean = nominal.amplitude_rpm.mean(axis=1)
    at_knots = np.stack([np.interp(knots_rpm, mean, sds[:, k]) for k in range(3)], axis=-1)
    if values.shape[1] < 2:
        return np.zeros((knots_rpm.size, 3, 3))
    standard = (columns - columns.mean(axis=1, keepdims=True)) / sds[:, None, :]
    flat = standard.reshape(-1, 3)
    root = np.sqrt((flat**2).mean(axis=0))
    correlation = (flat.T @ flat) / len(flat) / np.outer(root, root)
    return np.asarray(at_knots[:, :, None] * at_knots[:, None, :] * correlation)


SIZES = np.geomspace(1e-5, 6e-3, 12)
"""Relative sizes; a lack of fit above 0.5 % calls for another degree, not a correction."""
LENGTHS = np.geomspace(0.15, 0.7, 5)
"""Lengths in ln A; longer ones would only compete with the polynomial."""
SMALLEST_SCATTER = 1e-5


@dataclass(frozen=True, slots=True)
class Regression:
    """Joint posterior of coefficients and lack of fit, at given knots.

    Attributes
    ----------
    coefficients
        Posterior mean of c_0 … c_degree, δ in rad and A in rpm, shape (k,).
    knots_rpm
        Shape (g,).
    lack_of_fit
        Posterior mean of g at the knots, relative, shape (g,).
    log_evidence
        Restricted log likelihood, for comparing degrees.
    """

    coefficients: FloatArray
    knots_rpm: FloatArray
    lack_of_fit: FloatArray
    log_evidence: float
    _coefficient_root: FloatArray
    _sensitivity: FloatArray
    _remaining_root: FloatArray

    @property
    def log_gap(self) -> FloatArray:
        """ln δ at the knots, polynomial and lack of fit together, shape (g,)."""
        value = polynomial.polyval(self.knots_rpm, self.coefficients)
        return np.asarray(np.log(value) - np.log1p(-self.lack_of_fit))

    def draws(self, count: int, generator: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Departures of ln δ at the knots, due to the coefficients and to the lack of fit, (count,
        g).

        The first includes the change of the lack of fit with the coefficients, as the sweep points
        demand.
        """
        k = self.coefficients.size
        shifts = generator.standard_normal((count, k)) @ self._coefficient_root.T
        powers = self.knots_rpm ** np.arange(k)[:, None]
        nominal = self.coefficients @ powers
        shifted = self.lack_of_fit + shifts @ self._sensitivity.T
        by_coefficients = np.log1p(shifts @ powers / nominal) - np.log(
            (1.0 - shifted) / (1.0 - self.lack_of_fit)
        )
        noise = generator.standard_normal((count, self.knots_rpm.size)) @ self._remaining_root.T
        by_lack_of_fit = -np.log1p(-noise / (1.0 - self.lack_of_fit))
        return by_coefficients, by_lack_of_fit


def regress(
    amplitude_rpm: FloatArray,
    gap_rad: FloatArray,
    relative_scatter: FloatArray,
    knots_rpm: FloatArray,
    degree: int,
) -> Regression:
    """Regress δ on A.

    Parameters
    ----------
    amplitude_rpm, gap_rad
        Sweep points, shape (n,).
    relative_scatter
        Standard deviation of ln δ from the scatter of A over start angles, shape (n,).

    Raises
    ------
    CurveError
        If there are too few different gaps for the degree.
    """
    if np.unique(gap_rad).size < degree + 3:
        raise CurveError(
            "The sweep has too few gaps for this degree.",
            where="[sweep] gap_rad.count",
            found=np.unique(gap_rad).size,
            expected=f"at least {degree + 3} for degree {degree}",
        )
    scale = float(np.exp(np.mean(np.log(amplitude_rpm))))
    columns = (amplitude_rpm[:, None] / scale) ** np.arange(degree + 1) / gap_rad[:, None]
    norms = np.linalg.norm(columns, axis=0)
    columns = columns / norms
    logs = np.log(amplitude_rpm)
    ones = np.ones(logs.size)
    variance = np.maximum(relative_scatter, SMALLEST_SCATTER) ** 2

    evidence, size, length = max(
        (_log_evidence(columns, ones, _kernel(logs, logs, s, h) + np.diag(variance)), s, h)
        for s in SIZES
        for h in LENGTHS
    )
    total = cho_factor(_kernel(logs, logs, size, length) + np.diag(variance), lower=True)
    weighted = cho_solve(total, columns)
    covariance = np.linalg.inv(columns.T @ weighted)
    scaled = covariance @ (weighted.T @ ones)
    cross_covariance = _kernel(np.log(knots_rpm), logs, size, length)
    kriging = cho_solve(total, cross_covariance.T).T
    remaining = (
        _kernel(np.log(knots_rpm), np.log(knots_rpm), size, length) - kriging @ cross_covariance.T
    )
    rescale = 1.0 / (norms * scale ** np.arange(degree + 1))
    coefficients = rescale * scaled
    return Regression(
        coefficients=coefficients,
        knots_rpm=knots_rpm,
        lack_of_fit=kriging @ (ones - columns @ scaled),
        log_evidence=float(evidence),
        _coefficient_root=rescale[:, None] * np.linalg.cholesky(covariance),
        _sensitivity=-(kriging @ columns) / rescale,
        _remaining_root=_root(remaining),
    )


def relative_fit(amplitude_rpm: FloatArray, gap_rad: FloatArray, degree: int) -> FloatArray:
    """Coefficients of plain relative least squares, without lack of fit, shape (degree + 1,)."""
    return np.asarray(polynomial.polyfit(amplitude_rpm, gap_rad, degree, w=1.0 / gap_rad))


def _kernel(x: FloatArray, y: FloatArray, size: float, length: float) -> FloatArray:
    return np.asarray(size**2 * np.exp(-0.5 * ((x[:, None] - y[None, :]) / length) ** 2))


def _log_evidence(columns: FloatArray, y: FloatArray, covariance: FloatArray) -> float:
    """Restricted log likelihood: coefficients integrated out under a flat prior."""
    factor = cho_factor(covariance, lower=True)
    weighted = cho_solve(factor, columns)
    gram = columns.T @ weighted
    scaled = np.linalg.solve(gram, weighted.T @ y)
    residual = y - columns @ scaled
    return float(
        -0.5 * residual @ cho_solve(factor, residual)
        - np.sum(np.log(np.diag(factor[0])))
        - 0.5 * np.linalg.slogdet(gram)[1]
        - 0.5 * (y.size - columns.shape[1]) * math.log(2.0 * math.pi)
    )


def _root(covariance: FloatArray) -> FloatArray:
    """Square root of a covariance that rounding may have left slightly indefinite."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
