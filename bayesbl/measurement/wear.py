"""How fast a joint wears, and when its gap reaches a limit, from joint draws of dated snapshots.

Path, laws and priors are those of ``docs/design.md``, "Change and wear". Time is measured in spans,
from 0 at the first snapshot in use to 1 at the last, so no law has a unit of time. The growth since
the first snapshot is a multiple of the growth over the span.

Law and scatter are drawn by sequential Monte Carlo (Del Moral, Doucet and Jasra 2006) from their
marginal likelihood, with δ(t₁) and Δ integrated out under flat priors. Between snapshots, the gamma
process is approximated by a normal one of the same mean and covariance. Beyond the last snapshot it
is the gamma process itself, with changes of the law that no snapshot can show.

A path is fitted to *each joint draw* of the gaps, with a law of its own. An error that the
snapshots share, of curve or bench, is thereby one draw for all of them, and a shared factor gives
another path of the same law. The errors that they do not share determine the weights.

Wear does not heal, so falling paths are dropped. Rate and date must therefore never be read as a
sign of wear. Use :func:`trend` for that, which may have either sign.

**Stored.** :data:`DATES` and, if there is a rate, :data:`WEAR` as one group of ``result.nc``.
Attributes: ``decide_before`` if requested, ``relative_sd_per_date`` with ``drift_widens`` if the
gaps drift, ``width_over_prior`` of the date. The keys of the summary are those of
:class:`bayesbl.measurement.summary_types.WearSummary`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from datetime import date as Date
from datetime import timedelta
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.optimize import bisect
from scipy.special import gdtrib, ndtr, ndtri

from bayesbl.config.measurement import CompareConfig
from bayesbl.config.sections import Interval as IntervalConfig
from bayesbl.measurement.compatibility import limit_rad_of
from bayesbl.measurement.measurement import Answer, Reason
from bayesbl.measurement.summary_types import WearSummary
from bayesbl.probabilities import FALSE_ALARM, TOO_FEW, ends, normal_sf
from bayesbl.recording.types import FloatArray
from bayesbl.results.store import interval
from bayesbl.results.variables import Group, dataset, table

HAZARD = 1.5
"""Expected changes of regime per e-fold of the age."""

EXPONENT = (1.8, 1.0)
FACTOR = (1.3, 1.3)
AGE = (0.03, 10.0)

CHANGES, AHEAD = 2, 4
"""Largest number of changes between the snapshots, and after them."""

NORMALS = 2 + 3 * CHANGES
"""Standard normal numbers that define one law: age, exponents, changes and their factors."""

_LARGEST_EXPONENT = 300.0
"""Exponents beyond this count as infinite; above 700 the exponential overflows."""


@dataclass(frozen=True, slots=True)
class Kind:
    """A range of exponents of the regime at the last snapshot, and its prior probability."""

    law: str
    exponents: tuple[float, float]

    @property
    def probability(self) -> float:
        median, deviation = EXPONENT
        low, high = (np.log(np.asarray(end) / median) / deviation for end in self.exponents)
        return float(ndtr(high) - ndtr(low))


KINDS = (
    Kind("slowing", (1e-9, 0.85)),
    Kind("steady", (0.85, 1.18)),
    Kind("speeding_up", (1.18, 2.0)),
    Kind("speeding_up", (2.0, 3.5)),
    Kind("speeding_up", (3.5, 1e9)),
)
"""Kinds of wear. They mean the same for every joint, so that joints may share them."""


def shares(kind: NDArray[np.int_] | FloatArray) -> dict[str, float]:
    """Share of each law among draws of the kind."""
    counted = np.bincount(kind.astype(int).ravel(), minlength=len(KINDS)) / kind.size
    return by_law(counted)


def by_law(share: FloatArray) -> dict[str, float]:
    """Sum the shares of kinds over those of one law."""
    total = dict.fromkeys((kind.law for kind in KINDS), 0.0)
    for kind, kind_share in zip(KINDS, share, strict=True):
        total[kind.law] += float(kind_share)
    return total


@dataclass(frozen=True, slots=True)
class Laws:
    """Laws of wear, one per particle, in regimes from the first snapshot on.

    ``rows``: shape (1 + 3 regimes, particle): the age at the first snapshot in spans; for each
    regime ln(age at its start / age at the first snapshot), ascending, the first 0; the exponent of
    each; the factor by which the rate changes at the start of each.
    """

    rows: FloatArray

    @classmethod
    def until_now(cls, normal: FloatArray, age: float | None = None) -> Laws:
        """Laws up to the last snapshot, from standard normal numbers of shape (``NORMALS``,
        particle).

        Changes are counted back from the last snapshot. They come at random, so this is equivalent
        to counting from the first, and the latest ones matter most. ``age`` is the age at the first
        snapshot, if known.
        """
        exponents, waits, factors = np.split(normal[1:], [CHANGES + 1, 2 * CHANGES + 1])
        low, high = AGE
        ages = low * (high / low) ** ndtr(normal[:1])
        if age is not None:
            ages = np.full(ages.shape, max(age, 1e-3))
        log_start = np.log1p(1.0 / ages) - np.cumsum(_waits(waits), axis=0)[::-1]
        start, factor = np.maximum(log_start, 0.0), _log_normal(FACTOR, factors)
        first = np.zeros(ages.shape)
        exponent = _log_normal(EXPONENT, exponents)
        return cls(np.concatenate([ages, first, start, exponent, first + 1.0, factor]))

    def and_ahead(self, generator: np.random.Generator) -> Laws:
        """Add changes after the last snapshot, drawn from the prior."""
        count = self.rows.shape[1]
        waits, exponents, factors = generator.standard_normal((3, AHEAD, count))
        start = self._log_age(1.0) + np.cumsum(_waits(waits), axis=0)
        ahead = [start, _log_normal(EXPONENT, exponents), _log_normal(FACTOR, factors)]
        parts = np.concatenate([self._parts(), np.stack(ahead)], axis=1)
        return Laws(np.concatenate([self.rows[:1], parts.reshape(-1, count)]))

    def _parts(self) -> FloatArray:
        """Starts, exponents and factors, shape (3, regime, particle)."""
        return self.rows[1:].reshape(3, -1, self.rows.shape[1])

    def _log_age(self, elapsed: FloatArray | float) -> FloatArray:
        """ln(age / age at the first snapshot), ``elapsed`` spans after that snapshot."""
        return np.asarray(np.log1p(np.asarray(elapsed) / self.rows[0]))

    def grown(self, elapsed: FloatArray) -> FloatArray:
        """Growth as a multiple of that over the span; ``elapsed`` has shape (…, particle)."""
        return self._grown(elapsed) / self._grown(np.ones(self.rows.shape[1]))

    def _grown(self, elapsed: FloatArray) -> FloatArray:
        log_age = self._log_age(elapsed)
        total = np.zeros(log_age.shape)
        for start, end, exponent, scale in self._regimes():
            within = np.clip(log_age, start, end) - start
            total += scale * np.expm1(_small(exponent * within))
        return total

    def _regimes(self) -> Iterator[tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
        """Start, end, exponent p, scale of regimes: growth = scale (e^(p (ln age − start)) − 1)."""
        starts, exponents, factors = self._parts()
        ends = np.concatenate([starts[1:], np.full((1, starts.shape[1]), np.inf)])
        log_rate = np.zeros(starts.shape[1])
        for start, end, exponent, factor in zip(starts, ends, exponents, factors, strict=True):
            log_rate = log_rate + np.log(factor)
            yield start, end, exponent, np.exp(_small(log_rate + start)) / exponent
            log_rate = log_rate + (exponent - 1.0) * (end - start)

    def kind(self) -> NDArray[np.int_]:
        """Index in :data:`KINDS` of the regime at the last snapshot, (particle,)."""
        bounds = [kind.exponents[1] for kind in KINDS[:-1]]
        return np.asarray(np.searchsorted(bounds, self._parts()[1, CHANGES]))

    def time_of(self, growth: FloatArray, longest: float) -> FloatArray:
        """Time in spans, up to ``longest``, at ``growth`` times the growth over the span."""
        remaining = growth * self._grown(np.ones(self.rows.shape[1]))
        log_age = np.zeros(growth.shape)
        for start, end, exponent, scale in self._regimes():
            regime_growth = scale * np.expm1(_small(exponent * (end - start)))
            within_regime = np.log1p(np.clip(remaining, 0.0, regime_growth) / scale) / exponent
            log_age = np.where(remaining > 0.0, start + within_regime, log_age)
            remaining = remaining - regime_growth
        return np.asarray(np.minimum(self.rows[0] * np.expm1(_small(log_age)), longest))

    def changes_before(self, elapsed: FloatArray) -> NDArray[np.bool_]:
        """Whether the law changes between the last snapshot and ``elapsed`` spans, (particle,)."""
        return np.asarray(self._parts()[0, CHANGES + 1] < self._log_age(elapsed))


def _waits(normal: FloatArray) -> FloatArray:
    """Exponentially distributed e-folds of the age between successive changes."""
    return np.asarray(-np.log(ndtr(normal)) / HAZARD)


def _log_normal(prior: tuple[float, float], normal: FloatArray) -> FloatArray:
    return np.asarray(prior[0] * np.exp(prior[1] * normal))


def _small(exponent: FloatArray) -> FloatArray:
    return np.minimum(exponent, _LARGEST_EXPONENT)


FEWEST_FOR_SCATTER = 4
"""Fewest snapshots that can distinguish irregular wear from measurement errors."""

LONGEST_YEARS = 1000.0
"""Longest time to the limit: with a rate near 0 it would have no bound."""

SCATTER = (0.001, 0.8)
"""Range of the log-uniform prior of σ, in multiples of the growth over the span."""

PARTICLES = 2048
LEAST_EFFECTIVE = 0.5
"""Share of particles that stay effective in a step of tempering."""

MOVES = 4
"""Metropolis steps of every particle after each step of tempering."""

_SMOOTH = 1e4
"""With more jumps than this between gap and limit, growth counts as smooth."""


WEAR = Group(
    "wear",
    table("""
        law (chain, draw) | 1 | kind of the law at the last snapshot, from 0
        law_shape (law_parameter, chain, draw) | 1 | age, starts, exponents, factors of the law
        first_rad (chain, draw) | rad | gap at the first snapshot in use, estimated from all
        current_rad (chain, draw) | rad | gap at the last snapshot, estimated from all
        expected_growth_rad (chain, draw) | rad | mean growth between them by the law
        rate_now_rad_per_year (chain, draw) | rad/year | rate at the last snapshot by the law
        scatter_rad_per_root_year (chain, draw) | rad/year^0.5 | irregular wear
        trend_rad_per_year (chain, draw) | rad/year | slope of a straight line, of either sign
        years_to_limit? (chain, draw) | year | time from the last snapshot to the limit
        changes_ahead? (chain, draw) | 1 | 1 where wear changes before the limit is reached
    """),
)
"""Wear of one joint since its last repair; chains and draws are those of the gaps.

``law`` is an index in :data:`KINDS`, ``law_shape`` is :attr:`Laws.rows`, ``expected_growth_rad`` is
Δ, and ``scatter_rad_per_root_year`` is σ over the root of the span. ``years_to_limit`` is 0 if δ is
beyond the limit, and at most ``LONGEST_YEARS``. It is present if there is a limit, as is
``changes_ahead``, which no measurement can show. The attribute ``width_over_prior`` is the width of
the 90 % interval of ln years_to_limit, over that with the same gap and mean rate but laws from the
prior. It is missing if hardly any draw has the limit ahead.
"""

DATES = Group(
    WEAR.name,
    table("""
        date (dated) | text | date of snapshot
        used (dated) | 1 | 1 where taken since the last repair
    """),
)
"""Variables of group :data:`WEAR` for dated snapshots, present with or without a rate."""


def fall(delta_rad: FloatArray) -> tuple[int, float, float] | None:
    """Find the most significant fall of the gap between successive snapshots, which wear rules out.

    Uses joint draws, (snapshot, chain, draw), rad, so that shared errors cause no fall.

    Returns the index of the snapshot below its predecessor, the fall in rad, and the fall in
    standard deviations. ``None`` if measurement errors cause a fall as significant as this
    somewhere with a probability of ``FALSE_ALARM`` or more (Bonferroni).
    """
    falls = -np.diff(delta_rad.reshape(len(delta_rad), -1), axis=0)
    mean, sd = falls.mean(axis=1), falls.std(axis=1)
    deviations = mean / np.maximum(sd, 1e-12 * np.abs(delta_rad).max())
    most_significant = int(np.argmax(deviations))
    deviation = float(deviations[most_significant])
    if len(falls) * normal_sf(deviation) >= FALSE_ALARM:
        return None
    return most_significant + 1, float(mean[most_significant]), deviation


def since_repair(repaired: Sequence[bool]) -> slice:
    """The snapshots since the last repair, or all if there was none."""
    starts = [number for number, flag in enumerate(repaired) if flag]
    return slice(starts[-1] if starts else 0, len(repaired))


def trend(delta_rad: FloatArray, years: FloatArray) -> FloatArray:
    """Slope of the straight line through each joint draw, of either sign, rad/year.

    Its sign is that of the wear under any law. Parameters as for :func:`wear`.
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
) -> xr.Dataset | None:
    """Law, rate, present gap and time to the limit, from snapshots without a repair between them.

    Returns group :data:`WEAR`, or ``None`` if less than ``TOO_FEW`` of the draws grow:
    the gap shrank.

    ``delta_rad``: draws of the gaps, paired by draw, shape (snapshot, chain, draw), two snapshots
    or more. ``years``: time of each snapshot, from any origin, shape (snapshot,), ascending, not
    all the same. ``age_years``: time in service at the first snapshot; ``None`` if unknown. Raises
    ValueError if the times give no rate.
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
    # Matheron's rule: a line fitted to (draw − drawn path) is a draw of the line.
    (first, growth), _ = _fit(gaps - path, elapsed, problem.own, scatter**2)
    current = first + growth + path[-1]
    grows = np.flatnonzero((growth > scatter / SCATTER[1]) & (current > first))
    if grows.size < TOO_FEW * count:
        return None
    # Replace every falling draw by a growing one.
    place = np.arange(count)
    place[np.setdiff1d(place, grows)] = generator.choice(grows, count - grows.size)
    laws = problem.laws(normal[:, place]).and_ahead(generator)
    first, growth, current, scatter = (x[place] for x in (first, growth, current, scatter))
    just_before = np.full(count, 1.0 - 1e-3)
    values = {
        "law": laws.kind(),
        "law_shape": laws.rows,
        "first_rad": first,
        "current_rad": current,
        "expected_growth_rad": growth,
        "rate_now_rad_per_year": growth * (1.0 - laws.grown(just_before)) / (1e-3 * span),
        "scatter_rad_per_root_year": scatter / np.sqrt(span),
    }
    attrs = {}
    if limit_rad is not None:
        needed = _growth_needed(limit_rad - current, scatter**2 / growth, generator)
        prior_laws = problem.laws(generator.standard_normal(normal.shape)).and_ahead(generator)
        longest = 1.0 + LONGEST_YEARS / span
        spans, prior_spans = (x.time_of(1.0 + needed / growth, longest) for x in (laws, prior_laws))
        is_ahead = needed > 0.0
        values["years_to_limit"] = np.where(is_ahead, span * (spans - 1.0), 0.0)
        values["changes_ahead"] = np.where(is_ahead & laws.changes_before(spans), 1.0, 0.0)
        if is_ahead.mean() > TOO_FEW:
            width = _log_width(spans[is_ahead] - 1.0) / _log_width(prior_spans[is_ahead] - 1.0)
            attrs["width_over_prior"] = width
    draws = delta_rad.shape[1:]
    values = {name: v.reshape(*v.shape[:-1], *draws) for name, v in values.items()}
    values["trend_rad_per_year"] = trend(delta_rad, years)
    return dataset(WEAR, values).assign_attrs(attrs)


def _log_width(times: FloatArray) -> float:
    return max(float(np.ptp(ends(np.log(np.maximum(times, 1e-12)), 0.9))), 1e-12)


def own_variance(gaps: FloatArray) -> FloatArray:
    """Variance of each gap that it does not share with the others, shape (snapshot,), rad²."""
    mean = gaps.mean(axis=1)
    relative = np.cov(gaps / mean[:, None])
    variance = np.diag(relative)
    shared = (relative.sum() - variance.sum()) / (relative.size - variance.size)
    # A floor: gaps that share all but rounding must not count as exact.
    return np.asarray(np.maximum(variance - shared, 1e-4 * variance + 1e-18) * mean**2)


@dataclass(frozen=True, slots=True)
class _Problem:
    """The measured gaps, time in spans: means and unshared variances, (snapshot,)."""

    middle: FloatArray
    own: FloatArray
    elapsed: FloatArray
    scale_rad: float
    age: float | None

    @classmethod
    def of(cls, gaps: FloatArray, elapsed: FloatArray, age: float | None) -> _Problem:
        own_variances = own_variance(gaps)
        slope = trend(gaps[:, None, :], elapsed)
        scale = max(float(slope.mean()), float(slope.std()))
        return cls(gaps.mean(axis=1), own_variances, elapsed, scale, age)

    def laws(self, normal: FloatArray) -> Laws:
        return Laws.until_now(normal[:NORMALS], self.age)

    def scatter(self, normal: FloatArray) -> FloatArray:
        low, high = SCATTER
        return np.asarray(self.scale_rad * low * (high / low) ** ndtr(normal[NORMALS]))

    def growth(self, normal: FloatArray) -> FloatArray:
        """Growth u at each snapshot, shape (snapshot, particle)."""
        return self.laws(normal).grown(self.elapsed[:, None])

    def log_likelihood(self, normal: FloatArray) -> FloatArray:
        growth, variance = self.growth(normal), self.scatter(normal) ** 2
        mean = np.broadcast_to(self.middle[:, None], growth.shape)
        return _fit(mean, growth, self.own, variance)[1]


def _fit(
    gaps: FloatArray, growth: FloatArray, unshared_variance: FloatArray, variance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Fit δ(t₁) and Δ by generalised least squares; return them, (2, particle), and ln likelihood.

    The model is gaps = δ(t₁) + Δ u + W + errors, with W a normal random walk of variance
    ``variance`` · u. The likelihood is the restricted one. All arguments but
    ``unshared_variance`` have shape (snapshot, particle) or (particle,). A Kalman filter removes
    the walk one snapshot at a time, so the cost is linear in the snapshots.
    """
    columns = np.stack([np.ones(gaps.shape), growth, gaps - gaps[0]])
    state, state_variance = np.zeros((3, gaps.shape[1])), np.zeros(gaps.shape[1])
    products, log_determinant = np.zeros((3, 3, gaps.shape[1])), 0.0
    previous = np.zeros(gaps.shape[1])
    for k, noise in enumerate(unshared_variance):
        state_variance = state_variance + variance * (growth[k] - previous)
        previous = growth[k]
        innovation_variance = state_variance + noise
        innovation = columns[:, k] - state
        products += innovation[:, None] * innovation[None] / innovation_variance
        log_determinant = log_determinant + np.log(innovation_variance)
        gain = state_variance / innovation_variance
        state, state_variance = state + gain * innovation, state_variance * (1.0 - gain)
    (a, b, e), (_, c, f), (_, _, squares) = products
    determinant = a * c - b * b
    line = np.stack([c * e - b * f, a * f - b * e]) / determinant
    misfit = squares - line[0] * e - line[1] * f
    log_likelihood = -0.5 * (log_determinant + np.log(determinant) + misfit)
    line[0] += gaps[0]
    return line, log_likelihood


def _tempered(problem: _Problem, generator: np.random.Generator) -> FloatArray:
    """Standard normal numbers of equally weighted laws and scatters, by tempering: the
    likelihood is raised to the power ``beta``, from 0 to 1."""
    from scipy.stats import qmc

    uniform = qmc.Sobol(NORMALS + 1, rng=generator).random(PARTICLES)
    normal = ndtri(np.clip(uniform.T, 1e-9, 1.0 - 1e-9))
    log_likelihood, beta = problem.log_likelihood(normal), 0.0
    while beta < 1.0:
        step = _step(log_likelihood, 1.0 - beta)
        beta += step
        weight = np.exp(step * (log_likelihood - log_likelihood.max()))
        quantiles = (np.arange(PARTICLES) + generator.uniform()) / PARTICLES
        ancestors = np.searchsorted(np.cumsum(weight / weight.sum()), quantiles)
        ancestors = generator.permutation(np.minimum(ancestors, PARTICLES - 1))
        normal, log_likelihood = normal[:, ancestors], log_likelihood[ancestors]
        for _ in range(MOVES):
            # Differential-evolution step in a subset of the coordinates (ter Braak 2006).
            first_other = normal[:, generator.permutation(PARTICLES)]
            difference = normal[:, generator.permutation(PARTICLES)] - first_other
            size = generator.choice([0.1, 0.4, 0.8], PARTICLES)
            mask = generator.uniform(size=normal.shape) < generator.choice(
                [0.2, 0.5, 1.0], PARTICLES
            )
            noise = 0.01 * generator.standard_normal(normal.shape)
            proposal = normal + np.where(mask, size * difference, 0.0) + noise
            proposed_likelihood = problem.log_likelihood(proposal)
            log_ratio = beta * (proposed_likelihood - log_likelihood) - 0.5 * np.sum(
                proposal**2 - normal**2, axis=0
            )
            accepted = np.log(generator.uniform(size=PARTICLES)) < log_ratio
            normal = np.where(accepted, proposal, normal)
            log_likelihood = np.where(accepted, proposed_likelihood, log_likelihood)
    return np.asarray(normal)


def _step(log_likelihood: FloatArray, largest: float) -> float:
    """Largest tempering step that keeps ``LEAST_EFFECTIVE`` of the particles effective."""

    def effective(step: float) -> float:
        weight = np.exp(step * (log_likelihood - log_likelihood.max()))
        return float(weight.sum() ** 2 / np.sum(weight**2)) / log_likelihood.size

    if effective(largest) >= LEAST_EFFECTIVE:
        return largest
    return float(bisect(lambda step: effective(step) - LEAST_EFFECTIVE, 0.0, largest))


def _growth_needed(
    distance: FloatArray, jump: FloatArray, generator: np.random.Generator
) -> FloatArray:
    """Mean growth at which a gamma process first covers a distance; 0 if it already has. At a mean
    growth of m, the growth is gamma distributed with shape m / jump and scale ``jump``. The result
    is the m at which a uniformly drawn share of it lies below the distance."""
    distance_ahead = np.maximum(distance, 0.0)
    jumps = np.clip(distance_ahead / jump, 1e-12, _SMOOTH)
    shape = gdtrib(1.0, generator.uniform(size=jumps.size), jumps)
    return np.where(jumps < _SMOOTH, shape * jump, distance_ahead) * (distance > 0.0)


DAYS_PER_YEAR = 365.25


def years_between(first: Date, last: Date) -> float:
    """Time from one date to another, years."""
    return (last - first).days / DAYS_PER_YEAR


def wear_of(
    config: CompareConfig,
    answers: Sequence[Answer],
    seed: np.random.SeedSequence,
    change_reason: Reason | None = None,
) -> tuple[xr.Dataset | None, Reason | None]:
    """Group :data:`WEAR` of a comparison with its :data:`DATES`, and the reason if it has no rate.

    The group is ``None`` unless every recording has a date. ``change_reason`` says why the change
    of the gap is withheld, which withholds its rate too.
    """
    dates = config.dates
    if dates is None:
        return None, None
    used = since_repair([recording.repaired for recording in config.recordings])
    since, chosen = dates[used], answers[used]
    is_used = np.zeros(len(dates))
    is_used[used] = 1.0
    group = dataset(DATES, {"date": [d.isoformat() for d in dates], "used": is_used})
    if config.joint.decide_before is not None:
        group.attrs["decide_before"] = config.joint.decide_before.isoformat()
    if since[0] == since[-1]:
        repaired = config.recordings[used.start].repaired
        return group, Reason("one_date", {"count": len(since), "repaired": repaired})
    withheld = [answer.name for answer in chosen if answer.is_withheld]
    if withheld:
        return group, Reason("gap_withheld", {"names": withheld})
    if change_reason is not None:
        return group, change_reason
    years = np.array([years_between(since[0], day) for day in since])
    drift_seed, wear_seed = seed.spawn(2)
    measured = np.stack([a.delta_rad for a in chosen if a.delta_rad is not None])
    # Independent scatter at each date, for effects of temperature, grease and the like.
    scatter = np.random.default_rng(drift_seed).standard_normal(measured.shape)
    gap_draws = measured * np.exp(config.wear.relative_sd_per_date * scatter)
    start, limit = config.wear.in_service_since, limit_rad_of(config)
    age = None if start is None else max(years_between(start, since[0]), 0.0)
    if (significant_fall := fall(gap_draws)) is not None:
        number, fall_rad, deviations = significant_fall
        values = {"name": chosen[number].name, "fall_rad": fall_rad}
        return group, Reason("gap_fell", {**values, "standard_deviations": deviations})
    forecast = wear(gap_draws, years, wear_seed, limit_rad=limit, age_years=age)
    if forecast is None:
        return group, Reason("gap_shrank")
    group = group.merge(forecast).assign_attrs({**group.attrs, **forecast.attrs})
    if config.wear.relative_sd_per_date > 0.0:
        group.attrs["relative_sd_per_date"] = config.wear.relative_sd_per_date
        group.attrs["drift_widens"] = float(
            trend(gap_draws, years).std() / trend(measured, years).std()
        )
    return group, None


def used_dates(group: xr.Dataset) -> list[Date]:
    """Dates of the snapshots since the last repair."""
    stored = zip(group["date"].values, group["used"].values, strict=True)
    return [Date.fromisoformat(str(day)) for day, used in stored if used]


@dataclass(frozen=True, slots=True)
class WearDraws:
    """How a joint wears: paired draws, shape (draw,).

    ``rate_rad_per_year``: mean rate from the first snapshot in use to the last. ``kind``: index in
    :data:`KINDS` of the law at the last snapshot. ``jump_rad``: mean jump of irregular wear:
    variance of the growth over its mean. ``years_to_limit``: ``None`` without a limit.
    ``probability_wear``: probability that the gap grows at all, from lines of either sign.
    """

    rate_rad_per_year: FloatArray
    kind: NDArray[np.int_]
    jump_rad: FloatArray
    rate_now_rad_per_year: FloatArray
    years_to_limit: FloatArray | None = None
    probability_wear: float = 1.0

    @classmethod
    def of(cls, group: xr.Dataset) -> WearDraws | None:
        """Read group :data:`WEAR`; ``None`` if it has dates but no rate."""
        if "law" not in group:
            return None
        dates = used_dates(group)
        span = years_between(dates[0], dates[-1])
        rows = {str(name): group[name].values.ravel() for name in group.data_vars}
        return cls(
            (rows["current_rad"] - rows["first_rad"]) / span,
            rows["law"].astype(int),
            rows["scatter_rad_per_root_year"] ** 2 * span / rows["expected_growth_rad"],
            rows["rate_now_rad_per_year"],
            rows.get("years_to_limit"),
            float(np.mean(rows["trend_rad_per_year"] > 0.0)),
        )

    def at(self, draws: NDArray[np.int_]) -> WearDraws:
        """Select draws by index."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        rows: dict[str, Any] = {n: v[draws] for n, v in values.items() if isinstance(v, np.ndarray)}
        return replace(self, **rows)

    def summary(self, last: Date, of: IntervalConfig, before: Date | None) -> dict[str, Any]:
        """Keys of :class:`WearSummary` that follow from the draws.

        ``last``: date of the last snapshot; ``before``: the date to decide before.
        """
        level, kind = of.level, of.kind
        result: dict[str, Any] = {
            "probability_wear": self.probability_wear,
            "law": shares(self.kind),
            "rate": {**interval(self.rate_rad_per_year, level, kind), "unit": "rad/year"},
            "rate_now": {**interval(self.rate_now_rad_per_year, level, kind), "unit": "rad/year"},
            "rate_at_most_rad_per_year": float(np.quantile(self.rate_rad_per_year, level)),
        }
        if (years := self.years_to_limit) is not None:
            bounds = interval(years, level, kind)
            ends = {key: date_after(last, bounds[key]) for key in ("median", "low", "high")}
            earliest = date_after(last, float(np.quantile(years, 1.0 - level)))
            result |= {
                "years_to_limit": bounds,
                "date_of_limit": {**bounds, **ends},
                "not_before": {"date": earliest, "level": level},
            }
            if before is not None:
                passed = float(np.mean(years <= years_between(last, before)))
                result["probability_before"] = {"date": before.isoformat(), "probability": passed}
        return result


def summarise_wear(
    group: xr.Dataset,
    names: Sequence[str],
    of: IntervalConfig,
    limit_rad: float | None,
    stated_limit: str | None = None,
) -> dict[str, Any]:
    """Entry ``wear`` of a comparison's summary (see the module), without its ``reason``."""
    before = group.attrs.get("decide_before")
    dates = used_dates(group)
    result: dict[str, Any] = dict.fromkeys(WearSummary.__annotations__)
    result |= {
        "snapshots": [n for n, used in zip(names, group["used"].values, strict=True) if used],
        "first_date": dates[0].isoformat(),
        "last_date": dates[-1].isoformat(),
        "level": of.level,
        "relative_sd_per_date": float(group.attrs.get("relative_sd_per_date", 0.0)),
        "drift_widens": group.attrs.get("drift_widens"),
        "limit_rad": limit_rad,
        "limit": stated_limit,
        "decide_before": before,
    }
    draws = WearDraws.of(group)
    if draws is None:
        return result
    result |= draws.summary(dates[-1], of, None if before is None else Date.fromisoformat(before))
    if len(dates) >= FEWEST_FOR_SCATTER:
        scatter = group["scatter_rad_per_root_year"].values
        result["scatter_rad_per_root_year"] = interval(scatter, of.level, of.kind)
    if "width_over_prior" in group.attrs:
        result["forecast_from_prior"] = {
            "width_over_prior": float(group.attrs["width_over_prior"]),
            "probability_change_ahead": float(group["changes_ahead"].mean()),
        }
    return result


def date_after(first: Date, years: float) -> str | None:
    """The day ``years`` later, in ISO form; ``None`` beyond ``LONGEST_YEARS``."""
    if years >= LONGEST_YEARS:
        return None
    return (first + timedelta(days=round(years * DAYS_PER_YEAR))).isoformat()
