"""How fast a joint wears, and when its gap reaches a limit: from joint draws of dated snapshots.

Since the last repair the gap follows a monotone path,

    δ(t) = δ(t₁) + X(t),    X a gamma process with mean Δ u(t) and variance σ² u(t),    Δ > 0,

whose mean u follows one of the laws of :mod:`bayesbl.measurement.wear_laws` and whose increments
are irregular by σ (van Noortwijk 2009). Law and σ are drawn by sequential Monte Carlo (Del Moral,
Doucet and Jasra 2006) from their marginal likelihood: δ(t₁) and Δ have flat priors and are
integrated out; between snapshots the process is taken as normal with the same mean and covariance,
beyond the last it is the gamma process itself, with changes of the law that no snapshot can show.

The path is laid through *each joint draw* of the gaps, each with a law of its own. What the
snapshots share, the curve's coefficients and the bench, is thereby one draw for all of them; a
factor that they share makes another path of the same law. Weights come from what they do not
share.

Wear does not heal: paths that fall are left out. Rate and date must therefore never be read as a
sign of wear; that is what :func:`trend` is for, which may have either sign.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gdtrib, ndtr, ndtri

from bayesbl.measurement.wear_laws import NORMALS, Laws
from bayesbl.probabilities import normal_sf
from bayesbl.recording.types import FloatArray

FEWEST_FOR_SCATTER = 4
"""Snapshots from which on irregular wear can be told from errors of measuring."""

LEAST_SHARE_GROWING = 0.01
"""Share of draws that grow below which the gap has shrunk, which wear cannot do."""

FALSE_ALARM = 0.01
"""How often gaps that never fell are said to have fallen between two dates."""

LONGEST_YEARS = 1000.0
"""Times to the limit are cut here: a rate near 0 makes them as long as one likes."""

SCATTER = (0.001, 0.8)
"""Range of the log-uniform prior of σ, in multiples of the growth over the span."""

PARTICLES = 2048
LEAST_EFFECTIVE = 0.5
"""Share of particles that a step of tempering leaves effective."""

MOVES = 4
"""Metropolis steps of every particle after each step of tempering."""

_SMOOTH = 1e4
"""More jumps than this between the gap and its limit are as good as none."""


@dataclass(frozen=True, slots=True)
class Wear:
    """Wear of one joint since its last repair; arrays have the shape (chain, draw) of the gaps.

    Attributes
    ----------
    law
        Number of its kind at the last snapshot in :data:`bayesbl.measurement.wear_laws.KINDS`.
    law_shape
        :attr:`bayesbl.measurement.wear_laws.Laws.rows`, (law_parameter, chain, draw).
    first_rad, current_rad
        Gap at the first and at the last snapshot, given all of them.
    expected_growth_rad
        Δ, the mean growth over the span by the law.
    rate_now_rad_per_year
        Mean rate by the law at the last snapshot.
    scatter_rad_per_root_year
        σ over the root of the span.
    years_to_limit
        From the last snapshot until δ first reaches the limit, 0 where it has, at most
        ``LONGEST_YEARS``; ``None`` without a limit.
    changes_ahead
        1 where wear changes between the last snapshot and the limit, which nothing measured can
        show; ``None`` without a limit.
    width_over_prior
        Width of the 90 % interval of ln years_to_limit over that with the same gap and mean rate
        but laws as believed beforehand; ``None`` where hardly a draw has the limit ahead.
    """

    law: NDArray[np.int_]
    law_shape: FloatArray
    first_rad: FloatArray
    current_rad: FloatArray
    expected_growth_rad: FloatArray
    rate_now_rad_per_year: FloatArray
    scatter_rad_per_root_year: FloatArray
    years_to_limit: FloatArray | None
    changes_ahead: FloatArray | None
    width_over_prior: float | None


@dataclass(frozen=True, slots=True)
class Fall:
    """The surest fall of the gap from one snapshot to the next, which wear rules out.

    Attributes
    ----------
    snapshot
        Number of the snapshot that lies below the one before it.
    fall_rad, standard_deviations
        By how much, also in units of its uncertainty; 0 or less where no gap falls.
    probability
        That errors of measuring make a fall as sure as this somewhere, at most (Bonferroni).
    """

    snapshot: int
    fall_rad: float
    standard_deviations: float
    probability: float

    @property
    def is_fall(self) -> bool:
        """Whether measuring does not explain it; wrongly claimed with ``FALSE_ALARM`` at most."""
        return self.probability < FALSE_ALARM


def fall(delta_rad: FloatArray) -> Fall:
    """Whether the gap fell between neighbouring snapshots, from their joint draws.

    What snapshots share falls nowhere: the draws of the difference are paired.
    """
    falls = -np.diff(delta_rad.reshape(len(delta_rad), -1), axis=0)
    middle, spread = falls.mean(axis=1), falls.std(axis=1)
    deviations = middle / np.maximum(spread, 1e-12 * np.abs(delta_rad).max())
    surest = int(np.argmax(deviations))
    found = float(deviations[surest])
    probability = min(1.0, len(falls) * normal_sf(found))
    return Fall(surest + 1, float(middle[surest]), found, probability)


def since_repair(repaired: Sequence[bool]) -> slice:
    """The snapshots from the last that was the first after a repair, or all of them."""
    starts = [number for number, flag in enumerate(repaired) if flag]
    return slice(starts[-1] if starts else 0, len(repaired))


def trend(delta_rad: FloatArray, years: FloatArray) -> FloatArray:
    """Slope of the straight line through each joint draw, of either sign, rad/year.

    Whatever the law, its sign is that of the wear. Parameters as :func:`wear` takes them.
    """
    gaps = delta_rad.reshape(len(years), -1)
    elapsed = np.broadcast_to(years[:, None] - years[0], gaps.shape)
    line, _ = _fit(gaps, elapsed, own_variance(gaps), np.zeros(gaps.shape[1]))
    return np.asarray(line[1].reshape(delta_rad.shape[1:]))


def wear(
    delta_rad: FloatArray,
    years: FloatArray,
    seed: np.random.SeedSequence,
    *,
    limit_rad: float | None = None,
    age_years: float | None = None,
) -> Wear | None:
    """Law, rate, present gap and time to the limit from snapshots without a repair between them.

    ``None`` where less than ``LEAST_SHARE_GROWING`` of the draws grow: the gap shrank.

    Parameters
    ----------
    delta_rad
        Draws of the gaps, paired by draw, shape (snapshot, chain, draw), two snapshots or more.
    years
        When each was taken, from any origin, shape (snapshot,), ascending, not all the same.
    age_years
        How long the joint had worn at the first snapshot; ``None`` where nobody knows.

    Raises
    ------
    ValueError
        Where the times give no rate.
    """
    span = float(years[-1] - years[0])
    if len(years) < 2 or span <= 0.0 or np.any(np.diff(years) < 0.0):
        raise ValueError("a rate needs ascending times of two snapshots or more")
    generator = np.random.default_rng(seed)
    gaps = delta_rad.reshape(len(years), -1)
    problem = _Problem.of(gaps, (years - years[0]) / span, age_years and age_years / span)
    normal = _tempered(problem, generator)
    count = gaps.shape[1]
    normal = normal[:, generator.permutation(np.arange(count) % PARTICLES)]
    elapsed, scatter = problem.growth(normal), problem.scatter(normal)
    steps = np.sqrt(np.diff(elapsed, axis=0, prepend=0.0))
    path = scatter * np.cumsum(steps * generator.standard_normal(gaps.shape), axis=0)
    # Matheron's rule: the line through what a drawn path leaves of a draw is a draw of the line.
    (first, growth), _ = _fit(gaps - path, elapsed, problem.own, scatter**2)
    current = first + growth + path[-1]
    grows = np.flatnonzero((growth > scatter / SCATTER[1]) & (current > first))
    if grows.size < LEAST_SHARE_GROWING * count:
        return None
    # Every draw that falls gives its place to one that grows.
    place = np.arange(count)
    place[np.setdiff1d(place, grows)] = generator.choice(grows, count - grows.size)
    laws = problem.laws(normal[:, place]).and_ahead(generator)
    first, growth, current, scatter = (x[place] for x in (first, growth, current, scatter))
    years_to_limit, changes_ahead, width = None, None, None
    if limit_rad is not None:
        needed = _growth_needed(limit_rad - current, scatter**2 / growth, generator)
        believed = problem.laws(generator.standard_normal(normal.shape)).and_ahead(generator)
        longest = 1.0 + LONGEST_YEARS / span
        spans, prior = (x.time_of(1.0 + needed / growth, longest) for x in (laws, believed))
        is_ahead = needed > 0.0
        years_to_limit = np.where(is_ahead, span * (spans - 1.0), 0.0)
        changes_ahead = np.where(is_ahead & laws.changes_before(spans), 1.0, 0.0)
        if is_ahead.mean() > LEAST_SHARE_GROWING:
            width = _log_width(spans[is_ahead] - 1.0) / _log_width(prior[is_ahead] - 1.0)
    before = np.full(count, 1.0 - 1e-3)
    rate = growth * (1.0 - laws.grown(before)) / (1e-3 * span)
    dims = delta_rad.shape[1:]
    return Wear(
        laws.kind().reshape(dims),
        laws.rows.reshape(-1, *dims),
        first.reshape(dims),
        current.reshape(dims),
        growth.reshape(dims),
        rate.reshape(dims),
        (scatter / np.sqrt(span)).reshape(dims),
        None if years_to_limit is None else years_to_limit.reshape(dims),
        None if changes_ahead is None else changes_ahead.reshape(dims),
        width,
    )


def _log_width(times: FloatArray) -> float:
    low, high = np.quantile(np.log(np.maximum(times, 1e-12)), [0.05, 0.95])
    return max(float(high - low), 1e-12)


def own_variance(gaps: FloatArray) -> FloatArray:
    """Variance of each gap that it does not share with the others, shape (snapshot,), rad²."""
    middle = gaps.mean(axis=1)
    relative = np.cov(gaps / middle[:, None])
    variance = np.diag(relative)
    shared = (relative.sum() - variance.sum()) / (relative.size - variance.size)
    # A floor: gaps that share all but rounding must not be taken for exact.
    return np.asarray(np.maximum(variance - shared, 1e-4 * variance + 1e-18) * middle**2)


@dataclass(frozen=True, slots=True)
class _Problem:
    """What is measured, in spans of time: means and own variances of the gaps, (snapshot,)."""

    middle: FloatArray
    own: FloatArray
    elapsed: FloatArray
    scale_rad: float
    age: float | None

    @classmethod
    def of(cls, gaps: FloatArray, elapsed: FloatArray, age: float | None) -> _Problem:
        own = own_variance(gaps)
        slope = trend(gaps[:, None, :], elapsed)
        scale = max(float(slope.mean()), float(slope.std()))
        return cls(gaps.mean(axis=1), own, elapsed, scale, age)

    def laws(self, normal: FloatArray) -> Laws:
        return Laws.until_now(normal[:NORMALS], self.age)

    def scatter(self, normal: FloatArray) -> FloatArray:
        low, high = SCATTER
        return np.asarray(self.scale_rad * low * (high / low) ** ndtr(normal[NORMALS]))

    def growth(self, normal: FloatArray) -> FloatArray:
        """u at each snapshot, shape (snapshot, particle)."""
        return self.laws(normal).grown(self.elapsed[:, None])

    def log_likelihood(self, normal: FloatArray) -> FloatArray:
        growth, variance = self.growth(normal), self.scatter(normal) ** 2
        middle = np.broadcast_to(self.middle[:, None], growth.shape)
        return _fit(middle, growth, self.own, variance)[1]


def _fit(
    gaps: FloatArray, growth: FloatArray, own: FloatArray, variance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """δ(t₁) and Δ by generalised least squares, (2, particle), and ln of the restricted likelihood.

    Of gaps = δ(t₁) + Δ u + W + errors, W a normal walk of variance ``variance`` u, all but ``own``
    of shape (snapshot, particle) or (particle,). A Kalman filter takes the walk out, one snapshot
    after the other, so that n of them cost n.
    """
    columns = np.stack([np.ones(gaps.shape), growth, gaps - gaps[0]])
    state, uncertain = np.zeros((3, gaps.shape[1])), np.zeros(gaps.shape[1])
    products, log_determinant = np.zeros((3, 3, gaps.shape[1])), 0.0
    before = np.zeros(gaps.shape[1])
    for number, noise in enumerate(own):
        uncertain = uncertain + variance * (growth[number] - before)
        before = growth[number]
        total = uncertain + noise
        left = columns[:, number] - state
        products += left[:, None] * left[None] / total
        log_determinant = log_determinant + np.log(total)
        gain = uncertain / total
        state, uncertain = state + gain * left, uncertain * (1.0 - gain)
    (a, b, e), (_, c, f), (_, _, squares) = products
    determinant = a * c - b * b
    line = np.stack([c * e - b * f, a * f - b * e]) / determinant
    misfit = squares - line[0] * e - line[1] * f
    log_likelihood = -0.5 * (log_determinant + np.log(determinant) + misfit)
    line[0] += gaps[0]
    return line, log_likelihood


def _tempered(problem: _Problem, generator: np.random.Generator) -> FloatArray:
    """Standard normal numbers of equally likely laws and scatters, by tempering the likelihood."""
    from scipy.stats import qmc

    uniform = qmc.Sobol(NORMALS + 1, rng=generator).random(PARTICLES)
    normal = ndtri(np.clip(uniform.T, 1e-9, 1.0 - 1e-9))
    likely, done = problem.log_likelihood(normal), 0.0
    while done < 1.0:
        step = _step(likely, 1.0 - done)
        done += step
        weight = np.exp(step * (likely - likely.max()))
        ladder = (np.arange(PARTICLES) + generator.uniform()) / PARTICLES
        chosen = np.searchsorted(np.cumsum(weight / weight.sum()), ladder)
        chosen = generator.permutation(np.minimum(chosen, PARTICLES - 1))
        normal, likely = normal[:, chosen], likely[chosen]
        for _ in range(MOVES):
            # Along the difference of two others, in some of the numbers (ter Braak 2006).
            others = normal[:, generator.permutation(PARTICLES)]
            apart = normal[:, generator.permutation(PARTICLES)] - others
            size = generator.choice([0.1, 0.4, 0.8], PARTICLES)
            touched = generator.uniform(size=normal.shape) < generator.choice(
                [0.2, 0.5, 1.0], PARTICLES
            )
            noise = 0.01 * generator.standard_normal(normal.shape)
            moved = normal + np.where(touched, size * apart, 0.0) + noise
            found = problem.log_likelihood(moved)
            gain = done * (found - likely) - 0.5 * np.sum(moved**2 - normal**2, axis=0)
            taken = np.log(generator.uniform(size=PARTICLES)) < gain
            normal = np.where(taken, moved, normal)
            likely = np.where(taken, found, likely)
    return np.asarray(normal)


def _step(likely: FloatArray, most: float) -> float:
    """How far to temper so that ``LEAST_EFFECTIVE`` of the particles stay effective."""

    def effective(step: float) -> float:
        weight = np.exp(step * (likely - likely.max()))
        return float(weight.sum() ** 2 / np.sum(weight**2)) / likely.size

    if effective(most) >= LEAST_EFFECTIVE:
        return most
    low, high = 0.0, most
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if effective(middle) >= LEAST_EFFECTIVE else (low, middle)
    return high


def _growth_needed(
    distance: FloatArray, jump: FloatArray, generator: np.random.Generator
) -> FloatArray:
    """Mean growth until a gamma process first covers a distance, 0 where it is behind.

    A mean growth of m is a gamma distribution of shape m / jump and scale ``jump``: the shape at
    which a uniform share of it lies below the distance.
    """
    ahead = np.maximum(distance, 0.0)
    jumps = np.clip(ahead / jump, 1e-12, _SMOOTH)
    shape = gdtrib(1.0, generator.uniform(size=jumps.size), jumps)
    return np.where(jumps < _SMOOTH, shape * jump, ahead) * (distance > 0.0)


def probability_before(years_to_limit: FloatArray, years: float) -> float:
    """Probability that the limit is reached within ``years`` of the last snapshot."""
    return float(np.mean(years_to_limit <= years))
