"""How fast a joint wears, and when its gap reaches a limit: from joint draws of dated snapshots.

Since the last repair the gap grows as a straight line in time,

    δ(t) = δ(t₁) + r (t − t₁) + σ B(t − t₁),    r ≥ 0,

where B is Brownian motion: wear that is irregular beyond what measuring scatters (the Wiener
process with drift of degradation analysis, Whitmore and Schenkelberg 1997). Fewer than
``FEWEST_FOR_SCATTER`` snapshots cannot tell σ from measuring; it is then taken as 0.

The line is laid through *each joint draw* of the gaps. What the snapshots share, the curve's
coefficients and the bench, is thereby one draw for all of them; a factor that they share makes
another line of a line. Weights come from what they do not share.

Wear does not heal: draws with r < 0 are left out of rate, gap and time to the limit
(:attr:`Wear.heals`). They are counted first: :attr:`Wear.probability_wear` stays near one half, and
exceeds 0.95 in one of twenty cases, where nothing wears. Rate and time must therefore never be
read as a sign of wear: without any, the rate is still reported above 0, at about 0.8 of its
standard deviation, and the time to the limit is too short rather than too long.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from bayesbl.recording.types import FloatArray

FEWEST_FOR_SCATTER = 4
LEAST_SHARE_GROWING = 0.01
"""Share of draws with r ≥ 0 below which the gap has shrunk, which wear cannot do."""

FEWEST_FOR_LINE = 3
"""Snapshots from which on a straight line can fail to fit."""

FALSE_ALARM = 0.01
"""How often gaps that do lie on a line are said not to."""

LONGEST_YEARS = 1000.0
"""Times to the limit are cut here: a rate near 0 makes them as long as one likes."""

_GRID = 400


@dataclass(frozen=True, slots=True)
class Wear:
    """Wear of one joint since its last repair; arrays have the shape (chain, draw) of the gaps.

    Attributes
    ----------
    rate_rad_per_year
        r, of either sign.
    current_rad
        Gap at the last snapshot, given all snapshots since the repair.
    scatter_rad_per_root_year
        σ; zero where there are too few snapshots to tell it.
    years_to_limit
        From the last snapshot until δ first reaches the limit, 0 where it has, at most
        ``LONGEST_YEARS``; ``None`` without a limit. NaN where the draw heals.
    """

    rate_rad_per_year: FloatArray
    current_rad: FloatArray
    scatter_rad_per_root_year: FloatArray
    years_to_limit: FloatArray | None

    @property
    def heals(self) -> NDArray[np.bool_]:
        """Draws that wear rules out."""
        return np.asarray(self.rate_rad_per_year < 0.0)

    @property
    def probability_wear(self) -> float:
        """Share of draws in which the gap grows, before healing is ruled out."""
        return float(np.mean(self.rate_rad_per_year > 0.0))


@dataclass(frozen=True, slots=True)
class Straightness:
    """How well one straight line in time fits the gaps.

    Attributes
    ----------
    probability
        Of residuals as large as these where the gaps do lie on a line.
    snapshot
        Number of the snapshot that is farthest off the line through all others, counted in
        standard deviations; the middle one of three, which are all off by the same.
    excess_rad
        Its gap less that of the line through the others.
    standard_deviations
        The same over its uncertainty, both gap's and line's.
    """

    probability: float
    snapshot: int
    excess_rad: float
    standard_deviations: float

    @property
    def is_straight(self) -> bool:
        """Whether measuring explains the residuals; wrongly denied with ``FALSE_ALARM``."""
        return self.probability >= FALSE_ALARM


def straightness(delta_rad: FloatArray, years: FloatArray) -> Straightness | None:
    """χ² of the residuals from the line of generalised least squares through the gaps' means.

    Under the joint covariance of the draws: a factor that all snapshots share bends no line. The
    snapshot named is off the line through the others by (Q m)_i / Q_ii ± Q_ii^(−1/2), with Q the
    inverse covariance less what the line takes of it.

    Parameters
    ----------
    delta_rad, years
        As :func:`wear` takes them.

    Returns
    -------
    ``None`` for fewer than ``FEWEST_FOR_LINE`` snapshots, or where these have no more than two
    different dates.
    """
    count = len(years)
    if count < FEWEST_FOR_LINE or np.unique(years).size < FEWEST_FOR_LINE:
        return None
    gaps = delta_rad.reshape(count, -1)
    middle, design = gaps.mean(axis=1), _design((years - years[0]) / (years[-1] - years[0]))
    covariance = np.cov(gaps)
    # A floor: gaps that share all but rounding must not be taken for exact.
    weights = np.linalg.inv(covariance + 1e-9 * np.diag(np.diag(covariance)))
    line = weights @ design
    left = weights - line @ np.linalg.solve(design.T @ line, line.T)
    pull, stiffness = left @ middle, np.diag(left)
    deviations = pull / np.sqrt(stiffness)
    farthest = 1 if count == FEWEST_FOR_LINE else int(np.argmax(np.abs(deviations)))
    return Straightness(
        float(chi2.sf(middle @ pull, count - 2)),
        farthest,
        float(pull[farthest] / stiffness[farthest]),
        float(abs(deviations[farthest])),
    )


def since_repair(repaired: Sequence[bool]) -> slice:
    """The snapshots from the last that was the first after a repair, or all of them."""
    starts = [number for number, flag in enumerate(repaired) if flag]
    return slice(starts[-1] if starts else 0, len(repaired))


def wear(
    delta_rad: FloatArray,
    years: FloatArray,
    seed: np.random.SeedSequence,
    *,
    limit_rad: float | None = None,
) -> Wear:
    """Rate, present gap and time to the limit from snapshots without a repair between them.

    Parameters
    ----------
    delta_rad
        Draws of the gaps, paired by draw, shape (snapshot, chain, draw), two snapshots or more.
    years
        When each was taken, from any origin, shape (snapshot,), ascending, not all the same.
    """
    span = float(years[-1] - years[0])
    if len(years) < 2 or span <= 0.0 or np.any(np.diff(years) < 0.0):
        raise ValueError("a rate needs ascending times of two snapshots or more")
    generator = np.random.default_rng(seed)
    count, shape = len(years), delta_rad.shape[1:]
    gaps = delta_rad.reshape(count, -1)
    elapsed = (years - years[0]) / span
    own = _own_variance(gaps)
    scatter = np.zeros(gaps.shape[1])
    if count >= FEWEST_FOR_SCATTER:
        scatter = _scatter_draws(gaps.mean(axis=1), own, elapsed, gaps.shape[1], generator)
    rate, current = _lines(gaps, own, elapsed, scatter, generator)
    to_limit = None
    if limit_rad is not None:
        spans = _first_passage(limit_rad - current, rate, scatter, generator)
        to_limit = np.minimum(span * spans, LONGEST_YEARS).reshape(shape)
    return Wear(
        (rate / span).reshape(shape),
        current.reshape(shape),
        (scatter / np.sqrt(span)).reshape(shape),
        to_limit,
    )


def probability_before(years_to_limit: FloatArray, years: float) -> float:
    """Probability that the limit is reached within ``years`` of the last snapshot."""
    known = years_to_limit[np.isfinite(years_to_limit)]
    return float(np.mean(known <= years))


def _own_variance(gaps: FloatArray) -> FloatArray:
    """Variance of each gap that it does not share with the others, shape (snapshot,), rad²."""
    middle = gaps.mean(axis=1)
    relative = np.cov(gaps / middle[:, None])
    variance = np.diag(relative)
    shared = (relative.sum() - variance.sum()) / (relative.size - variance.size)
    # A floor: gaps that share all but rounding must not be taken for exact.
    return np.asarray(np.maximum(variance - shared, 1e-4 * variance + 1e-18) * middle**2)


def _walk(elapsed: FloatArray) -> FloatArray:
    """Covariance of Brownian motion from the first snapshot on, shape (snapshot, snapshot)."""
    return np.minimum.outer(elapsed, elapsed)


def _design(elapsed: FloatArray) -> FloatArray:
    """Columns of the line: gap at the first snapshot, growth over the span."""
    return np.column_stack([np.ones(elapsed.size), elapsed])


def _scatter_draws(
    middle: FloatArray,
    own: FloatArray,
    elapsed: FloatArray,
    count: int,
    generator: np.random.Generator,
) -> FloatArray:
    """Draws of σ over the span from its marginal likelihood, the line integrated out.

    The prior is half-Cauchy, its scale the typical scatter of measuring: it favours no scatter,
    and gives way to scatter of any size that the snapshots show.
    """
    scale = float(np.sqrt(own.mean()))
    edges = np.r_[0.0, np.geomspace(0.03 * scale, 10.0 * max(scale, np.ptp(middle)), _GRID)]
    grid = np.r_[0.0, np.sqrt(edges[1:-1] * edges[2:])]
    prior = np.diff(np.arctan(edges / scale))
    covariances = np.diag(own) + grid[:, None, None] ** 2 * _walk(elapsed)
    logs = _log_marginal(middle, covariances, _design(elapsed))
    weights = prior * np.exp(logs - logs.max())
    picked = generator.choice(_GRID, count, p=weights / weights.sum())
    return np.asarray(grid[picked])


def _log_marginal(middle: FloatArray, covariances: FloatArray, design: FloatArray) -> FloatArray:
    """ln of the restricted likelihood (flat prior on the line) of each covariance, less a constant.

    ``covariances`` has the shape (grid, snapshot, snapshot), the result (grid,).
    """
    inverses = np.linalg.inv(covariances)
    information = design.T @ inverses @ design
    lines = np.linalg.solve(information, (design.T @ inverses @ middle)[..., None])
    residuals = middle - (design @ lines)[..., 0]
    squares = np.einsum("gi,gij,gj->g", residuals, inverses, residuals)
    determinants = np.linalg.slogdet(covariances)[1] + np.linalg.slogdet(information)[1]
    return np.asarray(-0.5 * (determinants + squares))


def _lines(
    gaps: FloatArray,
    own: FloatArray,
    elapsed: FloatArray,
    scatter: FloatArray,
    generator: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Growth over the span, and the gap at the last snapshot, of every draw.

    Matheron's rule: a path of the walk is drawn, and the line laid by generalised least squares
    through what it leaves of the draw. For gaps that are normal this is the exact posterior of
    line and last gap: the rule's correction of the path is 0 there, since the walk's covariance
    with its last point grows as the line does.
    """
    design, walk = _design(elapsed), _walk(elapsed)
    steps = np.sqrt(np.diff(elapsed, prepend=0.0))[:, None]
    path = np.cumsum(steps * generator.standard_normal(gaps.shape), axis=0)
    rate, current = np.empty(gaps.shape[1]), np.empty(gaps.shape[1])
    for sigma in np.unique(scatter):
        chosen = np.flatnonzero(scatter == sigma)
        inverse = np.linalg.inv(np.diag(own) + sigma**2 * walk)
        left = gaps[:, chosen] - sigma * path[:, chosen]
        line = np.linalg.solve(design.T @ inverse @ design, design.T @ inverse @ left)
        rate[chosen] = line[1]
        current[chosen] = line.sum(axis=0) + sigma * path[-1, chosen]
    return rate, current


def _first_passage(
    distance: FloatArray, rate: FloatArray, scatter: FloatArray, generator: np.random.Generator
) -> FloatArray:
    """Time until a walk with drift first covers a distance; NaN for a negative drift.

    Inverse Gaussian with mean distance / rate, drawn as Michael, Schucany and Haas (1976) do, in
    a form that does not cancel where the drift is weak.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        mean = np.where(rate > 0.0, distance / rate, np.inf)
        spread = scatter**2 / (distance * rate)
        y = 0.5 * spread * generator.standard_normal(rate.size) ** 2
        ratio = 1.0 + y + np.sqrt(y * (2.0 + y))
        early = generator.uniform(size=rate.size) * (1.0 + 1.0 / ratio) <= 1.0
        time = np.where(scatter > 0.0, np.where(early, mean / ratio, mean * ratio), mean)
    time = np.where(np.isnan(time), np.inf, time)
    time = np.where(distance <= 0.0, 0.0, time)
    return np.where(rate < 0.0, np.nan, time)
